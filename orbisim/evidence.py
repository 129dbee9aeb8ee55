"""How much better one explanation predicts than another: the one number that decides.

The data come in blocks (windows of free runs, stretches of a recording). What an explanation leaves
of a block is taken to be distributed as Student's t with one unknown scale for all blocks (Lange,
Little and Taylor, J. Am. Stat. Assoc. 84, 1989): on a real machine it is model error, not the
sensor's noise, and a few blocks that nothing predicts count by their logarithm instead of
outweighing all others, or having to be left out. Neighbouring samples are not independent; a block
counts as many data as the autocorrelation of what is left allows.

Where bodies touch, a window whose impact comes out otherwise than the machine's is off by what that
does to the state, and by nothing else: what exceeds the scale of all windows counts as many data as
a state has numbers. With all of its samples, a single impact that happens to come out better would
outweigh a hundred windows.

What is left of a real machine is structure that returns in every window, so that windows are not
independent either. What effects that are not in an explanation explain of its rest says how many
data there are (an empirical null; Efron, J. Am. Stat. Assoc. 99, 2004): of n independent ones, r
directions explain a share of r/n together. Where these are fewer, the likelihood counts by a power
below 1 (Miller and Dunson, J. Am. Stat. Assoc. 114, 2019).

Two explanations are compared by the difference of their log predictive scores, with its standard
error over the blocks, plus the logarithm of their prior odds. The error is that of the blocks that
gain less than the mean (of a symmetric distribution it is the same): blocks in which a rare event
is explained are no reason to doubt it.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

FREEDOM = 4.0
"""Degrees of freedom of Student's t: the fewest with a finite variance of squares."""
NEAR = 1.5
"""What is left over the noise up to which it counts as noise."""
EFFECT = -3.0
"""Logarithm of the prior odds of an effect at a target, e^-3 = 1 in 20: of some dozens that are
possible on a machine few are there."""
SURE = 1.0
"""Standard errors that a gain must be worth."""


def like_parts(found: int, parts: int) -> float:
    """Logarithm of the prior odds that so many of some like parts of a machine have an effect,
    beside none of them.

    Each part has it with the same unknown probability, of which a Beta(a, 1) density is known
    beforehand. The next one then has it with odds (a + those that have it) / (those that do not),
    by Laplace's rule of succession; a is such that the first has the odds of any effect. One maker
    made the joints of a machine: where three of four have friction, the fourth's is no surprise.

    Args:
      found: parts that have it. parts: of the machine; where they are fewer than found, nothing is
        known of one by another, as with 1.
    """
    if found > parts:
        return EFFECT * found
    have = np.arange(found)
    return float(np.log((np.exp(EFFECT) * parts + have) / (parts - have)).sum())


@dataclasses.dataclass(frozen=True, eq=False)
class Blocks:
    """How the data of the blocks count.

    Attributes:
      size: [B] data of each block that count as independent.
      signal: [B] number of the signal: each has a scale of its own.
      floor: [B] least scale: that of the measurement noise.
      power: [B] or one for all: by which the likelihood of a block counts.
      beyond: data of a block by which what exceeds its signal's scale counts; infinite for as many
        as there are.
    """

    size: Floats
    signal: Ints
    floor: Floats
    power: Floats | float = 1.0
    beyond: float = np.inf

    @property
    def count(self) -> float:
        """How many data count in all, 2 at least."""
        return max(float((self.power * self.size).sum()), 2.0)

    @functools.cached_property
    def numbered(self) -> tuple[Ints, Ints]:
        """[B] the signal of each block, counted from 0; [S] how many blocks each signal has."""
        _, signal, count = np.unique(self.signal, return_inverse=True, return_counts=True)
        return signal.reshape(-1), count


def counted(
    data: npt.NDArray[np.generic], share: float, most: float = np.inf, beyond: float = np.inf
) -> Blocks:
    """Blocks of one signal in units of its noise, if such a share of their data is independent.

    Args:
      data: [B] their numbers. most: how many count in all, at most. beyond: as of `Blocks`.
    """
    size = np.maximum(share * np.asarray(data, np.float64), 1.0)
    power = min(1.0, most / float(size.sum())) if len(size) else 1.0
    return Blocks(size, np.zeros(len(size), np.int64), np.ones(len(size)), power, beyond)


@dataclasses.dataclass(frozen=True)
class Gain:
    """What one explanation is worth more than another.

    Attributes:
      mean: difference of the log predictive scores. error: its standard error over the blocks.
      prior: logarithm of the prior odds.
    """

    mean: float
    error: float
    prior: float = 0.0

    @property
    def total(self) -> float:
        """With the prior odds."""
        return self.mean + self.prior

    @property
    def sure(self) -> float:
        """What of it is sure; positive if the explanation is to be preferred."""
        return self.mean - SURE * self.error + self.prior


