"""What would do the same as an effect at another place."""

import mujoco
import numpy as np
import pytest

from orbisim import Scene, load_scene
from orbisim.effects import EffectInstance, add_effects, find

SCENE = """
<mujoco><worldbody>
  <body name="upper"><joint name="shoulder" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass="1"/>
    <body name="fore" pos="0 0 -.3" euler="0 30 0"><joint name="elbow" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 .25 0 0" size=".02" mass=".5"/>
      <body name="plate" pos=".25 0 0"><geom type="sphere" size=".02" mass=".1"/></body>
    </body>
  </body>
  <body name="other" pos="1 0 0"><joint name="slide" type="slide"/>
    <geom type="sphere" size=".02" mass=".1"/></body>
</worldbody></mujoco>
"""


def posed(scene: Scene, *angles: float) -> mujoco.MjData:
    data = mujoco.MjData(scene.model)
    data.qpos[: len(angles)] = angles
    mujoco.mj_kinematics(scene.model, data)
    return data


def inertia(scene: Scene, data: mujoco.MjData) -> np.ndarray:
    """The inertia matrix and gravity's forces at a pose."""
    own = mujoco.MjData(scene.model)
    own.qpos[:] = data.qpos
    mujoco.mj_forward(scene.model, own)
    full = np.zeros((scene.model.nv, scene.model.nv))
    mujoco.mj_fullM(scene.model, own, full)
    return np.column_stack([full, own.qfrc_bias])


def by(every: list[EffectInstance]) -> dict[tuple[str, str], EffectInstance]:
    return {(one.effect, one.target): one for one in every}


def test_a_payload_on_the_next_link() -> None:
    """At the same place of the world; not on what is welded to the link, nor on another machine."""
    scene = load_scene(SCENE)
    data = posed(scene, 0.7, 0.4)
    one = EffectInstance(
        "payload", "fore", {"mass": 0.3, "com_x": 0.02, "com_y": 0.05, "com_z": -0.01}
    )
    found = by(find("payload").elsewhere(scene.model, one, data))
    assert set(found) == {("payload", "upper"), ("armature", "elbow"), ("armature", "shoulder")}
    places = []
    for load in (one, found["payload", "upper"]):
        body = mujoco.mj_name2id(scene.model, mujoco.mjtObj.mjOBJ_BODY, load.target)
        com = [load.values[f"com_{axis}"] for axis in "xyz"]
        places.append(data.xpos[body] + data.xmat[body].reshape(3, 3) @ com)
    np.testing.assert_allclose(*places)
    assert found["payload", "upper"].values["mass"] == 0.3
    for joint in ("shoulder", "elbow"):  # what the mass adds at each joint by itself
        same = add_effects(scene, [found["armature", joint]])
        loaded, turned = (inertia(s, data) for s in (add_effects(scene, [one]), same))
        index = mujoco.mj_name2id(scene.model, mujoco.mjtObj.mjOBJ_JOINT, joint)
        assert loaded[index, index] == pytest.approx(turned[index, index])


def test_a_rotor_and_a_mass_on_the_link_that_it_turns() -> None:
    scene = load_scene(SCENE)
    data = posed(scene, 0.7, 0.4)
    one = EffectInstance("armature", "elbow", {"inertia": 0.02})
    found = by(find("armature").elsewhere(scene.model, one, data))
    assert set(found) == {("armature", "shoulder"), ("armature", "slide"), ("payload", "fore")}
    loaded = inertia(add_effects(scene, [found["payload", "fore"]]), data)
    turned = inertia(add_effects(scene, [one]), data)
    assert loaded[1, 1] == pytest.approx(turned[1, 1])


def test_an_offset_of_the_next_link_moves_the_whole_as_far() -> None:
    scene = load_scene(SCENE)
    data = posed(scene, 0.7, 0.4)
    one = EffectInstance("com_offset", "fore", {"offset": 0.03, "x": 0.0, "y": 0.0, "z": 0.03})
    (other,) = find("com_offset").elsewhere(scene.model, one, data)
    assert other.target == "upper"
    centres = []
    for effects in ([one], [other]):
        own = mujoco.MjData(changed := add_effects(scene, effects).model)
        own.qpos[:] = data.qpos
        mujoco.mj_forward(changed, own)
        centres.append(own.subtree_com[1])
    np.testing.assert_allclose(*centres, atol=1e-9)


def test_others_stand_at_all_other_targets() -> None:
    scene = load_scene(SCENE)
    one = EffectInstance("coulomb_friction", "elbow", {"torque": 0.2})
    found = find("coulomb_friction").elsewhere(scene.model, one, posed(scene))
    assert [(o.target, dict(o.values)) for o in found] == [
        ("shoulder", {"torque": 0.2}),
        ("slide", {"torque": 0.2}),
    ]
