"""How long windows have to be for forces to outweigh what sensors do."""

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
