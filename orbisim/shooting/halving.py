"""How much of what free runs miss is the timestep's."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from orbisim.shooting.bench import Bench
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.shooter import Variant
from orbisim.shooting.timestep import exact, is_exact, stepped, taken, typical_interval
from orbisim.shooting.windows import evenly

Floats = npt.NDArray[np.float64]


def halving(bench: Bench, hypothesis: Hypothesis | None = None) -> float:
    """By how many times the noise free runs of the scene differ from those with half its timestep:
    see `difference`."""
    return difference(bench, stepped(bench, taken(bench) / 2.0), hypothesis)


def matters(bench: Bench, ratio: float, hypothesis: Hypothesis | None = None) -> bool:
    """Whether the error of the step matters beside so much, over the noise (at least the noise).
    Where bodies touch, it has to go on as an error of a step does: what half of the step changes, a
    quarter changes in the same direction. What a rocking or sliding contact does is another motion
    with every step, and none of them is truer.

    Args:
      hypothesis: as of `halving`.
    """
    finer = stepped(bench, taken(bench) / 2.0)
    change = _change(bench, finer, hypothesis)
    if not _large(change, ratio):
        return False
    if not bench.contacts:
        return True
    further = _change(finer, stepped(finer, taken(finer) / 2.0), hypothesis)
    along = np.sum(change * further, axis=1) / np.maximum(np.sum(change**2, axis=1), 1e-300)
    return bool(np.median(along) > (0.0 if is_exact(bench) else _GOES_ON))


def _large(change: Floats, ratio: float) -> bool:
    """Whether what half of a step changes matters beside so much, over the noise; so does what is
    no number."""
    return not 2.0 * _size(change) <= MATTERS * max(ratio, 1.0)


_GOES_ON = 0.25
"""What a quarter of the step changes in the direction of what half of it does, over that, at least,
in a typical window: half of it in theory, of MuJoCo's integrators but RK4, of which it is little
(0.43 to 0.5 of boxes and balls in flight, -0.3 to 0.1 of pucks that rock while they slide)."""
MATTERS = 0.25
"""Error of a step, over what is left (at least the noise), that matters: three hundredths of that
are the step's then. While effects are missing, a coarser one does, and simulates faster. Whether
half of the step, or another form of friction, is tried at all is asked beside the noise alone."""


def exact_enough(bench: Bench) -> Bench | None:
    """In exact steps, as few as are; None if those that there are do, or none are (stiff)."""
    if is_exact(bench) or not matters(bench, 1.0):
        return None
    most = round(typical_interval(bench) / taken(bench))

    def is_enough(other: Bench) -> bool:
        return not _large(_change(other, stepped(other, taken(other) / 2.0), None), 1.0)

    return next(
        filter(is_enough, (exact(bench, 2**k) for k in range(int(np.log2(most)) + 1))), None
    )


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
    """By how many times the noise free runs differ from those of another form of the same data, and
    where bodies touch by how many times what noise and impacts leave unknown: root mean square over
    a typical window.

    Args:
      hypothesis: what acts beside the scene, as dry friction, which needs short steps where nothing
        else does; none if None.
    """
    return _size(_change(bench, other, hypothesis))


def _size(change: Floats) -> float:
    """Root mean square over a typical window: some are thrown off, whatever the step."""
    return float(np.median(np.sqrt(np.mean(change**2, axis=1))))


def _change(bench: Bench, other: Bench, hypothesis: Hypothesis | None) -> Floats:
    """[W, data] weighted, of some windows."""
    scene = (hypothesis or Hypothesis()).scene
    some = evenly(np.ones(len(bench.windows), bool), _MOST)

    def run(one: Bench) -> Floats:
        shooter, there = one.shooter(some), scene(one.scene)
        still = np.zeros((len(shooter), 2 * there.model.nv))
        return shooter.scaled(shooter.simulate(Variant(there), still))

    return run(other) - run(bench)


_MOST = 24
"""Windows that are simulated twice."""
