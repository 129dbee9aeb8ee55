"""Joints that stand at one moment and move at another with all that is recorded the same."""

from __future__ import annotations

import mujoco
import numpy as np

from orbisim import Recording, Scene, load_scene, make_backend
from orbisim.effects import EffectInstance, add_effects
from orbisim.motion.samples import prepare_all
from orbisim.shooting.bench import Bench, make_bench
from orbisim.shooting.history import HistoryDependent, history_dependent

RATE, NOISE = 100, 3e-4
LEAF = """
<mujoco><option timestep="0.002"/><worldbody>
  <body name="door"><joint name="leaf" axis="0 0 1" damping="0.3" limited="true" range="0 1.4"
    solimpfriction="0.999 0.9999 0.001"/>
    <geom type="box" size="0.2 0.02 0.2" pos="0.2 0 0" mass="2" contype="0" conaffinity="0"/>
  </body>{lever}
</worldbody></mujoco>
"""
LEVER = """
  <body pos="1 0 0"><joint name="lever" type="slide" axis="0 0 1" damping="5" stiffness="50"/>
    <geom type="sphere" size="0.05" mass="0.5" contype="0" conaffinity="0"/></body>
"""
LOCK = EffectInstance(
    "latch",
    "leaf",
    {"force": 50.0, "position": 0.0, "width": 0.02, "threshold": 0.05},
    {"other": "lever", "side": "above"},
)


def pulls(strong: float, weak: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Forces [T] at leaf and lever: again and again a strong pull alone, then a weak one with the
    lever up, then back; each a little different."""
    rng, leaf, lever = np.random.default_rng(seed), [], []
    for _ in range(3):
        for force, up, seconds in (
            (0.0, 0.0, 0.3),
            (strong, 0.0, 0.6),
            (0.0, 0.0, 0.3),
            (0.0, 20.0, 0.3),
            (weak, 20.0, 0.5),
            (-strong, 0.0, 1.5),
        ):
            count = round(seconds * RATE)
            leaf += [force * rng.uniform(0.9, 1.1)] * count
            lever += [up] * count
    return np.array(leaf), np.array(lever)


def record(true: Scene, strong: float, weak: float) -> list[Recording]:
    """The leaf's position and force; the lever is not recorded."""
    spec, found = true.spec, []
    for name in [true.model.joint(number).name for number in range(true.model.njnt)]:
        spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    driven = Scene.from_spec(spec, source="door")
    for seed in (1, 2):
        leaf, lever = pulls(strong, weak, seed)
        both = np.stack([leaf, lever], axis=1)[:, : driven.model.nu]
        engine = make_backend("mujoco", driven)
        start = engine.reset(1)
        run = engine.rollout(start, both[None], nstep=round(1 / RATE / 0.002))
        q = np.concatenate([start.qpos[:, 0], np.asarray(run.qpos)[0, :-1, 0]])
        noise = NOISE * np.random.default_rng([seed, 1]).standard_normal(len(q))
        signals = {"qpos/leaf": q + noise, "torque/leaf": leaf}
        found.append(Recording(np.arange(len(q)) / RATE, signals, source=f"door-{seed}"))
    return found


def bench(true: Scene, strong: float = 2.0, weak: float = 0.6) -> Bench:
    declared = load_scene(LEAF.format(lever=""))
    samples = prepare_all(record(true, strong, weak), declared)
    return make_bench(declared, samples, 0.5)


def test_a_lock_whose_release_is_not_recorded() -> None:
    locked = add_effects(load_scene(LEAF.format(lever=LEVER)), [LOCK])
    (found,) = history_dependent(bench(locked))
    assert found.joint == "leaf"
    assert 2.0 < found.ratio < 6.0  # 2 N m over 0.6 N m, each within 10 %
    assert "'leaf' is history-dependent" in found.told


def test_dry_friction_depends_on_nothing_else() -> None:
    """It holds against neither pull, the weak one, or that and some of the strong ones."""
    for friction in (0.3, 1.0, 1.95):
        spec = load_scene(LEAF.format(lever="")).spec
        spec.joint("leaf").frictionloss = friction
        assert history_dependent(bench(Scene.from_spec(spec, source="door"))) == ()


def test_friction_that_is_larger_at_rest_is_no_lock() -> None:
    plain = load_scene(LEAF.format(lever=""))
    sticks = EffectInstance(
        "stribeck_friction", "leaf", {"coulomb": 0.2, "static": 1.0, "velocity": 0.02}
    )
    assert history_dependent(bench(add_effects(plain, [sticks]))) == ()


def test_a_scene_that_is_right_has_no_history() -> None:
    assert history_dependent(bench(load_scene(LEAF.format(lever="")))) == ()


def test_what_is_told_says_when() -> None:
    one = HistoryDependent("leaf", (1, 2.0), (0, 3.5), 4.0)
    assert "at 2.00 s of recording 2 under 4 times" in one.told
    assert "moves at 3.50 s;" in one.told
