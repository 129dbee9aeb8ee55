"""Scenes from what is in memory already."""

from __future__ import annotations

import copy
import pickle
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from dm_control import mjcf
from dm_control.locomotion.arenas import floors
from dm_control.locomotion.walkers import rodent

from orbisim import Physics, Scene, load_scene, make_backend, suite
from orbisim.errors import InputError, SceneError
from orbisim.scene.scene import model_bytes
from orbisim.testing import scenes

CUBE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
WITH_MESH = """
<mujoco><asset><mesh name="m" file="{}"/></asset><worldbody><body><freejoint/>
<geom type="mesh" mesh="m"/></body></worldbody></mujoco>
"""


def same(a: Scene, b: Scene) -> bool:
    return model_bytes(a.model) == model_bytes(b.model)


def alike(a: mujoco.MjModel, b: mujoco.MjModel) -> bool:
    """Equal but for the last digits: MuJoCo writes frames of meshes after it has moved them."""
    names = ("body_mass", "body_inertia", "geom_pos", "geom_quat", "geom_size", "mesh_vert")
    return a.nq == b.nq and all(
        np.allclose(getattr(a, name), getattr(b, name), rtol=0, atol=1e-12) for name in names
    )


@pytest.fixture(scope="module")
def walker() -> Any:
    """A composed model with meshes, textures and skins."""
    arena, rat = floors.Floor(), rodent.Rat()
    arena.add_free_entity(rat)
    return arena, rat


def test_mujocos_own_objects() -> None:
    plain = load_scene(scenes.CARTPOLE)
    spec = mujoco.MjSpec.from_string(scenes.CARTPOLE)
    assert same(load_scene(spec), plain)
    assert load_scene(spec).editable
    model = load_scene(plain.model)
    assert same(model, plain)
    assert not model.editable
    assert load_scene(plain) is plain


def test_a_scene_does_not_follow_its_spec() -> None:
    spec = mujoco.MjSpec.from_string(scenes.CARTPOLE)
    scene = load_scene(spec)
    spec.option.gravity = [0, 0, 0]
    assert scene.spec.option.gravity[2] == -9.81


def test_mjcf_elements_come_with_their_assets(walker: Any) -> None:
    arena, rat = walker
    expected = mjcf.Physics.from_mjcf_model(arena.mjcf_model).model.ptr
    for element in (arena.mjcf_model, arena, rat.mjcf_model, rat.mjcf_model.find_all("joint")[0]):
        assert model_bytes(load_scene(element).model) == model_bytes(expected)


def test_models_of_dm_control() -> None:
    physics = suite.load("cartpole", "swingup").physics
    assert load_scene(physics.model).model.nq == physics.model.nq


@pytest.mark.parametrize(
    "data",
    [
        scenes.CARTPOLE.encode(),
        b"\xef\xbb\xbf" + scenes.CARTPOLE.encode(),
        scenes.CARTPOLE.encode("utf-16"),
        bytearray(scenes.CARTPOLE.encode()),
        "\ufeff" + scenes.CARTPOLE,
    ],
    ids=["bytes", "mark", "utf-16", "bytearray", "text with mark"],
)
def test_documents_as_bytes(data: Any) -> None:
    assert same(load_scene(data), load_scene(scenes.CARTPOLE))


def test_assets_may_be_text() -> None:
    xml = WITH_MESH.format("cube.obj")
    text, raw = (load_scene(xml, assets={"cube.obj": a}) for a in (CUBE, CUBE.encode()))
    assert same(text, raw)
    physics = Physics.from_xml_string(xml.encode(), assets={"cube.obj": CUBE})
    physics.reload_from_xml_string(xml, assets={"cube.obj": CUBE.encode()})
    assert physics.model.nmesh == 1


@pytest.mark.parametrize("source", [None, 3, ["a"], {"xml": "a"}, np.zeros(3), object()])
def test_what_is_no_scene(source: Any) -> None:
    with pytest.raises(InputError, match="a scene is a path, a name such as"):
        load_scene(source)


def test_what_goes_with_text_only() -> None:
    scene = load_scene(scenes.CARTPOLE)
    with pytest.raises(InputError, match="is a scene already; assets cannot change"):
        load_scene(scene, assets={})
    with pytest.raises(InputError, match="is a scene already; floating_base cannot change"):
        load_scene(scene.model, floating_base=True)
    with pytest.raises(InputError, match="assets are file names with contents"):
        load_scene(scenes.CARTPOLE, assets={"a.obj": 3})
    with pytest.raises(InputError, match="assets are file names with contents"):
        load_scene(scenes.CARTPOLE, assets=[b""])
    with pytest.raises(SceneError, match="is not text"):
        load_scene(b"\xff\xfe\x00")


def test_backends_and_physics_take_them_too(walker: Any, tmp_path: Path) -> None:
    path = tmp_path / "scene.xml"
    path.write_text(scenes.CARTPOLE)
    spec = mujoco.MjSpec.from_string(scenes.CARTPOLE)
    for source in (path, str(path), scenes.CARTPOLE, spec, spec.compile(), load_scene(path)):
        assert make_backend("mujoco", source).model.nq == 2
        assert Physics.from_scene(source).model.nq == 2
    assert make_backend("mujoco", "suite:cartpole-swingup").model.nq == 2
    assert Physics.from_scene(walker[0]).model.nskin == 1
    with pytest.raises(InputError, match="a scene is"):
        make_backend("mujoco", None)
    with pytest.raises(InputError, match="named by a string"):
        make_backend(None, spec)
    with pytest.raises(InputError, match="from_xml_path takes a path"):
        Physics.from_xml_string(str(path))


@pytest.mark.parametrize(
    "copied", [copy.copy, copy.deepcopy, lambda s: pickle.loads(pickle.dumps(s))],
    ids=["copy", "deepcopy", "pickle"],
)  # fmt: skip
def test_copies_are_equal_to_the_byte(copied: Any, tmp_path: Path) -> None:
    (tmp_path / "cube.obj").write_text(CUBE)
    path = tmp_path / "scene.xml"
    path.write_text(WITH_MESH.format("cube.obj"))
    scene = load_scene(path)
    _ = scene.descriptor, scene.fingerprint
    twin = copied(scene)
    assert same(twin, scene)
    assert (twin.name, twin.source, twin.warnings) == (scene.name, scene.source, scene.warnings)
    assert alike(twin.spec.compile(), scene.model)
    assert twin.descriptor == scene.descriptor


def test_a_pickle_needs_no_files(tmp_path: Path) -> None:
    (tmp_path / "cube.obj").write_text(CUBE)
    path = tmp_path / "scene.xml"
    path.write_text(WITH_MESH.format("cube.obj"))
    scene = load_scene(path)
    data = pickle.dumps(scene)
    (tmp_path / "cube.obj").unlink()
    assert alike(pickle.loads(data).spec.compile(), scene.model)
    late = pickle.loads(pickle.dumps(scene))  # too late for the document
    assert same(late, scene)
    assert not late.editable


def test_scenes_without_a_document(walker: Any) -> None:
    scene = load_scene(load_scene(walker[0]).model)
    for twin in (copy.deepcopy(scene), pickle.loads(pickle.dumps(scene))):
        assert same(twin, scene)
        assert not twin.editable
