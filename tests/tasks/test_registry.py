"""Tasks by name."""

from __future__ import annotations

import pytest

from orbisim.errors import InputError, UnknownNameError
from orbisim.tasks import registry
from orbisim.tasks.ball import Ball
from orbisim.tasks.registry import available, make, register, split
from orbisim.tasks.suite import SuiteTask


class Mine(Ball):
    name = "mine"


@pytest.fixture(autouse=True)
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "_TASKS", dict(registry._TASKS))


@pytest.mark.parametrize("name", available())
def test_every_task_has_its_name(name: str) -> None:
    assert make(name).label == make(f"task:{name}").label == f"task:{name}"


def test_tasks_of_the_suite() -> None:
    task = make("suite:cheetah-run", steps=3)
    assert isinstance(task, SuiteTask)
    assert task.label == "suite:cheetah-run"
    assert task.config.steps == 3


def test_one_of_ones_own() -> None:
    register("mine", Mine)
    assert "mine" in available()
    assert registry.load_scene("mine").source == "task:mine"
    assert len(registry.episodes("mine-throw", 2, 0).initial.qpos) == 2


@pytest.mark.parametrize(
    ("name", "task"), [("a-b", Mine), ("a:b", Mine), ("", Mine), ("a", Mine())]
)
def test_what_cannot_be_registered(name: str, task: object) -> None:
    with pytest.raises(InputError):
        register(name, task)  # type: ignore[arg-type]


def test_names_with_subtasks() -> None:
    assert split("push-to_hit") == ("push", "to_hit")
    assert split("push") == ("push", None)


@pytest.mark.parametrize("name", ["pusch", "task:pusch", "task:", "suite:", "ball:throw"])
def test_unknown_names(name: str) -> None:
    with pytest.raises(UnknownNameError):
        make(name)
