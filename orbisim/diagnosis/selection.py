"""Several effects at once: forward selection with removal, judged by cross-validation.

Data come as normal equations of blocks (stretches of a recording, windows, whole recordings). A
choice is fitted to all blocks but one and scored on that one, each in turn, so that an effect pays
only with what it predicts. One effect at a time, judged by what it leaves, fails where many are
missing: each looks wrong as long as the others are. Here they are fitted together.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from orbisim.diagnosis.regress import Normal, fit, profiled, total
from orbisim.effects import EffectInstance
from orbisim.effects.screening import Candidate

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


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
    """

    index: tuple[int, ...]
    key: tuple[str, ...]
    instance: Callable[[Floats], EffectInstance | None]
    fixed: bool = False
    shape: int = 0

    @property
    def width(self) -> int:
        """Numbers that data have to pay for."""
        return self.shape + (0 if self.fixed else len(self.index))


def groups_of(
    candidates: Sequence[Candidate],
    whole: Normal,
    sensible: Callable[[EffectInstance], bool] = lambda _: True,
) -> list[Group]:
    """Groups for candidates whose columns stand in `whole` one after the other.

    Candidates with many columns are offered with fewer, too: of a payload, mass and first moments.

    Args:
      sensible: whether an effect with such values can be.
    """
    found, start = [], 0
    for candidate in candidates:
        width = len(candidate.columns)
        found += [_group(candidate, start, n, whole, sensible) for n in {width, min(width, _FEW)}]
        start += width
    return [group for group in found if group.index]


_FEW = 4


