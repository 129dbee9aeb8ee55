"""What an explanation that was fitted by simulation is worth more than another."""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.diagnosis.bench import Hypothesis
from orbisim.diagnosis.evidence import Blocks, Gain, gain, independent_share
from orbisim.diagnosis.fits import Fit
from orbisim.diagnosis.refine import Judged
from orbisim.diagnosis.selection import EFFECT
from orbisim.effects import find

Floats = npt.NDArray[np.float64]


def worth(model: mujoco.MjModel, before: Judged, after: Judged) -> Gain:
    """Of the effects of one explanation over those of another, by the windows of both.

    Windows that parameters were fitted to count, too; each fitted number costs half the logarithm
    of the number of independent data (Laplace's approximation of the evidence).
    """
    share = independent_share(_courses(after))
    fits = [after.fit] if after.check_fit is after.fit else [after.fit, after.check_fit]
    size = np.concatenate([np.maximum(share * _data(fit), 1.0) for fit in fits])
    blocks = Blocks(size, np.zeros(len(size), np.int64), np.ones(len(size)))
    squares = [np.concatenate([one.fitted, one.checked][: len(fits)]) for one in (before, after)]
    odds = prior(model, after.hypothesis) - prior(model, before.hypothesis)
    numbers = len(after.fit.values) - len(before.fit.values)
    cost = 0.5 * numbers * np.log(max(float(size.sum()), 2.0))
    return gain(squares[0], squares[1], blocks, odds - cost)


def prior(model: mujoco.MjModel, hypothesis: Hypothesis) -> float:
    """Logarithm of the prior odds of a set of effects."""
    return sum(EFFECT + find(e.effect).odds(model, e.target) for e in hypothesis.effects)


def _data(fit: Fit) -> Floats:
    """[W]: number of data of each window."""
    return np.asarray((fit.residual != 0).sum(axis=1), np.float64)


def _courses(judged: Judged) -> list[Floats]:
    """What is left of each signal in each window."""
    residual = judged.fit.residual
    course = residual.reshape(len(residual), judged.windows.length + 1, -1)
    return [course[w, :, c] for w in range(course.shape[0]) for c in range(course.shape[2])]
