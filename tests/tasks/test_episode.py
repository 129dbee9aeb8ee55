"""What one trial leaves behind."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from orbisim.errors import DivergedError
from orbisim.tasks.episode import Episode, check_stable, clock


def test_mujocos_resets_are_noticed() -> None:
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data)
    check_stable(data)
    data.qvel[0] = 1e12
    mujoco.mj_step(model, data)
    with pytest.raises(DivergedError, match="unstable"):
        check_stable(data)


def test_times_do_not_add_up_rounding() -> None:
    time = clock(1000, 0.1)
    assert len(time) == 1001
    assert time[-1] == 100.0
    assert time[3] == 3 * 0.1


def test_steps_are_those_of_the_clock() -> None:
    episode = Episode("s", 0, "hash", {"time": clock(7, 0.1)}, {})
    assert episode.steps == 7
    assert episode.success is None
    assert np.isclose(episode.arrays["time"][-1], 0.7)
