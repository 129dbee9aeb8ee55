"""The number that decides between two explanations."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.special import comb
from scipy.stats import betabinom, multivariate_t

from orbisim.evidence import (
    EFFECT,
    FREEDOM,
    Blocks,
    gain,
    independent_share,
    like_parts,
    probabilities,
    scales,
    scores,
)


def blocks(count: int, size: float = 6.0, floor: float = 0.0) -> Blocks:
    return Blocks(np.full(count, size), np.zeros(count, int), np.full(count, floor))


def test_scores_are_those_of_students_t() -> None:
    rng = np.random.default_rng(0)
    left = rng.standard_normal((30, 6)) * 2
    squares = (left**2).mean(axis=1)
    scale = float(scales(squares, blocks(30))[0])
    density = multivariate_t(np.zeros(6), scale**2 * np.eye(6), df=FREEDOM)
    differences = scores(squares, blocks(30)) - density.logpdf(left)
    np.testing.assert_allclose(differences, differences[0], rtol=1e-9)


def test_the_scale_makes_the_scores_largest() -> None:
    squares = np.random.default_rng(1).chisquare(6, 40) / 6 * 9
    scale = float(scales(squares, blocks(40))[0])

    def total(size: float) -> float:
        density = multivariate_t(np.zeros(6), size**2 * np.eye(6), df=FREEDOM)
        return float(sum(density.logpdf(np.full(6, np.sqrt(s))) for s in squares))

    assert total(scale) >= max(total(0.9 * scale), total(1.1 * scale))


def test_what_exceeds_the_scale_counts_as_few_data_from_there_on() -> None:
    squares = np.concatenate([np.random.default_rng(1).chisquare(80, 40) / 80, [30.0, 12.0, 7.0]])
    every = blocks(43, 80.0)
    few = dataclasses.replace(every, beyond=12.0)
    assert scales(squares, few)[0] < scales(squares, every)[0]
    scale = float(scales(squares, few)[0])
    at = [  # what the scale is, makes the scores largest
        scores(squares, dataclasses.replace(few, floor=np.full(43, scale * by))).sum()
        for by in (1.0, 1.02, 1.1)
    ]
    assert at == sorted(at, reverse=True)
    near, inside = np.array([1.0, 1.0001]), dataclasses.replace(few, **_two)
    one, other = scores(near, inside)  # at the scale both are the same, and as steep
    assert one - other == pytest.approx(0.5 * 80 * 0.0001, rel=1e-3)


def test_one_impact_that_comes_out_better_outweighs_nothing() -> None:
    before = np.random.default_rng(3).chisquare(200, 60) / 200
    after = before.copy()
    before[5], after[5] = 11.5, 5.8
    counting = dataclasses.replace(blocks(60, 200.0, 1.0), beyond=12.0)
    assert gain(before, after, blocks(60, 200.0, 1.0), prior=-12.0).sure > 0
    assert gain(before, after, counting, prior=-12.0).sure < 0
    assert gain(3 * before, after, counting, prior=-12.0).sure > 0  # one that all windows tell


_two = {"size": np.full(2, 80.0), "signal": np.zeros(2, int), "floor": np.ones(2)}


def test_one_block_that_nothing_predicts_does_not_outweigh_all_others() -> None:
    before, after = np.ones(20), np.full(20, 0.5)
    before[0], after[0] = 100.0, 140.0
    assert gain(before, after, blocks(20)).sure > 0


def test_an_event_in_one_block_can_win() -> None:
    before, after = np.ones(20), np.ones(20)
    before[7] = 1e6
    assert gain(before, after, blocks(20, 40.0), prior=-3.0).sure > 0


def test_chance_wins_nothing() -> None:
    rng = np.random.default_rng(2)
    won = [
        gain(rng.chisquare(6, 24) / 6, rng.chisquare(6, 24) / 6, blocks(24), prior=-3.0).sure > 0
        for _ in range(100)
    ]
    assert sum(won) < 20


def test_the_scale_is_not_below_the_noise() -> None:
    left = np.full(20, 0.9), np.full(20, 0.2)
    assert scales(left[1], blocks(20, floor=1.0)) == pytest.approx(1.0)
    known, unknown = (gain(*left, blocks(20, floor=floor)).mean for floor in (1.0, 0.0))
    assert 0 < known < 0.7 * unknown


def test_a_rare_event_is_no_reason_to_doubt_it() -> None:
    """Three blocks of forty get much better; or three better and three as much worse."""
    before = np.ones(40)
    before[:3] = 30.0
    assert gain(before, np.ones(40), blocks(40), prior=-8.0).sure > 0
    worse = np.ones(40)
    worse[5:8] = 30.0
    assert gain(before, worse, blocks(40), prior=-8.0).sure < 0


def test_signals_have_scales_of_their_own() -> None:
    squares = np.concatenate([np.full(10, 1e-6), np.ones(10)])
    both = Blocks(np.full(20, 6.0), np.repeat([0, 1], 10), np.zeros(20))
    halved = squares * np.repeat([0.5, 1.0], 10)
    assert gain(squares, halved, both).mean == pytest.approx(10 * 6 / 2 * np.log(2), rel=0.02)


@pytest.mark.parametrize(("memory", "share"), [(0.0, 1.0), (0.5, 1 / 3), (0.9, 1 / 19)])
def test_neighbours_that_are_alike_count_less(memory: float, share: float) -> None:
    """Of a first-order process with that memory, (1 - a) / (1 + a) is independent."""
    noise = np.random.default_rng(3).standard_normal((12, 2000))
    course = noise.copy()
    for k in range(1, 2000):
        course[:, k] += memory * course[:, k - 1]
    assert independent_share(list(course)) == pytest.approx(share, rel=0.15)


def test_probabilities_add_up() -> None:
    found = probabilities(np.array([0.0, np.log(3.0), -np.inf]))
    np.testing.assert_allclose(found, [0.25, 0.75, 0.0])


@pytest.mark.parametrize("parts", [1, 2, 6])
def test_of_like_parts_each_that_has_an_effect_makes_it_likelier_of_the_next(parts: int) -> None:
    """The first has the odds of any effect, and all together are a Beta-binomial distribution's."""
    found = [like_parts(count, parts) for count in range(parts + 1)]
    assert found[0] == 0.0 and found[1] == pytest.approx(EFFECT)
    assert np.all(np.diff(found, 2) > 0)
    known = betabinom(parts, parts * np.exp(EFFECT), 1.0)
    ways = np.array([comb(parts, count) for count in range(parts + 1)])
    expected = known.logpmf(np.arange(parts + 1)) - np.log(ways)
    assert found == pytest.approx(expected - expected[0])


def test_of_parts_that_are_not_alike_one_says_nothing_of_another() -> None:
    assert like_parts(3, 1) == pytest.approx(3 * EFFECT)
