"""Fits of whole hypotheses by simulation, and how they fare on windows they have not seen."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from orbisim.effects import find
from orbisim.errors import OrbiSimError
from orbisim.host.deadline import TimeIsUpError
from orbisim.motion.linear import Intervals, linearize
from orbisim.motion.samples import extent
from orbisim.shooting.bench import Bench
from orbisim.shooting.chance import Chance
from orbisim.shooting.fits import WEAK, Fit, Hints, Unknown
from orbisim.shooting.gauss_newton import gauss_newton, proposed, start_derivatives
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.one_run import Own, glanced, moved_along, own_slopes
from orbisim.shooting.retune import Tunable
from orbisim.shooting.shooter import Shooter, Variant
from orbisim.shooting.stepping import stepping
from orbisim.shooting.timestep import stepped, taken
from orbisim.shooting.windows import Windows, evenly

Floats = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Judged:
    """A hypothesis, fitted and checked.

    Attributes:
      hypothesis: with fitted values. fit: on the windows it was fitted to.
      checked: [windows] mean squared weighted residual of each check window, starts fitted.
      ratio: residual over noise, on the fitted or on the check windows, whichever is larger.
      pooled: the same over all windows, with none left out.
      check_fit: window starts on the check windows.
      windows: those that it was fitted to.
      fitted: as `checked`, of the windows that it was fitted to.
      signals: [ny] residual over noise of each measured signal, pooled over all windows, where
        impacts leave less known of some than of others; empty elsewhere.
      counting: says `independent`, when it is asked.
    """

    hypothesis: Hypothesis
    fit: Fit
    checked: Floats
    ratio: float
    pooled: float
    check_fit: Fit
    windows: Windows
    fitted: Floats = dataclasses.field(default_factory=lambda: np.zeros(0))
    signals: Floats = dataclasses.field(default_factory=lambda: np.zeros(0))
    counting: Callable[[], float] | None = None

    @functools.cached_property
    def independent(self) -> float:
        """How many of the data that it was fitted to count as independent by what other effects
        explain of what is left; infinite where that is not known."""
        return np.inf if self.counting is None else self.counting()

    @property
    def loss(self) -> float:
        """How badly windows are predicted, bad ones by their logarithm: of two fits of the same
        hypothesis, the one with less is better."""
        return _loss(np.concatenate([self.fitted, self.checked]))


@dataclasses.dataclass(frozen=True, eq=False)
class Beginning:
    """Where fits begin: at windows' starts, with what these do, as far as that is known.

    Attributes:
      start: [W, 2 nv] of the fitted windows, None for the references. free: [W, data, 2 nv]
        derivatives of their weighted data by it, None if they have to be found.
      check_start, check_free: of the check windows.
      build, unknowns: the parameters of the explanation that the starts are of, where glances
        correct them too (where bodies touch); None otherwise. shooter: the fitted windows.
    """

    start: Floats | None = None
    free: Floats | None = None
    check_start: Floats | None = None
    check_free: Floats | None = None
    build: Callable[[Floats], Variant] | None = None
    unknowns: Sequence[Unknown] = ()
    shooter: Shooter | None = None

    def as_measured(self) -> Beginning:
        """The same with windows that start where they were measured to, at the references."""
        if self.start is None:
            return self
        return dataclasses.replace(self, start=np.zeros_like(self.start))

    @functools.cached_property
    def own(self) -> Own | None:
        """What the explanation's own parameters change; None where that is not to be had."""
        if self.build is None or self.shooter is None or self.start is None:
            return None
        try:
            return own_slopes(self.shooter, self.build, self.unknowns, self.start)
        except OrbiSimError:  # a difference step leads to no possible scene: glances do without
            return None


