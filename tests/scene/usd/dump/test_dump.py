"""USD: the dump against OpenUSD's own evaluation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("pxr")

from pxr import Gf, Usd, UsdGeom, UsdPhysics

from orbisim.scene.usd.attributes import prims_of
from orbisim.scene.usd.bodies import Bodies
from orbisim.scene.usd.context import Context
from orbisim.scene.usd.dump.stage import StageDumper
from orbisim.scene.usd.joints import read_joints
from orbisim.scene.usd.units import Units
from tests.scene.usd.usd_text import DATA, body, joins, joint, place, stage

numbers = st.floats(-4, 4).map(lambda x: round(x, 3))
factors = st.floats(0.3, 3).map(lambda x: round(x, 3)) | st.just(-1.5)
triples = st.tuples(numbers, numbers, numbers)
OPS = {
    "TranslateOp": triples.map(lambda v: Gf.Vec3d(*v)),
    "ScaleOp": st.tuples(factors, factors, factors).map(lambda v: Gf.Vec3f(*v)),
    "RotateXOp": numbers.map(lambda x: 40 * x),
    "RotateYOp": numbers.map(lambda x: 40 * x),
    "RotateZOp": numbers.map(lambda x: 40 * x),
    **{
        f"Rotate{order}Op": triples.map(lambda v: Gf.Vec3f(*v) * 40)
        for order in ("XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX")
    },
    "OrientOp": triples.map(lambda v: Gf.Quatf(1.0, Gf.Vec3f(*v)).GetNormalized()),
    "TransformOp": triples.map(
        lambda v: Gf.Matrix4d(Gf.Rotation(Gf.Vec3d(*v) + Gf.Vec3d(0, 0, 9), 77.0), Gf.Vec3d(*v))
    ),
    "TranslateXOp": numbers,
    "ScaleYOp": factors,
}


@st.composite
def ops(draw) -> list[tuple[str, object, bool]]:
    names = draw(st.lists(st.sampled_from(sorted(OPS)), max_size=5))
    return [(name, draw(OPS[name]), draw(st.booleans())) for name in names]


@settings(max_examples=60, deadline=None)
@given(st.lists(ops(), min_size=1, max_size=3), st.booleans())
def test_transforms_are_openusds(levels: list, reset: bool) -> None:
    usd = Usd.Stage.CreateInMemory()
    path = ""
    for level, content in enumerate(levels):
        path += f"/p{level}"
        xform = UsdGeom.Xform.Define(usd, path)
        known = [(f"Add{name}", i, value, inverted) for i, (name, value, inverted) in
                 enumerate(content) if hasattr(xform, f"Add{name}")]  # fmt: skip
        for add, i, value, _ in known:
            getattr(xform, add)(opSuffix=f"s{i}").Set(value)
        for add, i, _, inverted in known:  # as a pivot would: the same attribute, undone later
            if inverted and add != "AddScaleYOp":  # OpenUSD 26.11 negates it instead
                getattr(xform, add)(opSuffix=f"s{i}", isInverseOp=True)
        if reset and level == 1:
            xform.SetResetXformStack(True)
    flat = StageDumper(usd, "memory").dump()
    for prim in flat.prims:
        expected = UsdGeom.Xformable(usd.GetPrimAtPath(prim.path))
        matrix = np.array(expected.ComputeLocalToWorldTransform(Usd.TimeCode.EarliestTime())).T
        np.testing.assert_allclose(prim.matrix, matrix, atol=2e-4, rtol=1e-5)


def test_numbers_keep_their_decimals() -> None:
    """What OpenUSD turns into 0.10000000149 stays 0.1."""
    text = stage(body("B", pos=(0.1, 0.2, 0.3), scale=(0.1, 0.7, 3))).replace("double3", "float3")
    layer = Usd.Stage.CreateInMemory()
    layer.GetRootLayer().ImportFromString(text)
    flat = {prim.path: prim for prim in StageDumper(layer, "memory").dump().prims}
    np.testing.assert_array_equal(flat["/B"].matrix[:3, 3], [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(np.diag(flat["/B"].matrix), [0.1, 0.7, 3, 1])


pytestmark = pytest.mark.filterwarnings("ignore:LoadUsdPhysicsFromRange")


def opened(path: Path) -> tuple[Usd.Stage, Context]:
    usd = Usd.Stage.Open(str(path))
    flat = StageDumper(usd, str(path)).dump()
    return usd, Context(str(path), flat, prims_of(flat, str(path)), Units())


def test_joint_frames_are_openusds(tmp_path: Path) -> None:
    """OpenUSD's physics parser resolves bodies and scales; its poses are in single precision."""
    text = (
        body("A", f'def Xform "Hook"\n{{\n{place((1, 2, 3), (0.8, 0.6, 0, 0), (2, 2, 2))}\n}}\n',
             pos=(1, 0, 0), scale=(1, 3, 2))
        + body("B", pos=(0, 5, 0), quat=(0.6, 0, 0.8, 0), scale=(-1, 1, 2))
        + joint("PhysicsRevoluteJoint", "J", joins("/A/Hook", "/B", (0.1, 0.2, 0.3), (1, 2, 3),
                                                   (0.8, 0, 0, 0.6), (0.6, 0.8, 0, 0)))
    )  # fmt: skip
    path = tmp_path / "scene.usda"
    path.write_text(stage(text))
    usd, context = opened(path)
    (ours,) = read_joints(context, Bodies(context))
    parsed = UsdPhysics.LoadUsdPhysicsFromRange(usd, ["/"])
    _, (theirs,) = parsed[UsdPhysics.ObjectType.RevoluteJoint]
    assert (str(theirs.body0), str(theirs.body1)) == (ours.body0, ours.body1)
    for pose, pos, quat in (
        (ours.frame0, theirs.localPose0Position, theirs.localPose0Orientation),
        (ours.frame1, theirs.localPose1Position, theirs.localPose1Orientation),
    ):
        np.testing.assert_allclose(pose.pos, np.array(pos), atol=1e-5)
        theirs_quat = np.array([quat.GetReal(), *quat.GetImaginary()])
        assert abs(pose.quat @ theirs_quat) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("name", ["units", "mass", "car", "mujoco"])
def test_bodies_are_openusds(name: str) -> None:
    usd, context = opened(DATA / f"{name}.usda")
    parsed = UsdPhysics.LoadUsdPhysicsFromRange(usd, ["/"])
    paths, described = parsed[UsdPhysics.ObjectType.RigidBody]
    ours = Bodies(context).all
    assert {str(path) for path in paths} == set(ours)
    for path, body_desc in zip(paths, described, strict=True):
        np.testing.assert_allclose(
            ours[str(path)].pose.pos, np.array(body_desc.position), atol=1e-5
        )
