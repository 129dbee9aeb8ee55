"""USD: mass properties by the schema's rules of precedence."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from orbisim.errors import SceneError
from orbisim.scene import Scene, load_scene
from tests.scene.usd.usd_text import DATA, body, load


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene(DATA / "mass.usda")


def inertia(model: mujoco.MjModel, name: str) -> np.ndarray:
    """[3, 3] about the centre of mass, along the body's axes."""
    item = model.body(name)
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, item.iquat)
    rotation = rotation.reshape(3, 3)
    return rotation @ np.diag(item.inertia) @ rotation.T


CUBE = np.eye(3) / 6  # of 1 kg and 1 m
EXPECTED = {
    "MaterialDensity": (700, [0, 0, 0], 700 * CUBE),
    "Water": (1000, [0, 0, 0], 1000 * CUBE),
    "NearerDensity": (
        700,
        [0, 0, 4 / 7],  # 500 kg at 0, 200 kg at 2
        700 * CUBE + np.diag([1, 1, 0]) * (500 * 16 / 49 + 200 * 100 / 49),
    ),
    "BodyMass": (10, [0, 0, 0.5], 10 * CUBE),
    # a box of 1 x 1 x 2 m; its inertia about a point 0.5 m from its centre
    "CenterMoved": (6, [0, 0, 0.5], np.diag([2.5 + 1.5, 2.5 + 1.5, 1.0])),
    "ColliderMasses": (4, [0, 0, -0.5], 4 * CUBE + np.diag([1, 1, 0]) * (3 * 0.25 + 2.25)),
    # turned by 90 degrees: what was along x is along y
    "ColliderInertia": (2, [1, 0.5, 0], np.diag([2, 1, 3])),
    "Principal": (4, [0.1, 0, 0], np.diag([2, 1, 2.5])),
    "Full": (4, [0, 0, 0], np.array([[1, 0.1, 0.2], [0.1, 2, 0.3], [0.2, 0.3, 2.5]])),
    "Point": (1, [0, 0, 0], 0.4 * 0.01 * np.eye(3)),
    "PointMass": (5, [0, 0, 0], 5 * 0.4 * 0.01 * np.eye(3)),
}


@pytest.mark.parametrize("name", EXPECTED)
def test_precedence(scene: Scene, name: str) -> None:
    mass, com, tensor = EXPECTED[name]
    item = scene.model.body(name)
    assert item.mass[0] == pytest.approx(mass, rel=1e-9)
    np.testing.assert_allclose(item.ipos, com, atol=1e-9)
    np.testing.assert_allclose(inertia(scene.model, name), tensor, rtol=1e-6, atol=1e-6)


def test_assumed_mass_is_said(scene: Scene) -> None:
    assert any("/World/Point and 1 more: no collider" in text for text in scene.warnings)


@pytest.mark.parametrize(
    ("authored", "problem"),
    [
        ("float physics:mass = -1", "physics:mass is -1.0; expected a positive number"),
        ("float physics:mass = nan", "physics:mass is nan; expected finite"),
        ("float physics:mass = inf", "physics:mass is inf; expected finite"),
        ("float physics:density = -5", "physics:density is -5.0"),
        ("float3 physics:diagonalInertia = (1, 1, -1)", "moments of inertia are positive"),
        ("float physics:mass = 1\nfloat3 physics:diagonalInertia = (1, 1, 3)", "A \\+ B >= C"),
        ("point3f physics:centerOfMass = (nan, 0, 0)", "physics:centerOfMass is"),
        ('string physics:mass = "heavy"', "physics:mass is 'heavy'; expected a number"),
        ("float2 physics:mass = (1, 2)", "physics:mass holds 2 numbers; expected 1"),
    ],
)
def test_mass_that_makes_no_sense(tmp_path: Path, authored: str, problem: str) -> None:
    with pytest.raises(SceneError, match=problem) as caught:
        load(tmp_path, body("Bad", mass=authored))
    assert "Bad" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_zero_mass_counts_as_not_given(tmp_path: Path) -> None:
    cube = 'def Cube "C" (prepend apiSchemas = ["PhysicsCollisionAPI"]) {\ndouble size = 1\n}'
    model = load(tmp_path, body("B", cube, mass="float physics:mass = 0")).model
    assert model.body("B").mass[0] == pytest.approx(1000)


def test_moments_just_outside_of_the_triangle_are_rounding(tmp_path: Path) -> None:
    """A plate has A + B = C; single precision can end up on either side."""
    mass = "float physics:mass = 1\nfloat3 physics:diagonalInertia = (0.1, 0.2, 0.30000002)"
    model = load(tmp_path, body("Plate", mass=mass)).model
    np.testing.assert_allclose(sorted(model.body("Plate").inertia), [0.1, 0.2, 0.3], rtol=1e-6)
