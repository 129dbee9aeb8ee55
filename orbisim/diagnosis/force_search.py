"""Effects from the residual in force space: inverse dynamic identification with selection.

Where forces at the joints are known and the motion is the answer of a controller to them, a free
run says little: a heavy arm drifts off within a fraction of a second. The generalized force that is
missing along the measured motion is linear in most effects. They are selected together (see
`orbisim.diagnosis.selection`), each joint weighted by what is left at it (weighted least squares as
in Gautier, "Dynamic identification of robots with power model", ICRA 1997), and then fitted to the
inverse dynamics of the scene that has them.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from orbisim.diagnosis.bench import Hypothesis
from orbisim.diagnosis.fits import Fit
from orbisim.diagnosis.force_data import ForceData, candidates, force_data, normals
from orbisim.diagnosis.regress import total
from orbisim.diagnosis.samples import Samples
from orbisim.diagnosis.screening import bounded_instance
from orbisim.diagnosis.selection import Group, Rule, Selected, groups_of, select, without
from orbisim.diagnosis.sensible import extent, sensible
from orbisim.diagnosis.settings import Settings
from orbisim.diagnosis.state import Rival
from orbisim.effects import EffectInstance
from orbisim.errors import OrbiSimError
from orbisim.scene import Scene

Floats = npt.NDArray[np.float64]
Progress = Callable[[str], None]

_ROUNDS = 3
_ITERATIONS = 3
_FITTED = 600
_EACH = 6


@dataclasses.dataclass(frozen=True, eq=False)
class ForceAttribution:
    """What the search in force space found.

    Attributes:
      data: the missing forces. hypothesis: the effects, with fitted values.
      fit: of the hypothesis; one window for each stretch.
      sigma: [nv] by which forces are weighted.
      ratio, ratio_after: missing force over its noise (root mean square over joints).
      left: share of the weighted residual's amplitude that remains on stretches that the
        coefficients were not fitted to.
      evidence: for each effect the drop in information criterion that it brings.
      rejected: effects that were not believed, with the reason.
    """

    data: ForceData
    hypothesis: Hypothesis
    fit: Fit
    sigma: Floats
    ratio: float
    ratio_after: float
    left: float
    evidence: tuple[float, ...]
    rejected: tuple[tuple[EffectInstance, str], ...]

    @property
    def rivals(self) -> tuple[Rival, ...]:
        """None: suspects are not simulated one by one."""
        return ()

    @property
    def samples(self) -> tuple[Samples, ...]:
        """The recordings that were fitted."""
        return self.data.samples


def attribute_forces(
    scene: Scene, samples: Sequence[Samples], settings: Settings, say: Progress = lambda _: None
) -> ForceAttribution:
    """Searches for the effects whose forces a scene lacks.

    Raises:
      InputError: there are too few usable samples.
    """
    say("inverse dynamics along the recordings")
    data = force_data(scene, samples)
    ratio = _ratio(data, data.force)
    sigma = _spread(data.force)
    if ratio <= settings.enough:
        return _nothing(data, sigma, ratio, ())
    say("what effects would give along the recordings")
    chosen, sigma = _selected(data, settings, say)
    instances = _instances(data, chosen)
    left = float(np.sqrt(chosen.predicted.sum() / max(chosen.before.sum(), 1e-300)))
    if not instances:
        return _nothing(data, sigma, ratio, ())
    if left > settings.most_left:
        doubt = f"{100 * left:.0f} % of the missing force's amplitude remains"
        return _nothing(data, sigma, ratio, tuple((one, doubt) for one in instances))
    say("fitting the effects to the inverse dynamics")
    few = force_data(scene, samples, _FITTED)
    hypothesis, fit = fit_forces(few, Hypothesis(instances), sigma)
    after = _ratio(data, data.left(hypothesis))
    evidence = tuple(
        _evidence(g, data, x) for g, x in zip(chosen.gains, chosen.groups, strict=True)
    )
    return ForceAttribution(data, hypothesis, fit, sigma, ratio, after, left, evidence, ())


def _selected(data: ForceData, settings: Settings, say: Progress) -> tuple[Selected, Floats]:
    """Effects, selected with weights that follow from what they leave."""
    found, columns = candidates(data, settings.effects)
    duration, travel = extent(data.samples)
    possible = functools.partial(sensible, data.scene.model, duration=duration, travel=travel)
    sigma = _spread(data.force)
    rule = Rule(gain=_GAIN, most=max(settings.most_effects, _FORCES))
    for number in range(_ROUNDS):
        say(f"selecting effects, round {number + 1}")
        blocks = normals(data, columns, sigma)
        groups = groups_of(found, total(blocks), possible)
        chosen = select(blocks, groups, rule)
        left = data.force.copy()
        for group, x in zip(chosen.groups, chosen.coefficients, strict=True):
            left -= columns[:, :, list(group.index)] @ x
        before, sigma = sigma, _spread(left)
        if np.all(np.abs(sigma / before - 1) < _SETTLED) or number == _ROUNDS - 1:
            break
    paying = without(chosen, lambda g, gain: _evidence(gain, data, g) > settings.margin, blocks)
    return paying.ordered(), before


_FORCES = 24
"""Effects at most: a six-joint arm may well lack two at each joint and a few on its links."""
_GAIN = 0.004
_SETTLED = 0.1


def _instances(data: ForceData, chosen: Selected) -> tuple[EffectInstance, ...]:
    found = []
    for group, x in zip(chosen.groups, chosen.coefficients, strict=True):
        one = group.instance(x)
        one = None if one is None else bounded_instance(data.scene, one)
        if one is not None:
            found.append(one)
    return tuple(found)


def _spread(force: Floats) -> Floats:
    """[nv]: root mean square of each joint's missing force."""
    return np.maximum(np.sqrt(np.nanmean(force**2, axis=0)), 1e-12)


