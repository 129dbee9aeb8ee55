"""Tasks: scenes drawn from a distribution, scripted policies, and episodes collected from both.

```python
from orbisim import tasks

task = tasks.make("push")
episode = task.episode("to_hit", seed=3)
with tasks.EpisodeFile("push.h5") as file:
    batch = file.stack(["objects/pos", "objects/quat", "action"])
```

See docs/tasks.md for the tasks and docs/episodes.md for the file format. `EpisodeFile` needs
neither MuJoCo nor torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from orbisim.host.lazy import lazy

if TYPE_CHECKING:
    from orbisim.tasks.base import Task as Task
    from orbisim.tasks.collect import Collection as Collection
    from orbisim.tasks.dataset import EpisodeFile as EpisodeFile
    from orbisim.tasks.episode import Episode as Episode
    from orbisim.tasks.registry import available as available
    from orbisim.tasks.registry import make as make
    from orbisim.tasks.registry import register as register

_HOMES = {
    "Collection": "orbisim.tasks.collect",
    "Episode": "orbisim.tasks.episode",
    "EpisodeFile": "orbisim.tasks.dataset",
    "Task": "orbisim.tasks.base",
    "available": "orbisim.tasks.registry",
    "make": "orbisim.tasks.registry",
    "register": "orbisim.tasks.registry",
}

__all__ = [*_HOMES]


__getattr__, __dir__ = lazy(__name__, _HOMES)
