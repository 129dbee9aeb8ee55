"""Open-loop episodes: where they start, what controls them."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from orbisim.episodes import HORIZON, episodes, random_controls, random_initial_states
from orbisim.errors import SceneError, UnknownNameError
from orbisim.state import State

MIXED = """
<mujoco model="mixed">
  <compiler angle="radian"/>
  <option timestep="0.01"/>
  <worldbody>
    <body name="box" pos="0 0 1"><freejoint/><geom type="box" size="0.1 0.1 0.1" mass="1"/></body>
    <body name="arm" pos="2 0 1">
      <joint name="hinge" axis="0 1 0" range="-0.02 0.02" limited="true"/>
      <joint name="slide" type="slide"/>
      <geom size="0.1"/></body>
  </worldbody>
  <actuator>
    <motor joint="hinge" ctrlrange="-2 4" ctrllimited="true"/><motor joint="slide"/>
  </actuator>
  KEYS
</mujoco>
"""


def model(keys: str = "") -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(MIXED.replace("KEYS", keys))


def test_hinges_and_slides_start_at_random_within_their_limits() -> None:
    states = random_initial_states(model(), 200, 0)
    hinge, slide = states.qpos[:, 7], states.qpos[:, 8]
    assert np.abs(hinge).max() == 0.02  # most would be beyond it
    assert 0.009 < np.abs(slide).max() <= 0.01
    assert slide.std() == pytest.approx(0.01 / np.sqrt(3), rel=0.1)  # uniform
    np.testing.assert_array_equal(states.qpos[:, :7], np.tile([0, 0, 1, 1, 0, 0, 0], (200, 1)))
    assert not states.qvel.any()


def test_the_first_keyframe_is_where_they_start() -> None:
    keys = "<keyframe><key qpos='5 0 1 1 0 0 0 0 3' qvel='1 0 0 0 0 0 0 2'/><key/></keyframe>"
    states = random_initial_states(model(keys), 4, 0)
    assert (states.qpos[:, 0] == 5).all()
    assert states.qpos[:, 8].tolist() == pytest.approx([3.0] * 4, abs=0.01)
    assert (states.qvel[:, -1] == 2).all()


def test_the_seed_decides() -> None:
    def numbers(seed: int) -> bytes:
        states = random_initial_states(model(), 5, seed)
        return states.qpos.tobytes() + random_controls(model(), 2, 3, 0.1, seed).tobytes()

    assert numbers(1) == numbers(1)
    assert numbers(1) != numbers(2)


def test_controls_stay_within_their_ranges() -> None:
    controls = random_controls(model(), 4, 500, 0.01, 0)
    assert controls.shape == (4, 500, 2)
    assert controls[..., 0].min() == -2
    assert controls[..., 0].max() == 4
    assert controls[..., 0].mean() == pytest.approx(1, abs=0.3)
    assert np.abs(controls[..., 1]).max() == 1


@pytest.mark.parametrize("step", [0.01, 0.05])
def test_controls_are_correlated_over_a_tenth_of_a_second(step: float) -> None:
    """Whatever the step: a first-order filter forgets by exp(-t / 0.1 s)."""
    controls = random_controls(model(), 20, 2000, step, 3)[..., 0] - 1.0
    lag = round(0.1 / step)
    correlation = np.mean(controls[:, lag:] * controls[:, :-lag]) / np.mean(controls**2)
    assert correlation == pytest.approx(np.exp(-1), abs=0.05)


def test_episodes_of_a_string_are_random() -> None:
    made = episodes(MIXED.replace("KEYS", ""), 3, 7)
    assert isinstance(made.initial, State)
    assert made.initial.nworld == 3
    assert made.horizon == HORIZON
    assert made.controls(0.3, 0.1, 0).shape == (3, 3, 2)
    assert made.controls(0.001, 0.1, 0).shape == (3, 1, 2)  # at least one


def test_episodes_of_a_task_start_where_the_task_does() -> None:
    made = episodes("suite:cartpole-balance", 3, 7)
    assert made.scene.model.nu == 1
    assert made.initial.nworld == 3
    assert len(np.unique(made.initial.qpos[:, 0])) == 3


def test_names_that_are_neither() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'cartpole-balance'"):
        episodes("suite:cartpoel-balance", 1, 0)
    with pytest.raises(SceneError, match="no such file"):
        episodes("nothing.xml", 1, 0)
