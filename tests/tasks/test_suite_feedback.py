"""Feedback policies of the suite's domains."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from orbisim import suite
from orbisim.errors import UnknownNameError
from orbisim.tasks.suite_feedback import energy, feedback, has_feedback, lqr, wrap


@pytest.mark.parametrize(
    ("name", "least"),
    [("pendulum-swingup", 800), ("cartpole-swingup", 500), ("point_mass-easy", 600)],
)
def test_feedback_earns_a_return(name: str, least: float) -> None:
    domain, task = name.split("-")
    environment = suite.load(domain, task, task_kwargs={"random": 1})
    step, total = environment.reset(), 0.0
    policy = feedback(domain, environment.physics.model.ptr, environment.control_timestep())
    while not step.last():
        step = environment.step(policy(environment.physics.data.ptr))
        total += step.reward
    assert total > least


POLE = """
<mujoco><option timestep="0.01"><flag contact="disable"/></option><worldbody>
<body><joint name="j" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 1" size=".02" mass="1"/>
</body></worldbody><actuator><motor joint="j" gear="20"/></actuator></mujoco>
"""


def test_a_regulator_holds_what_falls_by_itself() -> None:
    model = mujoco.MjModel.from_xml_string(POLE)
    gain = lqr(model, 0.02, np.array([1.0, 0.1]), 1.0)
    ends = []
    for k in (gain, 0 * gain):
        data = mujoco.MjData(model)
        data.qpos[0] = 0.05
        for _ in range(200):
            data.ctrl[:] = -k @ [data.qpos[0], data.qvel[0]]
            mujoco.mj_step(model, data, 2)
        ends.append(abs(float(data.qpos[0])))
    assert ends[0] < 1e-3
    assert ends[1] > 0.5


def test_a_regulator_of_a_mass_has_the_known_gain() -> None:
    """Double integrator, u = -k x: for long the gains of the continuous problem (1, sqrt 3)."""
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody><body>
        <joint name="j" type="slide"/><geom size=".1" mass="1"/></body></worldbody>
        <actuator><motor joint="j"/></actuator></mujoco>"""
    )
    step = 0.001
    gain = lqr(model, step, step * np.ones(2), step)  # sums that approach the integrals
    np.testing.assert_allclose(gain, [[1.0, np.sqrt(3)]], rtol=2e-3)


def test_energy_is_mujocos() -> None:
    model = mujoco.MjModel.from_xml_string(POLE)
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = 0.4, 1.5
    mujoco.mj_forward(model, data)
    found = energy(model, mujoco.MjData(model), np.array([0.4]), np.array([1.5]))
    assert found == pytest.approx(data.energy.sum())


def test_angles() -> None:
    for angle in (-9.0, -np.pi / 2, 0.0, 1.0, 100.0):
        assert -np.pi <= wrap(angle) <= np.pi
        assert np.exp(1j * wrap(angle)) == pytest.approx(np.exp(1j * angle))


def test_domains_without_a_policy() -> None:
    assert has_feedback("walker")
    assert not has_feedback("dog")
    with pytest.raises(UnknownNameError, match="'dog'"):
        feedback("dog", mujoco.MjModel.from_xml_string(POLE), 0.02)
