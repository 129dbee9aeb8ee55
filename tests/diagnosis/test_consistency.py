"""How much an effect may differ between slow and fast motion, early and late and so on."""

from __future__ import annotations

import dataclasses

import orbisim
from orbisim.diagnosis.bench import Hypothesis, make_bench
from orbisim.diagnosis.consistency import inconsistency
from orbisim.diagnosis.refine import Judge
from orbisim.diagnosis.samples import prepare_all
from orbisim.effects import EffectInstance
from orbisim.testing import inject_effect


def test_how_much_it_may_differ_is_a_setting(arm: orbisim.Scene) -> None:
    """Recordings of two machines, one after the other, of which the second has more friction."""
    runs = []
    for seed, torque in ((1, 0.08), (2, 0.12)):
        truth = EffectInstance("coulomb_friction", "elbow", {"torque": torque})
        runs += inject_effect(arm, truth, duration=8.0, episodes=2, noise=1e-4, seed=seed)
    late = [
        run if i < 2 else dataclasses.replace(run, time=run.time + 100.0)
        for i, run in enumerate(runs)
    ]
    bench = make_bench(arm, prepare_all(late, arm), 0.5)
    guess = EffectInstance("coulomb_friction", "elbow", {"torque": 0.1})
    judged = Judge(bench, bench.intervals).judge(Hypothesis((guess,)))
    assert judged is not None
    told = inconsistency(bench, judged, 0, tolerance=0.2)
    assert told is not None and "time" in told
    assert inconsistency(bench, judged, 0, tolerance=0.8) is None
