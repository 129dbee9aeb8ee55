"""USD: properties that hold for any input."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from orbisim.scene.usd.decimals import converted, exact, unit_quaternion
from orbisim.scene.usd.dump.geometry import triangulate
from orbisim.scene.usd.flat import FlatMesh, FlatPrim, FlatStage, Look, Note
from orbisim.scene.usd.names import unique_names
from orbisim.scene.usd.pose import Pose, split
from orbisim.scene.usd.wire import decode, encode
from tests.scene.usd.usd_text import body, joins, joint, load

pytest.importorskip("pxr")

DEGREE = math.pi / 180
floats32 = st.floats(width=32, allow_nan=False, allow_infinity=False, allow_subnormal=False)


@given(floats32, st.sampled_from([1.0, DEGREE, 1 / DEGREE, 0.01, 1e-7]))
def test_numbers_keep_what_the_file_says(value: float, factor: float) -> None:
    """Back in the file's unit and precision, the number is the one that was stored."""
    stored = np.float32(value)
    read = converted(np.array(stored), factor)
    with np.errstate(over="ignore"):
        assert np.float32(read / factor) == stored or abs(read - float(stored) * factor) <= abs(
            np.spacing(stored) * factor
        )


@given(st.decimals(-1000, 1000, places=3))
def test_decimals_come_back(number) -> None:
    """A number of up to six digits survives single precision, in degrees and in radians."""
    value = float(number)
    assert exact(np.array(np.float32(value))) == value
    in_degrees = np.array(np.float32(value / DEGREE))
    assert converted(in_degrees, DEGREE) == pytest.approx(value, rel=1e-7, abs=1e-12)


@given(st.integers(-720, 720), st.integers(0, 2))
def test_whole_degrees_survive_single_precision(degrees: int, axis: int) -> None:
    half = degrees * DEGREE / 2
    quat = np.zeros(4)
    quat[0], quat[1 + axis] = math.cos(half), math.sin(half)
    read = unit_quaternion(quat.astype(np.float32))
    np.testing.assert_allclose(np.abs(read @ quat), 1.0, atol=1e-15)
    np.testing.assert_allclose(read * np.sign(read @ quat), quat, atol=1e-15)


@given(st.lists(floats32, min_size=4, max_size=4))
def test_quaternions_have_unit_length_and_stay_close(components: list[float]) -> None:
    stored = np.array(components, np.float32)
    read = unit_quaternion(stored)
    assert np.linalg.norm(read) == pytest.approx(1.0)
    norm = np.linalg.norm(stored.astype(np.float64))
    if norm > 0:
        np.testing.assert_allclose(read, stored.astype(np.float64) / norm, atol=3e-7)


@given(st.lists(st.lists(st.integers(0, 20), min_size=3, max_size=7), min_size=1, max_size=9))
def test_triangulation_keeps_every_polygon(polygons: list[list[int]]) -> None:
    counts = np.array([len(polygon) for polygon in polygons], np.int32)
    triangles = triangulate(counts, np.concatenate(polygons).astype(np.int32))
    expected = [
        [polygon[0], polygon[i], polygon[i + 1]]
        for polygon in polygons
        for i in range(1, len(polygon) - 1)
    ]
    np.testing.assert_array_equal(triangles, expected)


names = st.sampled_from(["a", "b", "foot", "foot_1"])


@given(st.lists(st.lists(names, min_size=1, max_size=4), min_size=1, max_size=12, unique_by=tuple))
def test_names_are_unique(paths: list[list[str]]) -> None:
    prims = [prim("/" + "/".join(path)) for path in paths]
    given_names = unique_names(prims, reserved=["foot"])
    assert len(set(given_names.values())) == len(prims)
    assert "foot" not in given_names.values()


def prim(path: str, **fields) -> FlatPrim:
    values = {
        "type_name": "Xform",
        "schemas": (),
        "display_name": "",
        "matrix": np.eye(4),
        "local": np.eye(4),
        "resets": False,
        "visible": True,
        "purpose": "default",
        "attributes": {},
        "relationships": {},
    }
    return FlatPrim(path, **{**values, **fields})


values = st.one_of(
    st.booleans(),
    st.integers(-(2**31), 2**31 - 1),
    st.text(max_size=5),
    st.lists(st.text(max_size=3), max_size=3).map(tuple),
    st.lists(floats32, max_size=4).map(lambda x: np.array(x, np.float32)),
    st.lists(st.floats(allow_nan=False), max_size=4).map(lambda x: np.array(x, np.float64)),
    st.lists(st.integers(-9, 9), max_size=4).map(lambda x: np.array(x, np.int64)),
)


@given(st.dictionaries(st.text(min_size=1, max_size=5), values, max_size=4))
def test_stages_survive_the_way_between_processes(attributes: dict) -> None:
    points = np.arange(12, dtype=np.float32).reshape(4, 3)
    stage = FlatStage(
        prims=(prim("/a", attributes=attributes, relationships={"r": ("/b", "/c")}),),
        meshes=(FlatMesh(points, np.array([[0, 1, 2]], np.int32), 3),),
        looks=(Look("/m", (1.0, 0.5, 0.25, 1.0), 0.0, -1.0, 0.5, True),),
        name="x",
        meters_per_unit=0.01,
        notes=(Note("/a", "b", "c"),),
    )
    back = decode(encode(stage))
    assert back.looks == stage.looks and back.notes == stage.notes
    assert back.prims[0].relationships == stage.prims[0].relationships
    assert back.prims[0].attributes.keys() == attributes.keys()
    for name, value in attributes.items():
        found = back.prims[0].attributes[name]
        assert type(found) is type(value)
        if isinstance(value, np.ndarray):
            assert found.dtype == value.dtype
        np.testing.assert_array_equal(found, value)
    np.testing.assert_array_equal(back.meshes[0].points, points)


