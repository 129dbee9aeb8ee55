"""How much an effect may differ between slow and fast motion, early and late and so on."""

from __future__ import annotations

import dataclasses

import orbisim
from orbisim.diagnosis.consistency import inconsistency
from orbisim.effects import EffectInstance
from orbisim.motion.samples import prepare_all
from orbisim.shooting.bench import Bench, make_bench
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.judge import Judge
from orbisim.shooting.retune import Tunable
from orbisim.testing import inject_effect


def two_machines(arm: orbisim.Scene, first: EffectInstance, second: EffectInstance) -> Bench:
    """Recordings of an arm with one effect, and, later, with another."""
    runs = []
    for seed, (truth, since) in enumerate([(first, 0.0), (second, 100.0)], start=1):
        made = inject_effect(arm, truth, duration=8.0, episodes=2, noise=1e-4, seed=seed)
        runs += [dataclasses.replace(run, time=run.time + since) for run in made]
    return make_bench(arm, prepare_all(runs, arm), 0.5)


def test_how_much_it_may_differ_is_a_setting(arm: orbisim.Scene) -> None:
    """Recordings of two machines, one after the other, of which the second has more friction."""
    guess = EffectInstance("coulomb_friction", "elbow", {"torque": 0.1})
    bench = two_machines(arm, guess.replace(torque=0.08), guess.replace(torque=0.12))
    judged = Judge(bench, bench.intervals).judge(Hypothesis((guess,)))
    assert judged is not None
    told = inconsistency(bench, judged, 0, tolerance=0.2)
    assert told is not None and "time" in told
    assert inconsistency(bench, judged, 0, tolerance=0.8) is None


def test_a_retuned_parameter_does_not_make_up_for_the_difference(arm: orbisim.Scene) -> None:
    """The declared gain, free in each half, would make up for the drift of the effect's."""
    guess = EffectInstance("torque_gain", "elbow", {"gain": 0.85})
    bench = two_machines(arm, guess.replace(gain=0.8), guess.replace(gain=0.9))
    both = dataclasses.replace(Hypothesis((guess,)), factors=((Tunable("gain", "elbow"), 1.0),))
    judged = Judge(bench, bench.intervals).judge(both)
    assert judged is not None
    told = inconsistency(bench, judged, 0)
    assert told is not None and "time" in told
