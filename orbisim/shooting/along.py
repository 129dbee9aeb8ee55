"""Windows seen from a scene's own free runs instead of from the measured motion.

With impacts, the smoothed measurement is no motion of any scene, and derivatives along it say
little. Along a simulation that starts where it fits best, they are those of the simulation error.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from orbisim.motion.linear import IntervalMap, linearize
from orbisim.motion.samples import Samples
from orbisim.shooting.bench import Bench
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.shooter import Shooter
from orbisim.shooting.windows import Windows, start_size

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


def along(
    bench: Bench, hypothesis: Hypothesis, windows: Windows, start: Floats
) -> tuple[Bench, Ints] | None:
    """Windows, each as a recording whose reference is a hypothesis' own free run from its start
    [W, 2 nv]; and the numbers that the intervals had. None if all runs diverge at once."""
    shooter = Shooter(
        bench.scene, bench.samples, bench.intervals, windows, bench.noise, bench.deadline
    )
    qpos, qvel = shooter.states(hypothesis.variant(bench.scene), start)
    reach = windows.reach()
    samples, rows, numbers = [], [], []
    for w in range(len(windows)):
        first = int(shooter.row[w])
        usable = np.isfinite(qpos[w]).all(axis=1) & np.isfinite(qvel[w]).all(axis=1)
        length = int(reach[w]) if usable.all() else max(int(np.argmin(usable)) - 1, 0)
        samples.append(
            _moved(
                bench.samples[windows.recording[w]],
                shooter,
                first,
                qpos[w, : length + 1],
                qvel[w, : length + 1],
            )
        )
        rows.append(np.arange(first, first + length))
        numbers.append(windows.first[w] + np.arange(length))
    kept = [w for w in range(len(windows)) if len(rows[w]) >= _SHORTEST]
    if not kept:
        return None
    longest = max(len(rows[w]) for w in kept)
    flow = IntervalMap(
        bench.scene,
        [samples[w] for w in kept],
        [rows[w] for w in kept],
        hypothesis.scene(bench.scene),
        hypothesis.measurement(bench.scene).clock,
        bench.deadline,
    )
    lengths = np.array([len(rows[w]) for w in kept])
    starts = np.concatenate([[0], np.cumsum(lengths)[:-1]])
    inside = lengths[:, None] if windows.horizon is None else windows.horizon[kept]
    horizon = np.broadcast_to(np.minimum(inside, lengths[:, None]), (len(kept), 2 * shooter.nv))
    scatter = None if windows.scatter is None else windows.scatter[kept, : longest + 1]
    cut = Windows(starts, longest, np.arange(len(kept)), horizon, scatter)
    everything = np.ones(len(cut), bool)
    local = dataclasses.replace(
        bench,
        samples=tuple(samples[w] for w in kept),
        rows=tuple(rows[w] for w in kept),
        intervals=linearize(flow),
        windows=cut,
        fit=everything,
        check=everything,
    )
    return local, np.concatenate([numbers[w] for w in kept])


_SHORTEST = 4
"""Intervals of a free run that can be screened."""


def cut_at_growth(bench: Bench) -> Bench:
    """The windows as far as the linear system along them says something.

    Where bodies touch, products of derivatives can grow without limit, and a few windows would
    drown all others; a window ends where a start's error has grown by a factor of 100. All windows
    stay as they are where none of those that are fitted would be left.
    """
    windows, intervals = bench.windows, bench.intervals
    step = float(np.median(np.concatenate([np.diff(one.time) for one in bench.samples])))
    size = start_size(bench.noise, step)
    product = np.broadcast_to(np.eye(len(size)), (len(windows), len(size), len(size)))
    reach, alive = np.zeros(len(windows), np.int64), np.ones(len(windows), bool)
    for k in range(windows.length):
        turn = intervals.A[np.minimum(windows.first + k, len(intervals.A) - 1)]
        product = np.where(alive[:, None, None], turn @ product, 0.0)
        grown = np.sqrt(((product * size / size[:, None]) ** 2).sum(axis=2))
        alive &= grown[:, : len(size) // 2].max(axis=1) < _GROWTH
        reach[alive] = k + 1
    keep = reach >= _SHORTEST
    if not keep[bench.fit].any():
        return bench
    inside = windows.length if windows.horizon is None else windows.horizon
    horizon = np.minimum(inside, reach[:, None])
    horizon = np.broadcast_to(horizon, (len(windows), len(size)))
    cut = dataclasses.replace(windows, horizon=horizon).some(keep)
    return dataclasses.replace(bench, windows=cut, fit=bench.fit[keep], check=bench.check[keep])


_GROWTH = 100.0
"""Growth of a start's error, in units of the noise, from which on products drown all else."""


def _moved(one: Samples, shooter: Shooter, first: int, qpos: Floats, qvel: Floats) -> Samples:
    """The recording with another reference in some of its rows."""
    rows = slice(first, first + len(qpos))
    new_q, new_v, new_a = one.qpos.copy(), one.qvel.copy(), one.qacc.copy()
    dq, dv = one.dq.copy(), one.dv.copy()
    dq[rows] -= shooter.difference(one.qpos[rows], qpos)
    dv[rows] -= qvel - one.qvel[rows]
    new_q[rows], new_v[rows] = qpos, qvel
    if len(qpos) > 2:
        new_a[rows] = np.gradient(qvel, one.time[rows], axis=0)
    return dataclasses.replace(one, qpos=new_q, qvel=new_v, qacc=new_a, dq=dq, dv=dv)
