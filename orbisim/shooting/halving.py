"""How much of what free runs miss is the timestep's."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from orbisim.shooting.bench import Bench
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.shooter import Variant
from orbisim.shooting.timestep import stepped, taken, typical_interval
from orbisim.shooting.windows import evenly

Floats = npt.NDArray[np.float64]


def halving(bench: Bench, hypothesis: Hypothesis | None = None) -> float:
    """By how many times the noise free runs of the scene differ from those with half its timestep:
    see `difference`."""
    return difference(bench, stepped(bench, taken(bench) / 2.0), hypothesis)


def matters(bench: Bench, ratio: float, hypothesis: Hypothesis | None = None) -> bool:
    """Whether the error of the step matters beside so much, over the noise (at least the noise).
    Where bodies touch, it has to be one that falls as the step does: what a sliding or rocking
    contact does depends on the step by definition, and no finer one is any truer.

    Args:
      hypothesis: as of `halving`.
    """
    if bench.rugged:
        return False
    here = halving(bench, hypothesis)
    if 2.0 * here <= MATTERS * max(ratio, 1.0):
        return False
    finer = stepped(bench, taken(bench) / 2.0) if bench.contacts else bench
    return finer is bench or halving(finer, hypothesis) <= _FALLS * here


_FALLS = 0.6
"""What half of a step changes, over what the step itself does, at most: half of it in theory, of
MuJoCo's integrators but RK4."""
MATTERS = 0.25
"""Error of a step, over what is left (at least the noise), that matters: three hundredths of that
are the step's then. While effects are missing, a coarser one does, and simulates faster."""


def coarsest(bench: Bench, most: float, hypothesis: Hypothesis | None = None) -> Bench:
    """With as few steps between samples as make free runs differ by `most` times the noise at most
    (`difference`); as it is where that saves less than half of them, or bodies touch: what a
    contact does depends on the step by definition."""
    interval, count = typical_interval(bench), 1
    while not bench.contacts and 2 * count <= round(interval / taken(bench)):
        other = stepped(bench, interval / count)
        if difference(bench, other, hypothesis) <= most:
            return other
        count *= 2
    return bench


def difference(bench: Bench, other: Bench, hypothesis: Hypothesis | None = None) -> float:
    """By how many times the noise free runs differ from those of another form of the same data:
    root mean square over a typical window, without impacts if most windows have none.

    Args:
      hypothesis: what acts beside the scene, as dry friction, which needs short steps where nothing
        else does; none if None.
    """
    scene = (hypothesis or Hypothesis()).scene
    some = evenly(np.ones(len(bench.windows), bool) if bench.rugged else bench.smooth, _MOST)

    def run(one: Bench) -> Floats:
        shooter, there = one.shooter(some).plain(), scene(one.scene)
        still = np.zeros((len(shooter), 2 * there.model.nv))
        return shooter.scaled(shooter.simulate(Variant(there), still))

    return float(np.median(np.sqrt(np.mean((run(other) - run(bench)) ** 2, axis=1))))


_MOST = 24
"""Windows that are simulated twice."""
