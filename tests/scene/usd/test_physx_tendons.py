"""PhysX's tendons: forces as its documentation gives them, or a reason why not."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from orbisim.scene import Scene
from tests.scene.usd.usd_text import body, joins, joint, load, schemas

pytest.importorskip("pxr")

DEGREE = np.pi / 180


def chain(root: str, axis: str, *, kinds: tuple[str, str] = ("Revolute", "Revolute")) -> str:
    """Two bodies on joints A and B; the tendon's attributes are on them."""
    first, second = (f"Physics{kind}Joint" for kind in kinds)
    return (
        body("A")
        + body("B", pos=(1, 0, 0))
        + joint(first, "JA", joins(None, "/A") + root, extra=("PhysxTendonAxisRootAPI:t",))
        + joint(second, "JB", joins("/A", "/B", (1, 0, 0)) + axis, extra=("PhysxTendonAxisAPI:t",))
    )


def attributes(**values: object) -> str:
    lines = []
    for name, value in values.items():
        listed = f"float[] physxTendon:t:{name} = [{value}]"
        scalar = f"float physxTendon:t:{name} = {value}"
        lines.append(listed if name in ("gearing", "forceCoefficient") else scalar)
    return "\n" + "\n".join(lines)


def passive(scene: Scene, qpos: list[float], qvel: list[float] | None = None) -> np.ndarray:
    data = mujoco.MjData(scene.model)
    data.qpos[:] = qpos
    data.qvel[:] = 0.0 if qvel is None else qvel
    mujoco.mj_forward(scene.model, data)
    return data.qfrc_spring + data.qfrc_damper


def test_a_fixed_tendon_pulls_its_joints(tmp_path: Path) -> None:
    """Gearing in m/degree and force coefficients in m that agree with it."""
    lever = (0.02, -0.03)
    scene = load(
        tmp_path,
        chain(
            attributes(
                gearing=lever[0] * DEGREE, forceCoefficient=lever[0], stiffness=400, damping=7,
                restLength=0.004, offset=0.001,
            ),
            attributes(gearing=lever[1] * DEGREE, forceCoefficient=lever[1]),
        ),
    )  # fmt: skip
    qpos, qvel = np.array([0.3, -0.4]), np.array([0.5, 0.2])
    length = qpos @ lever + 0.001
    force = -400 * (length - 0.004) - 7 * (qvel @ lever)
    found = passive(scene, qpos, qvel)
    np.testing.assert_allclose(found, force * np.array(lever), rtol=1e-5)
    assert not any("tendon" in str(entry).lower() for entry in scene.unsupported)


def test_units_of_the_stage(tmp_path: Path) -> None:
    """Centimetres and grams: the same tendon in SI."""
    text = chain(
        attributes(gearing=2 * DEGREE, forceCoefficient=2, stiffness=1000, restLength=1),
        attributes(gearing=-3, forceCoefficient=-3),
        kinds=("Revolute", "Prismatic"),
    )
    scene = load(tmp_path, text, meters=0.01, kilograms=0.001)
    angle, way = 0.3, 0.004
    force = -1.0 * (0.02 * angle - 3 * way - 0.01)  # 1000 g/s^2 are 1 N/m
    np.testing.assert_allclose(passive(scene, [angle, way]), [0.02 * force, -3 * force], rtol=1e-5)


def test_forces_in_another_proportion_than_lengths(tmp_path: Path) -> None:
    """A common factor between the two scales the springs."""
    scene = load(
        tmp_path,
        chain(
            attributes(gearing=0.02 * DEGREE, forceCoefficient=0.05, stiffness=100),
            attributes(gearing=0.04 * DEGREE, forceCoefficient=0.1),
        ),
    )
    force = -100 * (0.02 * 0.3 + 0.04 * 0.1)
    np.testing.assert_allclose(passive(scene, [0.3, 0.1]), [0.05 * force, 0.1 * force], rtol=1e-5)


