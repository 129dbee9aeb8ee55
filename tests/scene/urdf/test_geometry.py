"""Visual and collision geometry, materials, mesh files, packages."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from orbisim import load_scene
from orbisim.errors import SceneError
from orbisim.scene import Scene
from orbisim.scene.urdf import read_urdf_string
from tests.scene.urdf.urdf_text import collision, inertial, joint, link, robot, visual

DATA = Path(__file__).parent / "data"


def read(text: str, **options) -> Scene:
    return Scene.from_read(read_urdf_string(text, **options), "test")


def one_link(*content: str) -> str:
    return robot(link("a", inertial(), *content))


def test_groups_and_masks() -> None:
    text = robot(
        link("a", inertial(), visual("<sphere radius='0.1'/>"), collision("<box size='1 1 1'/>")),
        link("b", inertial(), collision("<box size='1 1 1'/>")),
        joint("j", "a", "b", type="continuous"),
    )
    model = read(text).model
    both = {int(model.geom_type[i]): i for i in range(2)}
    drawn = both[mujoco.mjtGeom.mjGEOM_SPHERE]
    hidden = both[mujoco.mjtGeom.mjGEOM_BOX]
    assert (model.geom_group[drawn], model.geom_contype[drawn]) == (1, 0)
    assert (model.geom_group[hidden], model.geom_contype[hidden]) == (3, 1)
    assert (model.geom_group[2], model.geom_conaffinity[2]) == (0, 1)
    assert read(text, visuals=False).model.ngeom == 2


def test_sizes_are_halved_where_mujoco_has_halves() -> None:
    shapes = ["<box size='2 4 6'/>", "<cylinder radius='1' length='4'/>", "<sphere radius='3'/>"]
    model = read(one_link(*(collision(shape) for shape in shapes))).model
    np.testing.assert_array_equal(model.geom_size, [[1, 2, 3], [1, 2, 0], [3, 0, 0]])


def test_colours() -> None:
    text = robot(
        "<material name='red'><color rgba='1 0 0 1'/></material>",
        link(
            "a",
            inertial(),
            visual("<sphere radius='1'/>", "<material name='red'/>"),
            visual(
                "<sphere radius='2'/>", "<material name='x'><color rgba='0 1 0 0.5'/></material>"
            ),
            visual("<sphere radius='3'/>", "<material name='x'/>"),
            visual("<sphere radius='4'/>", "<material name='none'/>"),
            visual(
                "<sphere radius='5'/>", "<material name='t'><texture filename='t.png'/></material>"
            ),
        ),
    )
    scene = read(text)
    rgba = {scene.model.geom_size[i][0]: scene.model.geom_rgba[i] for i in range(5)}
    np.testing.assert_allclose(rgba[1], [1, 0, 0, 1])
    np.testing.assert_allclose(rgba[2], [0, 1, 0, 0.5])
    np.testing.assert_allclose(rgba[3], [0, 1, 0, 0.5])
    assert any("no material 'none'" in warning for warning in scene.warnings)
    assert [item.feature for item in scene.unsupported] == ["<texture>"]


def test_shapes_without_extent() -> None:
    scene = read(one_link(visual("<sphere radius='0'/>")))
    assert scene.model.ngeom == 0
    assert [item.feature for item in scene.unsupported] == ["a sphere without extent"]
    with pytest.raises(SceneError, match=r"link 'a', collision 1 .*not positive: \(0.0,\)"):
        read(one_link(collision("<sphere radius='0'/>")))


def test_collada_keeps_all_nodes_transforms_units_and_colours() -> None:
    """Two cubes of 10 cm; one 1 m up, one 0.5 m aside, turned and stretched."""
    scene = read(one_link(visual(f"<mesh filename='{DATA / 'two_nodes.dae'}'/>")))
    model = scene.model
    assert model.ngeom == 2
    bounds = {}
    for geom in range(2):
        start, count = model.mesh_vertadr[geom], model.mesh_vertnum[geom]
        turn = np.empty(9)
        mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
        corners = model.mesh_vert[start : start + count] @ turn.reshape(3, 3).T
        corners = corners + model.geom_pos[geom]
        color = tuple(model.geom_rgba[geom])
        bounds[color] = np.array([corners.min(axis=0), corners.max(axis=0)])
    np.testing.assert_allclose(bounds[1, 0, 0, 1], [[0, 0, 1], [0.1, 0.1, 1.1]], atol=1e-6)
    np.testing.assert_allclose(bounds[0, 0, 1, 1], [[0.4, 0, 1], [0.5, 0.2, 1.1]], atol=1e-6)


def test_collada_collision_is_one_solid_with_the_mass_of_both() -> None:
    mesh = f"<mesh filename='{DATA / 'two_nodes.dae'}' scale='10 10 10'/>"
    text = robot(link("a"), link("b", collision(mesh)), joint("j", "a", "b", type="continuous"))
    model = read(text, mesh_inertia="exact").model
    assert (model.ngeom, model.nmesh) == (1, 1)
    assert model.body("b").mass == pytest.approx(3000)


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply", "off", "glb", "dae"])
def test_formats(tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"part.{suffix}"
    exported = trimesh.creation.box((1, 2, 3)).export(file_type=suffix)
    file.write_bytes(exported if isinstance(exported, bytes) else exported.encode())
    mesh = f"<mesh filename='{file}'/>"
    text = robot(
        link("a"), link("b", collision(mesh), visual(mesh)), joint("j", "a", "b", type="continuous")
    )
    assert read(text).model.body("b").mass == pytest.approx(6000, rel=1e-6)


def test_meshes_that_mujocos_decoders_do_not_take(tmp_path: Path) -> None:
    """ASCII STL, more than 200,000 faces, one triangle, a flat sheet that is to collide."""
    box = trimesh.creation.box((1, 1, 1))
    (tmp_path / "ascii.stl").write_text(box.export(file_type="stl_ascii"))
    trimesh.creation.icosphere(7).export(tmp_path / "fine.stl")
    corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    trimesh.Trimesh(corners, [[0, 1, 2]]).export(tmp_path / "one.stl")
    text = one_link(
        collision("<mesh filename='ascii.stl'/>"),
        visual("<mesh filename='fine.stl'/>"),
        collision("<mesh filename='one.stl'/>"),
        visual("<mesh filename='one.stl'/>"),
    )
    scene = read(text, base_folder=tmp_path)
    assert scene.model.nmesh == 4
    assert any("'one.stl' is flat; made 0.001 m thick" in warning for warning in scene.warnings)


TWO_OBJECTS = (
    "o one\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    "o two\nv 5 0 0\nv 6 0 0\nv 5 1 0\nv 5 0 1\nf 5 7 6\nf 5 6 8\nf 5 8 7\nf 6 7 8\n"
)


def test_all_objects_of_an_obj_are_kept(tmp_path: Path) -> None:
    """MuJoCo's own decoder reads the first."""
    (tmp_path / "two.obj").write_text(TWO_OBJECTS)
    text = robot(
        link("a"),
        link("b", collision("<mesh filename='two.obj'/>")),
        joint("j", "a", "b", type="continuous"),
    )
    model = read(text, base_folder=tmp_path, mesh_inertia="exact").model
    assert model.nmeshface == 8
    assert model.body("b").mass == pytest.approx(2000 / 6)


