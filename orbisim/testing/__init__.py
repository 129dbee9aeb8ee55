"""Tests that every backend and renderer must pass, for third parties to inherit, and recordings
of scenes with effects that they do not declare.

```python
from orbisim.testing import BackendConformance

class TestMine(BackendConformance):
    backend = "mine"
```

Run them with pytest. Names are imported when they are first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from orbisim.testing import scenes as scenes
    from orbisim.testing.backend import BackendConformance as BackendConformance
    from orbisim.testing.inject import inject_effect as inject_effect
    from orbisim.testing.renderer import RendererConformance as RendererConformance

_HOMES = {
    "BackendConformance": "orbisim.testing.backend",
    "RendererConformance": "orbisim.testing.renderer",
    "inject_effect": "orbisim.testing.inject",
}
_MODULES = ("scenes",)

__all__ = ["BackendConformance", "RendererConformance", "inject_effect", "scenes"]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        value = getattr(importlib.import_module(_HOMES[name]), name)
        globals()[name] = value
        return value
    if name in _MODULES:
        return importlib.import_module(f"orbisim.testing.{name}")
    raise AttributeError(f"module 'orbisim.testing' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
