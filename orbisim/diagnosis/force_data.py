"""The missing generalized force along recordings, as a regression on what effects would give."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from orbisim.effects import effect_names, find
from orbisim.effects.screening import Candidate
from orbisim.errors import InputError
from orbisim.evidence import Blocks, independent_by_chance, independent_share
from orbisim.motion.force import force_residual
from orbisim.motion.linear import IntervalMap
from orbisim.motion.regressors import MotionView
from orbisim.motion.samples import Samples
from orbisim.scene import Scene
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.regress import Normal, normal_of

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

_MOST_ROWS = 2500
"""Rows that are looked at, spread evenly: neighbours say the same, and each has all columns."""
_BLOCKS = 24
"""Stretches of all recordings: enough for a standard error, each long beside what is correlated."""
_SHORTEST = 24
"""Rows of a stretch at least."""


@dataclasses.dataclass(frozen=True, eq=False)
class ForceData:
    """Missing forces at some rows of recordings.

    Attributes:
      scene: as declared. samples: the recordings. every: one of so many usable rows is taken.
      force: [N, nv] missing generalized force. std: [N, nv] by measurement noise. total: [N, nv]
        what the motion needs.
      block: [N] number of the stretch that a row lies in.
    """

    scene: Scene
    samples: tuple[Samples, ...]
    every: int
    force: Floats
    std: Floats
    total: Floats
    block: Ints

    @property
    def blocks(self) -> int:
        """Number of stretches."""
        return int(self.block.max()) + 1

    @property
    def recordings(self) -> Ints:
        """[stretches]: the number of the recording that each lies in."""
        rows = [len(_taken(one, self.every)) for one in self.samples]
        return np.repeat(np.arange(len(rows)), rows)[np.unique(self.block, return_index=True)[1]]

    def left(self, hypothesis: Hypothesis) -> Floats:
        """[N, nv]: the force that is still missing with a hypothesis, by inverse dynamics."""
        scene = hypothesis.scene(self.scene)
        parts = force_residual(self.samples, scene, self.every)
        pairs = zip(parts, self.samples, strict=True)
        return np.concatenate([part.force[_taken(one, self.every)] for part, one in pairs])


def force_data(scene: Scene, samples: Sequence[Samples], most: int = _MOST_ROWS) -> ForceData:
    """The missing forces along recordings, at so many samples at most.

    Raises:
      InputError: there are too few usable samples.
    """
    usable = sum(int(s.usable.sum()) for s in samples)
    every = max(1, -(-usable // most))
    rows = [_taken(s, every) for s in samples]
    if sum(map(len, rows)) < 2 * _SHORTEST:
        raise InputError(
            f"the motion is known at {usable} samples, too few for the residual in force space "
            f"(at least {2 * _SHORTEST}); record more"
        )
    parts = force_residual(samples, scene, every)
    force, std, needed = (
        np.concatenate([getattr(p, name)[r] for p, r in zip(parts, rows, strict=True)])
        for name in ("force", "std", "total")
    )
    return ForceData(scene, tuple(samples), every, force, std, needed, _blocks(rows))


def _taken(one: Samples, every: int) -> Ints:
    """Rows that are looked at."""
    return np.flatnonzero(one.usable)[::every]


def _followed(one: Samples) -> npt.NDArray[np.bool_]:
    """[T]: whether the next row is usable, too."""
    return np.append(one.usable[1:], False)


def _blocks(rows: Sequence[Ints]) -> Ints:
    """Stretches of about the same length, none across two recordings."""
    total, number, found = sum(map(len, rows)), 0, []
    for own in rows:
        pieces = max(1, min(round(_BLOCKS * len(own) / total), len(own) // _SHORTEST))
        for part in np.array_split(own, pieces):
            found.append(np.full(len(part), number))
            number += 1
    return np.concatenate(found)


def candidates(data: ForceData, only: Sequence[str] | None) -> tuple[list[Candidate], Floats]:
    """What effects would add to the generalized force, and its columns [N, nv, C].

    Effects of the measurement and what an actuator makes of its command are left out: the force at
    the joint is taken as recorded, with an offset at most.
    """
    rows = [_taken(s, data.every) for s in data.samples]
    inside = [_followed(s)[r] for r, s in zip(rows, data.samples, strict=True)]
    inner = [r[i] for r, i in zip(rows, inside, strict=True)]
    flow = IntervalMap(data.scene, data.samples, inner)
    ends = np.concatenate(inside)
    view = MotionView(flow, data.samples, data.force[ends])
    found = [
        candidate
        for name in effect_names()
        if (only is None or name in only) and find(name).adds_force()
        for target in find(name).targets(data.scene.model)
        for candidate in find(name).screen(view, target)
        if find(name).adds_force_with(candidate.options)
        and not candidate.fixed
        and all(column.kind == "force" for column in candidate.columns)
    ]
    columns = np.zeros((len(data.force), data.scene.model.nv, sum(len(c.columns) for c in found)))
    flat = [column.values[: len(flow)] for candidate in found for column in candidate.columns]
    for c, values in enumerate(flat):
        columns[ends, :, c] = np.nan_to_num(values)
    return found, columns


def spread(data: ForceData, force: Floats) -> Floats:
    """[N, nv]: standard deviation of a missing force: what is typical of its joint, and what the
    motion's noise adds where it is not known well."""
    known = _known(data)
    typical = _TO_SIGMA * np.nanmedian(np.abs(force - np.nanmedian(force, axis=0)), axis=0)
    usual = np.maximum(np.maximum(typical, known), 1e-12)
    return np.asarray(np.sqrt(usual**2 + np.maximum(np.nan_to_num(data.std) ** 2 - known**2, 0.0)))


