"""Rotations in torch, against SciPy."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from orbisim_world_model.rotation import (
    conjugate,
    exponential,
    geodesic_distance,
    logarithm,
    multiply,
    orthonormalized,
    product,
    quaternion_distance,
    rotate,
    rotate_back,
    to_matrix,
)
from scipy.spatial.transform import Rotation

RNG = np.random.default_rng(0)
ONE, TWO = (Rotation.random(30, RNG) for _ in range(2))


def quat(rotation: Rotation) -> torch.Tensor:
    return torch.tensor(rotation.as_quat(scalar_first=True))


def close(found: torch.Tensor, expected: np.ndarray, atol: float = 1e-9) -> None:
    np.testing.assert_allclose(found.numpy(), expected, atol=atol)


def test_exponential_and_logarithm() -> None:
    vectors = 3.0 * torch.rand(50, 3, dtype=torch.float64) / 3.0**0.5
    vectors[0] = 0.0
    torch.testing.assert_close(logarithm(exponential(vectors)), vectors, atol=1e-6, rtol=0)
    negated = logarithm(-exponential(vectors))
    torch.testing.assert_close(negated, vectors, atol=1e-6, rtol=0)


def test_products_and_inverses() -> None:
    close(to_matrix(multiply(quat(ONE), quat(TWO))), (ONE * TWO).as_matrix())
    close(to_matrix(conjugate(quat(ONE))), ONE.inv().as_matrix())
    close(to_matrix(exponential(torch.tensor(ONE.as_rotvec()))), ONE.as_matrix(), 1e-6)
    close(product(to_matrix(quat(ONE)), to_matrix(quat(TWO))), (ONE * TWO).as_matrix())


def test_vectors_are_turned_there_and_back() -> None:
    vectors = RNG.normal(size=(30, 3))
    turned = rotate(to_matrix(quat(ONE)), torch.tensor(vectors))
    close(turned, ONE.apply(vectors))
    close(rotate_back(to_matrix(quat(ONE)), turned), vectors)


def test_distances_are_angles() -> None:
    angles = (ONE.inv() * TWO).magnitude()
    small = angles < 3.0  # near a half turn the angle is kept below it, for its gradient
    found = geodesic_distance(to_matrix(quat(ONE)), to_matrix(quat(TWO)))
    np.testing.assert_allclose(found.numpy()[small], angles[small], atol=1e-5)
    close(quaternion_distance(quat(ONE), -quat(TWO)), np.sin(angles / 2) ** 2)


def test_two_columns_make_a_rotation() -> None:
    bent = torch.tensor(ONE.as_matrix() + 0.1 * RNG.normal(size=(30, 3, 3)))
    found = orthonormalized(bent)
    close(product(found.transpose(-1, -2), found), np.tile(np.eye(3), (30, 1, 1)))
    close(torch.linalg.det(found), np.ones(30))
    close(orthonormalized(to_matrix(quat(ONE))), ONE.as_matrix())


@pytest.mark.parametrize("function", [exponential, lambda v: logarithm(exponential(v))])
def test_gradients_at_no_rotation_are_finite(function) -> None:  # type: ignore[no-untyped-def]
    still = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    function(still).sum().backward()
    assert torch.isfinite(still.grad).all()
