"""Tests that every backend and renderer must pass, for third parties to inherit.

```python
from orbisim.testing import BackendConformance

class TestMine(BackendConformance):
    backend = "mine"
```

Run them with pytest.
"""

from orbisim.testing import scenes
from orbisim.testing.backend import BackendConformance
from orbisim.testing.renderer import RendererConformance

__all__ = ["BackendConformance", "RendererConformance", "scenes"]
