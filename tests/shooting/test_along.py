"""Windows as far as a linear system along them says something."""

import dataclasses

import numpy as np
import numpy.typing as npt

import orbisim
from orbisim.motion.samples import prepare_all
from orbisim.shooting.along import cut_at_growth
from orbisim.shooting.bench import Bench, make_bench
from orbisim.testing import inject_effect

Floats = npt.NDArray[np.float64]


def along(bench: Bench, derivatives: Floats) -> Bench:
    """With these derivatives by states [N, 2 nv, 2 nv]."""
    return dataclasses.replace(bench, intervals=dataclasses.replace(bench.intervals, A=derivatives))


def test_screening_ends_where_a_start_grows_without_limit(arm: orbisim.Scene) -> None:
    runs = inject_effect(arm, [], duration=3.0, episodes=2, noise=1e-4, seed=4)
    bench = make_bench(arm, prepare_all(runs, arm), 0.5)
    assert cut_at_growth(bench).windows.reach().tolist() == bench.windows.reach().tolist()
    wild = bench.intervals.A.copy()
    middle = int(bench.windows.first[1]) + 10
    wild[middle] *= 1e4
    cut = cut_at_growth(
        dataclasses.replace(bench, intervals=dataclasses.replace(bench.intervals, A=wild))
    )
    assert cut.windows.reach()[1] == 10
    assert (np.delete(cut.windows.reach(), 1) == np.delete(bench.windows.reach(), 1)).all()


def test_windows_stay_where_none_would_be_left_to_fit(arm: orbisim.Scene) -> None:
    """Those that are only predicted are no data for a screening."""
    runs = inject_effect(arm, [], duration=3.0, episodes=2, noise=1e-4, seed=4)
    bench = make_bench(arm, prepare_all(runs, arm), 0.5)
    wild = bench.intervals.A.copy()
    for first in bench.windows.first[bench.fit]:
        wild[int(first)] *= 1e4
    cut = cut_at_growth(
        dataclasses.replace(bench, intervals=dataclasses.replace(bench.intervals, A=wild))
    )
    assert cut.fit.any() and len(cut.windows) == len(bench.windows)
