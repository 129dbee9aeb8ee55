"""What is drawn, and where: compared with MuJoCo's own numbers, without a browser."""

from __future__ import annotations

import sys
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orbisim.errors import InputError, MissingDependencyError
from orbisim.scene import Scene, load_scene
from orbisim.view.drawing import Drawing
from orbisim.view.options import GHOST, ViewOptions
from orbisim.view.three import color_number
from tests.view.scenes import CLOTH, SKIN, TENDONS, matrix_of, plain, showcase

SCENE = showcase()
DRAWN = {"floor", "hill", "sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh", "sdf"}
DRAWN |= {"glass", "marker"}


def objects(commands: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Objects by path."""
    return {c["path"]: c["object"] for c in commands if c["type"] == "set_object"}


def world_transforms(commands: list[dict[str, Any]]) -> dict[str, Any]:
    """[4, 4] of every path in the world, as the viewer's tree multiplies them."""
    own = {c["path"]: matrix_of(c["matrix"]) for c in commands if c["type"] == "set_transform"}
    result = {}
    for path in own:
        matrix, names = np.eye(4), path.strip("/").split("/")
        for depth in range(1, len(names) + 1):
            matrix = matrix @ own.get("/" + "/".join(names[:depth]), np.eye(4))
        result[path] = matrix
    return result


def by_name(drawing: Drawing, name: str) -> str:
    return next(drawing.part_path(p) for p in drawing.parts if p.name.startswith(name + " "))


def channels(number: int) -> list[int]:
    return [number >> 16, number >> 8 & 255, number & 255]


def one(kind: str, **attributes: str) -> Scene:
    given = " ".join(f'{key}="{value}"' for key, value in attributes.items())
    return load_scene(f'<mujoco><worldbody><geom type="{kind}" {given}/></worldbody></mujoco>')


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_every_geom_is_where_mujoco_puts_it(seed: int) -> None:
    model = SCENE.model
    rng = np.random.default_rng(seed)
    qpos = rng.normal(size=model.nq)
    mujoco.mj_normalizeQuat(model, qpos)
    mocap = {"mocap_pos": rng.normal(size=(1, 3)), "mocap_quat": np.array([[0.6, 0, 0.8, 0]])}
    drawing = Drawing(model)
    drawing.place(qpos, mocap)
    transforms = world_transforms(plain(drawing.create()))
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    data.mocap_pos[:], data.mocap_quat[:] = mocap["mocap_pos"], mocap["mocap_quat"]
    mujoco.mj_kinematics(model, data)
    for name in DRAWN:
        matrix = transforms[by_name(drawing, name)]
        np.testing.assert_allclose(matrix[:3, 3], data.geom(name).xpos, atol=1e-9)
        np.testing.assert_allclose(matrix[:3, :3].ravel(), data.geom(name).xmat, atol=1e-9)
    moved = {c["path"]: matrix_of(c["matrix"]) for c in plain(drawing.update())}
    assert moved.keys() == {drawing.bodies[b] for b in drawing.moving}
    for path, matrix in moved.items():
        np.testing.assert_array_equal(matrix, transforms[path])


def test_what_moves_and_what_does_not() -> None:
    drawing = Drawing(SCENE.model)
    names = {SCENE.model.body(b).name for b in drawing.moving}
    assert "world" not in names
    assert {"target", "arm", "ball"} <= names


def test_shows_what_mujoco_shows() -> None:
    names = {part.name.rsplit(" ", 1)[0] for part in Drawing(SCENE.model).parts}
    assert names == DRAWN
    every = Drawing(SCENE.model, ViewOptions(groups=(0, 1, 2, 3), sites=True))
    assert {p.name.rsplit(" ", 1)[0] for p in every.parts} == DRAWN | {"hidden", "tip"}
    assert {p.name for p in Drawing(SCENE.model, ViewOptions(groups=(3,))).parts} == {"hidden 10"}


def test_collision_twins_are_not_shown() -> None:
    urdf = """<robot name="r"><link name="a">
      <inertial><mass value="1"/>
      <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
      <visual><geometry><sphere radius=".1"/></geometry></visual>
      <collision><geometry><box size=".2 .2 .2"/></geometry></collision></link></robot>"""
    scene = load_scene(urdf)
    assert [p.kind for p in Drawing(scene.model).parts] == [mujoco.mjtGeom.mjGEOM_SPHERE]
    shown = Drawing(scene.model, ViewOptions(groups=(3,))).parts
    assert [p.kind for p in shown] == [mujoco.mjtGeom.mjGEOM_BOX]


def test_names_with_reserved_characters_stay_one_node() -> None:
    scene = load_scene(
        '<mujoco><worldbody><body name="a/b"><geom name="&lt;object&gt;" size="1"/><geom size="1"/>'
        '</body><body name="a:b"><geom size="1"/></body></worldbody></mujoco>'
    )
    drawing = Drawing(scene.model)
    paths = [drawing.part_path(part) for part in drawing.parts]
    assert len(set(paths)) == 3
    assert all(path.count("/") == 3 and "<" not in path for path in paths)


@pytest.mark.parametrize(
    ("kind", "size", "geometry"),
    [
        ("sphere", ".2", {"type": "SphereGeometry", "radius": 1.0}),
        ("box", ".1 .2 .3", {"width": 0.2, "height": 0.4, "depth": 0.6}),
        ("cylinder", ".1 .3", {"radiusTop": 0.1, "radiusBottom": 0.1, "height": 0.6}),
    ],
)
def test_parameters_of_primitives(kind: str, size: str, geometry: dict[str, Any]) -> None:
    drawing = Drawing(one(kind, size=size).model)
    (drawn,) = objects(plain(drawing.create())).values()
    for key, value in geometry.items():
        assert drawn["geometries"][0][key] == pytest.approx(value)


def test_round_shapes_lie_along_z() -> None:
    matrix = {
        kind: matrix_of(
            next(iter(objects(plain(Drawing(one(kind, size=size).model).create())).values()))[
                "object"
            ]["matrix"]
        )
        for kind, size in {"cylinder": ".1 .3", "capsule": ".1 .3", "ellipsoid": ".1 .2 .3"}.items()
    }
    y = np.array([0.0, 1, 0, 0])  # three.js's axis
    np.testing.assert_allclose(matrix["cylinder"] @ y, [0, 0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(matrix["capsule"] @ y, [0, 0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(matrix["ellipsoid"] @ y, [0, 0, 0.3, 0], atol=1e-12)
    np.testing.assert_allclose(
        np.sort(np.linalg.svd(matrix["ellipsoid"][:3, :3])[1]), [0.1, 0.2, 0.3]
    )
    assert all(np.linalg.det(m) > 0 for m in matrix.values())  # a mirror would turn faces inside


def test_capsule_profile() -> None:
    (drawn,) = objects(plain(Drawing(one("capsule", size=".1 .3").model).create())).values()
    profile = np.array([[p["x"], p["y"]] for p in drawn["geometries"][0]["points"]])
    assert profile[0] == pytest.approx([0, -0.4])
    assert profile[-1] == pytest.approx([0, 0.4])
    ends = profile[:, 1] - np.clip(profile[:, 1], -0.3, 0.3)
    np.testing.assert_allclose(np.hypot(profile[:, 0], ends), 0.1, atol=1e-12)


def vertices_of(drawn: dict[str, Any]) -> Any:
    return drawn["geometries"][0]["data"]["attributes"]["position"]["array"].reshape(-1, 3)


def test_meshes_fill_mujocos_bounding_boxes() -> None:
    drawing = Drawing(SCENE.model)
    drawn = objects(plain(drawing.create()))
    for name in ("mesh", "sdf"):
        points = vertices_of(drawn[by_name(drawing, name)])
        aabb = SCENE.model.geom_aabb[SCENE.model.geom(name).id]
        np.testing.assert_allclose(points.min(axis=0), aabb[:3] - aabb[3:], atol=1e-6)
        np.testing.assert_allclose(points.max(axis=0), aabb[:3] + aabb[3:], atol=1e-6)


def outward(points: Any, faces: Any) -> Any:
    """Volume of a closed surface; positive if its faces look outwards."""
    a, b, c = (points[faces[:, i]].astype(np.float64) for i in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def test_mesh_faces_and_normals_look_outwards() -> None:
    drawing = Drawing(SCENE.model)
    geometry = objects(plain(drawing.create()))[by_name(drawing, "mesh")]["geometries"][0]["data"]
    points = geometry["attributes"]["position"]["array"].reshape(-1, 3)
    normals = geometry["attributes"]["normal"]["array"].reshape(-1, 3)
    faces = geometry["index"]["array"].reshape(-1, 3)
    volume = 0.5 * 0.4 * 0.3 * 0.35
    assert outward(points, faces) == pytest.approx(volume, rel=1e-5)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-4)
    a, b, c = (points[faces[:, i]] for i in range(3))
    across = np.cross(b - a, c - a)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    for corner in range(3):  # every edge of a wedge is sharp
        np.testing.assert_allclose(normals[faces[:, corner]], across, atol=1e-4)


def test_smooth_meshes_stay_smooth() -> None:
    drawing = Drawing(SCENE.model)
    data = objects(plain(drawing.create()))[by_name(drawing, "sdf")]["geometries"][0]["data"]
    assert len(data["attributes"]["position"]["array"]) // 3 == SCENE.model.mesh_vertnum[1]


def test_height_field_has_its_heights_and_a_base() -> None:
    drawing = Drawing(SCENE.model)
    points = vertices_of(objects(plain(drawing.create()))[by_name(drawing, "hill")])
    assert points.min(axis=0) == pytest.approx([-0.3, -0.3, -0.05])
    assert points.max(axis=0)[:2] == pytest.approx([0.3, 0.3])
    data = SCENE.model.hfield_data.reshape(12, 12)
    surface = points[:144].reshape(12, 12, 3)
    np.testing.assert_allclose(surface[..., 2], 0.25 * data, atol=1e-6)
    # the row changes y and the column changes x, as a ray against MuJoCo's surface confirms
    model, hit = mujoco.MjData(SCENE.model), np.zeros(1, np.int32)
    mujoco.mj_kinematics(SCENE.model, model)
    at = surface[3, 7].astype(np.float64) + [0.95, -0.75, 0.05]
    down = np.array([0.0, 0, -1])
    distance = mujoco.mj_ray(SCENE.model, model, at + [1e-4, 1e-4, 1], down, None, 1, -1, hit)
    assert SCENE.model.geom(hit[0]).name == "hill"
    assert distance == pytest.approx(1.0, abs=2e-3)


def test_planes() -> None:
    (finite,) = objects(plain(Drawing(one("plane", size="2 1 .1").model).create())).values()
    assert np.abs(vertices_of(finite)).max(axis=0) == pytest.approx([2, 1, 0])
    infinite = one("plane", size="0 0 .1")
    (drawn,) = objects(plain(Drawing(infinite.model).create())).values()
    reach = np.linalg.norm(vertices_of(drawn), axis=1).max()
    assert reach > 10 * infinite.model.stat.extent
    alpha = drawn["geometries"][0]["data"]["attributes"]["color"]["array"].reshape(-1, 4)[:, 3]
    assert (alpha.min(), alpha.max()) == (0, 1)
    (half,) = objects(plain(Drawing(one("plane", size="0 1 .1").model).create())).values()
    assert np.abs(vertices_of(half)).max(axis=0)[1] == pytest.approx(1)


def test_colours_and_materials() -> None:
    drawing = Drawing(SCENE.model)
    drawn = objects(plain(drawing.create()))
    materials = {name: drawn[by_name(drawing, name)]["materials"][0] for name in DRAWN}
    assert channels(materials["sphere"]["color"]) == pytest.approx([229.5, 25.5, 25.5], abs=1)
    assert channels(materials["mesh"]["color"]) == pytest.approx([255, 191, 13], abs=1)
    assert channels(materials["mesh"]["emissive"]) == pytest.approx([76.5, 57, 4], abs=1)
    assert materials["glass"]["opacity"] == pytest.approx(0.5)
    assert materials["glass"]["transparent"]
    assert not materials["sphere"]["transparent"]
    assert "map" in materials["floor"]
    assert drawn[by_name(drawing, "floor")]["images"][0]["url"].startswith("data:image/png;base64,")


def test_a_cube_texture_becomes_its_mean_colour() -> None:
    scene = load_scene("""<mujoco><asset>
      <texture name="t" type="cube" builtin="flat" rgb1="0 .5 0" rgb2="0 .5 0"
        width="16" height="16"/>
      <material name="m" texture="t" rgba="1 1 .5 1"/></asset>
      <worldbody><geom size="1" material="m"/></worldbody></mujoco>""")
    (drawn,) = objects(plain(Drawing(scene.model).create())).values()
    assert channels(drawn["materials"][0]["color"]) == pytest.approx([0, 127, 0], abs=1)
    assert "map" not in drawn["materials"][0]


def test_a_ghost_is_what_moves_in_one_transparent_colour() -> None:
    drawing = Drawing(SCENE.model, look=GHOST)
    drawn = objects(plain(drawing.create()))
    assert not any("floor" in path or "hill" in path for path in drawn)
    assert any("marker" in path for path in drawn)  # mocap bodies move
    assert all(path.startswith("/ghost/") for path in drawn)
    assert {o["materials"][0]["color"] for o in drawn.values()} == {color_number(GHOST.tint)}
    assert all(o["materials"][0]["transparent"] for o in drawn.values())
    assert not any("map" in o["materials"][0] for o in drawn.values())


def test_objects_have_identities_of_their_own_and_output_repeats() -> None:
    def identities() -> list[str]:
        drawn = objects(plain(Drawing(SCENE.model).create()))
        return [
            entry["uuid"]
            for o in drawn.values()
            for entry in (o["object"], *o["geometries"], *o["materials"])
        ]

    assert len(set(identities())) == len(identities())
    assert identities() == identities()


def test_flexes_follow_their_vertices() -> None:
    scene = load_scene(CLOTH)
    drawing = Drawing(scene.model)
    drawn = objects(plain(drawing.create()))
    kinds = {path: o["object"]["type"] for path, o in drawn.items() if path.count("/") == 2}
    assert sorted(kinds.values()) == ["LineSegments", "Mesh", "Mesh"]
    qpos = np.random.default_rng(0).normal(scale=0.1, size=scene.model.nq)
    drawing.place(qpos)
    data = mujoco.MjData(scene.model)
    data.qpos[:] = qpos
    mujoco.mj_forward(scene.model, data)
    updates = [c for c in plain(drawing.update()) if c["type"] == "set_vertices"]
    got = np.concatenate([c["positions"].reshape(-1, 3) for c in updates])
    np.testing.assert_allclose(got, data.flexvert_xpos, atol=1e-6)
    for path, o in drawn.items():
        if path in kinds:
            index = o["geometries"][0]["data"]["index"]["array"]
            assert index.max() == len(vertices_of(o)) - 1


def test_tendons_are_lines_that_stop_at_pulleys() -> None:
    scene = load_scene(TENDONS)
    assert not Drawing(scene.model).deforming
    drawing = Drawing(scene.model, ViewOptions(tendons=True))
    (tendon,) = drawing.deforming
    points = tendon.vertices(drawing.kinematics.data)
    expected = [[-0.5, 0, 1], [0.3, 0, 0.8], [0.3, 0, 0.6], [0.3, 0, 0.8]]
    np.testing.assert_allclose(points, expected, atol=1e-6)
    assert not Drawing(scene.model, ViewOptions(tendons=True), GHOST).deforming


def test_contacts_are_shown_on_request() -> None:
    scene = load_scene(
        "<mujoco><worldbody><geom type='plane' size='1 1 1'/><body pos='0 0 .099'><freejoint/>"
        "<geom size='.1'/></body></worldbody></mujoco>"
    )
    drawing = Drawing(scene.model, ViewOptions(contacts=True))
    (contacts,) = drawing.deforming
    ends = contacts.vertices(drawing.kinematics.data)
    assert ends.shape == (2, 3)
    np.testing.assert_allclose(ends[:, :2], 0, atol=1e-6)
    assert ends[1, 2] > ends[0, 2]
    drawing.place(np.array([0, 0, 1.0, 1, 0, 0, 0]))
    assert contacts.vertices(drawing.kinematics.data).shape == (0, 3)


def test_skins_bend_with_their_bones() -> None:
    scene = load_scene(SKIN)
    assert not Drawing(scene.model).deforming
    drawing = Drawing(scene.model, ViewOptions(skins=True))
    (skin,) = drawing.deforming
    flat = skin.vertices(drawing.kinematics.data).astype(np.float64)
    np.testing.assert_allclose(flat[2], [0.4, 0.2, 0], atol=1e-6)
    drawing.place(np.array([np.pi / 2]))
    bent = skin.vertices(drawing.kinematics.data)
    np.testing.assert_allclose(bent[2], [0, 0.2, -0.4], atol=1e-6)
    assert skin.index() is not None
    assert np.asarray(skin.index()).tolist() == [[0, 1, 2], [0, 2, 3]]


def test_meshes_are_simplified_only_on_request() -> None:
    drawing, coarse = Drawing(SCENE.model), Drawing(SCENE.model, ViewOptions(max_faces=80))

    def faces(drawing: Drawing) -> tuple[int, Any]:
        data = objects(plain(drawing.create()))[by_name(drawing, "sdf")]["geometries"][0]["data"]
        return len(data["index"]["array"]) // 3, data["attributes"]["position"]["array"]

    assert faces(drawing)[0] == SCENE.model.mesh_facenum[1] > 80
    count, points = faces(coarse)
    assert 40 <= count <= 80
    assert np.abs(points.reshape(-1, 3)).max(axis=0) == pytest.approx([0.13, 0.13, 0.18], rel=0.15)


def test_simplification_needs_its_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "fast_simplification", None)
    with pytest.raises(MissingDependencyError, match=r"orbisim\[view\]"):
        list(Drawing(SCENE.model, ViewOptions(max_faces=80)).create())


@pytest.mark.parametrize(
    "wrong", [{"groups": (6,)}, {"background": "pink"}, {"max_faces": 3}, {"groups": (0, -1)}]
)
def test_options_out_of_range(wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        ViewOptions(**wrong)