def _known(data: ForceData) -> Floats:
    """[nv]: how well forces are known where they are known well."""
    flattened = _FLATTENED * np.sqrt(np.nanmean(data.total**2, axis=0))
    return np.asarray(np.hypot(np.nanmedian(data.std, axis=0), flattened))


_MISSING = 0.25
"""Share of what the columns say that may be effects which are missing: all are selected at once,
where a search by free runs adds one to what it has."""
_FLATTENED = 0.01
"""Share of the force that a motion needs which smoothing of its acceleration may take away."""
_TO_SIGMA = 1.4826
"""Standard deviation over the median absolute value of a normal distribution."""


def normals(data: ForceData, columns: Floats, sigma: Floats) -> list[Normal]:
    """Normal equations of each joint in each stretch, those of a stretch together.

    Args:
      columns: [N, nv, C]. sigma: [N, nv] by which forces are divided.
    """
    found = []
    for number, dof in itertools.product(range(data.blocks), range(sigma.shape[1])):
        own = data.block == number
        design = columns[own, dof] / sigma[own, dof][:, None]
        target = np.nan_to_num(data.force[own, dof]) / sigma[own, dof]
        found.append(normal_of(design, target, len(target)))
    return found


def counts(data: ForceData, left: Floats, sigma: Floats, columns: Floats | None = None) -> Blocks:
    """How the data of each joint in each stretch count.

    Args:
      left: [N, nv] what is left, whose autocorrelation says how many data are independent.
      columns: [N, nv, C] what effects would give, which says the same.
    """
    nv = sigma.shape[1]
    rows = np.bincount(data.block, minlength=data.blocks)
    floor = _known(data) / np.nanmedian(sigma, axis=0)
    share = np.array(
        [
            independent_share([left[data.block == b, dof] for b in range(data.blocks)])
            for dof in range(nv)
        ]
    )
    size = np.maximum(rows[:, None] * share, 1.0)
    power = np.ones(nv)
    for dof, design in enumerate(() if columns is None else np.moveaxis(columns, 1, 0)):
        weighted = np.nan_to_num(design / sigma[:, dof, None])
        rest = np.nan_to_num(left[:, dof] / sigma[:, dof])
        most = independent_by_chance(weighted[None], rest[None], np.ones(1), missing=_MISSING)
        power[dof] = min(1.0, most / float(size[:, dof].sum()))
    signal = np.tile(np.arange(nv), data.blocks)
    return Blocks(size.ravel(), signal, np.tile(floor, data.blocks), np.tile(power, data.blocks))
