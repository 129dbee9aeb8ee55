"""How much of what free runs miss is the timestep's."""

from __future__ import annotations

import numpy as np

from orbisim.shooting.bench import Bench
from orbisim.shooting.shooter import Variant
from orbisim.shooting.windows import evenly


def halving(bench: Bench) -> float:
    """By how many times the noise free runs of the scene differ from those with half its timestep:
    root mean square over a typical window, without impacts if most windows have none."""
    every = np.ones(len(bench.windows), bool)
    shooter = bench.shooter(evenly(every if bench.rugged else bench.smooth, _MOST))
    still = np.zeros((len(shooter), 2 * shooter.nv))
    variant = Variant(bench.scene)
    runs = [one.scaled(one.simulate(variant, still)) for one in (shooter, shooter.halved())]
    return float(np.median(np.sqrt(np.mean((runs[1] - runs[0]) ** 2, axis=1))))


_MOST = 24
"""Windows that are simulated twice."""
