"""How long windows have to be for forces to outweigh what sensors do."""

import mujoco
import numpy as np
import pytest

import orbisim
from orbisim.recording import Recording
from orbisim.shooting.horizon import telling_window

GLIDER = """
<mujoco><option timestep="0.01" gravity="0 0 0"/><worldbody><body>
<joint name="glider" type="slide" axis="1 0 0"/><geom size=".1" mass="1"/>
</body></worldbody></mujoco>
"""


def _run(force: float, slow_error: float) -> Recording:
    """A glide under a force that the scene lacks, read with white noise and a slow error."""
    time, rng = np.arange(0, 12, 0.01), np.random.default_rng(0)
    noise = 1e-3 * rng.standard_normal(len(time)) + slow_error * np.sin(9 * time)
    position = 0.5 * time + force * time**2 / 2 + noise
    return Recording(time, {"qpos/glider": position})


@pytest.mark.parametrize(
    ("force", "slow_error", "window"), [(0.0, 0.0, 0.5), (0.2, 0.0, 2.0), (40.0, 0.0, 0.5)]
)
def test_as_long_as_a_force_needs(force: float, slow_error: float, window: float) -> None:
    scene = orbisim.load_scene(GLIDER)
    assert telling_window(scene, [_run(force, slow_error)]) == window


def test_what_is_thinned_has_no_longer_steps() -> None:
    """A driven arm, logged at 500 Hz, whose scene has a timestep of 20 ms: in steps of 4 ms, as
    every second of its samples is left out in a second, it errs four times as much as in those of
    2 ms, and that was taken for a force."""
    arm = """
    <mujoco><option timestep="{}"/><worldbody><body>
    <joint name="arm" axis="0 1 0" damping=".02"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".1"/>
    </body></worldbody><actuator><motor name="m" joint="arm"/></actuator></mujoco>"""
    model = mujoco.MjModel.from_xml_string(arm.format(0.001))
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    time = 0.002 * np.arange(5000)
    torque = 0.3 * np.sin(8 * time) + 0.1 * np.sin(26 * time)
    angle = np.empty(len(time))
    for k, value in enumerate(torque):
        angle[k], data.ctrl[0] = data.qpos[0], value
        mujoco.mj_step(model, data, 2)
    angle += 1e-3 * rng.standard_normal(len(time))
    run = Recording(time, {"qpos/arm": angle, "ctrl/m": torque})
    assert telling_window(orbisim.load_scene(arm.format(0.02)), [run]) == 0.5
