"""From a residual to the effects that explain it: forward selection with removal."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Sequence

import numpy as np
import numpy.typing as npt

from orbisim.diagnosis.bench import Bench, Hypothesis
from orbisim.diagnosis.refine import Judge, Judged
from orbisim.diagnosis.screening import Screening, cleaned, screen
from orbisim.effects import EffectInstance, effect_names, find

Floats = npt.NDArray[np.float64]
Progress = Callable[[str], None]


@dataclasses.dataclass(frozen=True)
class Settings:
    """How the search goes about it.

    Attributes:
      effects: names of the effects to consider; all if None.
      most_effects: at most so many are added.
      shortlist: how many suspects of a screening are fitted by simulation.
      windows: how many windows are used to compare suspects.
      enough: residual over noise at which nothing is left to explain.
      gain: an effect must reduce the mean squared residual on check windows by this share.
      certainty: ... and by so many standard errors over the windows.
      margin: information criterion by which an effect must pay.
      robust: Huber threshold, or None.
    """

    effects: tuple[str, ...] | None = None
    most_effects: int = 4
    shortlist: int = 7
    windows: int = 48
    enough: float = 1.06
    gain: float = 0.02
    certainty: float = 2.0
    margin: float = 10.0
    robust: float | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class Rival:
    """A suspect that was fitted by simulation in one round.

    Attributes:
      instance: with fitted values. delta_bic: to the round's winner, positive is worse.
      ratio: residual over noise on check windows. round: number of the round.
    """

    instance: EffectInstance
    delta_bic: float
    ratio: float
    round: int


@dataclasses.dataclass(frozen=True, eq=False)
class Attribution:
    """What the search found.

    Attributes:
      bench: the data, with the noise as it was known in the end.
      before, after: the declared scene and the final hypothesis, fitted on all windows.
      first: screening of the declared scene. last: of the final one.
      rivals: fitted suspects of all rounds.
      evidence: for each effect the drop in information criterion that it brings, and the mean squared
        residuals on check windows without and with it.
    """

    bench: Bench
    before: Judged
    after: Judged
    first: Screening
    last: Screening | None
    rivals: tuple[Rival, ...]
    evidence: tuple[tuple[float, float, float], ...]


def attribute(bench: Bench, settings: Settings, say: Progress = lambda _: None) -> Attribution:
    """Searches for the effects that a scene lacks."""
    search = _Search(bench, settings, say)
    return search.run()


class _Search:
    def __init__(self, bench: Bench, settings: Settings, say: Progress) -> None:
        self.bench, self.settings, self.say = bench, settings, say
        self.rivals: list[Rival] = []

    def run(self) -> Attribution:
        settings = self.settings
        self.say("fitting the declared scene")
        self.judge = self._judge()
        current = self._need(Hypothesis())
        before_first = self.bench
        self.say("screening effects")
        first = last = screen(self.bench, Hypothesis(), settings.effects)
        for number in range(settings.most_effects):
            if current.ratio <= settings.enough and number > 0:
                break
            winner = self._round(number, current, last)
            if winner is None:
                break
            current = self._prune(winner)
            self._renew_noise(current)
            current = self._need(current.hypothesis)
            self.say(f"screening what is left ({current.ratio:.3g} times the noise)")
            last = screen(self.bench, current.hypothesis, settings.effects)
        return self._conclude(before_first, current, first, last)

    def _judge(self) -> Judge:
        return Judge(self.bench, self.settings.windows, self.settings.robust)

    def _need(self, hypothesis: Hypothesis) -> Judged:
        judged = self.judge.judge(hypothesis)
        if judged is None:
            raise FloatingPointError("the declared scene cannot be simulated along the recordings")
        return judged

    def _renew_noise(self, current: Judged) -> None:
        """The noise is known better along a better scene."""
        scene = current.hypothesis.scene(self.bench.scene)
        self.bench = self.bench.with_noise_of(scene)
        self.judge = self._judge()

    # -- one round -----------------------------------------------------------------------------

    def _round(self, number: int, current: Judged, screening: Screening) -> Judged | None:
        """The best effect to add, if any pays."""
        fitted: list[Judged] = []
        for instance in self._suspects(current.hypothesis, screening):
            self.say(f"round {number + 1}: fitting {instance.effect} at {instance.target}")
            judged = self.judge.judge(current.hypothesis.plus(instance))
            if judged is not None:
                fitted.append(judged)
        if not fitted:
            return None
        fitted.sort(key=self._criterion)
        best = self._criterion(fitted[0])
        self.rivals += [
            Rival(j.hypothesis.effects[-1], self._criterion(j) - best, j.ratio, number)
            for j in fitted
        ]
        for judged in fitted[:2]:
            if self._pays(current, judged):
                return judged
        return None

    def _suspects(self, hypothesis: Hypothesis, screening: Screening) -> list[EffectInstance]:
        found = [cleaned(self.bench, s) for s in screening.suspects]
        chosen = [instance for instance in found if instance is not None]
        chosen = chosen[: self.settings.shortlist]
        return [*chosen, *self._structural(hypothesis, screening)]

    def _structural(self, hypothesis: Hypothesis, screening: Screening) -> list[EffectInstance]:
        """Play and elasticity, which no regression sees, at the joints where something is left."""
        model = self.bench.scene.model
        names = [n for n in effect_names() if find(n).structural and find(n).kind == "joint"]
        if self.settings.effects is not None:
            names = [n for n in names if n in self.settings.effects]
        taken = {(e.effect, e.target) for e in hypothesis.effects}
        found: list[EffectInstance] = []
        for name in names:
            for target in find(name).targets(model):
                dof = int(model.jnt_dofadr[model.joint(target).id])
                if screening.shares[dof] < _SHARE or (name, target) in taken:
                    continue
                best = self._best_trial(hypothesis, name, target)
                if best is not None:
                    found.append(best)
        return found

    def _best_trial(self, hypothesis: Hypothesis, name: str, target: str) -> EffectInstance | None:
        """The trial values that leave least, without fitting."""
        best, least = None, np.inf
        for values in find(name).trials(self.bench.scene.model, target):
            instance = EffectInstance(name, target, dict(values))
            try:
                left = self.judge.score(hypothesis.plus(instance), self.judge.check).square
            except Exception:  # a variant that cannot be simulated is no candidate
                continue
            if left < least:
                best, least = instance, left
        return best

    def _criterion(self, judged: Judged) -> float:
        """Information criterion of the fit, with the error variance estimated where it is larger
        than the noise."""
        count = self._count(judged)
        return count * float(np.log(max(judged.fit.ratio, 1.0) ** 2)) + judged.size * float(
            np.log(count)
        )

    def _count(self, judged: Judged) -> int:
        """Independent data: neighbouring residuals of a wrong scene are not independent."""
        windows = len(judged.fit.per_window)
        measured = self.judge.fitted.target.shape[2]
        independent = windows * measured * _PER_WINDOW
        return int(min(judged.fit.count, max(independent, 8)))

    def _pays(self, before: Judged, after: Judged) -> bool:
        """Whether windows that were not fitted get better, by enough and surely."""
        settings = self.settings
        drop = before.checked - after.checked
        total = float(before.checked.mean())
        excess = max(total - 1.0, 1e-12)
        mean, error = float(drop.mean()), float(drop.std() / np.sqrt(max(len(drop), 1)))
        if mean <= settings.gain * max(excess, 0.02):
            return False
        if mean < settings.certainty * error and mean < 0.5 * excess:
            return False
        return self._criterion(before) - self._criterion(after) > settings.margin

    # -- removal -------------------------------------------------------------------------------

    def _prune(self, current: Judged) -> Judged:
        """Drops effects that a later one has made superfluous."""
        while len(current.hypothesis.effects) > 1:
            kept = None
            for index in range(len(current.hypothesis.effects) - 1):
                fewer = self.judge.judge(current.hypothesis.without(index))
                if fewer is not None and not self._pays(fewer, current):
                    kept = fewer
                    break
            if kept is None:
                return current
            current = kept
        return current

    # -- the end -------------------------------------------------------------------------------

    def _conclude(
        self, first_bench: Bench, current: Judged, first: Screening, last: Screening | None
    ) -> Attribution:
        """Fits on all windows and weighs each effect."""
        self.say("final fit")
        everything = dataclasses.replace(
            self.bench, fit=np.ones_like(self.bench.fit), check=self.bench.check
        )
        judge = Judge(everything, None, self.settings.robust)
        before = judge.judge(Hypothesis())
        after = judge.judge(current.hypothesis) if current.hypothesis.effects else before
        assert before is not None
        after = after or current
        evidence = []
        self.judge = judge
        for index in range(len(after.hypothesis.effects)):
            fewer = judge.judge(after.hypothesis.without(index)) or before
            evidence.append(
                (
                    self._criterion(fewer) - self._criterion(after),
                    float(np.sqrt(fewer.checked.mean())),
                    float(np.sqrt(after.checked.mean())),
                )
            )
        return Attribution(
            self.bench, before, after, first, last, tuple(self.rivals), tuple(evidence)
        )


_SHARE = 0.08
_PER_WINDOW = 6


def confidence(
    judged: Judged, names: Sequence[str], seed: int = 0
) -> dict[str, tuple[float, float]]:
    """95 % intervals of fitted parameters: the wider of the Jacobian's and a block bootstrap's.

    The bootstrap resamples windows and takes one Gauss-Newton step from the fit.
    """
    fit = judged.fit
    count = len(fit.values)
    if not count:
        return {}
    rng = np.random.default_rng(seed)
    windows = len(fit.information)
    draws = np.empty((_DRAWS, count))
    scale = np.sqrt(np.maximum(np.diag(fit.information.sum(axis=0)), 1e-300))
    for d in range(_DRAWS):
        chosen = rng.integers(0, windows, windows)
        gram = fit.information[chosen].sum(axis=0) / np.outer(scale, scale)
        moment = fit.score[chosen].sum(axis=0) / scale
        draws[d] = fit.values + np.linalg.lstsq(gram, moment, rcond=1e-10)[0] / scale
    low, high = np.quantile(draws, [0.025, 0.975], axis=0)
    width = 1.96 * np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    low, high = np.minimum(low, fit.values - width), np.maximum(high, fit.values + width)
    return {n: (float(a), float(b)) for n, a, b in zip(names, low, high, strict=True)}


_DRAWS = 200


def unique(values: Iterable[str]) -> tuple[str, ...]:
    """Without repetitions, in order."""
    return tuple(dict.fromkeys(values))
