"""A state that only sensors read."""

import numpy as np
import pytest

import orbisim
from orbisim.errors import RecordingError
from orbisim.recording import Recording, bind

BODY = """<mujoco><worldbody><body name="puck"><freejoint name="puck"/>
  <geom size=".1 .1 .1" type="box"/></body><body name="rod" pos="1 0 0">
  <joint name="hinge"/><geom size=".1" pos="0 0 -1"/></body></worldbody>
  <sensor><framepos name="place" objtype="xbody" objname="puck"/>
  <framequat name="turn" objtype="xbody" objname="puck"/>
  <framepos name="middle" objtype="body" objname="puck"/>
  <jointpos name="angle" joint="hinge"/><jointvel name="speed" joint="hinge"/>
  <jointpos name="late" joint="hinge" delay="0.01" nsample="20"/></sensor></mujoco>"""


def _signals() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    quat = rng.normal(size=(5, 4))
    return {
        "sensor/place": rng.normal(size=(5, 3)),
        "sensor/turn": quat / np.linalg.norm(quat, axis=1, keepdims=True),
        "sensor/angle": rng.normal(size=5),
        "sensor/speed": rng.normal(size=5),
    }


def test_joints_and_poses_from_their_sensors() -> None:
    signals = _signals()
    bound = bind(Recording(np.arange(5) * 0.01, signals), orbisim.load_scene(BODY))
    np.testing.assert_array_equal(bound.qpos[:, :3], signals["sensor/place"])
    turned = np.abs((bound.qpos[:, 3:7] * signals["sensor/turn"]).sum(axis=1))
    np.testing.assert_allclose(turned, 1.0)
    np.testing.assert_array_equal(bound.qpos[:, 7], signals["sensor/angle"])
    np.testing.assert_array_equal(bound.qvel[:, 6], signals["sensor/speed"])
    assert bound.measured == {0, 1}


def test_what_is_recorded_by_name_comes_first() -> None:
    signals = {**_signals(), "qpos/hinge": np.linspace(0, 1, 5)}
    bound = bind(Recording(np.arange(5) * 0.01, signals), orbisim.load_scene(BODY))
    np.testing.assert_array_equal(bound.qpos[:, 7], signals["qpos/hinge"])


@pytest.mark.parametrize("other", ["middle", "late"])
def test_a_sensor_of_something_else_is_no_state(other: str) -> None:
    signals = _signals()
    signals.pop({"middle": "sensor/place", "late": "sensor/angle"}[other])
    signals[f"sensor/{other}"] = np.zeros((5, 3)) if other == "middle" else np.zeros(5)
    with pytest.raises(RecordingError, match="not recorded"):
        bind(Recording(np.arange(5) * 0.01, signals), orbisim.load_scene(BODY))
