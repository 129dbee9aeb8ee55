"""Tests that every backend, renderer and reader must pass, for third parties to inherit, and
recordings of scenes with effects that they do not declare.

```python
from orbisim.testing import BackendConformance

class TestMine(BackendConformance):
    backend = "mine"
```

Run them with pytest. Names are imported when they are first used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from orbisim.host.lazy import lazy

if TYPE_CHECKING:
    from orbisim.testing import scenes as scenes
    from orbisim.testing.backend import BackendConformance as BackendConformance
    from orbisim.testing.inject import inject_effect as inject_effect
    from orbisim.testing.reader import ReaderConformance as ReaderConformance
    from orbisim.testing.renderer import RendererConformance as RendererConformance

_HOMES = {
    "BackendConformance": "orbisim.testing.backend",
    "ReaderConformance": "orbisim.testing.reader",
    "RendererConformance": "orbisim.testing.renderer",
    "inject_effect": "orbisim.testing.inject",
}
_MODULES = ("scenes",)

__all__ = [
    "BackendConformance",
    "ReaderConformance",
    "RendererConformance",
    "inject_effect",
    "scenes",
]


__getattr__, __dir__ = lazy(__name__, _HOMES, _MODULES)