def test_springs_at_the_limits_act_beyond_them_only(tmp_path: Path) -> None:
    scene = load(
        tmp_path,
        chain(
            attributes(
                gearing=0.02 * DEGREE, forceCoefficient=0.02, limitStiffness=500, lowerLimit=-0.001,
                upperLimit=0.001,
            ),
            attributes(gearing=-0.02 * DEGREE, forceCoefficient=-0.02),
        ),
    )  # fmt: skip
    np.testing.assert_allclose(passive(scene, [0.02, 0.0]), 0.0, atol=1e-12)
    force = -500 * (0.02 * 0.1 - 0.001)
    np.testing.assert_allclose(passive(scene, [0.1, 0.0]), [0.02 * force, -0.02 * force], rtol=1e-5)


def test_without_force_coefficients_the_force_is_along_the_length(tmp_path: Path) -> None:
    scene = load(
        tmp_path,
        chain(attributes(gearing=0.02 * DEGREE, stiffness=100), attributes(gearing=-0.01 * DEGREE)),
    )
    force = -100 * (0.02 * 0.3)
    np.testing.assert_allclose(passive(scene, [0.3, 0.0]), [0.02 * force, -0.01 * force], rtol=1e-5)
    assert any("no forceCoefficient" in warning for warning in scene.warnings)


def parts(gearing: float, force: float) -> dict[str, float]:
    return {"gearing": gearing, "forceCoefficient": force}


@pytest.mark.parametrize(
    ("root", "axis", "reason"),
    [
        (
            {"gearing": 1, "forceCoefficient": 0},
            {"gearing": 1, "forceCoefficient": 1},
            "proportion",
        ),
        ({"gearing": 1, "forceCoefficient": -1}, {"gearing": 1, "forceCoefficient": -1}, "against"),
        ({"gearing": 1, "forceCoefficient": 1}, {"gearing": 1}, "only some of its joints"),
        ({"gearing": 0, "stiffness": 1}, {"gearing": 0}, "runs along no joint"),
        (
            {"gearing": 0, "forceCoefficient": 1},
            {"gearing": 1, "forceCoefficient": 1},
            "proportion",
        ),
    ],
)
def test_what_mujoco_cannot_have_is_listed(
    tmp_path: Path, root: dict[str, float], axis: dict[str, float], reason: str
) -> None:
    scene = load(tmp_path, chain(attributes(**root), attributes(**axis)))
    assert scene.model.ntendon == 0
    assert any("fixed tendon 't'" in str(e) and reason in str(e) for e in scene.unsupported)


def test_joints_of_several_axes(tmp_path: Path) -> None:
    text = chain(attributes(), attributes(), kinds=("Spherical", "Revolute"))
    scene = load(tmp_path, text)
    assert any("has several axes" in str(entry) for entry in scene.unsupported)


def test_disabled_tendons(tmp_path: Path) -> None:
    off = attributes() + "\nbool physxTendon:t:tendonEnabled = false"
    scene = load(tmp_path, chain(off, attributes()))
    assert scene.model.ntendon == 0
    assert any("which is disabled" in str(entry) for entry in scene.unsupported)


def link(name: str, pos: tuple[float, float, float], content: str, *applied: str) -> str:
    return body(name, content, pos=pos, extra=applied)


def spatial(leaf: str, root: str = "", middle: str | None = None) -> str:
    """A tendon from A over M to C; C moves on a rail along x."""
    ends = [
        link("A", (0, 0, 0), "point3f physxTendon:r:localPos = (0, 0, 0.5)\n" + root,
             "PhysxTendonAttachmentRootAPI:r"),
        joint("PhysicsFixedJoint", "FA", joins(None, "/A")),
    ]  # fmt: skip
    parent = (
        'rel physxTendon:{0}:parentLink = <{1}>\ntoken physxTendon:{0}:parentAttachment = "{2}"\n'
    )
    before = ("/A", "r")
    if middle is not None:
        ends += [
            link("M", (1, 0, 0.5), parent.format("m", "/A", "r") + middle,
                 "PhysxTendonAttachmentAPI:m"),
            joint("PhysicsFixedJoint", "FM", joins(None, "/M", (1, 0, 0.5))),
        ]  # fmt: skip
        before = ("/M", "m")
    ends += [
        link("C", (2, 0, 0.5), parent.format("c", *before) + leaf,
             "PhysxTendonAttachmentAPI:c", "PhysxTendonAttachmentLeafAPI:c"),
        joint("PhysicsPrismaticJoint", "JC", joins(None, "/C", (2, 0, 0.5))),
    ]  # fmt: skip
    return "".join(ends)


