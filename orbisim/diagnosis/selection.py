"""Several effects at once: the set that predicts best, from all effects at all targets.

Data come as normal equations of blocks (windows, stretches of a recording). Coefficients are fitted
to all blocks but a few, and score these, each in turn, so that an effect pays only with what it
predicts. Moves are to add, to remove and to exchange; `orbisim.evidence` says what each
is worth. One effect at a time, judged by what it leaves, fails where many are missing: each looks
wrong as long as the others are. Here they are fitted together.
"""

from __future__ import annotations

import copy
import dataclasses
from collections import Counter
from collections.abc import Callable, Sequence

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.effects import EffectInstance, find
from orbisim.effects.screening import Candidate
from orbisim.evidence import EFFECT, Gain, gain, like_parts
from orbisim.host.deadline import NEVER, TimeIsUpError
from orbisim.shooting.blocks import Data
from orbisim.shooting.regress import (
    Normal,
    fit,
    left_by_each,
    profiled,
    scaled_gram,
    with_ones,
)

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Prior = Callable[[EffectInstance], float]

BEGINNINGS = (-1.0, np.inf)
"""Rarities down to which an effect belongs to what a search begins with: from all that machines
commonly have, and from nothing."""


@dataclasses.dataclass(frozen=True, eq=False)
class Group:
    """Columns that enter together.

    Attributes:
      index: of the columns that say anything. key: groups with the same key exclude each other
        (several shapes of an effect at a target).
      instance: the effect with values from fitted coefficients of the columns; None if these are
        not possible.
      fixed: whether the coefficients are ones instead of fitted.
      shape: number of parameters that were tried at several values.
      prior: logarithm of the odds of the effect beside those of any.
      parts: of the machine that may have it, see `orbisim.evidence.like_parts`.
      values: the same of what it says for coefficients, beside those of the effect.
      refines: key of the group without which it has the odds of both; empty for none.
    """

    index: tuple[int, ...]
    key: tuple[str, ...]
    instance: Callable[[Floats], EffectInstance | None]
    fixed: bool = False
    shape: int = 0
    prior: float = 0.0
    values: Prior = lambda _: 0.0
    refines: tuple[str, ...] = ()
    parts: int = 1


def groups_of(
    model: mujoco.MjModel, candidates: Sequence[Candidate], whole: Normal, prior: Prior
) -> list[Group]:
    """Groups for candidates whose columns stand in `whole` one after the other.

    Candidates with many columns are offered with fewer, too: of a payload, mass and first moments.

    Args:
      prior: logarithm of the odds of an effect with such values; minus infinity if it cannot be.
    """
    found, start = [], 0
    for candidate in candidates:
        width = len(candidate.columns)
        widths = sorted({width, min(width, _FEW)})
        found += [_group(model, candidate, start, n, whole, prior) for n in widths]
        start += width
    return [group for group in found if group.index]


_FEW = 4
"""Columns of the smaller form: mass and first moments of a body."""


def _group(
    model: mujoco.MjModel,
    candidate: Candidate,
    start: int,
    width: int,
    whole: Normal,
    prior: Prior,
) -> Group:
    strength = np.diag(whole.gram)[start : start + width]
    felt = np.flatnonzero(strength > _FELT * strength.max(initial=0.0))

    def instance(coefficients: Floats) -> EffectInstance | None:
        every = np.zeros(len(candidate.columns))
        every[felt] = coefficients
        with np.errstate(all="ignore"):
            values = candidate.solve(every)
        if values is None:
            return None
        made = EffectInstance(
            candidate.effect, candidate.target, dict(values), dict(candidate.options)
        )
        return made if prior(made) > -np.inf else None

    index = tuple(int(i) for i in start + felt)
    key = (candidate.effect, candidate.target)
    effect = find(candidate.effect)
    odds, simpler = effect.odds(model, candidate.target), effect.refines
    refines = (simpler, candidate.target) if simpler else ()
    parts = effect.like_parts(model)
    return Group(
        index, key, instance, candidate.fixed, candidate.shape, odds, prior, refines, parts
    )


_FELT = 1e-12
"""Strength of a column, over the strongest of its effect, below which it is rounding."""


@dataclasses.dataclass(frozen=True, eq=False)
class Rival:
    """What could stand in the place of a chosen group. gain: of the exchange."""

    group: Group
    instead_of: Group
    gain: Gain


