"""Episodes of the suite."""

from __future__ import annotations

import numpy as np
import pytest

from orbisim import tasks
from orbisim.errors import UnknownNameError
from orbisim.tasks.domains import SUITE_TASKS
from orbisim.tasks.suite import start


@pytest.mark.parametrize("name", SUITE_TASKS)
def test_every_policy_gives_finite_motion_within_the_control_range(name: str) -> None:
    task = tasks.make(f"suite:{name}", steps=40)
    for subtask in task.subtasks:
        episode = task.episode(subtask, 1)
        model = task.scene(subtask, 1).model
        ctrl = episode.arrays["ctrl"]
        assert ctrl.shape == (40, model.nu)
        assert np.isfinite(episode.arrays["qpos"]).all()
        assert (ctrl >= model.actuator_ctrlrange[:, 0]).all()
        assert (ctrl <= model.actuator_ctrlrange[:, 1]).all()
        assert np.abs(np.diff(episode.arrays["qpos"], axis=0)).max() > 1e-4
        assert "robot/pos" not in episode.arrays


def test_an_episode_does_not_depend_on_what_ran_before() -> None:
    first = start("reacher", "easy", 5)[0].model.ptr.geom_pos.copy()
    start("reacher", "easy", 6)
    np.testing.assert_array_equal(start("reacher", "easy", 5)[0].model.ptr.geom_pos, first)


def test_unknown_tasks() -> None:
    with pytest.raises(UnknownNameError, match="did you mean"):
        tasks.make("suite:cheetah-walk")
    with pytest.raises(UnknownNameError, match="did you mean 'push'"):
        tasks.make("pusch")
