"""Rows of descriptors, against the numbers in the document."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from orbisim.scene.matrices import (
    ACTUATOR_COLUMNS,
    JOINT_COLUMNS,
    OBJECT_COLUMNS,
    WORLD_COLUMNS,
    actuator_rows,
    joint_rows,
    main_geom,
    object_row,
    surface_geom,
    world_row,
)

MODEL = mujoco.MjModel.from_xml_string("""
<mujoco>
  <option timestep="0.004" gravity="0 1 -9" density="1.2" viscosity="0.1" impratio="3"/>
  <worldbody>
    <geom name="wall" type="box" size="1 1 1" pos="9 9 9"/>
    <geom name="floor" type="plane" size="1 1 .1" friction=".7 .02 .003" solref=".05 .8"/>
    <body name="box" pos="0 0 1"><freejoint/>
      <geom name="shown" type="sphere" size="5" contype="0" conaffinity="0" mass="0"/>
      <geom name="small" type="sphere" size=".05" mass="0.1"/>
      <geom name="large" type="box" size=".1 .2 .3" pos=".4 0 0" euler="0 0 90" mass="2"
            friction=".5 .01 .001" solref=".03 .9" rgba=".1 .2 .3 1"/></body>
    <body name="ghost"><freejoint/><geom type="capsule" size=".1 .2" contype="0" conaffinity="0"/>
    </body>
    <body name="arm"><joint name="slide" type="slide" axis="0 1 0" range="-.5 .25" damping="2"
        stiffness="3" springref=".1" frictionloss=".4" armature=".6"/><geom size=".1"/>
      <body><joint name="hinge" pos="0 0 .2" axis="1 0 0"/><geom size=".1"/></body></body>
    <body name="bare"><inertial pos=".1 .2 .3" mass="4" diaginertia="1 2 2.5"/><freejoint/></body>
  </worldbody>
  <tendon><fixed name="t"><joint joint="hinge" coef="1"/></fixed></tendon>
  <actuator>
    <dcmotor name="passive" joint="slide" input="none" motorconst="1e-9" resistance="1"/>
    <position name="p" joint="hinge" kp="5" kv="0.5" gear="3" ctrlrange="-1 2"/>
    <motor name="m" tendon="t" gear="7"/>
  </actuator>
</mujoco>
""")


def named(columns: tuple[str, ...], row: np.ndarray) -> dict[str, float]:
    return dict(zip(columns, row.tolist(), strict=True))


def test_an_object() -> None:
    row = named(OBJECT_COLUMNS, object_row(MODEL, MODEL.body("box").id))
    assert [row[f"half_{axis}"] for axis in "xyz"] == pytest.approx([0.1, 0.2, 0.3])
    assert row["mass"] == pytest.approx(2.1)
    assert row["friction_slide"] == 0.5
    assert (row["solref_0"], row["solref_1"]) == (0.03, 0.9)
    assert [name for name, value in row.items() if name.startswith("type_") and value] == [
        "type_box"
    ]
    assert row["com_x"] == pytest.approx(2 * 0.4 / 2.1)
    assert row["geom_x"] == 0.4
    assert (row["geom_qw"], row["geom_qz"]) == pytest.approx((np.sqrt(0.5), np.sqrt(0.5)))
    assert [row[colour] for colour in ("red", "green", "blue")] == pytest.approx([0.1, 0.2, 0.3])


def test_an_object_without_geoms() -> None:
    row = named(OBJECT_COLUMNS, object_row(MODEL, MODEL.body("bare").id))
    assert row["mass"] == 4.0
    assert sorted(row[f"inertia_{axis}"] for axis in "xyz") == [1.0, 2.0, 2.5]
    assert (row["com_x"], row["com_y"], row["com_z"]) == (0.1, 0.2, 0.3)
    assert row["geom_qw"] == 1.0
    assert not any(row[name] for name in OBJECT_COLUMNS if name.startswith(("type", "half")))


def test_the_largest_geom_that_collides_stands_for_the_shape() -> None:
    assert main_geom(MODEL, MODEL.body("box").id) == MODEL.geom("large").id
    assert main_geom(MODEL, MODEL.body("ghost").id) is not None
    assert main_geom(MODEL, MODEL.body("bare").id) is None


def test_the_world() -> None:
    row = named(WORLD_COLUMNS, world_row(MODEL, None, 0.02))
    expected = {
        "gravity_x": 0,
        "gravity_y": 1,
        "gravity_z": -9,
        "timestep": 0.004,
        "control_timestep": 0.02,
        "density": 1.2,
        "viscosity": 0.1,
        "impratio": 3,
        "friction_slide": 0.7,
        "friction_torsion": 0.02,
        "friction_roll": 0.003,
        "solref_0": 0.05,
        "solref_1": 0.8,
    }
    assert row == pytest.approx(expected)
    assert surface_geom(MODEL, "wall") == MODEL.geom("wall").id
    assert named(WORLD_COLUMNS, world_row(MODEL, "wall", 0.02))["friction_slide"] == 1.0


def test_joints() -> None:
    rows = joint_rows(MODEL, [MODEL.body("ghost").id, MODEL.body("box").id])
    box, ghost, slide, hinge, bare = (named(JOINT_COLUMNS, row) for row in rows)
    assert (box["body"], ghost["body"], slide["body"], bare["body"]) == (1, 0, -1, -1)
    assert (slide["qpos"], slide["dof"]) == (14, 12)
    assert box["type_free"] == slide["type_slide"] == hinge["type_hinge"] == 1.0
    assert (slide["axis_y"], hinge["axis_x"], hinge["pos_z"]) == (1.0, 1.0, 0.2)
    assert (slide["limited"], slide["low"], slide["high"], hinge["limited"]) == (1, -0.5, 0.25, 0)
    physical = [slide[n] for n in ("stiffness", "springref", "damping", "frictionloss", "armature")]
    assert physical == [3.0, 0.1, 2.0, 0.4, 0.6]


def test_each_control_has_the_row_of_its_actuator() -> None:
    """A passive actuator before them reads no control."""
    rows = actuator_rows(MODEL)
    assert rows.shape == (MODEL.nu, len(ACTUATOR_COLUMNS))
    position, motor = (named(ACTUATOR_COLUMNS, row) for row in rows)
    assert position["joint"] == MODEL.joint("hinge").id
    assert (position["gain"], position["bias_1"], position["bias_2"]) == (5.0, -5.0, -0.5)
    assert (position["gear"], position["limited"]) == (3.0, 1.0)
    assert (position["low"], position["high"]) == (-1.0, 2.0)
    assert (motor["joint"], motor["gear"], motor["limited"]) == (-1.0, 7.0, 0.0)
