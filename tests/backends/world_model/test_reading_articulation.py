"""What is read of a robot's limbs, and what is refused."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from orbisim_world_model.articulation import LIMB_COLUMNS
from orbisim_world_model.reading_articulation import (
    limb_concerns,
    limb_rows,
    natural_step,
    read_articulated,
)

from orbisim.errors import UnsupportedSceneError
from tests.backends.world_model.robots import CRAWLER


def rows_of(xml: str) -> dict[str, np.ndarray]:
    rows = limb_rows(mujoco.MjModel.from_xml_string(xml), "scene")
    return {name: rows[:, place] for place, name in enumerate(LIMB_COLUMNS)}


def test_masses_motors_and_shapes() -> None:
    model, rows = mujoco.MjModel.from_xml_string(CRAWLER), rows_of(CRAWLER)
    assert rows["parent"].tolist() == [-1, 0, 1, 2, 3, 2]
    assert rows["type_hinge"].tolist() == [0, 0, 1, 1, 0, 1]
    torso = model.body_mass[model.body("torso").id] + 0.7  # with what is welded to it
    np.testing.assert_allclose(rows["mass"][:3], [0, 0, torso])
    assert rows["mass"].sum() == pytest.approx(model.body_subtreemass[0])
    assert rows["control"].tolist() == [-1, -1, -1, 1, -1, 0]
    assert (rows["gear"][5], rows["bias_1"][3], rows["force_high"][3]) == (3, -20, 6)
    assert rows["limited"].tolist() == [0, 0, 0, 1, 0, 0]
    assert rows["ignored"].tolist() == [1, 0, 0, 0, 0, 0]
    assert rows["floor_there"].tolist() == [0, 0, 1, 1, 1, 1]
    assert rows["friction"][4] == 1.0  # MuJoCo takes the larger one: the floor's
    assert (rows["there_0"][2], rows["there_1"][2], rows["long_1"][2]) == (1, 1, 0)


def test_what_is_switched_off_is_not_read() -> None:
    flags = '<flag contact="disable" limit="disable" frictionloss="disable" gravity="disable"/>'
    rows = rows_of(
        CRAWLER.replace('<option timestep="0.005"/>', f'<option timestep="0.005">{flags}</option>')
    )
    for name in ("floor_there", "meets", "limited", "frictionloss", "heavy"):
        assert not rows[name].any(), name


def test_the_step_is_a_multiple_of_the_scenes() -> None:
    for own, step in ((0.02, 0.02), (0.005, 0.005), (0.002, 0.006), (0.001, 0.005)):
        xml = CRAWLER.replace('timestep="0.005"', f'timestep="{own}"')
        model = mujoco.MjModel.from_xml_string(xml)
        assert natural_step(model) == pytest.approx(step)
        assert read_articulated(model, step).substeps == round(step / own)
    with pytest.raises(UnsupportedSceneError, match="not a multiple"):
        read_articulated(model, 0.0055)


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ('<joint name="tail" axis="0 1 0"', '<joint name="tail" type="ball"', "neither hinges"),
        (
            '<motor joint="tail"',
            '<motor joint="hip"/><motor joint="tail"',
            "one actuator a joint; 'hip' has two",
        ),
        (
            '<motor joint="tail" gear="3" ctrlrange="-1 1" ctrllimited="true"',
            '<adhesion body="tail" ctrlrange="0 1"',
            "acts on 0 joints",
        ),
        ("<option ", '<option density="1.2" ', "no medium"),
        ('damping="0.2"', 'damping="0.2 0.1"', "springs and dampers that are not linear"),
        ('stiffness="2"', 'stiffness="2 1"', "springs and dampers that are not linear"),
        ('gear="3"', 'gear="3" damping="1"', "damping, armature or delay of actuators"),
        (
            "</worldbody>",
            '</worldbody><equality><joint joint1="tail" joint2="hip"/></equality>',
            "equality constraints",
        ),
    ],
)
def test_what_limbs_do_not_know_is_refused(old: str, new: str, match: str) -> None:
    xml = CRAWLER.replace(old, new, 1)
    with pytest.raises(UnsupportedSceneError, match=match):
        limb_rows(mujoco.MjModel.from_xml_string(xml), "scene")


def test_what_is_seen_otherwise_is_told() -> None:
    xml = CRAWLER.replace(
        '<geom fromto="0 0 0 -.25 0 .05"/>', '<geom type="box" size=".1 .02 .02"/>'
    )
    xml = xml.replace(
        "<worldbody>", '<worldbody><geom name="wall" type="box" size="1 1 1" pos="5 0 0"/>'
    )
    said = " ".join(limb_concerns(mujoco.MjModel.from_xml_string(xml)))
    assert "body 'tail': 1 geoms that are no capsules" in said
    assert "contacts with geom 'wall' are not known" in said
    assert limb_concerns(mujoco.MjModel.from_xml_string(CRAWLER)) == []
