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
from collections.abc import Callable, Collection, Sequence

import numpy as np
import numpy.typing as npt
from scipy.optimize import lsq_linear

from orbisim.diagnosis.force_data import (
    ForceData,
    candidates,
    counts,
    force_data,
    normals,
    spread,
)
from orbisim.diagnosis.selection import BEGINNINGS, Group, Selected
from orbisim.diagnosis.settings import Settings
from orbisim.diagnosis.together import instances, left_of, select_in_rounds
from orbisim.diagnosis.worth import told_of
from orbisim.effects import EffectInstance, effect_names, find
from orbisim.effects.base import Extent
from orbisim.effects.screening import Candidate
from orbisim.errors import OrbiSimError
from orbisim.evidence import Blocks, Gain
from orbisim.host.deadline import NEVER, Deadline
from orbisim.motion.samples import Samples, extent
from orbisim.scene import Scene
from orbisim.shooting.fits import WEAK, Fit
from orbisim.shooting.hypothesis import Hypothesis, bounded_instance
from orbisim.shooting.regress import Normal

Floats = npt.NDArray[np.float64]
Progress = Callable[[str], None]
Suspicion = tuple[tuple[str, str] | None, tuple[str, str] | None, Gain]
"""An effect and its target, that in whose place it would stand if any, and what that is worth."""

_ITERATIONS = 3
"""Steps of a fit: forces are nearly linear in the parameters."""
_FITTED = 600
"""Rows of a fit, in which every parameter is moved at every step."""


@dataclasses.dataclass(frozen=True, eq=False)
class ForceAttribution:
    """What the search in force space found.

    Attributes:
      data: the missing forces. hypothesis: the effects, with fitted values.
      fit: of the hypothesis; one window for each stretch.
      ratio, ratio_after: missing force over its noise (root mean square over joints).
      gains: what each effect is worth beside the others.
      suspects: what could stand in an effect's place, or be added, with its gain; nearest first.
    """

    data: ForceData
    hypothesis: Hypothesis
    fit: Fit
    ratio: float
    ratio_after: float
    gains: tuple[Gain, ...] = ()
    suspects: tuple[Suspicion, ...] = ()

    @property
    def evidence(self) -> tuple[float, ...]:
        """For each effect twice the log predictive score that it brings."""
        return tuple(2 * one.total for one in self.gains)

    @property
    def samples(self) -> tuple[Samples, ...]:
        """The recordings that were fitted."""
        return self.data.samples


def attribute_forces(
    scene: Scene,
    samples: Sequence[Samples],
    settings: Settings,
    say: Progress = lambda _: None,
    deadline: Deadline = NEVER,
) -> ForceAttribution:
    """Searches for the effects whose forces a scene lacks, with what it has at the deadline.

    Raises:
      InputError: there are too few usable samples.
    """
    say("inverse dynamics along the recordings")
    data = force_data(scene, samples)
    ratio = _ratio(data, data.force)
    if ratio <= settings.enough:
        return _nothing(data, ratio, ())
    say("what effects would give along the recordings")
    offered = candidates(data, settings.effects)
    if not offered[0]:
        return _nothing(data, ratio, ())
    suspects: tuple[Suspicion, ...] = ()
    few, here = force_data(scene, samples, _FITTED), extent(samples)
    while offered[0]:
        chosen = _selected(data, *offered, say, deadline)
        suspects = tuple((_named(o.group), _named(o.instead_of), o.gain) for o in chosen.rivals)
        known = instances(scene, chosen)
        impossible: set[tuple[str, str]] = set()
        while known and not impossible:
            say("fitting the effects to the inverse dynamics")
            hypothesis = Hypothesis(tuple(one for one, _ in known))
            sigma = spread(few, few.left(hypothesis))
            hypothesis, fit = fit_forces(few, hypothesis, sigma, deadline)
            fitted = [(o, worth) for o, (_, worth) in zip(hypothesis.effects, known, strict=True)]
            impossible = {
                (one.effect, one.target)
                for one, _ in fitted
                if not _prior(scene, here, one) > -np.inf
            }
            there = [not _idle(hypothesis, fit, number, scene) for number in range(len(known))]
            if all(there) and not impossible:
                after = _ratio(data, data.left(hypothesis))
                gains = tuple(worth for _, worth in known)
                return ForceAttribution(data, hypothesis, fit, ratio, after, gains, suspects)
            known = [one for one, kept in zip(fitted, there, strict=True) if kept]
        if not impossible:
            break
        offered = _without(offered, impossible)  # others may stand in their places
    return _nothing(data, ratio, suspects)


