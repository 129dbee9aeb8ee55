"""From a residual to the effects that explain it: forward selection with removal."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import numpy.typing as npt

from orbisim.diagnosis.along import along
from orbisim.diagnosis.bench import SAME, Bench, Hypothesis, clean
from orbisim.diagnosis.consistency import inconsistency
from orbisim.diagnosis.joint import propose
from orbisim.diagnosis.laws import imitated
from orbisim.diagnosis.linear import linearize
from orbisim.diagnosis.paying import unpaid
from orbisim.diagnosis.refine import Judge, Judged, is_structural
from orbisim.diagnosis.retune import REACH, Tunable, tunables
from orbisim.diagnosis.samples import Samples
from orbisim.diagnosis.screening import (
    Screening,
    Suspect,
    cleaned,
    factor_columns,
    merged,
    missing_force,
    screen,
)
from orbisim.diagnosis.settings import Settings
from orbisim.effects import EffectInstance, effect_names, find
from orbisim.errors import OrbiSimError

Floats = npt.NDArray[np.float64]
Progress = Callable[[str], None]


@dataclasses.dataclass(frozen=True, eq=False)
class Rival:
    """A suspect that was fitted by simulation in one round.

    Attributes:
      instance: with fitted values. delta_bic: to the round's winner, positive is worse.
      ratio: residual over noise on check windows. round: number of the round.
      reason: why it was not taken; empty for the one that was.
    """

    instance: EffectInstance
    delta_bic: float
    ratio: float
    round: int
    reason: str = ""


@dataclasses.dataclass(frozen=True, eq=False)
class Attribution:
    """What the search found.

    Attributes:
      bench: the data, with the noise as it was known in the end.
      before, after: the declared scene and the final hypothesis, fitted on all windows.
      first: screening of the declared scene; None if nothing had to be explained.
      rivals: fitted suspects of all rounds.
      evidence: for each effect the drop in information criterion that it brings.
      rejected: effects that lowered the residual but were not believed, with the reason.
      cut_short: whether the search ended because its time was up.
    """

    bench: Bench
    before: Judged
    after: Judged
    first: Screening | None
    rivals: tuple[Rival, ...]
    evidence: tuple[float, ...]
    rejected: tuple[tuple[EffectInstance, str], ...]
    cut_short: bool

    @property
    def samples(self) -> tuple[Samples, ...]:
        """The recordings that were fitted."""
        return self.bench.samples

    @property
    def hypothesis(self) -> Hypothesis:
        """The effects, with fitted values."""
        return self.after.hypothesis


def attribute(bench: Bench, settings: Settings, say: Progress = lambda _: None) -> Attribution:
    """Searches for the effects that a scene lacks."""
    return _Search(bench, settings, say).run()


def enough(settings: Settings, judged: Judged) -> float:
    """Residual over noise below which there is nothing to explain, given how much data there is."""
    return settings.enough + 3.0 / np.sqrt(2.0 * max(judged.fit.count, 1))


class _Search:
    def __init__(self, bench: Bench, settings: Settings, say: Progress) -> None:
        self.bench, self.settings, self.say = bench, settings, say
        self.rivals: list[Rival] = []
        self.rejected: list[tuple[EffectInstance, str]] = []
        self.tunables: tuple[Tunable, ...] = ()
        self.columns: Floats | None = None
        self.intervals = bench.intervals
        self.robust, self._given = settings.robust, bench
        self.round = 0
        self._started = time.monotonic()

    @property
    def _late(self) -> bool:
        return time.monotonic() - self._started > self.settings.patience

    def run(self) -> Attribution:
        self.say("fitting the declared scene")
        self.judge = self._judge()
        nothing = self._need(Hypothesis())
        if self._done(nothing):
            return self._conclude(nothing, None)
        self._find_tunables()
        self.say("screening effects")
        first = self._screen(nothing)
        found = self._explain(nothing, first)
        together = self._jointly(found)
        if together is not None:
            found = self._prune(self._add_all(together))
        return self._conclude(found, first)

    def _explain(self, nothing: Judged, first: Screening) -> Judged:
        """One effect if it is all; else declared parameters; else effects and parameters."""
        single = self._round(nothing, first.suspects, first)
        if single is not None:
            single = self._renewed(single)
            if self._done(single) and single.hypothesis.effects[0].effect not in SAME:
                return single
        tuned = self._tuned(Hypothesis())
        alone = single if single is not None and self._done(single) else None
        explains = tuned is not None and self._done(tuned) and not _strained(tuned)
        if tuned is not None and explains and (alone is None or tuned.cost < alone.cost):
            return tuned
        if alone is not None:
            return alone
        both = self._paired(nothing, single, first)
        if both is not None:
            single = self._renewed(self._prune(both))
            if self._done(single):
                return single
        elif single is not None:
            single = self._renewed(single)
        start = single
        if single is not None and self.tunables:
            start = self._tuned(single.hypothesis) or single
        elif single is None:
            start = tuned or nothing
        assert start is not None
        if start is nothing or (self._done(start) and not _strained(start)):
            return self._untuned(self._prune(start, newest=True))
        return self._forward(start, tuned or nothing, first)

    def _paired(self, nothing: Judged, single: Judged | None, first: Screening) -> Judged | None:
        """Two effects at once, if they do much better than the best single one."""
        self._renew(Hypothesis())
        self.judge.start_from(nothing)
        fitted: list[Judged] = []
        for pair in first.pairs[: self.settings.shortlist]:
            one, other = (cleaned(self.bench, suspect) for suspect in pair)
            if one is None or other is None or self._late:
                continue
            self.say(f"fitting {one.effect} at {one.target} and {other.effect} at {other.target}")
            judged = self.judge.judge(Hypothesis((one, other)), self._iterations)
            if judged is not None:
                fitted.append(judged)
                if self._done(judged):
                    break
        if not fitted:
            return None
        best = min(fitted, key=lambda judged: judged.cost)
        rival = nothing if single is None else single
        problem = unpaid(self.settings, rival, best)
        if not self._done(best) and best.ratio > _HALF * rival.ratio:
            problem = "two effects at once leave more than half of what the best single one leaves"
        if problem is not None:
            alone = {(r.instance.effect, r.instance.target) for r in self.rivals}
            self.rejected += [
                (e, f"with another at once: {problem}")
                for e in best.hypothesis.effects
                if (e.effect, e.target) not in alone
            ]
        return best if problem is None else None

    def _jointly(self, rival: Judged) -> Judged | None:
        """Several effects at once, if they are better than what was found before."""
        if self.bench.contacts or rival.ratio <= _NEAR:
            return None
        self.say("several effects at once")
        bench, settings = self._given, self.settings
        most = max(settings.most_effects, _TOGETHER)
        effects = propose(bench, bench.intervals, settings.effects, most)
        if len(effects) < max(1, len(rival.hypothesis.effects)):
            return None
        robust = settings.robust or _HUBER
        judge = Judge(bench, bench.intervals, (), None, settings.windows, robust)
        fitted = judge.judge(Hypothesis(effects), 6)
        plain = dataclasses.replace(rival.hypothesis, factors=())
        others = [judge.judge(one, 6) for one in (Hypothesis(), plain)]
        if fitted is None or not all(o is not None and self._steadier(o, fitted) for o in others):
            return None
        self.bench, self.intervals, self.judge = bench, bench.intervals, judge
        self.robust, self.tunables, self.columns = robust, (), None
        self._started = time.monotonic()
        return self._prune(fitted)

    def _steadier(self, before: Judged, after: Judged) -> bool:
        """Whether check windows get better in amplitude: squares are those of a few windows where
        models of a real machine fall short."""
        drop = np.sqrt(before.checked) - np.sqrt(after.checked)
        error = float(drop.std() / np.sqrt(max(len(drop), 1)))
        sure = float(drop.mean()) > self.settings.certainty * error
        return sure and before.cost - after.cost > self.settings.margin

    def _forward(self, start: Judged, base: Judged, first: Screening) -> Judged:
        """Adds effects while they pay, from one start or, if that ends worse, from the other."""
        current = self._add_all(start)
        again = base is not start and not self._done(current) and not self._late
        if again and self.tunables:
            self.say("looking again with declared parameters retuned")
            self._renew(base.hypothesis)
            winner = self._round(base, first.tuned, first)
            if winner is not None and winner.hypothesis.effects[0] != start.hypothesis.effects[0]:
                other = self._add_all(self._renewed(winner))
                if other.ratio < current.ratio:
                    current = other
        return self._untuned(self._prune(current, newest=True))

    def _add_all(self, current: Judged) -> Judged:
        while len(current.hypothesis.effects) < self.settings.most_effects and not self._late:
            if self._done(current) and not _strained(current):
                return current
            self.say(f"screening what is left ({current.ratio:.3g} times the noise)")
            found = self._screen(current)
            suspects = found.tuned if current.hypothesis.factors else found.suspects
            winner = self._round(current, suspects, found)
            if winner is None:
                return current
            current = self._renewed(self._prune(winner))
        return current

    # -- tools ---------------------------------------------------------------------------------

    def _judge(self) -> Judge:
        settings = self.settings
        return Judge(
            self.bench, self.intervals, self.tunables, self.columns, settings.windows,
            self.robust,
        )  # fmt: skip

    def _need(self, hypothesis: Hypothesis) -> Judged:
        judged = self.judge.judge(hypothesis)
        if judged is None:
            raise FloatingPointError("the scene cannot be simulated along the recordings")
        return judged

    def _done(self, judged: Judged) -> bool:
        return judged.ratio <= enough(self.settings, judged)

    def _screen(self, judged: Judged) -> Screening:
        only, hypothesis = self.settings.effects, judged.hypothesis
        fitted = None
        if self.bench.contacts and not is_structural(hypothesis):
            fitted = along(self.bench, judged)
        if fitted is None:
            return screen(self.bench, hypothesis, self.intervals, only, self.columns)
        bench, numbers = fitted
        columns = None if self.columns is None else factor_columns(bench, self.tunables)
        force = missing_force(self.intervals)[numbers]
        own = screen(bench, hypothesis, bench.intervals, only, columns, force)
        return merged(own, screen(self.bench, hypothesis, self.intervals, only, self.columns))

    def _find_tunables(self) -> None:
        """Declared parameters that the data feel at all."""
        if not self.settings.retune:
            return
        every = tunables(self.bench.scene.model)
        columns = factor_columns(self.bench, every)
        size = np.abs(columns).max(axis=(0, 1)) if len(every) else np.zeros(0)
        felt = size > 1e-9
        self.tunables = tuple(one for one, f in zip(every, felt, strict=True) if f)
        self.columns = columns[:, :, felt] if felt.any() else None
        self.judge = self._judge()

    def _renew(self, hypothesis: Hypothesis) -> None:
        """Noise and derivatives are known better along a better scene."""
        self.intervals = linearize(self.bench.flow(hypothesis))
        self.bench = self.bench.with_noise_of(hypothesis, self.intervals)
        self.judge = self._judge()

    def _renewed(self, judged: Judged) -> Judged:
        self._renew(judged.hypothesis)
        again = self._need(judged.hypothesis)
        self.judge.start_from(again)
        return again

    def _tuned(self, hypothesis: Hypothesis) -> Judged | None:
        """The hypothesis with declared parameters retuned."""
        if not self.tunables:
            return None
        self.say("retuning declared parameters")
        self._renew(hypothesis)
        judged = self.judge.judge(hypothesis.tuned(self.tunables))
        if judged is None:
            return None
        self._renew(judged.hypothesis)
        return self.judge.judge(judged.hypothesis)

    def _untuned(self, judged: Judged) -> Judged:
        """Without retuning, if that is no worse."""
        if not judged.hypothesis.factors:
            return judged
        plain = self.judge.judge(dataclasses.replace(judged.hypothesis, factors=()))
        return plain if plain is not None and plain.cost <= judged.cost else judged

    # -- one round -----------------------------------------------------------------------------

    def _round(
        self, current: Judged, suspects: Sequence[Suspect], screening: Screening
    ) -> Judged | None:
        """The best effect to add, if any pays."""
        self.round += 1
        self.judge.start_from(current)
        fitted: list[Judged] = []
        for instance, bic in self._suspects(current.hypothesis, suspects, screening):
            if fitted and (self._late or self._settled(current, fitted, bic)):
                break
            self.say(f"round {self.round}: fitting {instance.effect} at {instance.target}")
            judged = self.judge.judge(current.hypothesis.plus(instance), self._iterations)
            if judged is not None:
                fitted.append(judged)
            else:
                self.rejected.append((instance, "the scene with it cannot be simulated"))
        if not fitted:
            return None
        fitted = _ranked(fitted)
        winner, reasons = self._winner(current, fitted)
        self.rivals += [
            Rival(j.hypothesis.effects[-1], j.cost - fitted[0].cost, j.ratio, self.round, reason)
            for j, reason in zip(fitted, reasons, strict=True)
        ]
        return winner

    def _winner(self, current: Judged, fitted: Sequence[Judged]) -> tuple[Judged | None, list[str]]:
        """The first of the best that pays, and why each of the others was not taken."""
        winner: Judged | None = None
        reasons: list[str] = []
        for place, judged in enumerate(fitted):
            last = len(judged.hypothesis.effects) - 1
            reason = unpaid(self.settings, current, judged)
            if reason is None and winner is not None:
                best = winner.hypothesis.effects[-1]
                reason = f"it explains less than {best.effect} at {best.target}"
            elif reason is None and place >= 3:
                reason = "it explains less than three others, none of which was believed"
            elif reason is None and judged.ratio > _NEAR:
                reason = inconsistency(self.bench, judged, last)
                if reason is not None:
                    self.rejected.append((judged.hypothesis.effects[-1], reason))
            if reason is None:
                winner = judged
            reasons.append(reason or "")
        return winner, reasons

    def _settled(self, current: Judged, fitted: Sequence[Judged], bic: float | None) -> bool:
        """Whether an explanation down to the noise makes clearly worse suspects idle, or one that
        leaves little those that are slow to fit."""
        best = min(fitted, key=lambda j: j.cost)
        if len(fitted) < 2:
            return False
        if bic is None and best.ratio**2 - 1 < _LITTLE * (current.ratio**2 - 1):
            return True
        return best.ratio <= 1.15 and (bic is None or len(fitted) >= 3)

    def _suspects(
        self, hypothesis: Hypothesis, suspects: Sequence[Suspect], screening: Screening
    ) -> Iterator[tuple[EffectInstance, float | None]]:
        """Best first; then play and elasticity, which no regression sees."""
        yield from self._shortlist(hypothesis, suspects)
        yield from ((instance, None) for instance in self._structural(hypothesis, screening))

    def _shortlist(
        self, hypothesis: Hypothesis, suspects: Sequence[Suspect]
    ) -> list[tuple[EffectInstance, float]]:
        """The best. Where there are contacts, regressions say less: one simulation of each of many
        decides."""
        found = ((cleaned(self.bench, s), s) for s in suspects)
        possible = [(instance, s.bic) for instance, s in found if instance is not None]
        most = self.settings.shortlist
        if not self.bench.contacts or is_structural(hypothesis):
            return possible[:most]
        touching = [one for one in possible if find(one[0].effect).kind == "geom"]
        others = [one for one in possible if find(one[0].effect).kind != "geom"]
        chosen = [*touching[:most], *others[: _GLANCES - most]]
        left = {id(one): self.judge.glance(hypothesis.plus(one[0])) for one in chosen}
        return sorted(chosen, key=lambda one: left[id(one)])[:most]

    @property
    def _iterations(self) -> int:
        return 4 if self.bench.contacts else 5

    def _structural(self, hypothesis: Hypothesis, screening: Screening) -> Iterator[EffectInstance]:
        """Play and elasticity at the joints where something is left."""
        model = self.bench.scene.model
        names = [n for n in effect_names() if find(n).structural and find(n).kind == "joint"]
        if self.settings.effects is not None:
            names = [n for n in names if n in self.settings.effects]
        taken = {(e.effect, e.target) for e in hypothesis.effects}
        for name in names:
            for target in find(name).targets(model):
                dof = int(model.jnt_dofadr[model.joint(target).id])
                if screening.shares[dof] < _SHARE or (name, target) in taken:
                    continue
                best = self._best_trial(hypothesis, name, target)
                if best is not None:
                    yield best

    def _best_trial(self, hypothesis: Hypothesis, name: str, target: str) -> EffectInstance | None:
        """The trial values that leave least, without fitting."""
        best, least = None, np.inf
        for values in find(name).trials(self.bench.scene.model, target):
            instance = EffectInstance(name, target, dict(values))
            try:
                instance = clean(self.bench.scene, instance)
                trial = hypothesis.plus(instance)
                left = self.judge.score(trial, self.judge.check, 2).square
            except OrbiSimError:  # a variant that cannot be simulated is no candidate
                continue
            if left < least:
                best, least = instance, left
        return best

    def _pays(self, before: Judged, after: Judged) -> bool:
        """Whether windows that were not fitted get better, by enough and surely."""
        return unpaid(self.settings, before, after) is None

    # -- removal -------------------------------------------------------------------------------

    def _prune(self, current: Judged, newest: bool = False) -> Judged:
        """Drops effects that a later one has made superfluous.

        Args:
          newest: whether the last one may go too, as retuned parameters can replace it.
        """
        while len(current.hypothesis.effects) > 1:
            kept = None
            for index in range(len(current.hypothesis.effects) - (not newest)):
                fewer = self.judge.judge(current.hypothesis.without(index))
                if fewer is not None and not self._pays(fewer, current):
                    kept = fewer
                    break
            if kept is None:
                return current
            current = kept
        return current

    # -- the end -------------------------------------------------------------------------------

    def _conclude(self, current: Judged, first: Screening | None) -> Attribution:
        """Fits on all windows and weighs each effect."""
        self.say("final fit")
        if current.hypothesis.effects or current.hypothesis.factors:
            self._renew(current.hypothesis)
        everything = np.ones_like(self.bench.fit)
        whole = dataclasses.replace(self.bench, fit=everything, check=everything)
        judge = Judge(
            whole, self.intervals, self.tunables, self.columns, _MOST_WINDOWS,
            self.robust,
        )  # fmt: skip
        before = judge.judge(Hypothesis())
        assert before is not None
        after = judge.judge(current.hypothesis, 8) or current
        if not current.hypothesis.effects and not current.hypothesis.factors:
            after = before
        else:
            problem = self._doubt(whole, before, after)
            if problem is None and not self.bench.contacts:
                problem = imitated(judge, after)
            if problem is not None:
                self.rejected += [(effect, problem) for effect in after.hypothesis.effects]
                after = before
        judge.start_from(after)
        fewer = (
            judge.judge(after.hypothesis.without(index)) or before
            for index in range(len(after.hypothesis.effects))
        )
        evidence = tuple(one.cost - after.cost for one in fewer)
        return Attribution(
            self.bench, before, after, first, tuple(self.rivals), evidence,
            tuple(self.rejected), self._late and not self._done(after),
        )  # fmt: skip

    def _excess(self, judged: Judged) -> float:
        """Amplitude of the residual beyond the noise, in units of the noise."""
        return _amplitude(float(np.mean(judged.checked)) - 1.0, self.robust)

    def _doubt(self, whole: Bench, before: Judged, after: Judged) -> str | None:
        """Why an explanation that does not reach the noise is none; None if it is one."""
        if after.ratio <= _NEAR:
            return None
        if not after.hypothesis.effects:
            return "declared parameters alone do not explain it"
        left = self._excess(after) / max(self._excess(before), 1e-12)
        if left > self.settings.most_left:
            return f"{100 * left:.0f} % of the residual's amplitude remains"
        for index in range(len(after.hypothesis.effects)):
            problem = inconsistency(whole, after, index)
            if problem is not None:
                return problem
        return None


def _amplitude(square: float, threshold: float | None) -> float:
    """Amplitude of residuals whose mean Huber loss (2 k |r| - k^2 beyond a threshold k) is this."""
    if threshold is None or square <= threshold**2:
        return float(np.sqrt(max(square, 0.0)))
    return (square + threshold**2) / (2 * threshold)


def _ranked(fitted: Sequence[Judged]) -> list[Judged]:
    """Best first; of those that the data do not tell apart, the first in the catalogue first."""
    order = {name: i for i, name in enumerate(effect_names())}
    least = min(judged.cost for judged in fitted)

    def rank(judged: Judged) -> tuple[float, int]:
        tied = judged.cost < least + _TIE
        return (least if tied else judged.cost, order[judged.hypothesis.effects[-1].effect])

    return sorted(fitted, key=rank)


_TIE = 2.0


def _strained(judged: Judged) -> bool:
    """Whether a declared parameter is as far off as it may be: that is an effect, then."""
    return any(abs(factor - 1) > 0.9 * REACH for _, factor in judged.hypothesis.factors)


_TOGETHER = 6
_HUBER = 4.0
_GLANCES = 20
_SHARE = 0.08
_LITTLE = 0.1
_HALF = 0.5
_NEAR = 1.5
_MOST_WINDOWS = 96