def scales(squares: Floats, blocks: Blocks) -> Floats:
    """[B]: the likeliest scale of each block's signal, at least the floor.

    Args:
      squares: [B] mean squared residual of each block.
    """
    signal, count = blocks.numbered
    size, weight, whole = blocks.size, np.ones(len(squares)), np.bincount(signal, blocks.size)
    least = np.bincount(signal, blocks.floor**2) / count
    variance = np.zeros(len(count))
    for _ in range(_ROUNDS):
        before = variance
        variance = np.maximum(np.bincount(signal, size * weight * squares) / whole, least)
        if (np.abs(variance - before) <= _STILL * variance).all():
            break
        weight = _weight(size, squares / variance[signal], blocks.beyond)
    return np.asarray(np.sqrt(variance[signal]))


_ROUNDS = 25
"""Of reweighting at most, which hardly moves after the first few."""
_STILL = 1e-9
"""Relative change of a scale's square by a round that is none: of a million data it changes the
score by less than a thousandth."""


def weights(squares: Floats, blocks: Blocks) -> Floats:
    """[B]: by which squares count in a fit that makes the likelihood largest."""
    size, variance = blocks.size, scales(squares, blocks) ** 2
    return _weight(size, squares / variance, blocks.beyond) / variance


def _weight(size: Floats, squares: Floats, beyond: float) -> Floats:
    """[B]: by which squares in units of the scale count, from one for those at the scale on."""
    least, above = _beyond(size, squares, beyond)
    found = (FREEDOM + size) / (FREEDOM + size * squares)
    return np.asarray(np.where(squares > 1, least / (least + above), found))


def _beyond(size: Floats, squares: Floats, beyond: float) -> tuple[Floats, Floats]:
    """[B]: by how many data what exceeds the scale counts, with those of the distribution, and by
    how much it exceeds that, in units of the scale and over all data of a block."""
    return FREEDOM + np.minimum(size, beyond), size * np.maximum(squares - 1, 0.0)


def scores(squares: Floats, blocks: Blocks) -> Floats:
    """[B]: log predictive score of each block, but for a constant of the block."""
    size, variance = blocks.size, scales(squares, blocks) ** 2
    least, above = _beyond(size, squares / variance, blocks.beyond)
    spread = (FREEDOM + size) * np.log1p(size * np.minimum(squares / variance, 1) / FREEDOM)
    spread += least * np.log1p(above / least)
    return np.asarray(blocks.power * (-size * np.log(variance) - spread) / 2)


def gain(before: Floats, after: Floats, blocks: Blocks, prior: float = 0.0) -> Gain:
    """What an explanation is worth more than another.

    Args:
      before, after: [B] mean squared residual of each block, predicted.
      prior: logarithm of the odds of the later one.
    """
    return gain_of(scores(after, blocks) - scores(before, blocks), prior)


def gain_of(difference: Floats, prior: float = 0.0) -> Gain:
    """The same from [B] differences of the log predictive scores."""
    short = np.minimum(difference - difference.mean(), 0.0)
    return Gain(float(difference.sum()), float(np.sqrt(2 * (short**2).sum())), prior)


def independent_share(residuals: Sequence[Floats]) -> float:
    """Share of data that counts as independent, by the autocorrelation of what is left.

    Args:
      residuals: of each signal in each block, [T]; NaN is passed over. Lags are summed until the
        correlation is lost in chance (initial positive sequence; Geyer, Statist. Sci. 7, 1992).
    """
    longest = max((len(one) for one in residuals), default=0)
    product, count = np.zeros(longest), np.zeros(longest)
    for one in residuals:
        values = np.nan_to_num(one)
        length = 2 * len(values)
        spectrum = np.abs(np.fft.rfft(values, length)) ** 2
        product[: len(values)] += np.fft.irfft(spectrum, length)[: len(values)]
        count[: len(values)] += np.arange(len(values), 0, -1)
    if longest < 2 or product[0] <= 0:
        return 1.0
    correlation = (product / np.maximum(count, 1)) / (product[0] / count[0])
    chance = 2 / np.sqrt(np.maximum(count, 1))
    lost = np.flatnonzero(correlation < chance)
    until = int(lost[0]) if len(lost) else longest
    return float(1 / (1 + 2 * correlation[1:until].sum()))


