"""Names of parameters, their declared values, and scenes with others."""

from __future__ import annotations

import mujoco
import pytest

from orbisim import load_scene
from orbisim.errors import InputError, UnknownNameError
from orbisim.identification.parameters import parameters, patched

XML = """
<mujoco model="slide">
  <worldbody>
    <geom name="floor" type="plane" size="2 2 0.1" priority="1" friction="0.4"/>
    <body name="box" pos="0 0 0.05"><freejoint/>
      <geom name="box" type="box" size="0.05 0.04 0.05" density="500" friction="0.3"/></body>
    <body name="rod" pos="1 0 1"><joint name="hinge" axis="0 1 0" damping="0.2"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02"/></body>
  </worldbody>
</mujoco>
"""


def test_declared_values_and_patched_scenes() -> None:
    scene = load_scene(XML)
    wanted = parameters(scene, "friction:floor, density, damping:hinge,armature:hinge")
    assert [p.label for p in wanted] == [
        "friction:floor", "density:box", "damping:hinge", "armature:hinge"
    ]  # fmt: skip
    assert [round(p.declared, 6) for p in wanted] == [0.4, 500, 0.2, 1e-6]
    edited = patched(scene, dict(zip(wanted, (0.7, 1000.0, 0.5, 0.01), strict=True))).model
    before = scene.model
    body, joint = before.body("box").id, before.joint("hinge").id
    assert edited.geom_friction[before.geom("floor").id, 0] == 0.7
    assert edited.body_mass[body] == pytest.approx(2 * before.body_mass[body])
    assert edited.body_inertia[body] == pytest.approx(2 * before.body_inertia[body])
    assert edited.dof_damping[before.jnt_dofadr[joint]] == 0.5
    assert edited.dof_armature[before.jnt_dofadr[joint]] == 0.01
    assert isinstance(edited, mujoco.MjModel)
    assert [p.unit for p in wanted] == ["1", "kg/m^3", "N*m*s/rad", "kg*m^2"]
    # what is not named stays
    assert edited.geom_friction[before.geom("box").id, 0] == 0.3


def test_a_body_stands_for_its_geoms_and_mass_for_density() -> None:
    scene = load_scene(XML)
    friction, mass = parameters(scene, ["friction", "mass:rod"])
    assert friction.label == "friction:box" and friction.declared == pytest.approx(0.3)
    assert (mass.low, mass.high) == (mass.declared / 10, mass.declared * 10)


@pytest.mark.parametrize(
    ("wanted", "error", "said"),
    [
        ("colour", UnknownNameError, "colour"),
        ("friction:nothing", UnknownNameError, "nothing"),
        ("damping:box", UnknownNameError, "box"),
        ("density:world", UnknownNameError, "world"),
        (" , ", InputError, "no parameter"),
    ],
)
def test_wrong_names(wanted: str, error: type[Exception], said: str) -> None:
    with pytest.raises(error, match=said):
        parameters(load_scene(XML), wanted)