def _group(
    candidate: Candidate,
    start: int,
    width: int,
    whole: Normal,
    sensible: Callable[[EffectInstance], bool],
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
        return made if sensible(made) else None

    index = tuple(int(i) for i in start + felt)
    key = (candidate.effect, candidate.target)
    return Group(index, key, instance, candidate.fixed, candidate.shape)


_FELT = 1e-12


@dataclasses.dataclass(frozen=True)
class Rule:
    """When a group is worth it.

    Attributes:
      gain: share of the squared residual left so far that it must predict away on unseen blocks.
      certainty: ... and by so many standard errors over the blocks.
      most: groups at most. tried: how many of those with the best fit are cross-validated.
    """

    gain: float = 0.01
    certainty: float = 2.0
    most: int = 40
    tried: int = 10


@dataclasses.dataclass(frozen=True, eq=False)
class Selected:
    """Result of a selection.

    Attributes:
      groups: as chosen. coefficients: of each group's columns.
      predicted: [blocks] squared residual of each block, predicted from the others.
      before: [blocks] squared residual without any group.
      gains: for each group the share of the squared residual, as it is without this group, that it
        predicts away.
    """

    groups: tuple[Group, ...]
    coefficients: tuple[Floats, ...]
    predicted: Floats
    before: Floats
    gains: tuple[float, ...]

    def ordered(self) -> Selected:
        """Those that bring most first."""
        order = sorted(range(len(self.groups)), key=lambda i: -self.gains[i])
        return dataclasses.replace(
            self,
            groups=tuple(self.groups[i] for i in order),
            coefficients=tuple(self.coefficients[i] for i in order),
            gains=tuple(self.gains[i] for i in order),
        )


def select(blocks: Sequence[Normal], groups: Sequence[Group], rule: Rule) -> Selected:
    """Groups that predict blocks they were not fitted to, best first."""
    search = _Search(blocks, groups, rule)
    while len(search.chosen) < rule.most and search.add():
        search.remove(0.0)
        search.swap()
    search.remove(rule.certainty, last=True)
    return _selected(blocks, search.chosen)


def without(
    selected: Selected, keep: Callable[[Group, float], bool], blocks: Sequence[Normal]
) -> Selected:
    """The selection less those groups that are not to be kept, by their gain, the worst first."""
    while selected.groups:
        poor = [
            (gain, i)
            for i, (group, gain) in enumerate(zip(selected.groups, selected.gains, strict=True))
            if not keep(group, gain)
        ]
        if not poor:
            break
        number = min(poor)[1]
        kept = [group for i, group in enumerate(selected.groups) if i != number]
        selected = _selected(blocks, kept)
    return selected


def _selected(blocks: Sequence[Normal], chosen: Sequence[Group]) -> Selected:
    """Coefficients and gains of chosen groups."""
    now = predicted(blocks, chosen)
    gains = []
    for group in chosen:
        left = predicted(blocks, [one for one in chosen if one is not group])
        gains.append(float(1 - now.sum() / max(left.sum(), 1e-300)))
    before = np.array([one.square for one in blocks])
    found = coefficients(total(blocks), chosen)
    return Selected(tuple(chosen), tuple(found), now, before, tuple(gains))


def predicted(blocks: Sequence[Normal], chosen: Sequence[Group]) -> Floats:
    """[blocks] squared residual of each block, with coefficients fitted to all the others."""
    whole = total(blocks)
    free = [i for group in chosen if not group.fixed for i in group.index]
    ones = [i for group in chosen if group.fixed for i in group.index]
    index = [*ones, *free]
    found = np.empty(len(blocks))
    for b, own in enumerate(blocks):
        others = Normal(
            whole.gram - own.gram, whole.moment - own.moment,
            whole.square - own.square, whole.count - own.count,
        )  # fmt: skip
        x = np.concatenate([np.ones(len(ones)), _free(others, ones, free)])
        gram, moment = own.gram[np.ix_(index, index)], own.moment[index]
        found[b] = max(own.square - 2 * x @ moment + x @ gram @ x, 0.0)
    return found


def coefficients(whole: Normal, chosen: Sequence[Group]) -> list[Floats]:
    """Coefficients of each group's columns, all fitted together."""
    free = [i for group in chosen if not group.fixed for i in group.index]
    ones = [i for group in chosen if group.fixed for i in group.index]
    x = dict(zip(free, _free(whole, ones, free), strict=True))
    return [np.array([x.get(i, 1.0) for i in group.index]) for group in chosen]


def _free(normal: Normal, ones: Sequence[int], free: Sequence[int]) -> Floats:
    """Coefficients of the free columns while those in `ones` have a coefficient of one."""
    if ones:
        taken = normal.gram[:, list(ones)].sum(axis=1)
        normal = dataclasses.replace(normal, moment=normal.moment - taken)
    return fit(normal, free)[0]


class _Search:
    def __init__(self, blocks: Sequence[Normal], groups: Sequence[Group], rule: Rule) -> None:
        self.blocks, self.groups, self.rule = blocks, groups, rule
        self.whole = total(blocks)
        self.chosen: list[Group] = []
        self._place = {group.index: number for number, group in enumerate(groups)}
        self.before = np.array([one.square for one in blocks])
        self.now = self.before
        self._price = np.log(_EACH * len(blocks)) / (_EACH * len(blocks))

    def add(self) -> bool:
        """Adds the group that predicts best, if any pays."""
        found = self._best([], self.now)
        if found is None:
            return False
        group, left = found
        self.chosen, self.now = [*self.chosen, group], left
        return True

    def swap(self) -> None:
        """Puts another group in the place of one, as long as that predicts clearly better."""
        for _ in range(_SWAPS):
            best, least = None, self.now
            for group in self.chosen[:-1]:
                found = self._best([group], least)
                if found is not None:
                    best, least = (group, found[0]), found[1]
            if best is None:
                return
            self.chosen = [*(one for one in self.chosen if one is not best[0]), best[1]]
            self.now = least

    def _best(self, instead_of: Sequence[Group], rival: Floats) -> tuple[Group, Floats] | None:
        """The group to add, and what is left then; None if none pays.

        Of those that predict as well as the best as far as the blocks can tell, the one with fewest
        numbers to fit, then the first (Breiman et al., "Classification and regression trees",
        1984, section 3.4).
        """
        kept = [one for one in self.chosen if one not in instead_of]
        paying: list[tuple[Group, Floats]] = []
        for group in self._promising(kept):
            left = predicted(self.blocks, [*kept, group])
            if self._pays(rival, left, _LOOSE) and self._makes_sense([*kept, group]):
                paying.append((group, left))
        if not paying:
            return None
        least = min(paying, key=lambda one: float(one[1].sum()))[1]
        level = [one for one in paying if _level(one[1], least, self.rule.gain)]
        return min(level, key=lambda one: (one[0].width, self._place[one[0].index]))

    def remove(self, certainty: float, last: bool = False) -> None:
        """Drops groups that do not pay given the others, the least useful one first."""
        while len(self.chosen) > 1:
            trials: list[tuple[float, int, list[Group], Floats]] = []
            for group in self.chosen if last else self.chosen[:-1]:
                fewer = [one for one in self.chosen if one is not group]
                left = predicted(self.blocks, fewer)
                if not self._pays(left, self.now, certainty):
                    trials.append((float(left.sum()), len(trials), fewer, left))
            if not trials:
                return
            _, _, self.chosen, self.now = min(trials, key=lambda one: one[:2])

    def _promising(self, chosen: Sequence[Group]) -> list[Group]:
        """Groups with the best fit on all blocks, given those chosen."""
        taken = {group.key for group in chosen}
        ones = [i for group in chosen if group.fixed for i in group.index]
        index = [i for group in chosen if not group.fixed for i in group.index]
        normal = self.whole
        if ones:
            less = normal.gram[:, ones].sum(axis=1)
            square = normal.square - 2 * normal.moment[ones].sum() + less[ones].sum()
            normal = Normal(normal.gram, normal.moment - less, float(square), normal.count)
        rest = profiled(normal, index, np.full(len(index), 0.0))
        scored: list[tuple[float, int, Group]] = []
        for group in self.groups:
            if group.key in taken:
                continue
            at = list(group.index)
            strength = np.diag(rest.gram)[at] / np.maximum(np.diag(self.whole.gram)[at], 1e-300)
            if strength.max(initial=0.0) < _NEW:
                continue
            if group.fixed:
                inner = rest.gram[np.ix_(at, at)].sum()
                left = float(rest.square - 2 * rest.moment[at].sum() + inner)
            else:
                left = fit(rest, at)[1]
            scored.append(
                (np.log(max(left, 1e-300)) + group.width * self._price, len(scored), group)
            )
        return [group for _, _, group in sorted(scored, key=lambda s: s[:2])[: self.rule.tried]]

    def _makes_sense(self, trial: Sequence[Group]) -> bool:
        found = coefficients(self.whole, trial)
        return all(group.instance(x) is not None for group, x in zip(trial, found, strict=True))

    def _pays(self, without: Floats, with_it: Floats, certainty: float) -> bool:
        drop = without - with_it
        if drop.sum() <= self.rule.gain * without.sum():
            return False
        error = float(drop.std(ddof=1) / np.sqrt(len(drop))) if len(drop) > 1 else 0.0
        return float(drop.mean()) > certainty * error


def _level(left: Floats, least: Floats, gain: float) -> bool:
    """Whether a prediction is as good as the best, as far as blocks can tell."""
    more = left - least
    error = float(more.std(ddof=1) / np.sqrt(len(more))) if len(more) > 1 else 0.0
    return float(more.mean()) <= max(_TIE * error, gain * float(least.mean()))


_TIE = 2.0
_NEW = 1e-6
"""Share of a column that must not be in the span of those already chosen."""
_LOOSE = 1.0
"""Standard errors that a group must be worth on the way; in the end each must be worth more."""
_SWAPS = 3
_EACH = 6
"""Independent data that a block is taken to have, where groups of several sizes are compared."""
