"""What an explanation that was fitted by simulation is worth more than another: the one number by
which a search adds, removes, exchanges, merges and retunes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from orbisim.effects import find
from orbisim.evidence import EFFECT, Blocks, Gain, gain, independent_share
from orbisim.motion.samples import extent
from orbisim.shooting.bench import Bench
from orbisim.shooting.fits import Fit
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.judge import Judged
from orbisim.shooting.retune import SPREAD

Floats = npt.NDArray[np.float64]


def worth(bench: Bench, before: Judged, after: Judged) -> Gain:
    """Of one explanation over another, by the windows of both."""
    return gains(bench, before, [after])[0]


def gains(bench: Bench, before: Judged, others: Sequence[Judged]) -> list[Gain]:
    """What each of some explanations is worth more than one, all by the same data.

    Windows that parameters were fitted to count, too; each fitted number of an effect costs half
    the logarithm of the number of independent data (Laplace's approximation of the evidence, with a
    prior worth one datum), and so does, in each window, the state of a joint that an effect adds.
    How many are independent, what the best of them leaves says.

    Args:
      bench: the data. before, others: judged on the same windows.
    """
    best = min([before, *others], key=lambda one: one.loss)
    share = independent_share(_courses(best))
    fits = [best.fit] if best.check_fit is best.fit else [best.fit, best.check_fit]
    size = np.concatenate([np.maximum(share * _data(fit), 1.0) for fit in fits])
    blocks = Blocks(size, np.zeros(len(size), np.int64), np.ones(len(size)))
    data = max(float(size.sum()), 2.0)
    starts = 0.5 * float(np.log(size).sum())  # of one number more in each window

    def odds(one: Judged) -> float:
        hidden = one.fit.start.shape[1] - 2 * bench.scene.model.nv
        return log_prior(bench, one, data) - hidden * starts

    known = _squares(before, len(size)), odds(before)
    return [
        gain(known[0], _squares(one, len(size)), blocks, odds(one) - known[1]) for one in others
    ]


def _squares(judged: Judged, count: int) -> Floats:
    """[B]: mean squared residual of each window."""
    return np.concatenate([judged.fitted, judged.checked])[:count]


def log_prior(bench: Bench, judged: Judged, data: float) -> float:
    """Logarithm of the prior odds of effects with such values, less what fitted numbers cost.

    Args:
      data: how many data are independent.
    """
    hypothesis = judged.hypothesis
    numbers = len(hypothesis.free(bench.scene)) + len(hypothesis.frozen)
    effects = prior(bench, hypothesis) - 0.5 * numbers * float(np.log(data))
    return effects - float(retuning_costs(bench, judged, data).sum())


def retuning_costs(bench: Bench, judged: Judged, data: float) -> Floats:
    """[F]: by how much each retuned declared parameter lowers the log evidence: the prior at its
    factor, times the width of what the data leave of it (Laplace), which costs no more than any
    other number."""
    hypothesis = judged.hypothesis
    if not hypothesis.factors:
        return np.zeros(0)
    first = len(hypothesis.free(bench.scene))
    factors = np.array([factor for _, factor in hypothesis.factors])
    deviation = np.sqrt(np.maximum(np.diag(judged.fit.covariance)[first:], 1e-300))
    width = np.clip(np.log(SPREAD / deviation), 0.0, 0.5 * np.log(data))
    return np.asarray(width + ((factors - 1) / SPREAD) ** 2 / 2)


def prior(bench: Bench, hypothesis: Hypothesis) -> float:
    """Logarithm of the prior odds of a set of effects with their values."""
    model, known, found = bench.scene.model, extent(bench.samples), 0.0
    for one in hypothesis.effects:
        effect = find(one.effect)
        found += EFFECT + effect.odds(model, one.target) + effect.log_prior(model, one, known)
    return found


def _data(fit: Fit) -> Floats:
    """[W]: number of data of each window."""
    return np.asarray((fit.residual != 0).sum(axis=1), np.float64)


def _courses(judged: Judged) -> list[Floats]:
    """What is left of each signal in each window."""
    residual = judged.fit.residual
    course = residual.reshape(len(residual), judged.windows.length + 1, -1)
    return [course[w, :, c] for w in range(course.shape[0]) for c in range(course.shape[2])]
