"""What an explanation that was fitted by simulation is worth more than another: the one number by
which a search adds, removes, exchanges, merges and retunes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence

import numpy as np
import numpy.typing as npt

from orbisim.effects import find
from orbisim.evidence import EFFECT, Blocks, Gain, counted, gain, independent_share, like_parts
from orbisim.motion.samples import extent
from orbisim.scene import Scene
from orbisim.shooting.bench import Bench
from orbisim.shooting.confidence import confidence, told
from orbisim.shooting.fits import Fit, data_in
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.judge import Judged
from orbisim.shooting.retune import SPREAD

Floats = npt.NDArray[np.float64]


def worth(bench: Bench, before: Judged, after: Judged) -> Gain:
    """Of one explanation over another, by the windows of both."""
    return gains(bench, before, [after])[0]


def gains(bench: Bench, before: Judged, others: Sequence[Judged]) -> list[Gain]:
    """What each of some explanations is worth more than one, all by the same data.

    Windows that parameters were fitted to count, too; what each fitted number costs, `log_prior`
    says. In each window, the state of a joint that an effect adds costs half the logarithm of its
    data. How many are independent, what the best of them leaves says (`blocks_of`).

    Args:
      bench: the data. before, others: judged on the same windows.
    """
    best = min([before, *others], key=lambda one: one.loss)
    blocks = blocks_of(best, 2 * bench.scene.model.nv if bench.contacts else np.inf)
    size, data = blocks.size, blocks.count
    least = np.maximum(blocks.power * size, 1.0)
    starts = 0.5 * float(np.log(least).sum())  # of one number more in each window

    def odds(one: Judged) -> float:
        hidden = one.fit.start.shape[1] - 2 * bench.scene.model.nv
        return log_prior(bench, one, data) - hidden * starts

    known, there = _squares(before, len(size)), odds(before)
    found = []
    for one in others:
        other = odds(one)
        more = 0.0 if other == there else other - there  # both may be impossible: -inf
        found.append(gain(known, _squares(one, len(size)), blocks, more))
    return found


def blocks_of(judged: Judged, beyond: float = np.inf) -> Blocks:
    """How the data of all windows count, by what an explanation leaves of them.

    Args:
      beyond: as of `Blocks`.
    """
    share = independent_share(judged.fit.courses(judged.windows.length))
    own, every = data_in([judged.fit]), _all_data(judged)
    most = judged.independent * every.sum() / max(own.sum(), 1.0)
    return counted(every, share, most, beyond)


def _all_data(judged: Judged) -> Floats:
    """[B]: number of data of each window that was fitted or checked."""
    same = judged.check_fit is judged.fit
    return data_in([judged.fit] if same else [judged.fit, judged.check_fit])


def _squares(judged: Judged, count: int) -> Floats:
    """[B]: mean squared residual of each window."""
    return np.concatenate([judged.fitted, judged.checked])[:count]


def log_prior(bench: Bench, judged: Judged, data: float) -> float:
    """Logarithm of the prior odds of effects with such values, less what fitted numbers cost.

    Laplace's approximation of the evidence is the likelihood at the fitted numbers, times their
    prior density there, times the volume that the data leave of them. The density is that of its
    peak (in `number_costs` and `retuning_cost`, with the volume) and how far below the peak the
    fitted numbers are (in `prior`).

    Args:
      data: how many data are independent.
    """
    effects = prior(bench, judged.hypothesis) - float(number_costs(bench, judged, data).sum())
    return effects - retuning_cost(bench, judged, data)


def number_costs(bench: Bench, judged: Judged, data: float) -> Floats:
    """[P]: by how much each number of an effect lowers the log evidence at its prior's peak: half
    the logarithm of the number of data with a prior worth one datum; with one that is stated
    (`Parameter.usual`), width of the prior over what the data leave of it, which costs no more.
    What the data do not determine (`Hypothesis.frozen`) is as wide as its prior: it costs nothing.
    """
    hypothesis, model = judged.hypothesis, bench.scene.model
    most = 0.5 * float(np.log(data))
    found = np.full(len(hypothesis.free(bench.scene)), most)
    for k, (i, name) in enumerate(hypothesis.free(bench.scene)):
        one = hypothesis.effects[i]
        known = {p.name: p.usual for p in find(one.effect).parameters(model, one.target)}
        deviation = float(np.sqrt(max(judged.fit.covariance[k, k], 1e-300)))
        if known.get(name):
            width = known[name] * np.sqrt(np.pi / 2) / deviation  # 1 / (peak sqrt(2 pi) deviation)
            found[k] = np.clip(np.log(width), 0.0, most)
    return found


def retuning_cost(bench: Bench, judged: Judged, data: float) -> float:
    """By how much all retuned declared parameters together lower the log evidence: as
    `retuning_costs`, with the volume that the data leave of all of them. Masses, dampings and gains
    that grow alike move nothing: each alone is hardly known then, and their ratios are."""
    hypothesis = judged.hypothesis
    if not hypothesis.factors:
        return 0.0
    first = len(hypothesis.free(bench.scene))
    left = np.linalg.eigvalsh(np.nan_to_num(judged.fit.covariance[first:, first:]))
    width = 0.5 * np.log(SPREAD**2 / np.maximum(left, 1e-300))
    away = np.array([factor - 1 for _, factor in hypothesis.factors]) / SPREAD
    return float(np.clip(width, 0.0, 0.5 * np.log(data)).sum() + (away**2).sum() / 2)


def retuning_costs(bench: Bench, judged: Judged, data: float) -> Floats:
    """[F]: by how much each retuned declared parameter lowers the log evidence: the prior at its
    factor, times the width of what the data leave of it (Laplace), which costs no more than any
    other number."""
    hypothesis = judged.hypothesis
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
        found += effect.odds(model, one.target) + effect.log_prior(model, one, known)
    for name, count in Counter(one.effect for one in hypothesis.effects).items():
        found += like_parts(count, find(name).like_parts(model))
    return found + EFFECT * unrefined([(one.effect, one.target) for one in hypothesis.effects])


def unrefined(places: Collection[tuple[str, str]]) -> int:
    """How many of some effects, with targets, refine one that is not among them."""
    known = [(find(effect).refines, target) for effect, target in places]
    return len({place for place in known if place[0] and place not in places})


def told_of(
    scene: Scene, hypothesis: Hypothesis, fit: Fit, number: int, independent: float = np.inf
) -> bool:
    """Whether what there is of an effect can be told from nothing; so it is of what has no number
    that a derivative says anything of.

    Args:
      number: of the effect. independent: how many of the data count as independent.
    """
    own, neutral = hypothesis.sizes(scene, number)
    if not own:
        return True
    intervals = confidence(fit, [str(k) for k in range(len(fit.values))], 0, independent)
    return told(fit, own, neutral, [intervals[str(k)] for k in own])


def vague(scene: Scene, judged: Judged) -> list[int]:
    """Numbers of the effects that cannot be told from nothing, the last first."""
    hypothesis, independent = judged.hypothesis, independent_data(judged)
    return [
        number
        for number in reversed(range(len(hypothesis.effects)))
        if not told_of(scene, hypothesis, judged.fit, number, independent)
    ]


def apart(scene: Scene, hypothesis: Hypothesis, fit: Fit, number: int) -> float:
    """How far an effect is from nothing, in linear approximation: the mean square of its numbers in
    standard deviations (Wald's statistic). Infinite for what no derivative says anything of."""
    own, neutral = hypothesis.sizes(scene, number)
    if not own:
        return np.inf
    away = fit.values[own] - np.array(neutral)
    covariance = np.nan_to_num(fit.covariance[np.ix_(own, own)])
    inverse = np.linalg.pinv(covariance, rcond=1e-12, hermitian=True)
    return float(away @ inverse @ away) / len(own)


def independent_data(judged: Judged) -> float:
    """How many of the data that an explanation was fitted to count as independent."""
    blocks = blocks_of(judged)
    return blocks.count * data_in([judged.fit]).sum() / max(_all_data(judged).sum(), 1.0)
