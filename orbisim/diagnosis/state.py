"""What a search for missing effects knows at a time, and what it does over and over."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from orbisim.diagnosis.along import along, tame
from orbisim.diagnosis.bench import Bench, Hypothesis
from orbisim.diagnosis.linear import linearize
from orbisim.diagnosis.nuisance import factor_columns
from orbisim.diagnosis.paying import enough, strain, unpaid
from orbisim.diagnosis.refine import Judge, Judged, is_structural
from orbisim.diagnosis.retune import Tunable, tunables
from orbisim.diagnosis.screening import missing_force, screen
from orbisim.diagnosis.settings import Settings
from orbisim.diagnosis.suspects import Screening, merged
from orbisim.effects import EffectInstance, find

Floats = npt.NDArray[np.float64]
Progress = Callable[[str], None]

NEAR = 1.5
"""Residual over noise of a hypothesis that only small things are missing from."""


@dataclasses.dataclass(frozen=True, eq=False)
class Rival:
    """A suspect that was fitted by simulation in one round.

    Attributes:
      instance: with fitted values. delta_bic: to the round's winner, positive is worse.
      ratio: residual over noise on check windows. round: number of the round.
      reason: why it was not taken; empty for the one that was.
      pays: whether windows that it was not fitted to get better by enough and surely.
    """

    instance: EffectInstance
    delta_bic: float
    ratio: float
    round: int
    reason: str = ""
    pays: bool = False


def quiet(settings: Settings, declared: Judged) -> bool:
    """Whether there is nothing to explain: the declared scene predicts all windows to within noise.

    Where bodies touch, an effect may show in a few windows only, which `Judged.ratio` leaves out.
    """
    return max(declared.ratio, declared.pooled) <= enough(settings, declared)


class SearchState:
    """The data with their noise as it is known by now, and the judge of hypotheses on them.

    Attributes:
      given: the data as they came. bench: the same with the noise along the best scene so far.
      settings: of the search. say: told what is going on.
      intervals: the linear system along the best scene so far. judge: of hypotheses.
      tunables: declared parameters that the data feel. columns: their effect on the motion,
        [intervals, 2 nv, tunables]; None without.
      robust: Huber threshold; None for the default. heavy: as in `Judge`.
      declared: the declared scene, judged. round: number of the present round.
      rivals, rejected: as in `Attribution`.
    """

    def __init__(self, bench: Bench, settings: Settings, say: Progress) -> None:
        self.bench, self.given, self.settings, self.say = bench, bench, settings, say
        self.rivals: list[Rival] = []
        self.rejected: list[tuple[EffectInstance, str]] = []
        self.tunables: tuple[Tunable, ...] = ()
        self.columns: Floats | None = None
        self.intervals = bench.intervals
        self.robust, self.heavy = settings.robust, False
        self.round = 0
        self.declared: Judged | None = None
        self.judge = self._judge()
        self._started = time.monotonic()

    def restart(self, judge: Judge) -> None:
        """Goes on with the data as they came, a judge of them to whom what is left is model error,
        and nothing to retune."""
        self.bench, self.intervals, self.judge = self.given, self.given.intervals, judge
        self.robust, self.heavy, self.tunables, self.columns = None, True, (), None

    @property
    def late(self) -> bool:
        """Whether the time for further effects is up."""
        return time.monotonic() - self._started > self.settings.patience

    @property
    def iterations(self) -> int:
        """Of a fit in a round."""
        return 4 if self.bench.contacts else 5

    def _judge(self) -> Judge:
        settings = self.settings
        return Judge(
            self.bench, self.intervals, self.tunables, self.columns, settings.windows,
            self.robust,
        )  # fmt: skip

    def allowed(self, instance: EffectInstance) -> bool:
        """Whether the search may use an effect, and its target can have it."""
        only = self.settings.effects
        if only is not None and instance.effect not in only:
            return False
        return find(instance.effect).possible(self.bench.scene.model, instance.target)

    def need(self, hypothesis: Hypothesis) -> Judged:
        """Judges what must be possible to simulate.

        Raises:
          FloatingPointError: it cannot be simulated along the recordings.
        """
        judged = self.judge.judge(hypothesis)
        if judged is None:
            raise FloatingPointError("the scene cannot be simulated along the recordings")
        return judged

    def done(self, judged: Judged) -> bool:
        """Whether nothing is left to explain."""
        return judged.ratio <= enough(self.settings, judged)

    def screen(self, judged: Judged) -> Screening:
        """Ranks the effects that may be missing on top of a hypothesis; with contacts, along the
        recordings and along its own free runs."""
        only, hypothesis = self.settings.effects, judged.hypothesis
        fitted = None
        if self.bench.contacts and not is_structural(hypothesis):
            fitted = along(self.bench, judged)
        if fitted is None:
            return screen(self.bench, hypothesis, self.intervals, only, self.columns)
        bench, numbers = tame(fitted[0]), fitted[1]
        columns = None if self.columns is None else factor_columns(bench, self.tunables)
        force = missing_force(self.intervals)[numbers]
        own = screen(bench, hypothesis, bench.intervals, only, columns, force)
        seen = tame(dataclasses.replace(self.bench, intervals=self.intervals))
        return merged(own, screen(seen, hypothesis, self.intervals, only, self.columns))

    def find_tunables(self) -> None:
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

    def renew(self, hypothesis: Hypothesis) -> None:
        """Noise and derivatives are known better along a better scene."""
        self.intervals = linearize(self.bench.flow(hypothesis))
        self.bench = self.bench.with_noise_of(hypothesis, self.intervals)
        self.judge = self._judge()

    def renewed(self, judged: Judged) -> Judged:
        """The same hypothesis, judged with noise and derivatives along its own scene."""
        self.renew(judged.hypothesis)
        if self.bench.contacts:  # a start from nothing takes long
            self.judge.start_from(judged)
        again = self.need(judged.hypothesis)
        if not self.bench.contacts and again.ratio > _LOST * judged.ratio:
            self.judge.start_from(judged)  # a start from nothing was no good: a stop in the way
            warm = self.judge.judge(judged.hypothesis)
            again = again if warm is None or again.cost <= warm.cost else warm
        self.judge.start_from(again)
        return self.settled(again) if self.bench.contacts else again

    def settled(self, judged: Judged) -> Judged:
        """Fitted on, as long as that still brings much: what is left would be explained by the
        next effect, and steps through impacts are short."""
        for _ in range(_FURTHER):
            if self.done(judged) or self.late or is_structural(judged.hypothesis):
                break
            again = self.judge.judge(judged.hypothesis)
            if again is None or again.cost >= judged.cost:
                break
            little = judged.cost - again.cost < self.settings.margin
            judged = again
            self.judge.start_from(judged)
            if little:
                break
        return judged

    def tuned(self, hypothesis: Hypothesis) -> Judged | None:
        """The hypothesis with declared parameters retuned."""
        if not self.tunables:
            return None
        self.say("retuning declared parameters")
        self.renew(hypothesis)
        judged = self.judge.judge(hypothesis.tuned(self.tunables))
        if judged is None:
            return None
        self.renew(judged.hypothesis)
        if self.bench.contacts:
            self.judge.start_from(judged)
        return self.judge.judge(judged.hypothesis)

    def untuned(self, judged: Judged) -> Judged:
        """Without retuning, if that is no worse."""
        if not judged.hypothesis.factors:
            return judged
        plain = self.judge.judge(dataclasses.replace(judged.hypothesis, factors=()))
        return plain if plain is not None and plain.cost <= judged.cost else judged

    def pays(self, before: Judged, after: Judged) -> bool:
        """Whether windows that were not fitted get better, by enough and surely."""
        return unpaid(self.settings, before, after) is None

    def _superfluous(self, fewer: Judged, current: Judged) -> bool:
        """Whether an effect does not pay any more. It stays if only a declared parameter as far off
        as any may be could stand in for it. Where bodies touch, a few windows with impacts decide
        how sure a gain is: an effect that paid before must also have been replaced."""
        if self.pays(fewer, current):
            return False
        if strain(fewer.hypothesis) and not strain(current.hypothesis):
            return False
        gain = fewer.cost - current.cost
        return not (self.bench.contacts and gain > _REPLACED * self.settings.margin)

    def prune(self, current: Judged, newest: bool = False) -> Judged:
        """Drops effects that a later one has made superfluous.

        Args:
          newest: whether the last one may go too, as retuned parameters can replace it.
        """
        while len(current.hypothesis.effects) > 1:
            kept = None
            for index in range(len(current.hypothesis.effects) - (not newest)):
                fewer = self.judge.judge(current.hypothesis.without(index))
                if fewer is not None and self._superfluous(fewer, current):
                    kept = fewer
                    break
            if kept is None:
                return current
            current = kept
        return current


_REPLACED = 10.0
"""Margins of the criterion by which all must get worse without an effect that is to stay."""
_LOST = 1.2
"""How many times what a hypothesis left before (over noise) it may leave when judged again."""
_FURTHER = 4
"""How often a fit through contacts goes on at most."""
