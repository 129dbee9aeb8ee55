"""Parameters at their neutral values change nothing."""

import numpy as np
import pytest

from orbisim import load_scene, make_backend
from orbisim.effects import EffectInstance, add_effects, find

SCENE = """
<mujoco model="slide">
  <option timestep="0.002" cone="elliptic"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1" friction=".3 .01 .0001" solref="SOLREF"/>
    <body name="box" pos="0 0 .12">
      <freejoint/>
      <geom name="box" type="box" size=".1 .08 .05" mass="1" friction=".4 .02 .0005" condim="CONDIM"
            solref="SOLREF"/>
    </body>
    <body name="arm" pos="0 1 1">
      <joint name="hinge" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator><position name="motor" joint="hinge" kp="2"/></actuator>
</mujoco>
"""

EFFECTS = {
    "sliding_friction": "box",
    "torsional_friction": "box",
    "rolling_friction": "box",
    "anisotropic_friction": "box",
    "contact_compliance": "box",
    "restitution": "box",
    "adhesion": "box",
    "torque_gain": "motor",
    "torque_bias": "motor",
    "viscous_damping": "hinge",
}


# rolling friction makes contacts six-dimensional, where the declared torsional one acts too
CASES = [(name, d) for name in EFFECTS for d in (3, 6) if (name, d) != ("rolling_friction", 3)]


@pytest.mark.parametrize("solref", [".02 1", ".03 .5", "-4000 -60"])
@pytest.mark.parametrize(("name", "condim"), CASES)
def test_a_neutral_effect_changes_nothing(name: str, condim: int, solref: str) -> None:
    target = EFFECTS[name]
    scene = load_scene(SCENE.replace("CONDIM", str(condim)).replace("SOLREF", solref))
    values = {p.name: p.neutral for p in find(name).parameters(scene.model, target)}
    same = add_effects(scene, [EffectInstance(name, target, values)])
    final = []
    for one in (scene, same):
        backend = make_backend("mujoco", one)
        state = backend.reset(1)
        qvel = np.array(state.qvel)
        qvel[0, :6] = [1.0, 0.3, 0.0, 0.5, -0.4, 3.0]
        controls = np.full((1, 300, 1), 0.5)
        final.append(backend.rollout(state.replace(qvel=qvel), controls).qpos[0, -1])
    np.testing.assert_allclose(final[1], final[0], atol=1e-4)
    assert np.linalg.norm(final[0][:2]) > 0.05
