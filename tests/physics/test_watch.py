"""Whatever a task changes in a model is noticed, once."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import pytest

from orbisim.physics.watch import ModelWatch

SCENE = """
<mujoco>
  <asset><hfield name="h" nrow="2" ncol="2" size="1 1 1 1"/></asset>
  <worldbody>
    <geom type="hfield" hfield="h"/>
    <light name="l"/>
    <body name="b"><joint name="j"/><geom name="g" size=".1"/></body>
  </worldbody>
  <actuator><motor joint="j"/></actuator>
</mujoco>
"""

CHANGES: dict[str, Callable[[mujoco.MjModel], object]] = {
    "mass": lambda m: m.body_mass.__setitem__(1, 3.0),
    "friction": lambda m: m.geom_friction.__setitem__((1, 0), 0.3),
    "gear": lambda m: m.actuator_gear.__setitem__((0, 0), 2.0),
    "height field": lambda m: m.hfield_data.__setitem__(0, 0.5),
    "timestep": lambda m: setattr(m.opt, "timestep", 0.001),
    "gravity": lambda m: m.opt.gravity.__setitem__(2, -1.6),
    "wind": lambda m: m.opt.wind.__setitem__(0, 1.0),
    "magnetic": lambda m: m.opt.magnetic.__setitem__(0, 1.0),
    "wind in its last digit": lambda m: m.opt.wind.__setitem__(0, 5e-324),
    "density": lambda m: setattr(m.opt, "density", 1000.0),
    "cone": lambda m: setattr(m.opt, "cone", int(mujoco.mjtCone.mjCONE_ELLIPTIC)),
    "impratio": lambda m: setattr(m.opt, "impratio", 5.0),
    "solver": lambda m: setattr(m.opt, "solver", int(mujoco.mjtSolver.mjSOL_CG)),
    "iterations": lambda m: setattr(m.opt, "iterations", 3),
    "tolerance": lambda m: setattr(m.opt, "tolerance", 1e-3),
    "integrator": lambda m: setattr(m.opt, "integrator", int(mujoco.mjtIntegrator.mjINT_RK4)),
    "no contacts": lambda m: setattr(
        m.opt, "disableflags", int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    ),
    "contact parameters": lambda m: m.opt.o_solref.__setitem__(0, 0.5),
    "actuator group": lambda m: setattr(m.opt, "disableactuator", 1),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_change_is_noticed_once(name: str) -> None:
    model = mujoco.MjModel.from_xml_string(SCENE)
    watch = ModelWatch(model)
    assert not watch.changed()
    CHANGES[name](model)
    assert watch.changed()
    assert not watch.changed()


def test_actuation_is_switched_off_for_a_moment_by_dm_control_itself() -> None:
    """Its `forward` and `reset` do so; the scene is the same."""
    model = mujoco.MjModel.from_xml_string(SCENE)
    watch = ModelWatch(model)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    assert not watch.changed()
