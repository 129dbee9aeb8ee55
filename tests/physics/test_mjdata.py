"""One world in, one world out: what of MjData is the state, and what is derived from it."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from orbisim.physics.mjdata import acceleration_sensors, read_state, write_state
from orbisim.state import MEMORY, State

RICH = """
<mujoco>
  <worldbody>
    <body name="hand" mocap="true"/>
    <body name="arm" pos="0 0 1">
      <joint name="hinge" axis="0 1 0"/><geom size=".1" fromto="0 0 0 .3 0 0" type="capsule"/>
      <site name="tip"/>
    </body>
  </worldbody>
  <actuator><general joint="hinge" dyntype="filter" dynprm=".1" gainprm="3"/></actuator>
  <sensor>
    <accelerometer site="tip"/><jointpos joint="hinge"/><gyro site="tip"/><torque site="tip"/>
    <jointactuatorfrc joint="hinge"/><clock/>
  </sensor>
</mujoco>
"""


@pytest.fixture
def model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(RICH)


def disturbed(model: mujoco.MjModel, steps: int) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.ctrl[:], data.qvel[:], data.mocap_pos[:] = 0.7, 2.0, [1, 2, 3]
    data.qfrc_applied[:], data.xfrc_applied[2] = 0.1, [0, 0, 0.2, 0, 0, 0]
    mujoco.mj_step(model, data, steps)
    return data


def test_what_is_written_goes_on_as_what_was_read(model: mujoco.MjModel) -> None:
    """Bit for bit, warm start and applied forces included."""
    first = disturbed(model, 7)
    second = mujoco.MjData(model)
    write_state(second, read_state(first))
    second.ctrl[:] = first.ctrl
    for data in (first, second):
        mujoco.mj_step(model, data, 5)
    assert first.time == second.time
    for name in ("qpos", "qvel", "act", "mocap_pos", "qacc_warmstart"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name), err_msg=name)
    assert first.act[0] != 0


def test_the_state_is_a_copy(model: mujoco.MjModel) -> None:
    data = disturbed(model, 1)
    state = read_state(data)
    kept = state.qpos.copy()
    data.qpos[:] = 9.0
    data.mocap_pos[:] = 9.0
    np.testing.assert_array_equal(state.qpos, kept)
    np.testing.assert_array_equal(state.memory["mocap_pos"][0, 0], [1, 2, 3])


def test_memory_is_what_the_scene_has() -> None:
    bare = mujoco.MjModel.from_xml_string("<mujoco/>")
    state = read_state(mujoco.MjData(bare))
    assert state.qpos.shape == (1, 0)
    assert not {"mocap_pos", "mocap_quat"} & state.memory.keys()
    assert state.memory.keys() <= set(MEMORY)


def test_one_world_of_many_from_any_array_library(model: mujoco.MjModel) -> None:
    torch = pytest.importorskip("torch")
    state = State(
        time=torch.tensor([0.0, 4.0]),
        qpos=torch.tensor([[0.1], [0.2]], requires_grad=True),
        qvel=torch.tensor([[1.0], [2.0]]),
        act=torch.tensor([[3.0], [4.0]]),
        memory={"mocap_pos": torch.full((2, 1, 3), 5.0), "private": torch.zeros(2)},
    )
    data = mujoco.MjData(model)
    write_state(data, state, world=1)
    assert (data.time, data.qvel[0], data.act[0]) == (4.0, 2.0, 4.0)
    assert data.qpos[0] == np.float32(0.2)
    assert data.mocap_pos.tolist() == [[5, 5, 5]]


def test_acceleration_sensors_are_those_that_need_accelerations(model: mujoco.MjModel) -> None:
    """Those that a position or velocity stage leaves as they are."""
    data = mujoco.MjData(model)
    data.sensordata[:] = np.nan
    data.qvel[:] = 1.0
    mujoco.mj_step1(model, data)
    left = np.flatnonzero(np.isnan(data.sensordata))
    np.testing.assert_array_equal(acceleration_sensors(model), left)
    assert left.size == 3 + 3 + 1
    none = acceleration_sensors(mujoco.MjModel.from_xml_string("<mujoco/>"))
    assert none.shape == (0,)
