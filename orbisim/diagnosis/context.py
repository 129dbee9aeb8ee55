"""What a search knows at a time: data, noise and derivatives along the best scene so far."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from orbisim.diagnosis.nuisance import factor_columns
from orbisim.diagnosis.screening import candidates_of, screen
from orbisim.diagnosis.settings import Settings
from orbisim.diagnosis.suspects import Screening, merged
from orbisim.effects import EffectInstance, find
from orbisim.evidence import NEAR
from orbisim.host.deadline import NEVER, Deadline
from orbisim.motion.linear import Intervals, linearize, missing_force
from orbisim.motion.regressors import MotionView
from orbisim.shooting.along import along, cut_at_growth
from orbisim.shooting.bench import Bench
from orbisim.shooting.chance import Chance, chance_of
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.judge import Judge, Judged, is_structural
from orbisim.shooting.retune import Tunable, tunables

Floats = npt.NDArray[np.float64]
Progress = Callable[[str], None]


@dataclasses.dataclass(frozen=True, eq=False)
class Context:
    """The data and the judge of hypotheses on them.

    Attributes:
      settings: of the search. say: told what is going on.
      bench: the data, with the noise along the best scene so far.
      intervals: the linear system along that scene.
      tunables: declared parameters that the data feel. columns: their effect on the motion,
        [intervals, 2 nv, tunables]; None without.
      judge: of hypotheses on the fitted and the check windows.
      chance: says what effects would give along that scene, when it is asked; None where bodies
        touch, as chained through impacts that says little.
    """

    settings: Settings
    say: Progress
    bench: Bench
    intervals: Intervals
    tunables: tuple[Tunable, ...]
    columns: Floats | None
    judge: Judge
    chance: Callable[[], Chance | None] | None = None

    @property
    def deadline(self) -> Deadline:
        """Until when the search may take."""
        return self.bench.deadline

    def along(self, judged: Judged) -> Context:
        """Noise and derivatives are known better along a better scene; what exceeds the noise
        there is model error, and windows count as such."""
        hypothesis = judged.hypothesis
        intervals = linearize(self.bench.flow(hypothesis))
        bench = self.bench.with_noise_of(hypothesis, intervals)
        return self._with(
            bench, intervals, judged.ratio > NEAR, _chance(bench, intervals, hypothesis)
        )

    def on(self, bench: Bench) -> Context:
        """With the same data along another form of the declared scene."""
        chance = _chance(bench, bench.intervals, Hypothesis())
        return self._with(bench, bench.intervals, self.judge.heavy, chance)

    def trying(self, bench: Bench) -> Context:
        """The same, with what effects would give as it was."""
        return self._with(bench, bench.intervals, self.judge.heavy, self.chance)

    def until(self, deadline: Deadline) -> Context:
        """With another deadline."""
        bench = dataclasses.replace(self.bench, deadline=deadline)
        return self._with(bench, self.intervals, self.judge.heavy, self.chance)

    def whole(self, deadline: Deadline, most: int) -> Context:
        """With all windows fitted and checked (so many at most), until another deadline."""
        bench = dataclasses.replace(self.bench.whole(), deadline=deadline)
        return self._with(bench, self.intervals, self.judge.heavy, self.chance, most)

    def _with(
        self,
        bench: Bench,
        intervals: Intervals,
        heavy: bool,
        chance: Callable[[], Chance | None] | None,
        most: int | None = None,
    ) -> Context:
        """With other data, and a judge on them."""
        most = most or self.settings.windows
        judge = Judge(bench, intervals, self.tunables, self.columns, most, heavy, chance)
        return dataclasses.replace(
            self, bench=bench, intervals=intervals, judge=judge, chance=chance
        )

    def with_tunables(self) -> Context:
        """Finds the declared parameters that the data feel at all."""
        if not self.settings.retune:
            return self
        every = tunables(self.bench.scene.model)
        columns = factor_columns(self.bench, every)
        size = np.abs(columns).max(axis=(0, 1)) if len(every) else np.zeros(0)
        felt = size > 1e-9
        found = dataclasses.replace(
            self,
            tunables=tuple(one for one, f in zip(every, felt, strict=True) if f),
            columns=columns[:, :, felt] if felt.any() else None,
        )
        return found._with(self.bench, self.intervals, self.judge.heavy, self.chance)

    def allowed(self, instance: EffectInstance) -> bool:
        """Whether the search may use an effect, and its target can have it."""
        only = self.settings.effects
        if only is not None and instance.effect not in only:
            return False
        return find(instance.effect).possible(self.bench.scene.model, instance.target)

    def screen(self, judged: Judged) -> Screening:
        """Ranks the effects that may be missing on top of a hypothesis; with contacts, along the
        recordings and along its own free runs."""
        only, hypothesis, seen, fitted = self.settings.effects, judged.hypothesis, self.bench, None
        if self.bench.contacts:
            seen = cut_at_growth(dataclasses.replace(self.bench, intervals=self.intervals))
            if not is_structural(hypothesis):
                fitted = along(self.bench, hypothesis, judged.windows, judged.fit.start)
        if fitted is None:
            return screen(seen, hypothesis, self.intervals, only, self.columns)
        bench, numbers = cut_at_growth(fitted[0]), fitted[1]
        columns = None if self.columns is None else factor_columns(bench, self.tunables)
        force = missing_force(self.intervals)[numbers]
        own = screen(bench, hypothesis, bench.intervals, only, columns, force)
        return merged(own, screen(seen, hypothesis, self.intervals, only, self.columns))


def begun(bench: Bench, settings: Settings, say: Progress) -> Context:
    """Along the declared scene, with nothing to retune."""
    chance = _chance(bench, bench.intervals, Hypothesis())
    judge = Judge(bench, bench.intervals, (), None, settings.windows, chance=chance)
    return Context(settings, say, bench, bench.intervals, (), None, judge, chance)


def _chance(
    bench: Bench, intervals: Intervals, hypothesis: Hypothesis
) -> Callable[[], Chance | None] | None:
    """What effects would give along a scene, all of the catalogue: what may not be named tells as
    much of chance as what may. What is left has no say in the columns (frequencies that stand out
    in it would explain more than chance does), and none is made by simulation, which takes long.
    What was fitted in time is compared whatever the clock says."""
    if bench.contacts:
        return None

    @functools.cache
    def asked() -> Chance | None:
        flow = dataclasses.replace(bench, deadline=NEVER).flow(hypothesis)
        view = MotionView(flow, bench.samples)
        found = candidates_of(view, bench, hypothesis, flow, None, simulated=False)
        return chance_of(intervals, found)

    return asked