def test_a_spatial_tendon_pulls_its_ends(tmp_path: Path) -> None:
    given = {"stiffness": 30, "damping": 2, "offset": 0.1}
    root = "\n".join(f"float physxTendon:r:{name} = {value}" for name, value in given.items())
    leaf = "float physxTendon:c:restLength = 1.5\nfloat physxTendon:c:gearing = 1"
    scene = load(tmp_path, spatial(leaf, root))
    way, speed = 0.2, 0.5
    force = -30 * (0.1 + 2 + way - 1.5) - 2 * speed
    np.testing.assert_allclose(passive(scene, [way], [speed]), [force], rtol=1e-5)


def test_gearing_of_a_spatial_tendon(tmp_path: Path) -> None:
    """The length is geared, the force at the end is not."""
    root = "float physxTendon:r:stiffness = 30"
    leaf = "float physxTendon:c:restLength = 3\nfloat physxTendon:c:gearing = 2"
    scene = load(tmp_path, spatial(leaf, root))
    np.testing.assert_allclose(passive(scene, [0.2]), [-30 * (2 * 2.2 - 3)], rtol=1e-5)


def test_the_rest_length_is_that_of_the_start(tmp_path: Path) -> None:
    scene = load(tmp_path, spatial("", "float physxTendon:r:stiffness = 30"))
    np.testing.assert_allclose(passive(scene, [0.0]), [0.0], atol=1e-9)
    np.testing.assert_allclose(passive(scene, [0.2]), [-30 * 0.2], rtol=1e-5)


def test_a_string_pulls_only_when_it_is_taut(tmp_path: Path) -> None:
    root = "float physxTendon:r:limitStiffness = 300"
    scene = load(tmp_path, spatial("float physxTendon:c:upperLimit = 2.1", root, middle=""))
    np.testing.assert_allclose(passive(scene, [0.05]), [0.0], atol=1e-9)
    np.testing.assert_allclose(passive(scene, [0.2]), [-300 * 0.1], rtol=1e-5)
    assert any("intermediate attachments" in warning for warning in scene.warnings)


@pytest.mark.parametrize(
    ("leaf", "middle", "reason"),
    [
        ("float physxTendon:c:gearing = -1", None, "gearing is not positive"),
        ("float physxTendon:c:gearing = 2", "", "gearings of their own"),
    ],
)
def test_spatial_tendons_that_mujoco_cannot_have(
    tmp_path: Path, leaf: str, middle: str | None, reason: str
) -> None:
    scene = load(tmp_path, spatial(leaf, middle=middle))
    assert any("spatial tendon 'c'" in str(e) and reason in str(e) for e in scene.unsupported)


def test_a_leaf_without_a_root(tmp_path: Path) -> None:
    loose = body("A", extra=("PhysxTendonAttachmentLeafAPI:t",))
    scene = load(tmp_path, loose)
    assert any("does not lead to a root" in str(entry) for entry in scene.unsupported)
    assert not any("physxTendon" in str(entry) for entry in scene.unsupported)


def test_schemas_of_tendons_are_not_reported_as_ignored(tmp_path: Path) -> None:
    assert "PhysxTendonAxisRootAPI:t" in schemas("PhysxTendonAxisRootAPI:t")
    scene = load(tmp_path, chain(attributes(gearing=1, stiffness=1), attributes(gearing=1)))
    assert not any("PhysxTendon" in str(entry) for entry in scene.unsupported)
