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

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


@dataclasses.dataclass(frozen=True, eq=False)
class Group:
    """Columns that enter together.

    Attributes:
      index: of the columns. key: groups with the same key exclude each other (several shapes of an
        effect at a target). possible: whether fitted coefficients of the columns make sense.
      fixed: whether the coefficients are ones instead of fitted.
    """

    index: tuple[int, ...]
    key: tuple[str, ...]
    possible: Callable[[Floats], bool]
    fixed: bool = False


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
      groups: in the order in which they entered. coefficients: of each group's columns.
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


def select(blocks: Sequence[Normal], groups: Sequence[Group], rule: Rule) -> Selected:
    """Groups that predict blocks they were not fitted to, best first."""
    search = _Search(blocks, groups, rule)
    while len(search.chosen) < rule.most and search.add():
        search.remove(0.0)
        search.swap()
    search.remove(rule.certainty, last=True)
    return search.result()


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
        """The group to add that predicts best, and what is left then; None if none pays."""
        kept = [one for one in self.chosen if one not in instead_of]
        best, least = None, rival
        for group in self._promising(kept):
            left = predicted(self.blocks, [*kept, group])
            pays = self._pays(rival, left, _LOOSE)
            if pays and left.sum() < least.sum() and self._makes_sense([*kept, group]):
                best, least = group, left
        return None if best is None else (best, least)

    def remove(self, certainty: float, last: bool = False) -> None:
        """Drops groups that do not pay given the others, the least useful one first."""
        while len(self.chosen) > 1:
            trials = []
            for group in self.chosen if last else self.chosen[:-1]:
                fewer = [one for one in self.chosen if one is not group]
                left = predicted(self.blocks, fewer)
                if not self._pays(left, self.now, certainty):
                    trials.append((float(left.sum()), len(trials), fewer, left))
            if not trials:
                return
            _, _, self.chosen, self.now = min(trials, key=lambda one: one[:2])

    def result(self) -> Selected:
        """The groups with coefficients and gains."""
        gains = []
        for group in self.chosen:
            left = predicted(self.blocks, [one for one in self.chosen if one is not group])
            gains.append(float(1 - self.now.sum() / max(left.sum(), 1e-300)))
        return Selected(
            tuple(self.chosen), tuple(coefficients(self.whole, self.chosen)), self.now,
            self.before, tuple(gains),
        )  # fmt: skip

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
        scored = []
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
            width = 0 if group.fixed else len(at)
            scored.append((np.log(max(left, 1e-300)) + width * self._price, len(scored), group))
        return [group for _, _, group in sorted(scored, key=lambda s: s[:2])[: self.rule.tried]]

    def _makes_sense(self, trial: Sequence[Group]) -> bool:
        found = coefficients(self.whole, trial)
        return all(group.possible(x) for group, x in zip(trial, found, strict=True))

    def _pays(self, without: Floats, with_it: Floats, certainty: float) -> bool:
        drop = without - with_it
        if drop.sum() <= self.rule.gain * without.sum():
            return False
        error = float(drop.std(ddof=1) / np.sqrt(len(drop))) if len(drop) > 1 else 0.0
        return float(drop.mean()) > certainty * error


_NEW = 1e-6
"""Share of a column that must not be in the span of those already chosen."""
_LOOSE = 1.0
"""Standard errors that a group must be worth on the way; in the end each must be worth more."""
_SWAPS = 3
_EACH = 6
"""Independent data that a block is taken to have, where groups of several sizes are compared."""