def test_mjcf_says_that_mujoco_reads_the_first_object(tmp_path: Path) -> None:
    (tmp_path / "two.obj").write_text(TWO_OBJECTS)
    (tmp_path / "s.xml").write_text(
        "<mujoco><asset><mesh name='m' file='two.obj'/></asset><worldbody><body><freejoint/>"
        "<geom type='mesh' mesh='m'/></body></worldbody></mujoco>"
    )
    scene = load_scene(tmp_path / "s.xml")
    assert scene.model.nmeshface == 4
    assert any("of which MuJoCo reads the first" in warning for warning in scene.warnings)


def test_files_of_one_name_in_two_folders_stay_apart(tmp_path: Path) -> None:
    for folder, edge in (("x", 1.0), ("y", 2.0)):
        (tmp_path / folder).mkdir()
        trimesh.creation.box((edge, 1, 1)).export(tmp_path / folder / "part.stl")
    text = one_link(
        collision("<mesh filename='x/part.stl'/>"), collision("<mesh filename='y/part.stl'/>")
    )
    model = read(text, base_folder=tmp_path).model
    np.testing.assert_allclose(sorted(model.geom_size.max(axis=1)), [0.5, 1.0], atol=1e-6)


def test_a_scene_outlives_its_mesh_files(tmp_path: Path) -> None:
    file = tmp_path / "part.stl"
    trimesh.creation.box((1, 1, 1)).export(file)
    scene = read(one_link(collision(f"<mesh filename='{file}'/>")))
    file.unlink()
    scene.spec.compile()
    again = load_scene(scene.save(tmp_path / "saved"))
    np.testing.assert_allclose(again.model.geom_size, scene.model.geom_size, atol=1e-7)


