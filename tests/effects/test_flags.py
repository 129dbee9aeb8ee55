"""Effects in scenes whose flags switch off what they need."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import orbisim
from orbisim.effects import EffectInstance, add_effects
from orbisim.scene import Scene

ARM = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"><flag {flag}="disable"/></option>
  <worldbody>
    <geom type="plane" size="2 2 .1" pos="0 0 -0.3"/>
    <body>
      <joint name="one" axis="0 1 0" range="-20 20" limited="true" frictionloss="0.3"/>
      <geom type="capsule" size=".02" fromto="0 0 0 .3 0 0" mass="1"/>
      <body pos=".3 0 0">
        <joint name="two" axis="0 1 0" range="-20 20" limited="true" frictionloss="0.3"/>
        <geom type="capsule" size=".02" fromto="0 0 0 .3 0 0" mass="1"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def arm(flag: str) -> Scene:
    return orbisim.load_scene(ARM.format(flag=flag))


def fall(scene: Scene, steps: int = 300) -> tuple[np.ndarray, np.ndarray]:
    data = mujoco.MjData(scene.model)
    data.qvel[:] = 1.0, -2.0
    mujoco.mj_step(scene.model, data, steps)
    return data.qpos.copy(), data.qvel.copy()


def friction(torque: float) -> EffectInstance:
    return EffectInstance("coulomb_friction", "one", {"torque": torque})


def stop(side: float) -> EffectInstance:
    return EffectInstance("hard_stop", "one", {"position": side * 0.5, "side": side})


@pytest.mark.parametrize("flag", ["constraint", "frictionloss"])
def test_an_effect_of_no_size_leaves_all_that_the_flag_keeps_off_off(flag: str) -> None:
    """Limits, contacts and the friction that is declared at joints act no more than before."""
    scene = arm(flag)
    for place, there in zip(fall(add_effects(scene, [friction(0.0)])), fall(scene), strict=True):
        np.testing.assert_array_equal(place, there)


@pytest.mark.parametrize("flag", ["constraint", "limit"])
def test_a_stop_where_limits_are_off_leaves_the_declared_ones_off(flag: str) -> None:
    scene = arm(flag)
    far = add_effects(scene, [EffectInstance("hard_stop", "one", {"position": 50.0, "side": 1.0})])
    for place, there in zip(fall(far), fall(scene), strict=True):
        np.testing.assert_array_equal(place, there)
    assert fall(scene)[0][0] > 1.0  # beyond where the stop is put, and the declared range
    assert fall(add_effects(scene, [stop(1.0)]))[0][0] < 0.6


def test_friction_acts_where_constraints_are_off() -> None:
    scene = arm("constraint")
    held = add_effects(scene, [friction(100.0)])
    assert abs(fall(held)[1][0]) < 0.1 < 1.0 < abs(fall(scene)[1][0])


def test_effects_that_lift_flags_go_together() -> None:
    """The later one switches nothing off that the earlier one needs."""
    scene = arm("constraint")
    for pair in ([friction(2.0), stop(1.0)], [stop(1.0), friction(2.0)]):
        model = add_effects(scene, pair).model
        np.testing.assert_array_equal(model.dof_frictionloss, [2.0, 0.0])
        np.testing.assert_array_equal(model.jnt_limited, [1, 0])
        off = int(model.opt.disableflags)
        assert off & int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        assert not off & int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)


def test_what_acts_at_every_step_lifts_flags_too() -> None:
    """Friction that a hook sets as `frictionloss`."""
    values = {"coulomb": 100.0, "static": 100.0, "velocity": 0.1}
    scene = add_effects(arm("constraint"), [EffectInstance("stribeck_friction", "one", values)])
    engine = orbisim.make_backend("mujoco", scene)
    state = engine.step(engine.reset(), [], 300)
    assert abs(float(state.qvel[0, 0])) < 0.5 < abs(fall(arm("constraint"))[1][0])
