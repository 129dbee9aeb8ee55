"""How long windows of free runs have to be.

What a missing force does to a position grows with the square of the time, what a sensor does to it
does not grow. In a window in which the declared scene is off by little more than the noise, what
sensors do besides (a barometer's filter, a camera's calibration) is as large as a force's effect,
and would be named as one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from orbisim.errors import InputError
from orbisim.motion.samples import prepare_all
from orbisim.recording import Recording
from orbisim.recording.split import bounded, some_of
from orbisim.recording.thinning import thinned, usual_window
from orbisim.scene import Scene
from orbisim.shooting.bench import Bench, Noise, make_bench
from orbisim.shooting.cutting import windows_enough
from orbisim.shooting.regress import normal_equations
from orbisim.shooting.stepping import within_samples

Floats = npt.NDArray[np.float64]


def telling_window(scene: Scene, recordings: Sequence[Recording]) -> float:
    """Duration of windows, s: the usual one, doubled as long as what the declared scene leaves is
    less than `_OUTWEIGHS` times the noise (root mean square of all windows), and grows in most as
    only a force makes it grow."""
    window = usual_window(recordings)
    longest = max((float(one.time[-1] - one.time[0]) for one in recordings), default=0.0)
    if 2 * window > longest / _PARTS:
        return window
    recordings = some_of(recordings, window, windows_enough(scene, recordings, window), [])
    scene = within_samples(scene, recordings, [])  # else thinning lengthens steps, which bend runs
    bench = _bench(scene, recordings, window, None)
    if bench is None or bench.contacts:
        return window
    left, noise = _left(bench), bench.noise
    while np.sqrt(left.mean()) < _OUTWEIGHS and 2 * window <= longest / _PARTS:
        longer = _bench(scene, recordings, 2 * window, noise)
        if longer is None or not np.median(_left(longer)) > _GROWS**2 * np.median(left):
            break
        window, left = 2 * window, _left(longer)
    return window


_OUTWEIGHS = 10.0
"""Residual over noise at which forces outweigh what sensors do besides the noise."""
_GROWS = 2.0
"""Growth of what is left as a window doubles: that of a force is 4, less where it changes its sign;
that of a wrong start or clock 2 at most."""
_PARTS = 2
"""Windows that the longest recording has at least."""


def _bench(
    scene: Scene, recordings: Sequence[Recording], window: float, noise: Noise | None
) -> Bench | None:
    some = bounded(thinned(recordings, window, []), [])
    try:
        return make_bench(scene, prepare_all(some, scene), window, noise=noise)
    except InputError:  # no stretch without a gap is so long
        return None


def _left(bench: Bench) -> Floats:
    """[W]: mean squares of what the declared scene leaves, over the noise, starts fitted."""
    normals = normal_equations(bench.samples, bench.intervals, bench.windows, (), bench.noise)
    return np.array([one.square / max(one.count, 1) for one in normals])
