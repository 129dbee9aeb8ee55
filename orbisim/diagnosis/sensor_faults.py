"""Faults of sensors that read no joint, along the motion of what was found."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from orbisim.diagnosis.conclusion import Attribution
from orbisim.evidence import NEAR
from orbisim.sensing.faults import Sensed, faults
from orbisim.sensing.readings import (
    FreeRun,
    simulated_readings,
    smoothed_readings,
    usable_sensors,
)
from orbisim.shooting.bench import Bench
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.judge import Judge, is_structural
from orbisim.shooting.shooter import Shooter
from orbisim.shooting.windows import Windows


def sensor_faults(
    found: Attribution, unseen: Bench, notes: list[str], say: Callable[[str], None]
) -> Sensed:
    """Faults of sensors, by readings along the scene's own free runs where these are right, and
    along the smoothed motion elsewhere.

    Args:
      unseen: held-out windows, which decide nothing. notes: get what is left out.
    """
    chosen = usable_sensors(found.bench.samples, notes)
    if not chosen:
        return Sensed()
    say("looking at the sensors")
    hypothesis, after = found.after.hypothesis, found.after
    scene = hypothesis.scene(found.bench.scene)
    sure = after.ratio <= NEAR and not is_structural(hypothesis)
    if not sure:
        fitted, held = (smoothed_readings(one.samples, scene) for one in (found.bench, unseen))
        return faults(chosen, fitted, held, sure, notes)
    judge = Judge(unseen, unseen.intervals)
    apart = judge.score(hypothesis).start
    runs = (
        (found.bench, free_runs(found.bench, hypothesis, after.windows, after.fit.start)),
        (unseen, free_runs(unseen, hypothesis, judge.fitted.windows, apart)),
    )
    fitted, held = (simulated_readings(bench.samples, scene, one) for bench, one in runs)
    return faults(chosen, fitted, held, sure, notes)


def free_runs(
    bench: Bench, hypothesis: Hypothesis, windows: Windows, start: npt.NDArray[np.float64]
) -> list[FreeRun]:
    """Windows as a hypothesis runs through them, as far as they can be predicted.

    Args:
      start: [W, 2 nv] deviations at their starts.
    """
    shooter = Shooter(bench.scene, bench.samples, bench.intervals, windows, bench.noise)
    qpos, qvel = shooter.states(hypothesis.variant(bench.scene), start)
    stop = windows.reach() + 1
    return [
        FreeRun(int(i), int(shooter.row[w]), qpos[w, : stop[w]], qvel[w, : stop[w]])
        for w, i in enumerate(windows.recording)
    ]