@dataclasses.dataclass(frozen=True, eq=False)
class Selected:
    """Result of a selection.

    Attributes:
      groups: as chosen, those that bring most first. coefficients: of each group's columns.
      predicted: [B] mean squared residual of each block, predicted from the others.
      before: the same without any group.
      gains: what each group is worth beside the others.
      rivals: what could stand in their places, nearest first.
    """

    groups: tuple[Group, ...]
    coefficients: tuple[Floats, ...]
    predicted: Floats
    before: Floats
    gains: tuple[Gain, ...]
    rivals: tuple[Rival, ...] = ()


def select(data: Data, groups: Sequence[Group], most: int = 40) -> Selected:
    """The set of groups that predicts best.

    From all that machines commonly have, as far as it is possible together, groups are removed that
    are not surely worth it; then others are added and exchanged. That is done from several
    beginnings, and the best end counts: from nothing alone, the first effects would stand in for
    all others, and hide them.

    Args:
      most: groups at most.
    """
    best: _Search | None = None
    for rarity in BEGINNINGS:
        search = _Search(data, groups)
        try:
            search.begin(rarity)
            search.remove()
            while search.better() and len(search.chosen) < most and search.add():
                search.reweigh()
                search.exchange()
                search.remove()
        except TimeIsUpError:
            search.close()
        search.back()
        nearer = best is None or best.worth(search) > 0
        best = search if nearer else best
    assert best is not None
    try:
        return best.result()
    except TimeIsUpError:
        best.close()
        return best.result()


def predicted(data: Data, chosen: Sequence[Group]) -> Floats:
    """[B]: mean squared residual of each block, with coefficients fitted to the other folds."""
    data.deadline.check()
    ones, free = _columns(chosen)
    index, stack = np.array([*ones, *free], int), data.stack
    gram = stack.gram[:, index[:, None], index]
    moment, x = stack.moment[:, index], np.ones((len(stack.square), len(index)))
    if free:
        x[:, len(ones) :] = _by_fold(data, index, len(ones))[data.folds]
    square = (x[:, None, :] @ gram @ x[:, :, None])[:, 0, 0]
    left = stack.square - 2 * (x * moment).sum(axis=1) + square
    return np.asarray(np.maximum(left, 0.0) / stack.data)


def _by_fold(data: Data, index: Ints, ones: int) -> Floats:
    """[F, P]: coefficients of the free columns, fitted to all folds but one each.

    Args:
      index: of the columns, first those whose coefficients are ones. ones: their number.
    """
    gram, moment = data.others
    inner = gram[:, index[:, None], index]
    wanted = moment[:, index] - inner[:, :, :ones].sum(axis=2)
    inner, wanted = inner[:, ones:, ones:], wanted[:, ones:]
    inner, scale = scaled_gram(inner)
    inner = inner + _RIDGE * np.eye(inner.shape[1])
    wanted = np.where(np.isfinite(wanted), wanted, 0.0) / scale
    return np.asarray(np.linalg.solve(inner, wanted[..., None])[..., 0] / scale)


_RIDGE = 1e-9
"""Ridge on scaled gram matrices: columns that repeat others are no reason to fail."""


def coefficients(whole: Normal, chosen: Sequence[Group]) -> list[Floats]:
    """Coefficients of each group's columns, all fitted together."""
    ones, free = _columns(chosen)
    x = dict(zip(free, fit(with_ones(whole, ones), free)[0], strict=True))
    return [np.array([x.get(i, 1.0) for i in group.index]) for group in chosen]


def _columns(chosen: Sequence[Group]) -> tuple[list[int], list[int]]:
    """Those whose coefficients are ones, and the others."""
    ones = [i for group in chosen if group.fixed for i in group.index]
    return ones, [i for group in chosen if not group.fixed for i in group.index]


