"""How much of what free runs miss is the timestep's."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from orbisim.shooting.bench import Bench
from orbisim.shooting.shooter import Variant
from orbisim.shooting.timestep import stepped, taken
from orbisim.shooting.windows import evenly

Floats = npt.NDArray[np.float64]


def halving(bench: Bench) -> float:
    """By how many times the noise free runs of the scene differ from those with half its timestep:
    see `difference`."""
    return difference(bench, stepped(bench, taken(bench) / 2.0))


def difference(bench: Bench, other: Bench) -> float:
    """By how many times the noise free runs differ from those of another form of the same data:
    root mean square over a typical window, without impacts if most windows have none."""
    some = evenly(np.ones(len(bench.windows), bool) if bench.rugged else bench.smooth, _MOST)

    def run(one: Bench) -> Floats:
        shooter = one.shooter(some)
        still = np.zeros((len(shooter), 2 * shooter.nv))
        return shooter.scaled(shooter.simulate(Variant(one.scene), still))

    return float(np.median(np.sqrt(np.mean((run(other) - run(bench)) ** 2, axis=1))))


_MOST = 24
"""Windows that are simulated twice."""