def common_forces(
    scene: Scene, samples: Sequence[Samples], only: Collection[str] | None, most: int
) -> tuple[EffectInstance, ...]:
    """What every machine has (`Effect.common`), at all joints together, as far as it is possible:
    least squares of the missing forces, each joint weighted by what all of it leaves there.

    Args:
      only: names of the effects to consider; all if None. most: effects at most.

    Raises:
      InputError: there are too few usable samples.
    """
    names = [n for n in effect_names() if find(n).common and (only is None or n in only)]
    data = force_data(scene, samples)
    found, columns = candidates(data, names)
    if not found:
        return ()
    several = next((one.effect for one in found if len(one.columns) != 1), None)
    if several:
        raise TypeError(
            f"effect {several!r} is `common` and has several numbers along the motion; a common "
            "effect has one: set `common = False` in its class"
        )
    parameters = [find(one.effect).parameters(scene.model, one.target)[0] for one in found]
    least = np.array([max(one.low, one.possible[0]) for one in parameters])
    left = np.nan_to_num(data.force)
    for _ in range(_ITERATIONS):
        sigma = _size(left)
        flat = (columns / sigma[:, None]).reshape(-1, len(found))
        scale = np.maximum(np.linalg.norm(flat, axis=0), 1e-300)
        wanted = np.nan_to_num(data.force / sigma).ravel()
        x = lsq_linear(flat / scale, wanted, (least * scale, np.inf)).x / scale
        left = np.nan_to_num(data.force) - columns @ x
    order = np.argsort(-np.abs(x) * scale, kind="stable")[:most]
    made = [found[i].solve(x[i : i + 1]) for i in order]
    every = [
        bounded_instance(scene, EffectInstance(found[i].effect, found[i].target, dict(values)))
        for i, values in zip(order, made, strict=True)
        if values is not None
    ]
    return tuple(one for one in every if one is not None)


def _without(
    offered: tuple[list[Candidate], Floats], gone: Collection[tuple[str, str]]
) -> tuple[list[Candidate], Floats]:
    """Candidates and their columns but some effects at their targets."""
    kept = [(one.effect, one.target) not in gone for one in offered[0]]
    columns = np.repeat(kept, [len(one.columns) for one in offered[0]])
    return [one for one, k in zip(offered[0], kept, strict=True) if k], offered[1][:, :, columns]


def _idle(hypothesis: Hypothesis, fit: Fit, number: int, scene: Scene) -> bool:
    """Whether an effect's numbers cannot be told from those that change nothing (Wald's test), the
    data feel none of them, or one of them ran off."""
    free = hypothesis.free(scene)
    own = [k for k, (i, _) in enumerate(free) if i == number]
    unknowns = hypothesis.unknowns(scene)
    felt = _felt(np.sqrt(np.diag(fit.information.sum(axis=0))), fit.values)
    if not felt[own].any() or any(unknowns[k].ran_off(float(fit.values[k])) for k in own):
        return True
    return not told_of(scene, hypothesis, fit, number)


def _selected(
    data: ForceData,
    found: Sequence[Candidate],
    columns: Floats,
    say: Progress,
    deadline: Deadline,
) -> Selected:
    """Effects, selected with weights that follow from what they leave."""

    def blocks(left: Floats) -> tuple[list[Normal], Blocks]:
        say("selecting effects")
        sigma = spread(data, left)
        return normals(data, columns, sigma), counts(data, left, sigma, columns)

    def after(chosen: Selected) -> Floats:
        return left_of(chosen, columns, data.force)

    def settled(before: Floats, left: Floats) -> bool:
        return bool(np.all(np.abs(_size(left) / _size(before) - 1) < _SETTLED))

    left = _common(data, found, columns)
    return select_in_rounds(
        data.scene, data.samples, found, left, blocks, after, settled, deadline=deadline
    )


_SETTLED = 0.1
"""Relative change of what is left at a joint that weighs data alike."""


def _prior(scene: Scene, known: Extent, instance: EffectInstance) -> float:
    """Logarithm of the prior odds of an effect's values; minus infinity for what no machine has."""
    return find(instance.effect).log_prior(scene.model, instance, known)


def _common(data: ForceData, found: Sequence[Candidate], columns: Floats) -> Floats:
    """[N, nv]: what all common effects together leave. What is missing is no noise: weights and
    the share of independent data are to be those of what effects cannot explain."""
    rare = [find(one.effect).rarity < BEGINNINGS[0] for one in found for _ in one.columns]
    if all(rare):  # or none is offered
        return np.nan_to_num(data.force)
    flat = columns[:, :, ~np.array(rare)].reshape(-1, len(rare) - sum(rare))
    scale, force = np.maximum(np.linalg.norm(flat, axis=0), 1e-300), np.nan_to_num(data.force)
    x = np.linalg.lstsq(flat / scale, force.ravel(), rcond=_FLAT)[0]
    return np.asarray(force - (flat / scale @ x).reshape(force.shape))


