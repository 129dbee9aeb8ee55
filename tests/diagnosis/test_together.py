"""Several effects at once from free runs, and what a machine can have."""

import mujoco
import numpy as np
import pytest

import orbisim
from orbisim.diagnosis.together import propose
from orbisim.effects import EffectInstance, find
from orbisim.effects.base import Extent, reach
from orbisim.motion.samples import prepare_all
from orbisim.shooting.bench import make_bench
from orbisim.testing import inject_effect


def test_proposes_what_is_missing(arm: orbisim.Scene, several: tuple[EffectInstance, ...]) -> None:
    runs = inject_effect(arm, several, duration=5.0, episodes=3, noise=2e-4, seed=8)
    bench = make_bench(arm, prepare_all(runs, arm), 0.5)
    found = {(e.effect, e.target): e.values for e in propose(bench, bench.intervals, None, 6)}
    assert found["viscous_damping", "elbow"]["coefficient"] == pytest.approx(0.08, rel=0.2)
    assert found["torque_bias", "elbow"]["offset"] == pytest.approx(0.15, rel=0.2)
    # near standstill a regression cannot tell a constant friction from one that rises there
    dry = {key: v for key, v in found.items() if key[1] == "shoulder" and "friction" in key[0]}
    (values,) = dry.values()
    assert next(iter(values.values())) == pytest.approx(0.3, rel=0.2)


def test_proposes_nothing_for_a_right_scene(arm: orbisim.Scene) -> None:
    runs = inject_effect(arm, [], duration=5.0, episodes=3, noise=2e-4, seed=9)
    bench = make_bench(arm, prepare_all(runs, arm), 0.5)
    assert not propose(bench, bench.intervals, None, 6)


def sensible(
    model: mujoco.MjModel,
    instance: EffectInstance,
    duration: float = 100.0,
    travel: tuple[float, float] = (10.0, 10.0),
) -> bool:
    known = Extent(duration, np.array(travel), np.array([1.0, 1.0]))
    return find(instance.effect).log_prior(model, instance, known) > -np.inf


def test_what_a_machine_can_have(arm: orbisim.Scene) -> None:
    model = arm.model
    far = 1.1 * reach(model, "forearm")
    total = float(model.body_mass.sum())

    def payload(mass: float, place: float) -> EffectInstance:
        values = {"mass": mass, "com_x": place, "com_y": 0.0, "com_z": 0.0}
        return EffectInstance("payload", "forearm", values)

    assert sensible(model, payload(0.5 * total, far))
    assert not sensible(model, payload(0.5 * total, 2 * far))
    assert not sensible(model, payload(3 * total, 0.0))
    offset = {"offset": far, "x": far, "y": 0.0, "z": 0.0}
    assert not sensible(model, EffectInstance("com_offset", "forearm", offset))
    wave = {"amplitude": 1.0, "periods": 2.0, "phase": 0.0}
    cogging = EffectInstance("cogging", "elbow", wave)
    assert sensible(model, cogging, travel=(7.0, 7.0))
    assert not sensible(model, cogging, travel=(7.0, 3.0))
    slow = EffectInstance("periodic_disturbance", "elbow", {"frequency": 0.1})
    assert sensible(model, slow, duration=20.0)
    assert not sensible(model, slow, duration=10.0)
    for factor, possible in ((0.7, True), (1.02, True), (2.3, False), (0.4, False)):
        skew = EffectInstance("clock_skew", "recording", {"factor": factor})
        assert sensible(model, skew) == possible
