"""One explanation over another by free runs and by forces: where both kinds of evidence exist, both
count.

An explanation was fitted to one of them. What it is worth shows in both: what free runs leave of
windows and what inverse dynamics leaves of the forces in stretches of the recordings are blocks of
the same score, each with scales of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from orbisim.diagnosis.force_data import ForceData, counts, spread
from orbisim.diagnosis.worth import prior
from orbisim.errors import OrbiSimError
from orbisim.evidence import Blocks, Gain, counted, gain, independent_share
from orbisim.shooting.bench import Bench
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.judge import Judge, mean_squares

Floats = npt.NDArray[np.float64]
_Score = TypeVar("_Score")


def worth_in_both(bench: Bench, data: ForceData, before: Hypothesis, after: Hypothesis) -> Gain:
    """Of one explanation over another, as they are: nothing but windows' starts is fitted.

    Args:
      bench: windows, all of which are scored (so many at most, spread evenly). data: forces.
    """
    runs, moved = _of_runs(bench, before, after)
    forces, pushed = _of_forces(data, before, after)
    count = max(float(moved.size.sum() + pushed.size.sum()), 2.0)

    def odds(one: Hypothesis) -> float:
        numbers = len(one.free(bench.scene)) + len(one.frozen) + len(one.factors)
        return prior(bench, one) - 0.5 * numbers * float(np.log(count))

    parts = gain(runs[0], runs[1], moved), gain(forces[0], forces[1], pushed)
    error = math.hypot(parts[0].error, parts[1].error)
    return Gain(sum(one.mean for one in parts), error, odds(after) - odds(before))


class Runs(NamedTuple):
    """What free runs say of an explanation.

    Attributes:
      gain: over the declared scene. left: root mean square over the noise, windows' starts fitted.
    """

    gain: Gain
    left: float


def by_runs(bench: Bench, one: Hypothesis) -> Runs:
    """An explanation, as it is, beside the declared scene by free runs alone.

    Args:
      bench: see `worth_in_both`.
    """
    (declared, own), blocks = _of_runs(bench, Hypothesis(), one)
    return Runs(gain(declared, own, blocks), float(np.sqrt(own.mean())))


def _of_runs(bench: Bench, *both: Hypothesis) -> tuple[list[Floats], Blocks]:
    """[W]: what is left of each window, over the noise."""
    judge = Judge(bench.whole(), bench.intervals, most=_MOST_WINDOWS, heavy=True)
    fits = _possible(both, lambda one: judge.score(one))
    lost = np.full(len(judge.fitted), _LOST)
    left = [lost if fit is None else mean_squares(judge.fitted, fit) for fit in fits]
    best, share = fits[int(np.argmin([np.log1p(one).mean() for one in left]))], 1.0
    if best is not None:
        share = independent_share(best.courses(judge.fitted.windows.length))
    return left, counted(judge.fitted.data, share)


def _of_forces(data: ForceData, *both: Hypothesis) -> tuple[list[Floats], Blocks]:
    """[B]: what is left of each joint in each stretch, at least the noise."""
    left = [data.force if f is None else f for f in _possible(both, data.left)]
    best = min(left, key=lambda f: float(np.nanmean(np.log1p(f**2))))
    sigma = spread(data, best)
    blocks = counts(data, best, sigma)
    least, found = blocks.floor**2, list[Floats]()
    for force in left:
        square = np.nan_to_num((force / sigma) ** 2)
        mean = [square[data.block == b].mean(axis=0) for b in range(data.blocks)]
        found.append(np.maximum(np.concatenate(mean), least))
    return found, blocks


def _possible(
    both: Sequence[Hypothesis], score: Callable[[Hypothesis], _Score]
) -> list[_Score | None]:
    """None for what cannot be simulated."""
    found: list[_Score | None] = []
    for one in both:
        try:
            found.append(score(one))
        except (OrbiSimError, np.linalg.LinAlgError):
            found.append(None)
    return found


_LOST = 1e12
"""Mean square of a window that cannot be simulated."""
_MOST_WINDOWS = 96
"""Windows that are scored: as many as a final fit has."""
