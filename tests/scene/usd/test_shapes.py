"""USD: colliders, meshes and visual geometry under all kinds of transforms."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

from orbisim.errors import SceneError
from orbisim.scene import Scene
from tests.scene.usd.usd_text import body, load, schemas

GEOM = mujoco.mjtGeom


def collider(kind: str, name: str = "C", content: str = "", *extra: str) -> str:
    return f'def {kind} "{name}" ({schemas("PhysicsCollisionAPI", *extra)})\n{{\n{content}\n}}\n'


def tetrahedron(approximation: str = "none", points: str = "", more: str = "") -> str:
    """A mesh collider; by default a corner of a cube, 1/6 m^3."""
    points = points or "[(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]"
    return collider(
        "Mesh",
        "M",
        f"""
        point3f[] points = {points}
        int[] faceVertexCounts = [3, 3, 3, 3]
        int[] faceVertexIndices = [0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3]
        uniform token physics:approximation = "{approximation}"
        {more}
        """,
        "PhysicsMeshCollisionAPI",
    )


def scaled(content: str, scale: str = "(2, 3, 4)", order: str = '"xformOp:scale"') -> str:
    return f"{content}\ndouble3 xformOp:scale = {scale}\nuniform token[] xformOpOrder = [{order}]"


SHAPES = {
    "cube": (collider("Cube", "C", "double size = 0.5"), GEOM.mjGEOM_BOX, [0.25, 0.25, 0.25]),
    "default cube": (collider("Cube"), GEOM.mjGEOM_BOX, [1, 1, 1]),
    "scaled cube": (collider("Cube", "C", scaled("")), GEOM.mjGEOM_BOX, [2, 3, 4]),
    "sphere": (collider("Sphere", "C", "double radius = 0.2"), GEOM.mjGEOM_SPHERE, [0.2, 0, 0]),
    "ellipsoid": (collider("Sphere", "C", scaled("")), GEOM.mjGEOM_ELLIPSOID, [2, 3, 4]),
    "capsule": (
        collider("Capsule", "C", "double radius = 0.1\ndouble height = 1"),
        GEOM.mjGEOM_CAPSULE,
        [0.1, 0.5, 0],
    ),
    "uneven capsule": (
        collider("Capsule", "C", scaled("double radius = 0.1\ndouble height = 1")),
        GEOM.mjGEOM_CAPSULE,
        [0.3, 2, 0],
    ),
    "cylinder": (
        collider("Cylinder", "C", scaled('uniform token axis = "Y"', "(2, 5, 2)")),
        GEOM.mjGEOM_CYLINDER,
        [2, 5, 0],
    ),
    "mirrored cube": (collider("Cube", "C", scaled("", "(-1, 2, 1)")), GEOM.mjGEOM_BOX, [1, 2, 1]),
}


@pytest.mark.parametrize("name", SHAPES)
def test_primitives(tmp_path: Path, name: str) -> None:
    text, kind, size = SHAPES[name]
    model = load(tmp_path, body("B", text)).model
    assert model.geom("C").type[0] == kind
    np.testing.assert_allclose(model.geom("C").size[: 3 if kind != GEOM.mjGEOM_PLANE else 0], size)


def radii(bottom: float, top: float) -> str:
    return f"double radiusBottom = {bottom}\ndouble radiusTop = {top}\n"


VOLUMES = {
    "cone": (collider("Cone", "C", "double radius = 0.3\ndouble height = 0.9"), 0.3**2 * 0.3),
    "elliptic cylinder": (collider("Cylinder", "C", scaled("", "(2, 1, 0.5)")), 2 * 1 * 2 * 0.5),
    "truncated cone": (
        collider("Cylinder_1", "C", radii(2, 1) + "double height = 3"),
        1 + 2 + 4,
    ),
    "egg": (
        collider("Capsule_1", "C", radii(1, 1) + "double height = 2"),
        4 / 3 + 2,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", VOLUMES)
def test_shapes_that_become_meshes_keep_their_volume(tmp_path: Path, name: str) -> None:
    text, share = VOLUMES[name]
    scene = load(tmp_path, body("B", text, mass=""))
    expected = 1000 * math.pi * share
    assert scene.model.body("B").mass[0] == pytest.approx(expected, rel=0.004)
    assert any("becomes a convex mesh" in text for text in scene.warnings)


def test_a_cone_is_where_usd_has_it(tmp_path: Path) -> None:
    """Its tip is at +height/2 along its axis, its centre of mass a quarter above the base."""
    text = collider("Cone", "C", 'double radius = 1\ndouble height = 4\nuniform token axis = "X"')
    model = load(tmp_path, body("B", text, mass="")).model
    np.testing.assert_allclose(model.body("B").ipos, [-1, 0, 0], atol=1e-6)


def test_planes_face_their_axis(tmp_path: Path) -> None:
    text = "".join(
        collider("Plane", f"P{axis}", f'uniform token axis = "{axis}"\ndouble width = 4')
        for axis in "XYZ"
    )
    model = load(tmp_path, text + body("B")).model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for i, axis in enumerate("XYZ"):
        np.testing.assert_allclose(
            data.geom(f"P{axis}").xmat.reshape(3, 3)[:, 2], np.eye(3)[i], atol=1e-12
        )


def test_a_plane_on_a_moving_body_is_left_out(tmp_path: Path) -> None:
    scene = load(tmp_path, body("B", collider("Plane") + collider("Cube", "K")))
    assert scene.model.ngeom == 1
    assert any("Plane that collides" in str(entry) for entry in scene.unsupported)


def test_a_sheared_cube_is_a_parallelepiped(tmp_path: Path) -> None:
    """A rotation between two uneven scales shears; the volume is the product of the factors."""
    inner = f"""
    def Xform "Turned"
    {{
        double3 xformOp:scale = (3, 1, 1)
        float xformOp:rotateZ = 45
        uniform token[] xformOpOrder = ["xformOp:scale", "xformOp:rotateZ"]
        {collider("Cube", "C", "double size = 1")}
    }}
    """
    model = load(tmp_path, body("B", inner, mass="")).model
    assert model.geom("C").type[0] == GEOM.mjGEOM_MESH
    assert model.body("B").mass[0] == pytest.approx(3000, rel=1e-6)


def test_sheared_spheres_are_ellipsoids(tmp_path: Path) -> None:
    inner = f"""
    def Xform "Turned"
    {{
        double3 xformOp:scale = (3, 1, 1)
        float xformOp:rotateZ = 30
        uniform token[] xformOpOrder = ["xformOp:scale", "xformOp:rotateZ"]
        {collider("Sphere", "C", scaled("double radius = 1", "(1, 2, 1)"))}
    }}
    """
    model = load(tmp_path, body("B", inner, mass="")).model
    assert model.geom("C").type[0] == GEOM.mjGEOM_ELLIPSOID
    assert np.prod(model.geom("C").size) == pytest.approx(6)


def test_reset_of_the_transform_stack(tmp_path: Path) -> None:
    inner = f"""
    def Xform "Away"
    {{
        double3 xformOp:translate = (1, 2, 3)
        uniform token[] xformOpOrder = ["!resetXformStack!", "xformOp:translate"]
        {collider("Cube", "C")}
    }}
    {collider("Cube", "K")}
    """
    model = load(tmp_path, body("B", inner, pos=(10, 0, 0))).model
    assert model.geom("C").bodyid[0] == 0  # it does not move with the body above it
    np.testing.assert_allclose(model.geom("C").pos, [1, 2, 3])
    assert model.geom("K").bodyid[0] == model.body("B").id


def mesh_type(scene: Scene) -> tuple[int, float]:
    geom = scene.model.geom("M")
    return int(geom.type[0]), float(scene.model.body("B").mass[0])


@pytest.mark.parametrize(
    ("approximation", "kind", "volume"),
    [
        ("none", GEOM.mjGEOM_MESH, 1 / 6),
        ("convexHull", GEOM.mjGEOM_MESH, 1 / 6),
        ("convexDecomposition", GEOM.mjGEOM_MESH, 1 / 6),
        ("meshSimplification", GEOM.mjGEOM_MESH, 1 / 6),
        ("sdf", GEOM.mjGEOM_MESH, 1 / 6),
    ],
)
def test_approximations_of_a_convex_mesh(
    tmp_path: Path, approximation: str, kind: int, volume: float
) -> None:
    scene = load(tmp_path, body("B", tetrahedron(approximation), mass=""))
    found, mass = mesh_type(scene)
    assert found == kind
    assert mass == pytest.approx(1000 * volume, rel=1e-5)
    np.testing.assert_allclose(scene.model.body("B").ipos, [0.25] * 3, atol=1e-5)
    assert not scene.unsupported


def test_bounding_sphere(tmp_path: Path) -> None:
    """The smallest sphere around the corner of a cube has the far face as a great circle."""
    scene = load(tmp_path, body("B", tetrahedron("boundingSphere")))
    geom = scene.model.geom("M")
    assert geom.type[0] == GEOM.mjGEOM_SPHERE
    assert geom.size[0] == pytest.approx(math.sqrt(2 / 3), rel=5e-3)
    np.testing.assert_allclose(geom.pos, [1 / 3] * 3, atol=5e-3)


def test_bounding_cube_is_the_smallest_box(tmp_path: Path) -> None:
    """A needle along the diagonal: the box along the axes would be a cube."""
    points = "[(0, 0, 0), (1, 1, 1), (0.5, 0.52, 0.5), (0.5, 0.5, 0.52)]"
    scene = load(tmp_path, body("B", tetrahedron("boundingCube", points)))
    size = np.sort(scene.model.geom("M").size)
    assert scene.model.geom("M").type[0] == GEOM.mjGEOM_BOX
    assert size[2] == pytest.approx(math.sqrt(3) / 2, rel=0.02)
    assert size[1] < 0.02


L_SHAPE = """
point3f[] points = [(0,0,0),(2,0,0),(2,1,0),(1,1,0),(1,2,0),(0,2,0),
                    (0,0,1),(2,0,1),(2,1,1),(1,1,1),(1,2,1),(0,2,1)]