def test_textures_of_mesh_files_are_listed(tmp_path: Path) -> None:
    (tmp_path / "m.mtl").write_text("newmtl red\nKd 1 0 0\nmap_Kd wood.png\n")
    obj = trimesh.creation.box((1, 1, 1)).export(file_type="obj")
    (tmp_path / "m.obj").write_text("mtllib m.mtl\n" + obj.replace("\nf ", "\nusemtl red\nf ", 1))
    scene = read(one_link(visual("<mesh filename='m.obj'/>")), base_folder=tmp_path)
    assert [item.feature for item in scene.unsupported] == ["texture images"]
    np.testing.assert_allclose(scene.model.geom_rgba[0], [1, 0, 0, 1])


# ---- where files are ---------------------------------------------------------------------------


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """`ws/src/my_robot` with a package.xml of another folder name, and a mesh in it."""
    folder = tmp_path / "ws" / "src" / "checkout"
    (folder / "meshes").mkdir(parents=True)
    (folder / "urdf").mkdir()
    (folder / "package.xml").write_text("<package><name>my_robot</name></package>")
    trimesh.creation.box((1, 1, 1)).export(folder / "meshes" / "a part.stl")
    return folder


TEXT = robot(link("a", inertial(), collision("<mesh filename='{}'/>")))


def _loads(text: str, **options) -> bool:
    return read(text, **options).model.nmesh == 1


def test_package_found_above_the_file(package: Path) -> None:
    file = package / "urdf" / "r.urdf"
    file.write_text(TEXT.format("package://my_robot/meshes/a part.stl"))
    assert load_scene(file).model.nmesh == 1


def test_package_found_by_option(package: Path, tmp_path: Path) -> None:
    text = TEXT.format("package://my_robot/meshes/a part.stl")
    assert _loads(text, package_paths={"my_robot": package})
    assert _loads(text, package_paths=[tmp_path, package])
    assert _loads(text, package_paths=package)


def test_package_found_by_environment(
    package: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = TEXT.format("package://my_robot/meshes/a part.stl")
    with pytest.raises(SceneError, match="package 'my_robot' is not found"):
        _loads(text, base_folder=tmp_path)
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "ws"))
    assert _loads(text, base_folder=tmp_path)
    monkeypatch.delenv("ROS_PACKAGE_PATH")
    (tmp_path / "install" / "share").mkdir(parents=True)
    (tmp_path / "install" / "share" / "my_robot").symlink_to(package)
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere:{tmp_path / 'install'}")
    assert _loads(text, base_folder=tmp_path)


