"""Tasks by name."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

from orbisim.episodes import Episodes
from orbisim.errors import InputError, UnknownNameError
from orbisim.scene import Scene
from orbisim.tasks.base import Task
from orbisim.tasks.domains import MECHANISMS

_TASKS: dict[str, str | type[Task]] = {
    "push": "orbisim.tasks.push:Push",
    "push_hold": "orbisim.tasks.push_hold:PushHold",
    "shove": "orbisim.tasks.shove:Shove",
    "push_cubes": "orbisim.tasks.push_cubes:PushCubes",
    "pick_and_place": "orbisim.tasks.pick_and_place:PickAndPlace",
    "ball": "orbisim.tasks.ball:Ball",
    "drape": "orbisim.tasks.drape:Drape",
    "stack": "orbisim.tasks.stack:Stack",
    "toss": "orbisim.tasks.toss:Toss",
}


_SUITE = "orbisim.tasks.suite:SuiteTask"
_SCENE = "orbisim.tasks.scene_task:SceneTask"
_MECHANISM = "orbisim.tasks.mechanism:MechanismTask"


def available() -> tuple[str, ...]:
    """Names of the tasks (of the suite's, see `orbisim.suite.ALL_TASKS`)."""
    return tuple(sorted([*_TASKS, *(f"mechanism:{family}" for family in MECHANISMS)]))


def register(name: str, task: type[Task]) -> None:
    """Adds a task for this process.

    Raises:
      InputError: the name has a colon or a hyphen, or the class is not a task.
    """
    if not name or ":" in name or "-" in name:
        raise InputError(f"a task's name is not empty and has no colon or hyphen; got {name!r}")
    if not (isinstance(task, type) and issubclass(task, Task)):
        raise InputError(f"{name!r} must be a subclass of Task; got {task!r}")
    _TASKS[name] = task


def make(name: str, **changes: Any) -> Task:
    """A task by name: `push`, `task:mechanism:door`, `suite:cheetah-run`; or a scene's path.

    Args:
      name: its name; what has a suffix, such as `arm.xml`, is a path.
      **changes: fields of its configuration to replace (`table_friction=0.1`).

    Raises:
      UnknownNameError: there is no such task, or no such field.
      SceneError: the scene cannot be read.
    """
    prefix, _, rest = name.partition(":")
    if prefix == "suite" and rest:
        return _imported(_SUITE)(rest, **changes)
    if Path(name).suffix:
        return _imported(_SCENE)(name, **changes)
    short = rest if prefix == "task" and rest else name
    kind, _, family = short.partition(":")
    if kind == "mechanism" and family in MECHANISMS:
        return _imported(_MECHANISM)(family, **changes)
    if short not in _TASKS:
        known = [f"task:{n}" for n in available()] if prefix == "task" else list(available())
        raise UnknownNameError("task", name, [*known, "suite:cheetah-run"])
    found = _TASKS[short]
    task: Task = (_imported(found) if isinstance(found, str) else found)(**changes)
    return task


def _imported(place: str) -> Any:
    module, _, attribute = place.partition(":")
    return getattr(importlib.import_module(module), attribute)


def load_scene(name: str) -> Scene:
    """The nominal scene of a task, by `push` or `push-to_hit`.

    Raises:
      UnknownNameError: there is no such task or subtask.
    """
    task, subtask = split(name)
    return make(f"task:{task}").scene(subtask)


def episodes(name: str, count: int, seed: int) -> Episodes:
    """Episodes on a scene drawn from a task's distribution, with the controls of its policy.

    Raises:
      UnknownNameError: there is no such task or subtask.
    """
    task, subtask = split(name)
    return make(f"task:{task}").trials(count, seed, subtask)


def split(name: str) -> tuple[str, str | None]:
    """`push-to_hit` as (`push`, `to_hit`), `push` as (`push`, None)."""
    task, _, subtask = name.partition("-")
    return task, subtask or None