def _ratio(data: ForceData, force: Floats) -> float:
    """Missing force over its standard deviation."""
    noise = np.sqrt(np.nanmean(data.std**2, axis=0))
    return float(np.sqrt(np.mean((_spread(force) / np.maximum(noise, 1e-12)) ** 2)))


def _evidence(gain: float, data: ForceData, group: Group) -> float:
    """Drop in information criterion; neighbouring samples are not independent."""
    independent = data.blocks * _EACH * data.force.shape[1]
    left = max(1.0 - gain, 1e-12)
    return float(-independent * np.log(left) - (len(group.index) + 1) * np.log(independent))


def _nothing(
    data: ForceData,
    sigma: Floats,
    ratio: float,
    rejected: tuple[tuple[EffectInstance, str], ...],
) -> ForceAttribution:
    fit = _fit_of(data, data.force / sigma, np.zeros((*data.force.shape, 0)), np.zeros(0))
    return ForceAttribution(data, Hypothesis(), fit, sigma, ratio, ratio, 1.0, (), rejected)


# -- the fit -----------------------------------------------------------------------------------


def fit_forces(data: ForceData, hypothesis: Hypothesis, sigma: Floats) -> tuple[Hypothesis, Fit]:
    """Fits the effects' parameters to the inverse dynamics of the scene that has them.

    Gauss-Newton with differences; a step that does not help is halved.
    """
    scene = data.scene
    unknowns = hypothesis.unknowns(scene)
    low, high = (np.array([getattr(u, end) for u in unknowns]) for end in ("low", "high"))
    here = _weighted(data, hypothesis, sigma)
    for _ in range(_ITERATIONS):
        slopes = _slopes(data, hypothesis, sigma, here)
        step = _step(slopes, here)
        values, moved = hypothesis.values(scene), False
        for share in (1.0, 0.5, 0.25):
            trial = hypothesis.at(scene, np.clip(values + share * step, low, high))
            try:
                there = _weighted(data, trial, sigma)
            except OrbiSimError:
                continue
            if (there**2).sum() < (here**2).sum():
                moved = (there**2).sum() < (1 - 1e-4) * (here**2).sum()
                hypothesis, here = trial, there
                break
        if not moved:
            break
    slopes = _slopes(data, hypothesis, sigma, here)
    return hypothesis, _fit_of(data, here, slopes, hypothesis.values(scene))


def _weighted(data: ForceData, hypothesis: Hypothesis, sigma: Floats) -> Floats:
    return np.nan_to_num(data.left(hypothesis) / sigma)


def _slopes(data: ForceData, hypothesis: Hypothesis, sigma: Floats, here: Floats) -> Floats:
    """[N, nv, P]: by how much each parameter lowers the weighted missing force."""
    scene, values = data.scene, hypothesis.values(data.scene)
    out = np.zeros((*here.shape, len(values)))
    for p, unknown in enumerate(hypothesis.unknowns(scene)):
        step = unknown.step if values[p] + unknown.step <= unknown.high else -unknown.step
        moved = values.copy()
        moved[p] += step
        out[:, :, p] = (here - _weighted(data, hypothesis.at(scene, moved), sigma)) / step
    return out


def _step(slopes: Floats, left: Floats) -> Floats:
    flat = slopes.reshape(-1, slopes.shape[2])
    scale = np.maximum(np.linalg.norm(flat, axis=0), 1e-300)
    return np.asarray(np.linalg.lstsq(flat / scale, left.ravel(), rcond=1e-6)[0] / scale)


def _fit_of(data: ForceData, left: Floats, slopes: Floats, values: Floats) -> Fit:
    """The fit with each stretch's share; stretches, not samples, count as independent."""
    p, blocks = len(values), data.blocks
    information, score = np.zeros((blocks, p, p)), np.zeros((blocks, p))
    per = np.zeros(blocks)
    for b in range(blocks):
        own = data.block == b
        rest = left[own].ravel()
        flat = slopes[own].reshape(len(rest), p)
        information[b], score[b], per[b] = flat.T @ flat, flat.T @ rest, float(rest @ rest)
    inverse = np.linalg.pinv(information.sum(axis=0), rcond=1e-12, hermitian=True)
    covariance = inverse @ (score.T @ score) @ inverse
    return Fit(
        values, np.zeros((blocks, 0)), float(per.sum()), 0.0, left.size, covariance,
        left.reshape(left.shape[0], -1), per, information, score,
    )  # fmt: skip
