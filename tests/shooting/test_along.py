"""Windows as far as a linear system along them says something."""

import dataclasses

import numpy as np

import orbisim
from orbisim.motion.samples import prepare_all
from orbisim.shooting.along import tame
from orbisim.shooting.bench import make_bench
from orbisim.testing import inject_effect


def test_screening_ends_where_a_start_grows_without_limit(arm: orbisim.Scene) -> None:
    runs = inject_effect(arm, [], duration=3.0, episodes=2, noise=1e-4, seed=4)
    bench = make_bench(arm, prepare_all(runs, arm), 0.5)
    assert tame(bench).windows.reach().tolist() == bench.windows.reach().tolist()
    wild = bench.intervals.A.copy()
    middle = int(bench.windows.first[1]) + 10
    wild[middle] *= 1e4
    cut = tame(dataclasses.replace(bench, intervals=dataclasses.replace(bench.intervals, A=wild)))
    assert cut.windows.reach()[1] == 10
    assert (np.delete(cut.windows.reach(), 1) == np.delete(bench.windows.reach(), 1)).all()
