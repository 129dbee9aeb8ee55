"""What is computed for all worlds at once is what each world alone would compute, to the bit."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from dm_control.utils import rewards

from orbisim.vector.worlds import NotBatchedError, Worlds, WorldsDifferError

NWORLD = 97


def rows(*shape: int, seed: int = 0) -> Any:
    return np.random.default_rng(seed).normal(size=(NWORLD, *shape))


def same(function: Callable[..., Any], *arrays: Any) -> None:
    """Compares one call on all worlds with a call for each."""
    together = function(*map(Worlds, arrays))
    alone = [function(*(a[world] for a in arrays)) for world in range(NWORLD)]
    parts = together if isinstance(together, tuple) else (together,)
    columns = list(zip(*alone, strict=True)) if isinstance(together, tuple) else [alone]
    for part, column in zip(parts, columns, strict=True):
        expected = np.stack([np.asarray(value) for value in column])
        assert part.shape == expected.shape[1:]
        np.testing.assert_array_equal(part.rows, expected)


ONE = {
    "norm": (np.linalg.norm, (3,)),
    "norm of a long vector": (np.linalg.norm, (40,)),
    "norm of a matrix": (np.linalg.norm, (1, 3)),
    "norm along an axis": (lambda x: np.linalg.norm(x, axis=1), (4, 3)),
    "norm of columns that were picked": (lambda x: np.linalg.norm(x[:, [0, 2]]), (12, 3)),
    "sum": (np.sum, (30,)),
    "sum of a transposed matrix": (lambda x: x.T.sum(), (30, 4)),
    "sum along axes": (lambda x: (x.sum(axis=0), x.sum(axis=1), x.sum(axis=-1)), (30, 4)),
    "mean": (lambda x: x.mean(), (30,)),
    "mean of rows": (lambda x: np.mean(x, axis=1), (30, 3)),
    "prod": (lambda x: x.prod(), (20,)),
    "min, max": (lambda x: (x.min(), np.max(x), np.maximum.reduce(x)), (9,)),
    "any, all": (lambda x: (np.any(x > 1), (x > -1).all()), (3,)),
    "powers of numbers": (lambda x: (abs(x) ** 2.5, x**2, x**4, 2.0**x), ()),
    "powers of arrays": (lambda x: (abs(x) ** 2.5, x**2, x**3, 2.0**x), (3,)),
    "power": (lambda x: np.power(abs(x), 2.5), (3,)),
    "functions": (lambda x: (np.exp(x), np.tanh(x), np.cos(x), np.arcsinh(x)), (5,)),
    "modf": (np.modf, (2,)),
    "fancy indices": (lambda x: x[[[1], [2]], [0, 2]], (5, 3)),
    "a mask": (lambda x: x[np.array([True, False, True])], (3,)),
    "slices": (lambda x: (x[1:, ::2], x[-1], x[..., 0], x[None]), (5, 3)),
    "columns, flat": (lambda x: x[:, [0, 2]].ravel(), (5, 3)),
    "reshape": (lambda x: (x.reshape(2, 3), x.reshape((3, -1)).T, x.flatten()), (6,)),
    "stacked": (lambda x: np.hstack((x, 1.0, x)), (3,)),
    "stacked rows": (lambda x: np.vstack([np.sin(x), np.cos(x)]).T, (3,)),
    "concatenated": (lambda x: np.concatenate([x, np.zeros((1, 3))], axis=0), (2, 3)),
    "stack": (lambda x: np.stack([x, x], axis=1), (3,)),
    "diff": (lambda x: np.diff(x, axis=0), (2, 3)),
    "clip": (lambda x: (np.clip(x, -1, 0.5), x.clip(0, 1)), (3,)),
    "what has no form for many worlds": (lambda x: np.linalg.det(x), (3, 3)),
    "einsum": (lambda x: np.einsum("i,i", x, x), (3,)),
    "unpacking": (lambda x: (lambda a, b: a - b)(*x), (2, 3)),
    "float of a flag": (lambda x: x - x, ()),
}

TWO = {
    "vectors": ((3,), (3,)),
    "long vectors": ((40,), (40,)),
    "vector and matrix": ((3,), (3, 3)),
    "matrix and vector": ((3, 3), (3,)),
    "matrices": ((4, 3), (3, 3)),
    "number and vector": ((), (3,)),
}


@pytest.mark.parametrize("name", ONE)
def test_one_argument(name: str) -> None:
    function, shape = ONE[name]
    same(function, rows(*shape))


@pytest.mark.parametrize("name", TWO)
def test_products(name: str) -> None:
    a, b = TWO[name]
    same(np.dot, rows(*a), rows(*b, seed=1))
    if a:
        same(lambda x, y: (x.dot(y), x @ y), rows(*a), rows(*b, seed=1))


@pytest.mark.parametrize("shape", [(), (5,)], ids=["number", "array"])
@pytest.mark.parametrize(
    "sigmoid",
    [
        "gaussian",
        "hyperbolic",
        "long_tail",
        "reciprocal",
        "cosine",
        "linear",
        "quadratic",
        "tanh_squared",
    ],
)
def test_rewards(sigmoid: str, shape: tuple[int, ...]) -> None:
    same(lambda x: rewards.tolerance(x, (0, 0.1), margin=2, sigmoid=sigmoid), rows(*shape))
    same(lambda x: rewards.tolerance(x, (0, 0.1)), rows(*shape))


SHAPES = [(), (1,), (3,), (2, 3), (2, 1), (1, 2, 3)]


@pytest.mark.parametrize("ufunc", [np.subtract, np.arctan2, np.less], ids=lambda u: u.__name__)
def test_shapes_are_broadcast_as_in_one_world(ufunc: Any) -> None:
    for a, b in itertools.product(SHAPES, SHAPES):
        x, y = rows(*a), rows(*b, seed=1)
        constant = np.array(y[0])
        same(ufunc, x, y)
        same(lambda value, other=constant: ufunc(value, other), x)
        same(lambda value, other=constant: ufunc(other, value), x)


def test_a_branch_that_worlds_take_together_is_taken() -> None:
    assert Worlds(np.array([1.0, 2.0])) > 0
    assert not Worlds(np.array([1.0, 2.0])) < 0
    assert float(Worlds(np.array([2.0, 2.0]))) == 2.0


def test_a_branch_that_divides_the_worlds_says_which() -> None:
    values = Worlds(np.array([1.0, -1.0, 2.0]))
    with pytest.raises(WorldsDifferError) as caught:
        max(values, 0.0)
    np.testing.assert_array_equal(caught.value.mask, [False, True, False])
    with pytest.raises(WorldsDifferError) as caught:
        float(values > 0)
    np.testing.assert_array_equal(caught.value.mask, [True, False, True])


@pytest.mark.parametrize(
    "call",
    [
        lambda x: np.array([x, x]),
        lambda x: np.asarray(x),
        lambda x: float(x),
        lambda x: np.zeros(3) + np.array([1.0, x, 2.0]),
        lambda x: np.add(np.zeros(1), x, out=np.zeros(1)),
    ],
)
def test_what_cannot_be_said_of_all_worlds_is_refused(call: Callable[[Any], Any]) -> None:
    with pytest.raises(NotBatchedError):
        call(Worlds(rows()))


def test_views_of_the_simulation_are_not_written() -> None:
    fixed = rows(3)
    fixed.flags.writeable = False
    values = Worlds(fixed)
    with pytest.raises(ValueError, match="read-only"):
        values += 1.0
    with pytest.raises(ValueError, match="read-only"):
        values[0] = 1.0


def test_assignment_in_every_world() -> None:
    def zeroed(x: Any) -> Any:
        y = x.copy()
        y[1:] = 0.0
        y[0] = x[2]
        y *= 2.0
        return y

    same(zeroed, rows(3))
