"""Normal equations of blocks, left out in turns."""

import numpy as np

from orbisim.evidence import Blocks
from orbisim.shooting.blocks import data_of
from orbisim.shooting.regress import Normal

RNG = np.random.default_rng(0)
BLOCKS, ROWS, COLUMNS = 12, 30, 4


def blocks() -> list[Normal]:
    found = []
    for _ in range(BLOCKS):
        x, y = RNG.normal(size=(ROWS, COLUMNS)), RNG.normal(size=ROWS)
        found.append(Normal(x.T @ x, x.T @ y, float(y @ y), ROWS))
    return found


def counts(signal: np.ndarray) -> Blocks:
    return Blocks(np.full(BLOCKS, 10.0), signal, np.full(BLOCKS, 1e-9))


def test_neighbours_of_a_signal_are_left_out_together() -> None:
    """Blocks of a signal that are next to each other are alike."""
    data = data_of(blocks(), counts(np.repeat([0, 1], [8, 4])), folds=4)
    assert list(data.folds) == [0, 0, 1, 1, 2, 2, 3, 3, 0, 1, 2, 3]
    few = data_of(blocks(), counts(np.repeat([0, 1], [8, 4])), folds=20)
    assert list(few.folds) == [*range(8), *range(4)]


def test_others_are_all_blocks_but_those_of_a_fold() -> None:
    data = data_of(blocks(), counts(np.zeros(BLOCKS, int)), folds=3)
    gram, moment = data.others
    whole = data.whole()
    for fold in range(3):
        own = data.folds == fold
        weight, stack = data.weight[own], data.stack
        left_out = np.einsum("b,bij->ij", weight, stack.gram[own])
        np.testing.assert_allclose(gram[fold], whole.gram - left_out, atol=1e-9)
        np.testing.assert_allclose(
            moment[fold], whole.moment - weight @ stack.moment[own], atol=1e-9
        )
    assert whole.count == BLOCKS * ROWS
    assert data.rate == 10.0 * BLOCKS / (BLOCKS * ROWS)


def test_a_block_of_which_more_is_left_counts_less() -> None:
    data = data_of(blocks(), counts(np.zeros(BLOCKS, int)))
    left = np.ones(BLOCKS)
    left[3] = 100.0
    again = data.reweighed(left)
    assert again.weight[3] < 0.1 * np.delete(again.weight, 3).min()
    assert again.stack is data.stack