_FLAT = 1e-4
"""Singular values, in units of the largest, that all columns together may do without."""


def _named(group: Group) -> tuple[str, str] | None:
    return (group.key[0], group.key[1]) if group.key else None


def _size(force: Floats) -> Floats:
    """[nv]: root mean square of each joint's missing force."""
    return np.maximum(np.sqrt(np.nanmean(force**2, axis=0)), 1e-12)


def _ratio(data: ForceData, force: Floats) -> float:
    """Missing force over its standard deviation, typical of rows and joints."""
    noise = np.maximum(np.nan_to_num(data.std, nan=np.inf), 1e-12)
    return float(np.sqrt(np.mean(np.nanmedian((force / noise) ** 2, axis=0)) / _MEDIAN))


_MEDIAN = 0.455
"""Median of the square of a standard normal variable."""


def _nothing(
    data: ForceData,
    ratio: float,
    suspects: tuple[Suspicion, ...],
) -> ForceAttribution:
    left = np.nan_to_num(data.force / spread(data, data.force))
    fit = _fit_of(data, left, np.zeros((*data.force.shape, 0)), np.zeros(0))
    return ForceAttribution(data, Hypothesis(), fit, ratio, ratio, (), suspects)


def fit_forces(
    data: ForceData, hypothesis: Hypothesis, sigma: Floats, deadline: Deadline = NEVER
) -> tuple[Hypothesis, Fit]:
    """Fits the effects' parameters to the inverse dynamics of the scene that has them.

    Gauss-Newton with differences; a step that does not help is halved. At the deadline it ends with
    what it has.
    """
    scene = data.scene
    unknowns = hypothesis.unknowns(scene)
    low, high = (np.array([getattr(u, end) for u in unknowns]) for end in ("low", "high"))
    here = _weighted(data, hypothesis, sigma)
    for _ in range(_ITERATIONS):
        slopes = _slopes(data, hypothesis, sigma, here)
        values, moved = hypothesis.values(scene), False
        step = _step(slopes, here, values)
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
        if not moved or deadline.passed:
            break
    slopes = _slopes(data, hypothesis, sigma, here)
    return hypothesis, _fit_of(data, here, slopes, hypothesis.values(scene))


def jacobian(found: ForceAttribution, hypothesis: Hypothesis) -> Floats:
    """[R, P]: by how much each number of a hypothesis lowers the missing force, weighted as another
    was fitted, at half as many rows."""
    few = force_data(found.data.scene, found.samples, _FITTED // 2)
    sigma = spread(few, few.left(found.hypothesis))
    slopes = _slopes(few, hypothesis, sigma, _weighted(few, hypothesis, sigma))
    return slopes.reshape(-1, slopes.shape[2])


def _weighted(data: ForceData, hypothesis: Hypothesis, sigma: Floats) -> Floats:
    return np.nan_to_num(data.left(hypothesis) / sigma)


def _slopes(data: ForceData, hypothesis: Hypothesis, sigma: Floats, here: Floats) -> Floats:
    """[N, nv, P]: by how much each parameter lowers the weighted missing force."""
    scene, values = data.scene, hypothesis.values(data.scene)
    out = np.zeros((*here.shape, len(values)))
    for p, unknown in enumerate(hypothesis.unknowns(scene)):
        step = unknown.step_from(float(values[p]))
        moved = values.copy()
        moved[p] += step
        out[:, :, p] = (here - _weighted(data, hypothesis.at(scene, moved), sigma)) / step
    return out


def _step(slopes: Floats, left: Floats, values: Floats) -> Floats:
    """[P]: of all parameters that the data feel."""
    flat = slopes.reshape(-1, slopes.shape[2])
    scale = np.linalg.norm(flat, axis=0)
    felt = _felt(scale, values)
    step = np.zeros(len(values))
    step[felt] = np.linalg.lstsq(flat[:, felt] / scale[felt], left.ravel(), rcond=1e-6)[0]
    step[felt] /= scale[felt]
    return step


def _felt(scale: Floats, values: Floats) -> npt.NDArray[np.bool_]:
    """[P]: whether parameters change the data, compared with the others.

    Args:
      scale: [P] size of the change by a unit of each.
    """
    change = scale * np.maximum(np.abs(values), 1e-3)
    return np.asarray(change > WEAK * change.max(initial=0.0))


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
        values, np.zeros((blocks, 0)), float(per.sum()), left.size, covariance,
        left.reshape(left.shape[0], -1), per, information, score, data.recordings,
    )  # fmt: skip