def independent_by_chance(
    columns: Floats,
    left: Floats,
    weight: Floats,
    fitted: Floats | None = None,
    missing: float = 0.0,
) -> float:
    """How many data count as independent, by what columns explain that were not fitted to them.

    Of n independent data, a direction explains a share of 1 / n by chance. Columns are much alike:
    a mean, or a median, of what each explains would be one of a handful, so that it is orthogonal
    directions that are counted, which the normalised columns span. One column, or a share of as
    many as there are directions, may be effects that are missing, and do not count: those that
    explain most one after the other (orthogonal matching pursuit; Pati, Rezaiifar and
    Krishnaprasad, Asilomar 1993). What the rest of the r directions explains is compared with its
    median where there is nothing but chance, and known to a factor of about 1 + sqrt(3 / r).

    Shares are of all that is left, also of what those explain. Of what the missing ones leave they
    would be larger, and n right where nothing else is missing (of white data). Where one is, more
    are: what other directions explain is then no chance either, and so taken for less of it.

    Args:
      columns: [W, R, C] what effects would give; few of them say nothing (infinite).
      left: [W, R] what is left. weight: [W] by which windows count.
      fitted: [W, R, P] what was fitted: only what columns say beside that counts.
      missing: share of the directions that may be effects that are missing; one at least.
    """
    root = np.sqrt(weight)[:, None]
    flat = _of_known_size((columns * root[..., None]).reshape(-1, columns.shape[2]))
    rest = (left * root).ravel()
    whole = np.linalg.norm(flat, axis=0)
    if fitted is not None and fitted.shape[2]:
        own = _of_known_size((fitted * root[..., None]).reshape(len(flat), -1))
        basis = np.linalg.qr(own / np.maximum(np.linalg.norm(own, axis=0), 1e-300))[0]
        flat, rest = flat - basis @ (basis.T @ flat), rest - basis @ (basis.T @ rest)
    size, norm = np.linalg.norm(flat, axis=0), float(np.linalg.norm(rest))
    felt = (size > _NEW * whole) & (whole > 0)
    if not felt.any() or not norm > 0:
        return float("inf")
    unit = flat[:, felt] / size[felt]
    strength, turn = np.linalg.eigh(unit.T @ unit)
    apart = strength > _APART**2 * strength[-1]
    r = int(apart.sum())
    if r < _FEWEST:
        return float("inf")
    basis = turn[:, apart] / np.sqrt(strength[apart])
    there = basis.T @ (unit.T @ rest) / norm
    chance = np.random.default_rng(0).standard_normal((_DRAWS, r))
    most = max(1, int(missing * r))
    left = _beside_most(np.vstack([there, chance]), basis.T @ (unit.T @ unit), most)
    return float(np.median(left[1:]) / max(float(left[0]), 1e-300))


def _of_known_size(columns: Floats) -> Floats:
    """Without columns whose squares are beyond what a number can hold: what one does is chained
    through many steps, and grows in each that has an impact."""
    with np.errstate(over="ignore", invalid="ignore"):
        return columns[:, np.isfinite((columns**2).sum(axis=0))]


def _beside_most(draws: Floats, columns: Floats, most: int) -> Floats:
    """[D]: square of what some columns leave of each draw, one after the other that which explains
    most.

    Args:
      draws: [D, r]. columns: [r, C] in the same directions. most: how many of them.
    """
    left, rest = draws.copy(), np.repeat(columns[None], len(draws), axis=0)
    for _ in range(most):
        size = np.linalg.norm(rest, axis=1)
        explained = np.abs(np.einsum("dr,drc->dc", left, rest)) / np.maximum(size, 1e-300)
        explained[size < _APART] = 0.0  # others have said it
        first = explained.argmax(axis=1)[:, None, None]
        one = np.take_along_axis(rest, first, axis=2)[..., 0]
        one /= np.maximum(np.linalg.norm(one, axis=1, keepdims=True), 1e-300)
        left -= (left * one).sum(axis=1, keepdims=True) * one
        rest -= one[..., None] * np.einsum("dr,drc->dc", one, rest)[:, None]
    return np.asarray((left**2).sum(axis=1))


_NEW = 1e-4
"""Share of a column that what was fitted must leave."""
_APART = 0.1
"""Strength of a direction, over that of the strongest, from which on it is one: columns along a
measured motion are not better known than to a tenth, and weaker ones are what that leaves."""
_FEWEST = 8
"""Directions that say something: of fewer, an effect that is missing is too large a part."""
_DRAWS = 100
"""Draws of chance, whose median is known to a tenth."""


def probabilities(log_odds: Floats) -> Floats:
    """Probabilities from logarithms of odds."""
    odds = np.exp(log_odds - np.max(log_odds))
    return np.asarray(odds / odds.sum())
