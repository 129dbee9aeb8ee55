"""Arrays of many worlds on a device: what NumPy does with one world, torch does with all."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from dm_control.utils import rewards

from orbisim.vector.tensor_worlds import Context, TensorWorlds, merged
from orbisim.vector.worlds import NotBatchedError

COUNT = 5


def context() -> Context:
    return Context("cpu", COUNT)


def numbers(*shape: int) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(COUNT, *shape))


def worlds(rows: np.ndarray, where: Context | None = None) -> TensorWorlds:
    return TensorWorlds(torch.from_numpy(rows.copy()), where or context())


MATRIX = np.arange(9.0).reshape(3, 3) - 4.0

OF_VECTORS: dict[str, Callable[[Any], Any]] = {
    "arithmetic": lambda x: (2.0 * x - 1) ** 2 / (1 + abs(x)),
    "norm": np.linalg.norm,
    "dot": lambda x: x.dot(x),
    "matrix": lambda x: np.dot(MATRIX, x),
    "from the left": lambda x: x @ MATRIX,
    "hstack": lambda x: np.hstack([x[1], x[:2], [0.5, 2.0]]),
    "stack": lambda x: np.stack([x, x * 2], axis=1),
    "vstack": lambda x: np.vstack((x, np.ones(3))),
    "concatenate": lambda x: np.concatenate([x[::2], x]),
    "picked": lambda x: x[[2, 0]],
    "mask": lambda x: x[np.array([True, False, True])],
    "backwards": lambda x: x[::-1],
    "where": lambda x: np.where(x > 0, x, 0.0),
    "clip": lambda x: np.clip(x, -0.5, 0.5),
    "cross": lambda x: np.cross(x, [1.0, 2.0, 3.0]),
    "reductions": lambda x: x.min() + x.max() + x.sum() + np.mean(x) + np.prod(x),
    "flags": lambda x: np.logical_and(x > 0, x < 1).all(),
    "count": lambda x: np.sum(x > 0),
    "division of counts": lambda x: np.sum(x > 0) / 3,
    "tolerance": lambda x: rewards.tolerance(x, (0.0, 0.1), margin=0.5, sigmoid="cosine"),
    "long tail": lambda x: rewards.tolerance(x[0], margin=0.5, sigmoid="long_tail"),
    "angles": lambda x: np.arctan2(x[0], x[1]) + np.cos(np.deg2rad(x[2])),
    "diff": np.diff,
    "integer powers": lambda x: np.power(x, 3) + np.sqrt(np.abs(x)),
}


@pytest.mark.parametrize("name", OF_VECTORS)
def test_functions_of_vectors(name: str) -> None:
    function, rows = OF_VECTORS[name], numbers(3)
    found = function(worlds(rows))
    expected = np.stack([np.asarray(function(row)) for row in rows])
    assert found.dtype == expected.dtype
    np.testing.assert_allclose(found.rows.numpy(), expected, rtol=1e-15, atol=1e-15)


OF_MATRICES: dict[str, Callable[[Any], Any]] = {
    "element": lambda x: x[1, 2],
    "column": lambda x: x[:, [0, 2]],
    "pairs": lambda x: x[[0, 1], [2, 0]],
    "open mesh": lambda x: x[np.ix_([0, 2], [1, 2])],
    "transposed": lambda x: x.T.ravel(),
    "reshaped": lambda x: x.reshape(-1)[2:5],
    "rows' norms": lambda x: np.linalg.norm(x, axis=1),
    "product": lambda x: x.dot(x.T),
    "sum of an axis": lambda x: np.sum(x, axis=0),
    "trailing axis": lambda x: x[..., None],
    "mean of an axis": lambda x: x.mean(axis=-1),
    "column and row": lambda x: x * x[0],
}


@pytest.mark.parametrize("name", OF_MATRICES)
def test_functions_of_matrices(name: str) -> None:
    function, rows = OF_MATRICES[name], numbers(3, 3)
    found = function(worlds(rows)).rows.numpy()
    expected = np.stack([np.asarray(function(row)) for row in rows])
    np.testing.assert_allclose(found, expected, rtol=1e-15, atol=1e-15)


def test_types_are_numpys() -> None:
    flags, counts = worlds(numbers() > 0), worlds(np.arange(COUNT))
    assert (flags * 0.5).dtype == np.float64
    assert (counts / 2).dtype == np.float64
    assert np.sqrt(counts).dtype == np.float64
    assert (counts + 1).dtype == np.int64
    assert (counts + flags).dtype == np.int64
    assert (counts > 2.5).dtype == np.bool_


def branching(x: Any) -> Any:
    if x < -0.5:
        return -1.0
    return max(0.0, x) if float(x < 1.0) else x + 1


def test_branches_are_taken_both_ways() -> None:
    where, rows = context(), np.array([-1.0, -0.2, 0.3, 2.0, 0.9])
    parts = where.paths.of(lambda: branching(worlds(rows, where)))
    assert len(parts) == 4
    np.testing.assert_array_equal(merged(parts, where).numpy(), [branching(x) for x in rows])


def test_loops_without_end_are_refused() -> None:
    where = context()

    def halved() -> Any:
        x = worlds(numbers(), where)
        while x > 1e-3:
            x = x / 2
        return x

    with pytest.raises(NotBatchedError, match="more than 32 branches"):
        where.paths.of(halved)


def test_too_many_ways_are_refused() -> None:
    where = context()

    def sorted_out() -> Any:
        x = worlds(numbers(), where)
        return sum(1.0 if x > limit else 0.0 for limit in range(6))

    with pytest.raises(NotBatchedError, match="more than 32 ways"):
        where.paths.of(sorted_out)


@pytest.mark.parametrize(
    ("function", "said"),
    [
        (lambda x: np.array([x, x]), "np.array"),
        (float, "float"),
        (lambda x: np.linalg.inv(x), "np.inv"),
        (lambda x: [1, 2, 3][x], "index that differs"),
        (lambda x: x[x > 0], "index that differs"),
        (lambda x: np.sum(x, keepdims=True), "np.sum"),
        (lambda x: np.add(1.0, x, out=np.ones(())), "written into an array of one"),
    ],
    ids=["array", "float", "inverse", "index", "mask", "keepdims", "out"],
)
def test_what_has_no_form_is_refused(function: Any, said: str) -> None:
    with pytest.raises(NotBatchedError, match=said):
        function(worlds(numbers()))


def test_numbers_of_the_physics_are_not_written() -> None:
    frozen = TensorWorlds(torch.zeros(COUNT, 3), context(), frozen=True)
    with pytest.raises(ValueError, match="read-only"):
        frozen[:2] = 1.0
    own = frozen.copy()
    own[:2] = 1.0
    own += 1.0
    assert own.rows[0].tolist() == [2.0, 2.0, 1.0]
    assert not frozen.rows.any()


def test_constants_are_copied_once() -> None:
    where = context()
    x = worlds(numbers(3), where)
    for _ in range(3):
        _ = x * np.array([1.0, 2.0, 3.0]) + 0.5
    assert len(where._constants) == 2


def test_numbers_that_change_in_every_step_are_refused() -> None:
    where = context()
    x = worlds(numbers(), where)
    with pytest.raises(NotBatchedError, match="other numbers in every step"):
        for step in range(5000):
            _ = x + step * 0.1
