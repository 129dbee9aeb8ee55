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
    known = Extent(duration, np.array(travel), np.array([1.0, 1.0]), np.zeros(2))
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
    for factor, possible in ((0.93, True), (1.02, True), (1.2, False), (0.4, False)):
        skew = EffectInstance("clock_skew", "recording", {"factor": factor})
        assert sensible(model, skew) == possible


def test_what_is_unusual(arm: orbisim.Scene) -> None:
    """Priors of values: how far from its peak, in logarithms, beside what a number costs."""
    known = Extent(10.0, np.array([2.0, 2.0]), np.array([1.0, 1.0]), np.array([0.5, 0.5]))

    def told(effect: str, target: str, **values: float) -> float:
        one = EffectInstance(effect, target, values)
        return find(effect).log_prior(arm.model, one, known)

    assert told("clock_skew", "recording", factor=1.001) == pytest.approx(-np.log(2))
    assert told("clock_skew", "recording", factor=1.09) < -8
    late, early = (told("sensor_delay", "elbow", delay=sign * 0.01) for sign in (1, -1))
    assert late == pytest.approx(-np.log(2)) and early == late - 4
    assert told("sensor_scale", "elbow", factor=1.0) == 0
    near, far = (
        told("joint_spring", "elbow", stiffness=1.0, rest_position=at) for at in (0.5, 80.5)
    )
    assert near == 0 and far == pytest.approx(-2 * np.log(40), abs=0.01)
    assert told("joint_spring", "elbow", stiffness=-1.0, rest_position=0.5) == -np.inf