angle = st.floats(-3.0, 3.0).map(lambda x: round(x, 4))
length = st.floats(-2.0, 2.0).map(lambda x: round(x, 4))
vector = st.tuples(length, length, length)
rotation = st.tuples(angle, angle, angle).map(lambda e: Rotation.from_euler("xyz", e))
factor = st.sampled_from([-2.0, -1.0, 0.5, 1.0, 3.0])


@given(vector, rotation, st.tuples(factor, factor, factor))
def test_placements_recombine(pos: tuple, turn: Rotation, scale: tuple) -> None:
    matrix = np.eye(4)
    matrix[:3, :3] = turn.as_matrix() @ np.diag(scale)
    matrix[:3, 3] = pos
    placement = split(matrix)
    assert not placement.shears
    rotation_matrix = placement.pose.rotation
    assert np.linalg.det(rotation_matrix) == pytest.approx(1.0)
    np.testing.assert_allclose(rotation_matrix @ placement.stretch, matrix[:3, :3], atol=1e-12)


@given(vector, rotation, vector, rotation)
def test_poses_compose_like_matrices(p: tuple, r: Rotation, q: tuple, s: Rotation) -> None:
    first, second = Pose.of(p, r.as_matrix()), Pose.of(q, s.as_matrix())
    both = first @ second
    np.testing.assert_allclose(both.rotation, (r * s).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(both.pos, r.apply(q) + p, atol=1e-12)
    offset, twist = (first @ first.inverse()).distance(Pose())
    assert offset < 1e-12 and twist < 1e-7


@st.composite
def links(draw) -> dict:
    """One link of a chain: how it is joined to the one before, and where it is authored."""
    return {
        "kind": draw(st.sampled_from(["Revolute", "Prismatic", "Fixed"])),
        "axis": draw(st.sampled_from("XYZ")),
        "pos0": draw(vector),
        "pos1": draw(vector),
        "rot0": draw(rotation),
        "rot1": draw(rotation),
        "start": draw(angle),
        "value": draw(angle),
        "swapped": draw(st.booleans()),
        "fits": draw(st.booleans()),
    }


def quat(turn: Rotation) -> tuple[float, ...]:
    x, y, z, w = turn.as_quat()
    return (w, x, y, z)


def motion(link: dict, value: float) -> tuple[Rotation, np.ndarray]:
    """Rotation and offset of frame1 in frame0."""
    axis = np.eye(3)["XYZ".index(link["axis"])]
    if link["kind"] == "Revolute":
        return Rotation.from_rotvec(axis * value), np.zeros(3)
    return Rotation.identity(), axis * value if link["kind"] == "Prismatic" else np.zeros(3)


def follow(where: tuple[Rotation, np.ndarray], link: dict, value: float) -> tuple:
    """World pose of the next body: forward kinematics that shares nothing with the reader."""
    turn, pos = where
    inner, offset = motion(link, value)
    near, far = ("1", "0") if link["swapped"] else ("0", "1")
    if link["swapped"]:  # body1 is the parent: walk the joint backwards
        offset = -inner.inv().apply(offset)
        inner = inner.inv()
    frame_turn = turn * link[f"rot{near}"]
    frame_pos = pos + turn.apply(link[f"pos{near}"])
    result = frame_turn * inner * link[f"rot{far}"].inv()
    return result, frame_pos + frame_turn.apply(offset) - result.apply(link[f"pos{far}"])


@settings(max_examples=20, deadline=None, phases=[Phase.explicit, Phase.reuse, Phase.generate])
@given(st.lists(links(), min_size=1, max_size=5))
def test_forward_kinematics_of_random_chains(chain: list[dict]) -> None:
    """Whichever body is body0 and wherever bodies are authored, the joint frames decide.

    The file holds the frames in single precision: 5e-6 m over a chain of up to 20 m.
    """
    text, where = body("L0"), (Rotation.identity(), np.zeros(3))
    text += joint("PhysicsFixedJoint", "Root", joins(None, "/L0"))
    for i, link in enumerate(chain, 1):
        where = follow(where, link, link["start"])
        authored = where if link["fits"] else (Rotation.identity(), np.zeros(3))
        text += body(f"L{i}", pos=tuple(authored[1]), quat=quat(authored[0]))
        ends = (f"/L{i}", f"/L{i - 1}") if link["swapped"] else (f"/L{i - 1}", f"/L{i}")
        frames = joins(*ends, link["pos0"], link["pos1"], quat(link["rot0"]), quat(link["rot1"]))
        axis = f'\nuniform token physics:axis = "{link["axis"]}"'
        text += joint(f"Physics{link['kind']}Joint", f"J{i}", frames + axis)
    with tempfile.TemporaryDirectory() as folder:
        model = load(Path(folder), text).model
    data = mujoco.MjData(model)
    for i, link in enumerate(chain, 1):
        if link["kind"] != "Fixed":
            data.joint(f"J{i}").qpos[:] = link["value"]
    mujoco.mj_kinematics(model, data)
    where = (Rotation.identity(), np.zeros(3))
    for i, link in enumerate(chain, 1):
        where = follow(where, link, link["value"])
        np.testing.assert_allclose(data.body(f"L{i}").xpos, where[1], atol=5e-6)
        np.testing.assert_allclose(
            data.body(f"L{i}").xmat.reshape(3, 3), where[0].as_matrix(), atol=5e-6
        )
