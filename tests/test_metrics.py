"""Errors between state sequences: of which joints, in which units, by which formula."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from orbisim import load_scene, metrics
from orbisim.testing import scenes

JOINTS = {
    "hinge": "<joint type='hinge'/>",
    "slide": "<joint type='slide'/>",
    "ball": "<joint type='ball'/>",
    "free": "<freejoint/>",
}


def model_with(*kinds: str) -> mujoco.MjModel:
    """One body for each joint."""
    bodies = "".join(f"<body>{JOINTS[kind]}<geom size='.1'/></body>" for kind in kinds)
    return mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")


@pytest.mark.parametrize(
    ("kinds", "unit"),
    [
        (("hinge",), "rad"),
        (("ball",), "rad"),
        (("slide",), "m"),
        (("slide", "ball"), "rad or m"),
        (("hinge", "slide", "free"), "rad or m"),
    ],
)
def test_units_of_joints(kinds: tuple[str, ...], unit: str) -> None:
    units = metrics.layout(model_with(*kinds)).units
    assert units["joint_position"] == unit
    assert units["joint_velocity"] == " or ".join(f"{part}/s" for part in unit.split(" or "))


def test_groups_are_those_that_the_scene_has() -> None:
    assert metrics.layout(model_with("free")).groups == metrics.GROUPS[2:]
    assert metrics.layout(model_with("hinge", "free")).groups == metrics.GROUPS
    assert metrics.layout(model_with()).groups == ()


def test_errors_of_every_group_by_hand() -> None:
    """One hinge off by 0.3, one slide by 0.4, a ball turned by 1.2, two free bodies moved."""
    model = model_with("hinge", "free", "ball", "slide", "free")
    where = metrics.layout(model)
    a, b = mujoco.MjData(model).qpos, mujoco.MjData(model).qpos
    va, vb = np.zeros(model.nv), np.zeros(model.nv)

    def turned(angle: float) -> np.ndarray:
        return Rotation.from_rotvec([0, angle, 0]).as_quat(scalar_first=True)

    b[0], b[12] = 0.3, 0.4
    b[8:12] = -turned(1.2)  # the sign of a quaternion does not matter
    b[1:4], b[13:16] = [3, 4, 0], [0, 0, 12]
    b[4:8] = turned(0.5)
    vb[1:4], vb[4:7] = [1, 2, 2], [9, 9, 9]  # a free body's spin is in no group
    vb[7:10], vb[0] = [1, -1, 1], 2.0
    found = metrics.errors(where, a[None], va[None], b[None], vb[None])
    assert found.keys() == set(metrics.GROUPS)
    assert {n: float(v[0]) for n, v in found.items()} == pytest.approx(
        {
            "joint_position": np.sqrt((0.3**2 + 0.4**2 + 1.2**2) / 3),
            "joint_velocity": np.sqrt((2.0**2 + 3 * 1.0) / 5),
            "object_position": np.sqrt((5.0**2 + 12.0**2) / 2),
            "object_rotation": np.sqrt(0.5**2 / 2),
            "object_velocity": np.sqrt(3.0**2 / 2),
        }
    )


def test_errors_keep_leading_axes() -> None:
    model = model_with("hinge", "free")
    zeros = np.zeros((2, 5, model.nq)), np.zeros((2, 5, model.nv))
    found = metrics.errors(metrics.layout(model), *zeros, *zeros)
    assert {value.shape for value in found.values()} == {(2, 5)}


quaternions = st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(
    lambda q: np.linalg.norm(q) > 0.1
)


@given(quaternions, quaternions)
def test_rotation_angle_is_scipys(p: list[float], q: list[float]) -> None:
    a, b = (Rotation.from_quat(x, scalar_first=True) for x in (p, q))
    found = metrics.rotation_angle(*(r.as_quat(scalar_first=True) for r in (a, b)))
    assert found == pytest.approx((a.inv() * b).magnitude(), abs=1e-7)


@given(quaternions, quaternions, quaternions)
def test_rotation_angle_is_a_metric(p: list[float], q: list[float], r: list[float]) -> None:
    a, b, c = (np.array(x) / np.linalg.norm(x) for x in (p, q, r))
    ab, bc, ac = (metrics.rotation_angle(x, y) for x, y in ((a, b), (b, c), (a, c)))
    assert metrics.rotation_angle(a, a) == pytest.approx(0, abs=1e-7)
    assert metrics.rotation_angle(a, -a) == pytest.approx(0, abs=1e-7)
    assert ab == pytest.approx(metrics.rotation_angle(b, a), abs=1e-7)
    assert 0 <= ab <= np.pi + 1e-9
    assert ac <= ab + bc + 1e-6


def test_rotation_angle_of_known_rotations() -> None:
    for angle in (1e-9, 0.3, 3.0):
        turned = np.array([np.cos(angle / 2), 0, np.sin(angle / 2), 0])
        assert metrics.rotation_angle(np.array([1.0, 0, 0, 0]), turned) == pytest.approx(
            angle, rel=1e-6
        )


def test_poses_are_mujocos() -> None:
    model = load_scene(scenes.RESTING_BOX).model
    body = model.body(1).name
    qpos = np.tile(model.qpos0, (1, 2, 1))
    turn = Rotation.from_rotvec([0.1, 0.2, 0.3]).as_quat(scalar_first=True)
    qpos[0, 0, :7] = [1, 2, 3, *turn]
    qpos[0, 1, 0] = np.nan
    place, turned = metrics.poses(model, qpos, (("body", body),))
    assert place.shape == (1, 2, 1, 3) and turned.shape == (1, 2, 1, 4)
    np.testing.assert_allclose(place[0, 0, 0], [1, 2, 3])
    np.testing.assert_allclose(turned[0, 0, 0], turn)
    assert np.isnan(place[0, 1]).all() and np.isnan(turned[0, 1]).all()


def test_energy_of_a_pendulum() -> None:
    model = load_scene(scenes.PENDULUM).model
    found = metrics.energies(model, np.array([[[0.0], [np.pi / 2]]]), np.array([[[2.0], [0.0]]]))
    assert found.potential[0, 1] - found.potential[0, 0] == pytest.approx(9.81 * 0.25, rel=1e-6)
    inertia = model.body_inertia[1, 0] + 0.25**2
    assert found.kinetic[0].tolist() == pytest.approx([inertia * 2.0**2 / 2, 0.0])
    assert found.total[0, 0] == found.potential[0, 0] + found.kinetic[0, 0]


def test_energy_of_what_is_lost_is_not_a_number() -> None:
    model = load_scene(scenes.RESTING_BOX).model
    qpos = np.tile(model.qpos0, (1, 3, 1))
    qpos[0, 1, 2] = np.nan
    qpos[0, 2, 2] = 5.0
    found = metrics.energies(model, qpos, np.zeros((1, 3, model.nv)))
    assert np.isnan(found.total[0]).tolist() == [False, True, False]
    assert found.contacts[0].tolist() == [4, -1, 0]


def test_quantiles_pass_over_what_is_lost() -> None:
    values = np.array([[1.0, np.nan, np.inf], [3.0, 2.0, np.nan], [2.0, 4.0, np.nan]])
    median, most = metrics.quantiles(values, (0.5, 1.0))
    np.testing.assert_array_equal(median, [2.0, 3.0, np.nan])
    np.testing.assert_array_equal(most, [3.0, 4.0, np.nan])
    assert metrics.quantiles(np.zeros((0, 3))) == [[], []]
