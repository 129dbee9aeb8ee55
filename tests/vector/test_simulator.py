"""Steps of many worlds end as dm_control's."""

from __future__ import annotations

import copy
from typing import Any

import mujoco
import numpy as np
import pytest
from dm_control.suite import cheetah, pendulum

from orbisim.vector.models import ModelFields
from orbisim.vector.simulator import Threads
from orbisim.vector.worlds import NotBatchedError

NWORLD = 3


def made(physics: Any, **options: Any) -> tuple[Threads, ModelFields]:
    model = physics.model.ptr
    fields = ModelFields(model, copy.copy(model), NWORLD)
    simulator = Threads(model, fields, NWORLD, **options)
    for world in range(NWORLD):
        simulator.set_world(world, physics.data.ptr)
    return simulator, fields


@pytest.mark.parametrize("domain", [cheetah, pendulum], ids=["Euler", "Runge-Kutta"])
@pytest.mark.parametrize("legacy", [True, False])
def test_derived_fields_are_dm_controls(domain: Any, legacy: bool) -> None:
    physics = domain.Physics.from_xml_string(*domain.get_model_and_assets())
    if domain is pendulum:
        physics.model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    physics.legacy_step = legacy
    with physics.reset_context():
        physics.data.qvel[:] = 0.3
    simulator, _ = made(physics, legacy_step=legacy)
    for control in (0.5, -0.2):
        simulator.ctrl[:] = control
        physics.set_control(np.full(physics.model.nu, control))
        physics.step(3)
        assert not simulator.step(np.arange(NWORLD), 3).any()
        for name in ("qpos", "xpos", "sensordata", "qacc", "subtree_com", "time", "qfrc_bias"):
            found = simulator.field(name)
            for world in range(NWORLD):
                np.testing.assert_array_equal(found[world], getattr(physics.data, name), name)


def test_worlds_that_are_not_stepped_stay() -> None:
    physics = cheetah.Physics.from_xml_string(*cheetah.get_model_and_assets())
    simulator, _ = made(physics)
    simulator.step(np.array([0, 2]), 1)
    assert (simulator.state.time > 0).tolist() == [True, False, True]


def test_models_of_worlds() -> None:
    """Fields that a batch can vary, and then one that it cannot: each world gets a model."""
    xml = """<mujoco><asset><hfield name="h" nrow="3" ncol="3" size="1 1 1 .1"/></asset>
      <worldbody><geom type="hfield" hfield="h"/>
        <body pos="0 0 2"><freejoint/><geom size=".1"/></body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    fields = ModelFields(model, copy.copy(model), NWORLD)
    simulator = Threads(model, fields, NWORLD)
    every = np.arange(NWORLD)
    fields.vary("opt.gravity")[:, 2] = [0.0, -1.0, -2.0]
    simulator.set_models(every)
    simulator.step(every, 1)
    step = model.opt.timestep
    np.testing.assert_allclose(simulator.state.qvel[:, 2], [0.0, -step, -2 * step])
    fields.vary("hfield_data")[1] = 0.5
    simulator.set_models(every)
    simulator.step(every, 1)
    np.testing.assert_allclose(simulator.state.qvel[:, 2], [0.0, -2 * step, -4 * step])
    assert simulator._models is not None
    assert simulator._models[1].hfield_data[0] == 0.5 and simulator._models[2].hfield_data[0] == 0


def test_fields_that_there_are_not() -> None:
    physics = cheetah.Physics.from_xml_string(*cheetah.get_model_and_assets())
    with pytest.raises(NotBatchedError, match="contact"):
        made(physics)[0].field("contact")