@pytest.mark.parametrize(
    "name",
    ["meshes/a part.stl", "urdf/../meshes/a part.stl", "file://{}/meshes/a%20part.stl",
     "file:{}/meshes/a part.stl", "{}/meshes/a part.stl", "meshes\\a part.stl",
     "$(find my_robot)/meshes/a part.stl", "model://my_robot/meshes/a part.stl"],
)  # fmt: skip
def test_other_names(package: Path, name: str) -> None:
    assert _loads(TEXT.format(name.format(package)), base_folder=package)


def test_meshdir_and_strippath_of_the_extension(package: Path) -> None:
    compiler = "<mujoco><compiler meshdir='meshes' strippath='true'/></mujoco>"
    text = robot(compiler, link("a", inertial(), collision("<mesh filename='x/y/a part.stl'/>")))
    assert _loads(text, base_folder=package)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("meshes/none.stl", "does not exist; expected it at"),
        ("package://my_robot/none.stl", "has no file 'none.stl'; looked in"),
        ("package://other/none.stl", "name its folder: --package other=FOLDER (in Python"),
        ("http://example.org/a.stl", "on the network"),
        ("", "filename is empty"),
    ],
)
def test_files_that_are_not_there(package: Path, name: str, says: str) -> None:
    with pytest.raises(SceneError) as caught:
        read(TEXT.format(name), base_folder=package)
    assert says in str(caught.value)
    assert "link 'a'" in str(caught.value)


@pytest.mark.parametrize("name", ["meshes/none.stl", "package://other/none.stl", "pointer.stl"])
def test_visual_meshes_that_are_not_there_are_left_out(package: Path, name: str) -> None:
    """MuJoCo's import discards them anyway; its collision geometry is a robot's body."""
    (package / "pointer.stl").write_text("version https://git-lfs.github.com/spec/v1\noid x\n")
    visual = f"<visual><geometry><mesh filename='{name}'/></geometry></visual>"
    ball = collision("<sphere radius='1'/>")
    scene = read(robot(link("a", inertial(), visual, ball)), base_folder=package)
    assert scene.model.ngeom == 1
    assert scene.model.geom_group[0] == 0  # not hidden behind what is not drawn
    assert any("link 'a', visual 1" in w and "is left out" in w for w in scene.warnings)
    with pytest.raises(SceneError):
        read(TEXT.format(name), base_folder=package)  # of a collision element


def test_a_link_is_not_weighed_by_a_visual_that_is_not_there(package: Path) -> None:
    visual = "<visual><geometry><mesh filename='none.stl'/></geometry></visual>"
    text = robot(link("base"), link("a", visual), joint("j", "base", "a", type="continuous"))
    scene = read(text, base_folder=package)
    assert any("is left out" in warning for warning in scene.warnings)


@pytest.mark.parametrize("name", ["part.stl", "meshes/part.stl", "elsewhere/part.stl"])
def test_names_that_contain_the_mesh_folder_already(package: Path, name: str) -> None:
    (package / "meshes").mkdir(exist_ok=True)
    (package / "meshes" / "part.stl").write_bytes((package / "meshes/a part.stl").read_bytes())
    compiler = "<mujoco><compiler meshdir='meshes'/></mujoco>"
    text = robot(compiler, link("a", inertial(), collision(f"<mesh filename='{name}'/>")))
    assert _loads(text, base_folder=package)


def test_joint_and_geometry_names() -> None:
    text = one_link(
        collision("<sphere radius='1'/>", name="hull"),
        collision("<sphere radius='2'/>", name="hull"),
    )
    scene = read(text)
    assert [scene.model.geom(i).name for i in range(2)] == ["hull", ""]
    assert any("1 geoms have no name" in warning for warning in scene.warnings)


def test_world_link_geometry_goes_to_the_world() -> None:
    text = robot(
        f"<link name='world'>{collision('<box size=%s/>' % repr('1 1 1'))}</link>",  # noqa: UP031
        link("a"),
        joint("j", "world", "a", type="continuous"),
    )
    assert read(text).model.geom_bodyid[0] == 0
