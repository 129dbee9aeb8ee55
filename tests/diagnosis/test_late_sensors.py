"""Windows of late sensors, starts that are moved together, and windows that count less."""

import pytest

import orbisim
from orbisim.effects import EffectInstance
from orbisim.motion.samples import prepare_all
from orbisim.shooting.bench import Bench, make_bench
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.judge import Judge
from orbisim.testing import inject_effect

LATE = EffectInstance("sensor_delay", "shoulder", {"delay": 0.08})


@pytest.fixture(scope="module")
def bench(arm: orbisim.Scene) -> Bench:
    """Recordings in which one joint is read late."""
    runs = inject_effect(arm, [LATE], duration=4.0, episodes=3, noise=2e-4, seed=3)
    return make_bench(arm, prepare_all(runs, arm), 0.5)


def test_a_late_sensor_is_predicted_to_within_the_noise(bench: Bench) -> None:
    judge = Judge(bench, bench.intervals)
    held = Hypothesis((LATE,), frozen=frozenset({(0, "delay")}))
    judged, declared = judge.judge(held), judge.judge(Hypothesis())
    assert judged is not None
    assert declared is not None
    assert judged.ratio < 1.1
    assert declared.ratio > 5
    found = judge.judge(Hypothesis((LATE.replace(delay=0.03),)))
    assert found is not None
    assert found.hypothesis.effects[0].values["delay"] == pytest.approx(0.08, rel=0.01)
