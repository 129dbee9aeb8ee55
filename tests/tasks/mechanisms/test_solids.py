"""Solids: closed surfaces, where they are, and their mass."""

from __future__ import annotations

import numpy as np
import pytest

from orbisim.tasks.mechanisms.solids import Solid, box, cylinder, frustum, mass_properties, surface

SOME = (box((0.1, 0.2, 0.3), (1, 0, 0), (0, 0, 0.3)), cylinder(0.1, 0.4, axis="x"),
        frustum(0.1, 0.05, 0.2, (0, 0, 1)))  # fmt: skip


@pytest.mark.parametrize("solid", SOME)
def test_a_solid_is_closed_and_convex(solid: Solid) -> None:
    mesh = solid.mesh()
    assert mesh.is_watertight and mesh.is_convex and mesh.volume > 0
    np.testing.assert_allclose(mesh.center_mass[:2], solid.pos[:2], atol=1e-9)


def test_a_cylinder_lies_along_its_axis() -> None:
    np.testing.assert_allclose(SOME[1].mesh().extents, [0.4, 0.2, 0.2], atol=1e-6)


def test_mass_of_a_box() -> None:
    mass, com, tensor = mass_properties([box((0.1, 0.2, 0.3), (0, 1, 0))], 1000.0)
    assert mass == pytest.approx(6.0)
    np.testing.assert_allclose(com, [0, 1, 0], atol=1e-12)
    expected = [0.2**2 + 0.3**2, 0.1**2 + 0.3**2, 0.1**2 + 0.2**2]
    np.testing.assert_allclose(tensor, np.diag(expected) * 6 / 12, atol=1e-9)


def test_mass_of_two_halves_is_that_of_the_whole() -> None:
    whole = mass_properties([box((0.2, 0.1, 0.1))], 500.0)
    halves = [box((0.1, 0.1, 0.1), (x, 0, 0)) for x in (-0.05, 0.05)]
    for one, other in zip(whole, mass_properties(halves, 500.0), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9)


def test_a_parts_surface_has_all_its_solids() -> None:
    assert len(surface(SOME).faces) == sum(len(solid.mesh().faces) for solid in SOME)
