"""Noise that is told apart from the motion."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import orbisim
from orbisim.effects import EffectInstance
from orbisim.motion.samples import prepare_all
from orbisim.shooting.bench import make_bench
from orbisim.shooting.impacts import near_jump
from orbisim.shooting.noise import between_impacts
from orbisim.testing import inject_effect

SCENES = Path(__file__).parents[2] / "mjcf_assets"


def test_noise_is_told_apart_from_a_missing_force(arm: orbisim.Scene) -> None:
    """Friction that the scene lacks is of slow course, and no noise."""
    dry = EffectInstance("coulomb_friction", "elbow", {"torque": 0.1})
    runs = inject_effect(arm, [dry], duration=4.0, episodes=2, noise=1e-3, seed=6)
    found = make_bench(arm, prepare_all(runs, arm), 0.5).noise
    np.testing.assert_allclose(found[0], 1e-3, rtol=0.15)


def test_what_is_not_measured_has_no_noise(arm: orbisim.Scene) -> None:
    runs = inject_effect(arm, [], duration=2.0, episodes=1, noise=1e-3, seed=6, velocities=False)
    q, v = make_bench(arm, prepare_all(runs, arm), 0.5).noise
    assert q == pytest.approx(1e-3, rel=0.3) and np.isnan(v).all()


@pytest.mark.parametrize("name", ["toss", "gripper_push", "leg"])
def test_noise_is_known_where_bodies_touch(name: str) -> None:
    """Chained through impacts, what is left of a window's start would be metres."""
    scene = orbisim.load_scene(SCENES / name / "scene.xml")
    rate = 1 / (round(0.01 / scene.model.opt.timestep) * scene.model.opt.timestep)
    runs = inject_effect(scene, [], rate=rate, episodes=6, duration=2.0, noise=3e-4, seed=1)
    bench = make_bench(scene, prepare_all(runs, scene), 0.5)
    assert bench.contacts
    np.testing.assert_allclose(bench.noise[0], 3e-4, rtol=0.2)
    np.testing.assert_allclose(bench.noise[1], 3e-3, rtol=0.2)


def test_windows_between_impacts_hold_none() -> None:
    scene = orbisim.load_scene(SCENES / "bouncing_ball" / "scene.xml")
    samples = prepare_all(inject_effect(scene, [], episodes=2, noise=3e-4, seed=1), scene)
    bench = make_bench(scene, samples, 0.5)
    found = between_impacts(samples, bench.intervals, bench.windows)
    assert len(found) >= 4 and any(one.jumps.any() for one in samples)
    for first, number in zip(found.first, found.recording, strict=True):
        rows = bench.intervals.row[first : first + found.length]
        assert (np.diff(rows) == 1).all()
        assert not near_jump(samples[number])[rows].any()
    short = dataclasses.replace(samples[0], jumps=np.ones_like(samples[0].jumps))
    assert (
        between_impacts([short, *samples[1:]], bench.intervals, bench.windows).recording.min() == 1
    )
    never = [dataclasses.replace(one, jumps=np.ones_like(one.jumps)) for one in samples]
    assert between_impacts(never, bench.intervals, bench.windows) is bench.windows