class _Search:
    def __init__(self, data: Data, groups: Sequence[Group]) -> None:
        self.data, self.groups = data, groups
        self.whole = data.whole()
        self.chosen: list[Group] = []
        self.before = self.now = predicted(dataclasses.replace(data, deadline=NEVER), [])
        self.best: _Search | None = None

    def better(self) -> bool:
        """Whether what is chosen is the best so far, which is then remembered. A round of moves may
        end in something worse: weights move with it, and what is possible beside what."""
        if self.best is not None and not self.best.worth(self) > 0:
            return False
        self.best = copy.copy(self)
        return True

    def back(self) -> None:
        """To the best so far."""
        if self.best is not None and self.worth(self.best) > 0:
            self.chosen, self.now = self.best.chosen, self.best.now
            self.data, self.whole = self.best.data, self.best.whole

    def close(self) -> None:
        """Ends with what is chosen by now: the time is up."""
        self.data, self.groups = dataclasses.replace(self.data, deadline=NEVER), ()
        self.chosen = self._possible(self.chosen)
        self.now = predicted(self.data, self.chosen)

    def reweigh(self) -> None:
        """Blocks count by what is left of them now."""
        self.data = self.data.reweighed(self.now)
        self.whole = self.data.whole()
        self.now = predicted(self.data, self.chosen)

    def gain(
        self, before: Floats, after: Floats, more: Sequence[Group], fewer: Sequence[Group] = ()
    ) -> Gain:
        """Of a change by which some groups come and others go."""
        prior = self.prior(more) - self.prior(fewer)
        least = self.data.counts.floor**2  # what is below the noise is no better than that
        before, after = np.maximum(before, least), np.maximum(after, least)
        return gain(before, after, self.data.counts, prior)

    def prior(self, chosen: Sequence[Group]) -> float:
        """Logarithm of the prior odds of groups with the values that they have together."""
        found = coefficients(self.whole, chosen)
        said = [(g.values, g.instance(x)) for g, x in zip(chosen, found, strict=True)]
        there = {group.key for group in chosen}
        alone = sum(bool(group.refines) and group.refines not in there for group in chosen)
        values = sum(of(one) for of, one in said if one is not None)
        counts = Counter((group.key[0], group.parts) for group in chosen if group.key)
        odds = sum(like_parts(count, parts) for (_, parts), count in counts.items())
        return odds + sum(map(_log_prior, chosen)) + EFFECT * alone + values

    def worth(self, other: _Search) -> float:
        """What another end of the search is worth more."""
        return self.gain(self.now, other.now, other.chosen, self.chosen).total

    def begin(self, rarity: float) -> None:
        """With all groups so common, less those that are not possible beside the others."""
        first: dict[tuple[str, ...], Group] = {}
        for group in self.groups:
            if group.prior >= rarity and not group.fixed:
                first.setdefault(group.key, group)
        self.chosen = list(first.values())
        for _ in range(_REWEIGHTED):
            self.chosen = self._possible(self.chosen)
            self.reweigh()

    def _possible(self, trial: Sequence[Group]) -> list[Group]:
        """Those groups that are possible beside each other: what an effect had to make up for may
        be another one's when that comes. Of impossible ones, the least useful goes first."""
        kept = list(trial)
        while kept:
            found = coefficients(self.whole, kept)
            bad = [n for n, (g, x) in enumerate(zip(kept, found, strict=True)) if not g.instance(x)]
            if not bad:
                break
            costs = self._costs(kept)
            del kept[min(bad, key=lambda n: costs[n])]
        return kept

    def _costs(self, chosen: Sequence[Group]) -> list[float]:
        """By how much squares grow without each of some groups."""
        free = [group for group in chosen if not group.fixed]
        ones, index = _columns(chosen)
        x = fit(with_ones(self.whole, ones), index)[0]
        gram = self.whole.gram[np.ix_(index, index)]
        strength = np.diag(gram)  # none, but for rounding, where others explain it all
        scale = np.sqrt(np.where(strength > 0, strength, np.inf))
        alike = np.clip(gram / np.outer(scale, scale), -1.0, 1.0)
        inverse = np.linalg.inv(alike + _RIDGE * np.eye(len(index)))
        found, start = {}, 0
        for group in free:
            own = slice(start, start + len(group.index))
            start = own.stop
            y = x[own] * np.sqrt(np.maximum(strength[own], 0.0))
            # columns of a group may be one beside the others: a puck's centre of mass by height
            part = inverse[own, own]
            part = 1 / part if len(part) == 1 else np.linalg.pinv(part, hermitian=True)
            found[id(group)] = float(y @ part @ y)
        return [found.get(id(group), 0.0) for group in chosen]

    def add(self) -> bool:
        """Adds the group that is worth most, if any surely is."""
        found = self._best(self.chosen)
        if found is None:
            return False
        self.chosen, self.now, _ = found
        return True

    def exchange(self) -> None:
        """Puts another group in the place of one, as long as that is surely worth it."""
        for _ in range(_EXCHANGES):
            ones, free = _columns(self.chosen)
            most = fit(with_ones(self.whole, ones), free)[1] + 2 * _FAR_OFF / self.data.rate
            found = [
                one
                for out in self.chosen[:-1]
                if (one := self._best(_less(self.chosen, out), most))
            ]
            if not found:
                return
            self.chosen, self.now, _ = max(found, key=lambda one: one[2].total)

    def remove(self) -> None:
        """Drops groups that are not surely worth it beside the others, the least useful first; of
        two of which either is enough, that with more columns."""
        while len(self.chosen) > 1:
            order = np.argsort(self._costs(self.chosen), kind="stable")
            for numbers in (order[:_LEAST], order[_LEAST:]):
                trials: list[tuple[float, int, list[Group], Floats]] = []
                for number in numbers:
                    out = self.chosen[number]
                    kept = self._possible(_less(self.chosen, out))
                    left = predicted(self.data, kept)
                    worth = self.gain(left, self.now, self.chosen, kept).sure
                    trials.append((worth, -len(out.index), kept, left))
                least = min(trials, key=lambda one: one[:2], default=None)
                if least is not None and least[0] <= 0:
                    self.chosen, self.now = least[2:]
                    break
            else:
                return

    def _best(
        self, kept: Sequence[Group], most: float = np.inf
    ) -> tuple[list[Group], Floats, Gain] | None:
        """What is best chosen with another group beside those kept, what is left then, and what
        that is worth; None if nothing is surely better than what is chosen.

        Args:
          most: sum of squares beyond which a choice is not looked at.
        """
        best: tuple[list[Group], Floats, Gain] | None = None
        for trial in self._promising(kept, most):
            left = predicted(self.data, trial)
            worth = self.gain(self.now, left, trial, self.chosen)
            if worth.sure > 0 and (best is None or worth.total > best[2].total):
                best = trial, left, worth
        return best

    def _promising(self, chosen: Sequence[Group], most: float = np.inf) -> list[list[Group]]:
        """Choices with one group more that fit all blocks best, and leave no more squares than
        these: the new one is the last."""
        taken = {group.key for group in chosen}
        ones, index = _columns(chosen)
        rest = profiled(with_ones(self.whole, ones), index, np.zeros(len(index)))
        single = left_by_each(rest)
        scored: list[tuple[float, int, Group]] = []
        for group in self.groups:
            if group.key in taken:
                continue
            at = list(group.index)
            strength = np.diag(rest.gram)[at] / np.maximum(np.diag(self.whole.gram)[at], 1e-300)
            if not _NEW <= strength.max(initial=0.0) < np.inf:  # nothing new, or overflowed
                continue
            if group.fixed:
                left = with_ones(rest, at).square
            else:
                left = single[at[0]] if len(at) == 1 else fit(rest, at)[1]
            if left <= most:
                scored.append((left, len(scored), group))
        found: list[list[Group]] = []
        for _, _, group in sorted(scored, key=lambda s: s[:2])[:_FITTED]:
            trial = self._possible([*chosen, group])
            if trial and trial[-1] is group:
                found.append(trial)
            if len(found) == _TRIED:
                break
        return found

    def result(self) -> Selected:
        """What was chosen, and what could stand in its place."""
        gains = []
        for out in self.chosen:
            kept = _less(self.chosen, out)
            gains.append(self.gain(predicted(self.data, kept), self.now, self.chosen, kept))
        order = sorted(range(len(gains)), key=lambda i: -gains[i].total)
        found = coefficients(self.whole, self.chosen)
        return Selected(
            tuple(self.chosen[i] for i in order),
            tuple(found[i] for i in order),
            self.now,
            self.before,
            tuple(gains[i] for i in order),
            tuple(self._rivals()),
        )

    def _rivals(self) -> list[Rival]:
        found: list[Rival] = []
        for out in self.chosen or [_NOTHING]:
            kept = _less(self.chosen, out)
            for trial in self._promising(kept)[:_NEAREST]:
                if trial[-1].key != out.key:
                    worth = self.gain(self.now, predicted(self.data, trial), trial, self.chosen)
                    found.append(Rival(trial[-1], out, worth))
        return sorted(found, key=lambda one: -one.gain.total)


_NOTHING = Group((), (), lambda _: None)


def _log_prior(group: Group) -> float:
    return group.prior - group.shape * np.log(_SHAPES)


def _less(chosen: Sequence[Group], out: Group) -> list[Group]:
    return [one for one in chosen if one is not out]


_NEW = 1e-6
"""Share of a column that must not be in the span of those already chosen."""
_TRIED = 12
"""How many of the groups with the best fit are scored."""
_FITTED = 60
"""Of how many it is looked at whether they are possible."""
_NEAREST = 4
"""Rivals of each chosen group that are looked at."""
_LEAST = 4
"""How many of the groups that cost least to do without are scored for removal first."""
_REWEIGHTED = 3
"""Times that the beginning is thinned and weighed by what it leaves."""
_FAR_OFF = 100.0
"""By how much a choice may predict worse to be looked at in an exchange: prior odds make up for
some ten, and squares of what is far off are charged by their logarithm."""
_EXCHANGES = 3
"""Exchanges after an addition at most: two groups may take turns."""
_SHAPES = 5
"""Values at which a parameter is tried that is no coefficient."""