class Judge:
    """Fits and checks hypotheses on the same windows.

    Args:
      bench: the data.
      intervals: linear system along a scene close to what will be judged, for quick derivatives.
      tunables, columns: declared parameters and their effect on every interval [N, 2 nv, F]; not
        used where bodies touch, as chained through impacts it says little.
      most: at most so many windows are fitted (spread evenly), for speed; None for all.
      heavy: whether windows have one unknown scale and heavy tails, as where bodies touch, instead
        of the noise's: what is left on a real machine is model error.
      chance: what effects would give, asked when something is compared.
    """

    def __init__(
        self,
        bench: Bench,
        intervals: Intervals,
        tunables: Sequence[Tunable] = (),
        columns: Floats | None = None,
        most: int | None = None,
        heavy: bool = False,
        chance: Callable[[], Chance | None] | None = None,
    ) -> None:
        self.bench, self.chance, self.most = bench, chance, most
        self.robust = _IMPACTS if bench.contacts else None
        self.heavy = heavy or bench.contacts
        kept = evenly(bench.fit, most)
        self.fitted, self._smooth = bench.shooter(kept), np.flatnonzero(bench.smooth[kept])
        check = bench.check if bench.check.any() else bench.fit
        self.check, self._check_smooth = self.fitted, self._smooth
        if not (check == bench.fit).all():
            kept = evenly(check, None if most is None else max(8, most // 2))
            self.check = bench.shooter(kept)
            self._check_smooth = np.flatnonzero(bench.smooth[kept])
        self.cold = Beginning() if bench.contacts else self._chained(intervals)
        self._slopes: dict[Tunable, Floats] = {}
        if columns is not None and not bench.contacts:
            response = self.fitted.respond(intervals, columns)
            self._slopes = {one: response[..., f] for f, one in enumerate(tunables)}
        self.begin = functools.lru_cache(maxsize=2)(self._begin)
        self.moves = functools.lru_cache(maxsize=2)(self._moves)

    def _chained(self, intervals: Intervals) -> Beginning:
        """At the references, with what starts do in linear approximation."""
        free = self.fitted.chained(intervals)
        same = self.check is self.fitted
        return Beginning(free=free, check_free=free if same else self.check.chained(intervals))

    def _begin(self, judged: Judged) -> Beginning:
        """Where an explanation has windows start, with what that does: a first guess for others."""
        return self._beginning(judged.hypothesis, judged.fit.start, judged.check_fit.start)

    def begin_joined(self, judged: Judged, other: Judge) -> Beginning:
        """The same of an explanation that was judged on other windows, some to be fitted and some
        to be checked: windows that are among them start where they did, the others at the
        references. From nothing where bodies touch and there are others.

        Args:
          other: what judged it.
        """
        known: dict[int, Floats] = {}
        for part, fit in (other.check, judged.check_fit), (other.fitted, judged.fit):
            known |= dict(zip(part.windows.first.tolist(), fit.start, strict=True))
        own = self.fitted.windows.first.tolist()
        if self.bench.contacts and not known.keys() >= set(own):
            return self.cold
        nothing = np.zeros(judged.fit.start.shape[1])
        start = np.array([known.get(first, nothing) for first in own])
        return self._beginning(judged.hypothesis, start, start)

    def _beginning(
        self, hypothesis: Hypothesis, start: Floats, check_start: Floats | None
    ) -> Beginning:
        """Starts of as many windows as there are, with what they do where bodies touch."""
        found, declared = self.cold, self.bench.scene
        variant, contacts = hypothesis.variant(declared), self.bench.contacts
        if len(start) == len(self.fitted):
            found = dataclasses.replace(found, start=start)
            if contacts:
                free = start_derivatives(self.fitted, variant, start)
                found = dataclasses.replace(found, free=free, shooter=self.fitted)
            if contacts and not is_structural(hypothesis):
                found = dataclasses.replace(
                    found,
                    build=lambda values: hypothesis.at(declared, values).variant(declared),
                    unknowns=hypothesis.unknowns(declared),
                )
        if self.check is self.fitted:
            return dataclasses.replace(found, check_start=found.start, check_free=found.free)
        if check_start is not None and len(check_start) == len(self.check):
            found = dataclasses.replace(found, check_start=check_start)
            if contacts:
                free = start_derivatives(self.check, variant, check_start)
                found = dataclasses.replace(found, check_free=free)
        return found

    def judge(
        self,
        hypothesis: Hypothesis,
        iterations: int = 5,
        polish: bool = True,
        begin: Beginning | None = None,
        restarts: int = 0,
    ) -> Judged | None:
        """Fits the hypothesis' free parameters; None if it cannot be simulated.

        Args:
          polish: whether parameters that act in steps are searched, which takes long.
          begin: where the windows start at first; at the references if None.
          restarts: how often at most a fit through impacts is restarted where starts alone do
            better; each takes several times as long as the fit.
        """
        begin = begin or self.cold
        try:
            fitted, fit = self._fitted(hypothesis, iterations, begin)
            if restarts and self.bench.contacts and not is_structural(hypothesis):
                fitted, fit = self._restarted(fitted, fit, iterations, restarts)
            if polish:
                fitted, fit = self._polish(fitted, fit, begin)
            checked = fit
            if self.check is not self.fitted:
                start, free = begin.check_start, begin.check_free
                checked = self._scored(fitted, self.check, start, free)
                if restarts and self.bench.contacts and start is not None:
                    checked = _by_window(checked, self._scored(fitted, self.check, None, None))
        except (OrbiSimError, np.linalg.LinAlgError):
            return None
        means = mean_squares(self.check, checked)
        fit_means = mean_squares(self.fitted, fit)
        trimmed = bool(fitted.effects or fitted.factors)
        square = max(
            self._typical(self.fitted, fit_means, trimmed),
            self._typical(self.check, means, trimmed),
        )
        pooled = float(np.mean([*fit_means, *means]))
        return Judged(
            fitted, fit, means, float(np.sqrt(square)), float(np.sqrt(pooled)),
            checked, self.fitted.windows, fit_means, self._by_signal(fit, checked),
            functools.cache(functools.partial(self._independent, fitted, fit, fit_means)),
        )  # fmt: skip

    @functools.cached_property
    def _columns(self) -> tuple[Chance, Floats] | None:
        """What effects would give: with [W, R, C] of it."""
        chance = None if self.chance is None else self.chance()
        if chance is None:
            return None
        return chance, chance.design(self.bench, self.fitted.windows)

    def _independent(self, hypothesis: Hypothesis, fit: Fit, means: Floats) -> float:
        """See `Judged.independent`."""
        if self._columns is None:
            return np.inf
        chance, design = self._columns
        weight = 1 / (1 + means / max(float(np.median(means)), 1.0))
        there = [(one.effect, one.target) for one in hypothesis.effects]
        return chance.independent(design, fit.residual, weight, there)

    def _by_signal(self, fit: Fit, checked: Fit) -> Floats:
        """See `Judged.signals`; large residuals count as they do in the fit."""
        if self.fitted.whitening is None:
            return np.zeros(0)
        parts = [(self.fitted, fit)]
        if self.check is not self.fitted:
            parts.append((self.check, checked))
        square = np.zeros(len(self.fitted.measured))
        data = np.zeros(len(square))
        for shooter, one in parts:
            size = np.abs(one.residual.reshape(shooter.seen.shape))
            k = np.inf if self.robust is None else self.robust
            cost = size**2 - np.maximum(size - k, 0.0) ** 2  # Huber's
            own = shooter.seen.sum(axis=(0, 1))
            square += cost.sum(axis=(0, 1))
            data += own * (1 - 2 * shooter.nv * len(shooter) / max(own.sum(), 1))
        return np.asarray(np.sqrt(square / np.maximum(data, 1.0)))

    def _typical(self, shooter: Shooter, means: Floats, trimmed: bool = True) -> float:
        """Mean over windows; with contacts, without the worst few.

        Args:
          trimmed: whether any window may be left out, or only those that impacts cut short.
        """
        if not self.bench.contacts:
            return float(means.mean())
        may_go = np.ones(len(means), bool) if trimmed else shooter.windows.fragile()
        worst_first = np.flatnonzero(may_go)[np.argsort(-means[may_go])]
        kept = np.delete(means, worst_first[: round(_TRIMMED * len(means))])
        return float(kept.mean())

    def possible(self, judged: Judged) -> Judged:
        """Without effects with numbers that no machine has, and fitted again: of what stood in for
        the error of another form of the data hardly anything may be left in this one, and hardly
        anything may lie anywhere (a load of a milligram beyond its body). The same if there are
        none."""
        model, known = self.bench.scene.model, extent(self.bench.samples)
        fewer = judged.hypothesis
        for number, one in reversed(list(enumerate(judged.hypothesis.effects))):
            if find(one.effect).log_prior(model, one, known) == -np.inf:
                fewer = fewer.without(number)
        if fewer is judged.hypothesis:
            return judged
        return self.judge(fewer, begin=self.begin(judged)) or judged

    def closer(self, judged: Judged, iterations: int = 5, restarts: int = 1) -> Judged:
        """The hypothesis fitted again, if that is better: with what a window's start does along its
        own scene, then as differences show. Along the declared scene it may be quite another thing;
        where it is not, and both fits end alike, differences will show no more. Where bodies touch,
        only they are taken.
        """
        best = judged
        for own in (False,) if self.bench.contacts else (True, False):
            if best.ratio < _REACHED and not self.bench.contacts:
                break
            begin = self.begin(best)
            if own:
                begin = self._chained(linearize(self.bench.flow(best.hypothesis)))
            elif not self.bench.contacts:
                begin = dataclasses.replace(begin, free=None, check_free=None)
            again = self.judge(best.hypothesis, iterations, begin=begin, restarts=restarts)
            alike = own and again is not None and abs(again.loss - best.loss) < _ALIKE
            if again is not None and again.loss < best.loss:
                best = again
            if alike:
                break
        return best

    def fair(self, judged: Judged, others: Sequence[Judged]) -> Judged:
        """The same explanation with each window started as others start it, too, wherever that is
        better, and fitted once more from there: of two explanations, the one that happens to have
        the better starts must not win by them. Starts alone are fitted, as differences show what
        they do. It is the same where nothing but noise is left, and where not all windows are
        fitted; where bodies touch, restarts do as much.

        Args:
          others: judged on the same windows, with as many numbers in a start.
        """
        if judged.ratio < _REACHED or self.bench.contacts or self.check is not self.fitted:
            return judged
        shape, best = judged.fit.start.shape, judged.fit
        for one in (other.fit.start for other in others if other.fit.start.shape == shape):
            there = self._scored(judged.hypothesis, self.fitted, one, self.cold.free, 0)
            best = _by_window(best, there)
        tried = self._scored(judged.hypothesis, self.fitted, best.start, None)
        best = _by_window(best, tried)
        if not _loss(mean_squares(self.fitted, best)) < judged.loss - _ALIKE:
            return judged
        begin = dataclasses.replace(self.cold, start=best.start, check_start=best.start)
        again = self.judge(judged.hypothesis, _FURTHER, begin=begin)
        return again if again is not None and again.loss < judged.loss else judged

    def started(self, judged: Judged, others: Sequence[Judged]) -> Judged:
        """Where bodies touch, what `fair` does elsewhere: the same explanation with each window,
        fitted or checked, started as others start it, too, wherever that is better, and fitted once
        more from there. Through impacts a fit of all windows ends where the starts of some are
        poor, and which these are is chance. It is the same if hardly anything is better.

        Args:
          others: judged on the same windows; those with as many numbers in a start are asked.
        """
        hypothesis, fit, checked = judged.hypothesis, judged.fit, judged.check_fit
        try:
            for one in (other for other in others if other is not judged):
                if one.fit.start.shape != judged.fit.start.shape:
                    continue
                alone = self._scored(hypothesis, self.fitted, one.fit.start, None)
                fit = _by_window(fit, alone)
                if self.check is not self.fitted:
                    alone = self._scored(hypothesis, self.check, one.check_fit.start, None)
                    checked = _by_window(checked, alone)
            before = judged.fit.square + judged.check_fit.square
            if not fit.square + checked.square < _LITTLE * before:
                return judged
            begin = self._beginning(hypothesis, fit.start, checked.start)
        except (OrbiSimError, np.linalg.LinAlgError):
            return judged
        again = self.judge(hypothesis, _FURTHER, begin=begin)
        return again if again is not None and again.loss < judged.loss else judged

    def as_sure(self, judged: Judged) -> Judged:
        """Where bodies touch, the same with numbers of effects no surer than they stay in half of
        the step, and than the cost rises a tenth of each and half of it beside them, all others
        and the starts fitted there (profile likelihood): what a contact does depends on the step,
        and a fit through impacts ends in one of many narrow holes, whose width says nothing of how
        deep others are. Far away, windows are also begun where they were measured to. What leaves
        less there is the better fit, and asked in turn. Where the time is up, numbers are as sure
        as is known by then.
        """
        if not self.bench.contacts or is_structural(judged.hypothesis):
            return judged
        for _ in range(_FURTHER if judged.hypothesis.effects else 0):
            fit, deeper = judged.fit, None
            for asked in (self._as_sure_as_steps, self._as_sure_as_costs):
                with contextlib.suppress(TimeIsUpError):
                    for one in asked(dataclasses.replace(judged, fit=fit)):
                        fit, deeper = (fit, one) if isinstance(one, Judged) else (one, None)
            if deeper is None and fit is judged.fit:
                return judged
            if deeper is None:
                same = judged.check_fit is judged.fit
                checked = fit if same else judged.check_fit
                return dataclasses.replace(judged, fit=fit, check_fit=checked)
            judged = deeper
        return judged

    def _as_sure_as_steps(self, judged: Judged) -> Iterator[Fit]:
        """Fits that are no surer than half of the step moves their numbers."""
        fit, bench = judged.fit, stepped(self.bench, taken(self.bench) / 2.0)
        # without declared parameters: what these change is not used where bodies touch
        there = Judge(bench, bench.intervals, most=self.most, heavy=self.heavy)
        try:
            finer = there._fit(judged.hypothesis, _FURTHER, self.begin(judged))
        except (OrbiSimError, np.linalg.LinAlgError):
            return
        for k in range(len(judged.hypothesis.free(self.bench.scene))):
            fit = _no_surer(fit, k, 0.0, float(finer.values[k] - fit.values[k]))
            yield fit

    def _as_sure_as_costs(self, judged: Judged) -> Iterator[Fit | Judged]:
        """Fits that are no surer than the cost rises beside their numbers; where it falls, what is
        fitted from there, if that leaves less, as the last."""
        fit, hypothesis, begin = judged.fit, judged.hypothesis, self.begin(judged)
        for k, (number, name) in enumerate(hypothesis.free(self.bench.scene)):
            for near in () if _stepwise(hypothesis, number, name) else _BESIDE:
                beside, away = list[tuple[Hypothesis, Fit]](), near * abs(float(fit.values[k]))
                starts = (begin, self.cold) if near == max(_BESIDE) else (begin,)
                for move, start in itertools.product((-away, away) if away else (), starts):
                    values = fit.values + move * (np.arange(len(fit.values)) == k)
                    with contextlib.suppress(OrbiSimError, np.linalg.LinAlgError):
                        moved = hypothesis.at(self.bench.scene, values)
                        held = dataclasses.replace(moved, frozen=moved.frozen | {(number, name)})
                        beside.append((held, self._fit(held, 2, start)))
                if not beside:
                    continue
                held, least = min(beside, key=lambda one: one[1].square)
                if least.square < _LITTLE * fit.square:
                    there = held.at(self.bench.scene, least.values)
                    free = dataclasses.replace(there, frozen=hypothesis.frozen)
                    from_there = self._beginning(free, least.start, None)
                    deeper = self.judge(free, begin=from_there)
                    if deeper is not None and deeper.loss < judged.loss:
                        yield deeper
                        return
                fit = _no_surer(fit, k, least.square - fit.square, away)
                yield fit

    def glance(self, hypothesis: Hypothesis, begin: Beginning, every: bool = False) -> float:
        """As `sized_glance`, without the size."""
        return self.sized_glance(hypothesis, begin, every)[0]

    def sized_glance(
        self, hypothesis: Hypothesis, begin: Beginning, every: bool = False
    ) -> tuple[float, float]:
        """What a hypothesis would leave, at the price of one simulation: mean squared residual over
        every other window, with starts, the numbers of the explanation that they are of, and the
        size of the difference to that, corrected linearly, and this size; infinite if it cannot be
        simulated, or if `begin` has no starts.

        Args:
          every: whether every window is simulated, also where there are many, and what is left is
            as `Judged.loss`, in which a window that an event throws off counts no more than others.
        """
        if begin.start is None or begin.free is None:
            return np.inf, 1.0
        many = len(self.fitted) >= _MANY and not every
        some = np.arange(len(self.fitted)) % 2 == 0 if many else None
        try:
            variant = hypothesis.variant(self.bench.scene)
            left, size = glanced(
                self.fitted, variant, begin.start, begin.free, self.robust, begin.own, some
            )
        except (OrbiSimError, np.linalg.LinAlgError):
            return np.inf, 1.0
        dof = np.maximum(self.fitted.data - 2 * self.fitted.nv, 1)
        means = (left / dof)[slice(None) if some is None else some]
        return _loss(means) if every else self._typical(self.fitted, means), size

    def tried(self, hypothesis: Hypothesis, begin: Beginning) -> float:
        """What one step of a fit leaves, over all windows; with derivatives by the numbers of the
        explanation that the starts are of as they are there."""
        try:
            fit = self._fit(hypothesis, 1, begin, quick=True)
        except (OrbiSimError, np.linalg.LinAlgError):
            return np.inf
        return self._typical(self.fitted, mean_squares(self.fitted, fit))

    def _moves(self, judged: Judged) -> tuple[Own, Own] | None:
        """What the numbers of an explanation change in the windows that it was fitted to and in the
        check windows, those without impacts; None where differences have to show what starts do:
        where most windows have impacts or joints are added."""
        hypothesis, declared = judged.hypothesis, self.bench.scene
        some, others = self._smooth, self._check_smooth
        if not (len(some) and len(others)) or self.bench.rugged or is_structural(hypothesis):
            return None
        build = lambda values: hypothesis.at(declared, values).variant(declared)  # noqa: E731
        unknowns = hypothesis.unknowns(declared)
        known = Hints(slopes=self._known(hypothesis)).some(some)
        try:
            start = judged.fit.start[some]
            own = own_slopes(self.fitted.some(some), build, unknowns, start, known)
            if self.check is self.fitted:
                return own, own
            start = judged.check_fit.start[others]
            return own, own_slopes(self.check.some(others), build, unknowns, start)
        except OrbiSimError:  # a difference step leads to no possible scene
            return None

    def foreseen(self, judged: Judged, other: Judge) -> float | None:
        """By how much less `Judged.loss` of the same explanation would be in this form of the data,
        at the price of one simulation of the windows without impacts: numbers and starts corrected
        linearly, by what they do in the form that it was fitted in. None where differences have to
        show what starts do, of late sensors (which of their readings are of a window changes with
        the delay), and of other steps where bodies touch: what a contact does depends on them.
        Negative and infinite if it cannot be simulated.

        Args:
          judged: in the other form. other: what judged it.
        """
        touched = self.bench.contacts and stepping(self.bench.scene) != stepping(other.bench.scene)
        late = judged.hypothesis.variant(self.bench.scene).measurement.shifted
        moves = None if touched or late else other.moves(judged)
        if moves is None:
            return None
        some, others = self._smooth, self._check_smooth
        before = [judged.fitted[some]]
        try:
            variant, begin = judged.hypothesis.variant(self.bench.scene), other.begin(judged)
            part, start, hints = self.fitted.some(some), judged.fit.start, self._hints(begin.free)
            left, step = moved_along(
                part, variant, start[some], moves[0], hints.some(some), self.robust
            )
            means = [_means(part, left)]
            if self.check is not self.fitted:
                hints, start = self._hints(begin.check_free), judged.check_fit.start
                part, before = self.check.some(others), [*before, judged.checked[others]]
                left, _ = moved_along(
                    part, variant, start[others], moves[1], hints.some(others), self.robust, step
                )
                means.append(_means(part, left))
        except (OrbiSimError, np.linalg.LinAlgError):
            return -np.inf
        return _loss(np.concatenate(before)) - _loss(np.concatenate(means))

    def quick_loss(self, hypothesis: Hypothesis, begin: Beginning) -> float:
        """As `Judged.loss`, with starts alone fitted, and roughly.

        Raises:
          OrbiSimError: it cannot be simulated.
        """
        means = [mean_squares(self.fitted, self.score(hypothesis, begin, 2))]
        if self.check is not self.fitted:
            fit = self._scored(hypothesis, self.check, begin.check_start, begin.check_free, 2)
            means.append(mean_squares(self.check, fit))
        return _loss(np.concatenate(means))

    def score(
        self, hypothesis: Hypothesis, begin: Beginning | None = None, iterations: int = 4
    ) -> Fit:
        """Residuals of fixed parameters on the fitted windows, starts fitted."""
        begin = begin or self.cold
        return self._scored(hypothesis, self.fitted, begin.start, begin.free, iterations)

    def _scored(
        self,
        hypothesis: Hypothesis,
        shooter: Shooter,
        start: Floats | None,
        free: Floats | None,
        iterations: int = 4,
        near: bool = False,
    ) -> Fit:
        variant = hypothesis.variant(self.bench.scene)
        return gauss_newton(
            shooter,
            lambda _: variant,
            [],
            start=start,
            hints=dataclasses.replace(self._hints(free, quick=near), near=near),
            iterations=2 * iterations if is_structural(hypothesis) else iterations,
            robust=self.robust,
        )

    def _hints(
        self,
        free: Floats | None,
        slopes: Mapping[int, Floats] | None = None,
        quick: bool = False,
    ) -> Hints:
        lenient = _LENIENT if self.heavy else 0.0
        exact, rough = free is None, self.bench.contacts
        return Hints(free, slopes or {}, exact=exact, rough=rough, quick=quick, lenient=lenient)

    def _fitted(
        self, hypothesis: Hypothesis, iterations: int, begin: Beginning
    ) -> tuple[Hypothesis, Fit]:
        declared = self.bench.scene
        fit = self._fit(hypothesis, iterations, begin)
        fitted = hypothesis.at(declared, fit.values)
        weak = self._undetermined(fitted, fit)
        if weak:
            fitted = self._reset(hypothesis, fitted, weak)
            fit = self._fit(fitted, iterations, begin)
            fitted = fitted.at(declared, fit.values)
        return fitted, fit

    def _known(self, hypothesis: Hypothesis) -> dict[int, Floats]:
        """[W, data] by the numbers of the unknowns: what declared parameters change."""
        first = len(hypothesis.free(self.bench.scene))
        return {
            first + f: self._slopes[one]
            for f, (one, _) in enumerate(hypothesis.factors)
            if one in self._slopes
        }

    def _fit(
        self, hypothesis: Hypothesis, iterations: int, begin: Beginning, quick: bool = False
    ) -> Fit:
        declared = self.bench.scene
        unknowns, slopes = hypothesis.unknowns(declared), self._known(hypothesis)
        if quick and begin.own is not None:
            own = begin.own
            known = {one.name: own.slopes[..., k] for k, one in enumerate(own.unknowns)}
            slopes |= {k: known[u.name] for k, u in enumerate(unknowns) if u.name in known}
        return gauss_newton(
            self.fitted,
            lambda values: hypothesis.at(declared, values).variant(declared),
            unknowns,
            start=begin.start,
            hints=self._hints(begin.free, slopes, quick),
            iterations=iterations + 3 if is_structural(hypothesis) else iterations,
            robust=self.robust,
        )

    def _restarted(
        self, hypothesis: Hypothesis, fit: Fit, iterations: int, restarts: int
    ) -> tuple[Hypothesis, Fit]:
        """Fitted again from where windows start if nothing but starts is fitted, wherever that is
        better, as long as it brings something; its numbers are moved by steps of their own, too:
        through impacts the cost is rugged, and a fit of everything ends where the starts
        of some windows are poor. Starts are looked for from the references once."""
        free = hypothesis.free(self.bench.scene)
        cold = self._scored(hypothesis, self.fitted, None, None) if free else fit
        for _ in range(restarts if free else 0):
            alone = _by_window(self._scored(hypothesis, self.fitted, fit.start, None), cold)
            best, begin = self._moved(hypothesis, alone, fit.values)
            found, again = self._fitted(best, iterations, begin)
            if not again.square < fit.square:
                break
            little = again.square > _LITTLE * fit.square
            hypothesis, fit, cold = found, again, again
            if little:
                break
        return hypothesis, fit

    def _moved(
        self, hypothesis: Hypothesis, alone: Fit, values: Floats
    ) -> tuple[Hypothesis, Beginning]:
        """With its numbers moved by a step of a fit (`proposed`), or by more or less of it, as long
        as starts alone leave less then: through impacts, what a start does along the motion that
        there was says nothing of one that slides further, and a step with starts corrected by that
        seems to leave more however good it is.

        Args:
          alone: starts alone fitted. values: of the hypothesis.
        """
        declared = self.bench.scene
        unknowns = hypothesis.unknowns(declared)
        build = lambda moved: hypothesis.at(declared, moved).variant(declared)  # noqa: E731
        best = hypothesis, alone
        try:
            hints = self._hints(None)
            step = proposed(self.fitted, build, unknowns, hints, alone.start, self.robust)
        except (OrbiSimError, np.linalg.LinAlgError):
            step = np.zeros(len(values))
        for shares in _FURTHER_OR_LESS if step.any() else ():
            for share in shares:
                try:
                    other = hypothesis.at(declared, values + share * step)
                    tried = self._scored(other, self.fitted, best[1].start, None)
                except (OrbiSimError, np.linalg.LinAlgError):  # no such scene
                    break
                if not tried.square < best[1].square:
                    break
                best = other, tried
            if best[1] is not alone:
                break
        begin = self._beginning(best[0], best[1].start, None)
        return best[0], begin

    def _undetermined(self, fitted: Hypothesis, fit: Fit) -> list[tuple[int, str]]:
        """Parameters of effects that hardly change the data, compared with the others, or have run
        off to a bound that only says how far numbers go."""
        free = fitted.free(self.bench.scene)
        information = np.diag(fit.information.sum(axis=0))[: len(free)]
        values, unknowns = fit.values[: len(free)], fitted.unknowns(self.bench.scene)
        inside = [u.low < v < u.high for u, v in zip(unknowns, values, strict=False)]
        at_end = ~np.array(inside, bool)
        size = np.maximum(np.where(at_end, 0.0, np.abs(values)), 1e-3)
        change = np.sqrt(np.maximum(information, 0.0)) * size
        weak = change < max(WEAK * change.max(initial=0.0), 1e-3)
        weak |= np.array([u.ran_off(v) for u, v in zip(unknowns, values, strict=False)], bool)
        weak &= np.array([not _stepwise(fitted, i, name) for i, name in free], bool)
        if weak.all():
            return []
        return [name for name, w in zip(free, weak, strict=True) if w]

    def _reset(
        self, before: Hypothesis, fitted: Hypothesis, weak: Sequence[tuple[int, str]]
    ) -> Hypothesis:
        """The fitted hypothesis with undetermined parameters as they were, and held."""
        declared = self.bench.scene
        names = [*fitted.free(declared), *(None for _ in fitted.factors)]
        old, new = before.values(declared), fitted.values(declared)
        values = np.array([o if n in weak else v for n, o, v in zip(names, old, new, strict=True)])
        held = fitted.at(declared, values)
        return dataclasses.replace(held, frozen=held.frozen | set(weak))

    def _polish(self, hypothesis: Hypothesis, fit: Fit, begin: Beginning) -> tuple[Hypothesis, Fit]:
        """Searches parameters that act in steps (delays) on their grid, or on ever finer ones."""
        declared = self.bench.scene
        for index, (number, name) in enumerate(hypothesis.free(declared)):
            tried: dict[int, tuple[Hypothesis, Fit]] = {}
            grid = 0.0
            for grid in self._grids(hypothesis, number, name, float(fit.values[index])):
                tried = {}
                here = self._descend(hypothesis, fit, (number, name), index, grid, begin, tried)
                if here not in tried or not tried[here][1].square < fit.square:
                    continue
                held, other = tried[here]
                held = held.at(declared, other.values)
                hypothesis = dataclasses.replace(held, frozen=held.frozen - {(number, name)})
                values = hypothesis.values(declared)
                fit = dataclasses.replace(other, values=values, **_padded(other, index))
            beside = {k * grid - fit.values[index]: one for k, (_, one) in tried.items()}
            fit = _profiled(fit, beside, index, grid)
        return hypothesis, fit

    def _grids(self, hypothesis: Hypothesis, number: int, name: str, value: float) -> list[float]:
        """Steps of the grids on which a parameter is searched; none where it acts smoothly."""
        if value and _stepwise(hypothesis, number, name):
            return [share * abs(value) for share in _FINER]
        return []

    def _descend(
        self,
        hypothesis: Hypothesis,
        fit: Fit,
        which: tuple[int, str],
        index: int,
        grid: float,
        begin: Beginning,
        tried: dict[int, tuple[Hypothesis, Fit]],
    ) -> int:
        """Goes downhill on the grid from where the fit is."""

        def square(k: int) -> float:
            if k < 0:
                return np.inf
            if k not in tried:
                values = fit.values.copy()
                values[index] = k * grid
                trial = hypothesis.at(self.bench.scene, values)
                held = dataclasses.replace(trial, frozen=trial.frozen | {which})
                tried[k] = (held, self._fit(held, 2, begin))
            return tried[k][1].square

        here = round(fit.values[index] / grid)
        for _ in range(_GRID_STEPS_IN_CONTACT if self.bench.contacts else _GRID_STEPS):
            best = min((here - 1, here, here + 1), key=square)
            if best == here:
                break
            here = best
        return here


def _by_window(one: Fit, other: Fit) -> Fit:
    """Window by window the better of two fits of starts alone."""
    better = other.per_window < one.per_window
    each = better[:, None]
    return dataclasses.replace(
        one,
        start=np.where(each, other.start, one.start),
        square=one.square + float((other.per_window - one.per_window)[better].sum()),
        residual=np.where(each, other.residual, one.residual),
        per_window=np.where(better, other.per_window, one.per_window),
    )


def is_structural(hypothesis: Hypothesis) -> bool:
    """Whether joints are added, whose state at a window's start nothing reads."""
    kinds = [find(e.effect) for e in hypothesis.effects]
    return any(kind.structural and kind.kind == "joint" for kind in kinds)


def _stepwise(hypothesis: Hypothesis, number: int, name: str) -> bool:
    effect = hypothesis.effects[number]
    return find(effect.effect).stepwise(effect, name)


def _loss(means: Floats) -> float:
    """See `Judged.loss`, of mean squares of windows."""
    return float(np.log1p(means).mean())


def mean_squares(shooter: Shooter, fit: Fit) -> Floats:
    """[W]: mean squared weighted residual of each window, its start's numbers counted."""
    return _means(shooter, fit.per_window)


def _means(shooter: Shooter, squares: Floats) -> Floats:
    return np.asarray(squares / np.maximum(shooter.data - 2 * shooter.nv, 1))


_IMPACTS = 4.0
"""Huber threshold where there are contacts: some impacts no fit of the start reproduces."""
_REACHED = 1.05
"""Residual over noise below which a fit is not made better."""
_ALIKE = 1e-3
"""Difference of the losses of two fits that end alike: the share of the cost that ends a fit."""
_FURTHER = 3
"""Iterations of a fit that goes on from better starts."""
_FURTHER_OR_LESS = ((1.0, 2.0, 4.0), (0.3,), (0.1,))
"""Of a fit's step, that a restart tries: ever more as long as that leaves less, or else less."""
_BESIDE = (0.1, 0.5)
"""How far beside a number of an effect its cost is looked at, over what it is: as far as numbers of
fits through impacts that begin elsewhere differ, beyond the holes that single impacts make; and as
far as another of many minima may lie."""
_LITTLE = 0.99
"""Share of what a fit leaves that is hardly less."""
_GRID_STEPS = 12
"""Steps along a grid at most, each a fit."""
_FLAT = 1e-6
"""Rise of a sum of squares over a step of a grid that is none."""
_FINER = (0.12, 0.03, 0.008)
"""Grids for what acts in steps, of its value."""
_GRID_STEPS_IN_CONTACT = 2
"""The same where bodies touch, where a fit takes long."""
_LENIENT = 4.0
"""Mean square of a window, over what is typical of windows, at which it counts half."""
_TRIMMED = 0.15
"""Share of the windows, the worst, that `Judged.ratio` leaves out where bodies touch: some impacts
no start brings about. Decisions count all windows."""
_MANY = 24
"""Windows of which every other one does for a glance."""


def _padded(fit: Fit, index: int) -> dict[str, Any]:
    """Information with a row for a parameter that was held."""
    return {
        "covariance": np.insert(np.insert(fit.covariance, index, 0, 0), index, 0, 1),
        "information": np.insert(np.insert(fit.information, index, 0, 1), index, 0, 2),
        "score": np.insert(fit.score, index, 0, 1),
        "prior": None
        if fit.prior is None
        else np.insert(np.insert(fit.prior, index, 0, 0), index, 0, 1),
    }


def _no_surer(fit: Fit, index: int, rise: float, away: float) -> Fit:
    """A fit of which one number is no surer than its cost rises so far away, and not told at all
    from what is there where it does not rise by what noise would make of it."""
    square = max(fit.square / fit.count, 1.0)
    more = away**2 * square / max(rise, square) - float(fit.covariance[index, index])
    if more <= 0:
        return fit
    covariance = fit.covariance.copy()
    covariance[index, index] += more
    return dataclasses.replace(fit, covariance=covariance)


def _profiled(fit: Fit, beside: Mapping[float, Fit], index: int, grid: float) -> Fit:
    """A fit of which one number was searched on a grid: it is no surer than the cost rises beside
    it with the others fitted there, too (profile likelihood), nor than to half a step, whatever a
    derivative says.

    Args:
      beside: fits of the others with the number held, by how much it is more there.
    """
    near = {away: one for away, one in beside.items() if grid / 2 <= abs(away) < 2 * grid}
    if not near:
        return fit
    rises = [(one.square - fit.square) / away**2 for away, one in near.items()]
    known = float(fit.covariance[index, index])
    variance = max(fit.square / fit.count, 1.0) / max(min(rises), _FLAT / grid**2)
    more = max(variance, (grid / 2 / 1.96) ** 2) - known
    if more <= 0:
        return fit
    covariance, information = fit.covariance.copy(), fit.information.copy()
    covariance[index, index] += more
    if not known:  # held: resamples have to feel it
        information[:, index, index] = 1 / more / len(information)
    return dataclasses.replace(fit, covariance=covariance, information=information)