int[] faceVertexCounts = [4,4,4,4,4,4,4,4,4,4]
int[] faceVertexIndices = [0,3,2,1, 0,5,4,3, 6,7,8,9, 6,9,10,11, 0,1,7,6, 1,2,8,7, 2,3,9,8,
                           3,4,10,9, 4,5,11,10, 5,0,6,11]
"""


def test_a_mesh_that_is_not_convex(tmp_path: Path) -> None:
    """Its hull collides, which is said; its mass is that of the mesh."""
    text = collider("Mesh", "M", L_SHAPE, "PhysicsMeshCollisionAPI")
    scene = load(tmp_path, body("B", text, mass=""))
    assert scene.model.ngeom == 1
    assert scene.model.body("B").mass[0] == pytest.approx(3000, rel=1e-5)
    assert any("not convex" in str(entry) for entry in scene.unsupported)


@pytest.mark.parametrize("route", ["approximation", "option"])
def test_a_mesh_split_into_convex_parts(tmp_path: Path, route: str) -> None:
    pytest.importorskip("vhacdx")
    authored = 'uniform token physics:approximation = "convexDecomposition"'
    content = L_SHAPE + (authored if route == "approximation" else "")
    text = collider("Mesh", "M", content, "PhysicsMeshCollisionAPI", "PhysicsMassAPI")
    text = text.replace("point3f[]", "float physics:mass = 6\npoint3f[]")
    options = {} if route == "approximation" else {"decompose": True}
    scene = load(tmp_path, body("B", text, mass=""), options=options)
    assert scene.model.ngeom >= 2
    assert scene.model.body("B").mass[0] == pytest.approx(6)
    assert not scene.unsupported


def test_mirrored_and_left_handed_meshes_have_their_outside_outside(tmp_path: Path) -> None:
    mirrored = tetrahedron(more=scaled("", "(-1, 1, 1)"))
    left = tetrahedron(more='uniform token orientation = "leftHanded"').replace(
        "[0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3]", "[0, 1, 2, 0, 3, 1, 0, 2, 3, 1, 3, 2]"
    )
    scene = load(tmp_path, body("A", mirrored, mass="") + body("B", left, mass=""))
    for name, x in (("A", -0.25), ("B", 0.25)):
        assert scene.model.body(name).mass[0] == pytest.approx(1000 / 6, rel=1e-5)
        np.testing.assert_allclose(scene.model.body(name).ipos, [x, 0.25, 0.25], atol=1e-5)


def test_polygons_are_triangulated(tmp_path: Path) -> None:
    scene = load(tmp_path, body("B", collider("Mesh", "M", L_SHAPE)))
    assert scene.model.nmeshface == 20


def test_equal_meshes_are_held_once(tmp_path: Path) -> None:
    text = "".join(body(name, tetrahedron()) for name in "ABC")
    assert load(tmp_path, text).model.nmesh == 1


def test_a_flat_mesh_collides_as_a_slab(tmp_path: Path) -> None:
    quad = collider(
        "Mesh",
        "Ground",
        "point3f[] points = [(-5,-5,0),(5,-5,0),(5,5,0),(-5,5,0)]\n"
        "int[] faceVertexCounts = [4]\nint[] faceVertexIndices = [0,1,2,3]",
    )
    ball = body("B", collider("Sphere", "S", "double radius = 0.1"), pos=(0, 0, 0.5))
    scene = load(tmp_path, quad + ball)
    data = mujoco.MjData(scene.model)
    for _ in range(1000):
        mujoco.mj_step(scene.model, data)
    assert data.body("B").xpos[2] == pytest.approx(0.1, abs=2e-3)
    assert any("slab" in text for text in scene.warnings)


BROKEN = {
    "nan": ("points", "[(0,0,0),(nan,0,0),(0,1,0),(0,0,1)]", "coordinates must be finite"),
    "index": ("faceVertexIndices", "[0,2,1,0,1,9,0,3,2,1,2,3]", "holds 9; the mesh has 4 points"),
    "negative": ("faceVertexIndices", "[0,2,1,0,1,-1,0,3,2,1,2,3]", "holds -1"),
    "count": ("faceVertexCounts", "[3,3,3,1000000000]", "adds up to 1000000009 face vertices"),
    "edges": ("faceVertexCounts", "[2,4,3,3]", "a face has at least 3 vertices"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_meshes_are_refused(tmp_path: Path, name: str) -> None:
    field, value, problem = BROKEN[name]
    lines = tetrahedron().splitlines()
    text = "\n".join(
        f"{line.split('=')[0]}= {value}" if f" {field} " in line else line for line in lines
    )
    with pytest.raises(SceneError, match=problem) as caught:
        load(tmp_path, body("B", text))
    assert "/B/M" in str(caught.value)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (collider("Sphere", "C", "double radius = -1"), "radius is -1.0"),
        (collider("Sphere", "C", "double radius = 0"), "its size comes to"),
        (collider("Cube", "C", scaled("", "(0, 1, 1)")), "must not be zero"),
        (collider("Cylinder", "C", 'uniform token axis = "W"'), "axis is 'W'; expected one of X"),
        (collider("Mesh"), "collides but has no faces"),
        (collider("Cube", "C", scaled("", "(nan, 1, 1)")), "its transform is not finite"),
    ],
)
def test_shapes_that_make_no_sense(tmp_path: Path, text: str, problem: str) -> None:
    with pytest.raises(SceneError, match=problem):
        load(tmp_path, body("B", text))


def test_visual_geometry_and_looks(tmp_path: Path) -> None:
    text = """
    def Material "Red"
    {
        token outputs:surface.connect = </Red/Shader.outputs:surface>
        def Shader "Shader"
        {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor = (1, 0, 0)
            float inputs:opacity = 0.5
            float inputs:roughness = 0.25
            token outputs:surface
        }
    }
    """ + body(
        "B",
        """
        def Cube "Seen" (prepend apiSchemas = ["MaterialBindingAPI"])
        {
            rel material:binding = </Red>
        }
        def Cube "Coloured"
        {
            color3f[] primvars:displayColor = [(0, 0.25, 1)]
        }
        def Cube "Guide"
        {
            uniform token purpose = "guide"
        }
        def Xform "Hidden"
        {
            token visibility = "invisible"
            def Cube "Inside"
            {
            }
        }
        """
        + collider("Cube", "Solid"),
    )
    scene = load(tmp_path, text)
    model = scene.model
    seen = model.geom("Seen")
    assert seen.contype[0] == seen.conaffinity[0] == 0
    np.testing.assert_allclose(model.mat_rgba[seen.matid[0]], [1, 0, 0, 0.5])
    assert model.mat_shininess[seen.matid[0]] == pytest.approx(0.75)
    np.testing.assert_allclose(model.geom("Coloured").rgba, [0, 0.25, 1, 1])
    groups = {name: int(model.geom(name).group[0]) for name in
              ("Seen", "Guide", "Inside", "Solid")}  # fmt: skip
    assert groups == {"Seen": 2, "Guide": 3, "Inside": 3, "Solid": 0}
    assert model.body("B").mass[0] == pytest.approx(1)


def test_cameras_and_lights(tmp_path: Path) -> None:
    text = body(
        "B",
        """
        def Camera "Eye"
        {
            float focalLength = 24
            float verticalAperture = 24
            double3 xformOp:translate = (0, 0, 1)
            uniform token[] xformOpOrder = ["xformOp:translate"]
        }
        """,
    )
    text += 'def DistantLight "Sun" {\ncolor3f inputs:color = (1, 0.5, 0)\n}\n'
    text += 'def DomeLight "Sky" {\n}\n'
    scene = load(tmp_path, text)
    camera = scene.model.camera("Eye")
    assert camera.fovy[0] == pytest.approx(math.degrees(2 * math.atan(0.5)))
    assert camera.bodyid[0] == scene.model.body("B").id
    np.testing.assert_allclose(camera.pos, [0, 0, 1])
    np.testing.assert_allclose(scene.model.light("Sun").dir, [0, 0, -1])
    np.testing.assert_allclose(scene.model.light("Sun").diffuse, [0.7, 0.35, 0], atol=1e-6)
    assert any("DomeLight" in str(entry) for entry in scene.unsupported)
