"""Missing and non-physical mass properties of URDF links."""

from __future__ import annotations

import math
from pathlib import Path

import hypothesis
import mujoco
import numpy as np
import pytest
import trimesh
from hypothesis import strategies as st

from orbisim.errors import SceneError
from orbisim.scene import Scene
from orbisim.scene.urdf import inertia, read_urdf_string
from orbisim.scene.urdf.model import Inertial
from tests.scene.urdf.urdf_text import (
    collision,
    inertial,
    joint,
    link,
    robot,
    tensor,
    two_links,
    visual,
)

BOX = "<box size='0.2 0.4 0.6'/>"
BOX_MASS = 0.2 * 0.4 * 0.6 * 1000


def read(text: str, **options) -> Scene:
    return Scene.from_read(read_urdf_string(text, **options), "test")


def with_child(*content: str) -> str:
    return two_links(child=f"<link name='b'>{''.join(content)}</link>", type="continuous")


def test_missing_inertia_comes_from_collision_geometry_before_visual() -> None:
    scene = read(with_child(visual("<sphere radius='9'/>"), collision(BOX)))
    assert scene.model.body("b").mass == pytest.approx(BOX_MASS)
    assert any(
        "declares no inertia; inferred 48 kg from its collision" in w for w in scene.warnings
    )


def test_missing_inertia_comes_from_visual_geometry_if_there_is_no_other() -> None:
    scene = read(with_child(visual(BOX)), visuals=False)
    assert scene.model.body("b").mass == pytest.approx(BOX_MASS)
    assert any("from its visual geometry" in warning for warning in scene.warnings)


def test_visual_geometry_of_a_link_that_has_mass_weighs_nothing() -> None:
    scene = read(two_links(child=link("b", inertial(2.0), visual(BOX))))
    assert scene.model.body("b").mass == 2.0


@pytest.mark.parametrize(
    ("given", "says", "mass"),
    [
        (inertial(-1), "mass is negative", BOX_MASS),
        (inertial(0), "mass is zero", BOX_MASS),
        (inertial(2, (1, 1, -1)), "not positive definite", 2),
        (inertial(2, (0, 0, 0)), "inertia is zero", 2),
        (inertial(2, (1, 1, 3)), "triangle inequality", 2),
        ("<inertial><mass value='2'/></inertial>", "without moments", 2),
        ("<inertial/>", "declares no inertia", BOX_MASS),
    ],
)
def test_non_physical_inertia_is_replaced_and_noted(given: str, says: str, mass: float) -> None:
    scene = read(with_child(given, collision(BOX)))
    assert scene.model.body("b").mass == pytest.approx(mass)
    expected = mass / 12 * np.array([0.4**2 + 0.6**2, 0.2**2 + 0.6**2, 0.2**2 + 0.4**2])
    np.testing.assert_allclose(np.diag(tensor(scene.model, "b")), expected)
    assert any(says in warning and "inferred" in warning for warning in scene.warnings)


def test_a_declared_centre_of_mass_survives_a_wrong_tensor() -> None:
    given = inertial(2, (1, 1, 3), "<origin xyz='0.1 0.2 0.3'/>")
    scene = read(with_child(given, collision(BOX)))
    np.testing.assert_allclose(scene.model.body("b").ipos, [0.1, 0.2, 0.3])


def test_a_violation_by_rounding_is_only_rounded() -> None:
    scene = read(with_child(inertial(2, (0.1, 0.2, 0.30001)), collision(BOX)))
    np.testing.assert_allclose(np.diag(tensor(scene.model, "b")), [0.1, 0.2, 0.3], rtol=1e-9)
    assert any("rounding" in warning for warning in scene.warnings)


def test_wrong_moments_without_geometry_become_those_of_a_sphere() -> None:
    scene = read(with_child(inertial(2, (1, 1, 3))))
    radius = (3 * 2 / (4 * math.pi * 1000)) ** (1 / 3)
    np.testing.assert_allclose(np.diag(tensor(scene.model, "b")), 0.4 * 2 * radius**2)


@pytest.mark.parametrize("mass", [0, -1])
def test_no_mass_and_nothing_to_infer_it_from_is_an_error(mass: float) -> None:
    with pytest.raises(SceneError, match=r"link 'b' .*geometry to infer it from; give a positive"):
        read(with_child(inertial(mass)))


def test_an_empty_link_that_moves_gets_a_negligible_mass() -> None:
    scene = read(with_child())
    assert scene.model.body("b").mass == 1e-6
    assert any("negligible" in warning for warning in scene.warnings)


def test_frames_without_mass_between_joints_are_negligible() -> None:
    """Several joints at one place, written as links of mass zero."""
    text = robot(
        link("a"),
        link("x", inertial(0, (0, 0, 0))),
        link("y", inertial(0, (0, 0, 0))),
        link("b"),
        joint("jx", "a", "x", type="continuous"),
        joint("jy", "x", "y", "<axis xyz='0 1 0'/>", type="continuous"),
        joint("jz", "y", "b", "<axis xyz='0 0 1'/>", type="continuous"),
    )
    model = read(text).model
    np.testing.assert_allclose(model.body_mass, [0, 1e-6, 1e-6, 1])


@pytest.mark.parametrize("lump", [True, False])
def test_mass_of_fixed_children_counts(lump: bool) -> None:
    text = robot(
        link("a"),
        "<link name='b'/>",
        link("c", inertial(3.0)),
        joint("j", "a", "b", type="continuous"),
        joint("weld", "b", "c", "<origin xyz='1 0 0'/>", type="fixed"),
    )
    scene = read(text, lump_fixed=lump)
    assert scene.model.body_mass.sum() == pytest.approx(3.0 if lump else 4.0)  # and the root
    assert not any("negligible" in warning for warning in scene.warnings)


