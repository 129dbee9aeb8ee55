"""The web viewer: meshcat, for saved trajectories and for any backend live.

```python
from orbisim.view import ViewOptions, save_html, view_live, view_trajectory

save_html("run.html", scene, trajectory, ghost=other)  # one file, works without a network
view_trajectory(scene, trajectory)  # the same, served on this machine
view_live(scene, backend="warp")  # simulates in real time until Ctrl-C
```

Names are imported when they are first used; they need the extra `view`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from orbisim.errors import MissingDependencyError
from orbisim.host.lazy import lazy

if TYPE_CHECKING:
    from orbisim.view.live import view_live as view_live
    from orbisim.view.options import ViewOptions as ViewOptions
    from orbisim.view.saved import save_html as save_html
    from orbisim.view.saved import trajectory_html as trajectory_html
    from orbisim.view.saved import view_trajectory as view_trajectory
    from orbisim.view.simulation import Policy as Policy

_HOMES = {
    "Policy": "orbisim.view.simulation",
    "ViewOptions": "orbisim.view.options",
    "save_html": "orbisim.view.saved",
    "trajectory_html": "orbisim.view.saved",
    "view_live": "orbisim.view.live",
    "view_trajectory": "orbisim.view.saved",
}
"""Public names and the modules that define them."""

_NEEDED = ("meshcat", "umsgpack", "tornado", "PIL")

__all__ = list(_HOMES)


_find, __dir__ = lazy(__name__, _HOMES)


def __getattr__(name: str) -> Any:
    try:
        return _find(name)
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in _NEEDED:
            raise
        raise MissingDependencyError("the viewer", "view", str(error)) from error