def test_boundmass_of_the_extension_leaves_masses_to_mujoco() -> None:
    text = with_child().replace(
        "<link", "<mujoco><compiler boundmass='0.1' boundinertia='0.01'/></mujoco><link", 1
    )
    scene = read(text)
    assert scene.model.body("b").mass == 0.1


def test_closed_convex_mesh_by_each_rule(tmp_path: Path) -> None:
    file = tmp_path / "part.obj"
    trimesh.creation.box((1, 1, 1)).export(file)
    text = with_child(collision(f"<mesh filename='{file}'/>"))
    for rule in ("legacy", "exact", "convex"):
        assert read(text, mesh_inertia=rule).model.body("b").mass == pytest.approx(1000)


def test_an_open_mesh_by_the_exact_rule_is_its_hull(tmp_path: Path) -> None:
    file = tmp_path / "part.stl"
    box = trimesh.creation.box((1, 1, 1))
    box.update_faces(range(1, 12))
    box.export(file)
    text = with_child(collision(f"<mesh filename='{file}'/>"))
    assert read(text, mesh_inertia="exact").model.body("b").mass == pytest.approx(1000)


def test_a_mesh_that_mujocos_rule_overestimates_is_pointed_out(tmp_path: Path) -> None:
    file = tmp_path / "part.stl"
    far = trimesh.creation.box((1, 1, 1), trimesh.transformations.translation_matrix((5, 0, 0)))
    trimesh.util.concatenate([trimesh.creation.box((1, 1, 1)), far]).export(file)
    text = with_child(collision(f"<mesh filename='{file}'/>"))
    scene = read(text)
    assert scene.model.body("b").mass == pytest.approx(4666.6666, rel=1e-6)
    assert any("the closed meshes have 2000 kg" in warning for warning in scene.warnings)
    assert read(text, mesh_inertia="exact").model.body("b").mass == pytest.approx(2000)


dimension = st.floats(0.1, 10)
triple = st.tuples(dimension, dimension, dimension)


@hypothesis.settings(max_examples=20, deadline=None)
@hypothesis.given(size=triple)
def test_primitives_agree_with_fine_meshes(size: tuple[float, float, float]) -> None:
    x, y, z = size
    pairs = [
        (inertia._box(x, y, z), trimesh.creation.box(size), 1e-9),
        (inertia._sphere(x), trimesh.creation.icosphere(3, x), 0.02),
        (inertia._cylinder(x, y), trimesh.creation.cylinder(x, y, sections=64), 0.02),
        (inertia._capsule(x, y), trimesh.creation.capsule(y, x, count=[48, 48]), 0.02),
    ]
    for analytic, mesh, tolerance in pairs:
        meshed = inertia.exact(mesh)
        assert meshed.mass == pytest.approx(analytic.mass, rel=tolerance)
        np.testing.assert_allclose(
            np.diag(meshed.tensor), np.diag(analytic.tensor), rtol=2 * tolerance
        )


@hypothesis.given(size=triple, shift=triple)
def test_exact_rule_is_trimeshs_own(size, shift) -> None:
    mesh = trimesh.creation.cone(size[0], size[1], sections=16)
    mesh.apply_translation(shift)
    found = inertia.exact(mesh)
    assert found.mass == pytest.approx(mesh.volume)
    np.testing.assert_allclose(found.com, mesh.center_mass, atol=1e-9)
    np.testing.assert_allclose(
        found.tensor, mesh.moment_inertia, rtol=1e-6, atol=1e-9 * np.trace(found.tensor)
    )


@hypothesis.given(moments=st.tuples(*[st.floats(1e-6, 10)] * 3), mass=st.floats(1e-6, 100))
def test_what_is_let_pass_compiles_and_what_is_not_does_not(moments, mass) -> None:
    problem = inertia.problem_with(Inertial(mass, np.zeros(3), np.diag(moments)))
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(mass=mass, inertia=moments, explicitinertial=True)
    body.add_joint()
    if problem is None:
        spec.compile()
    else:
        with pytest.raises(ValueError, match="inertia"):
            spec.compile()


@hypothesis.given(
    moments=st.tuples(*[st.floats(0.1, 1)] * 2), excess=st.floats(0, 1e-4), turn=st.floats(-3, 3)
)
def test_rounded_inertia_compiles(moments, excess, turn) -> None:
    spread = np.diag([*moments, sum(moments) * (1 + excess)])
    axes = trimesh.transformations.rotation_matrix(turn, (1, 2, 3))[:3, :3]
    close = inertia.rounded(Inertial(1.0, np.zeros(3), axes @ spread @ axes.T))
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(mass=1, explicitinertial=True)
    t = close.tensor
    body.fullinertia = (t[0, 0], t[1, 1], t[2, 2], t[0, 1], t[0, 2], t[1, 2])
    body.add_joint()
    spec.compile()


def test_total_is_the_parallel_axis_theorem() -> None:
    halves = [Inertial(1.0, np.array([x, 0, 0]), np.zeros((3, 3))) for x in (-1.0, 1.0)]
    whole = inertia.total(halves)
    assert whole.mass == 2.0
    np.testing.assert_allclose(whole.com, 0)
    np.testing.assert_allclose(whole.tensor, np.diag([0, 2, 2]))
