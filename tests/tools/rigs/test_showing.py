"""How well the laws of trials show."""

from __future__ import annotations

import copy
import dataclasses
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "tools"))

from rigs import instruments
from rigs.bodies import Misread
from rigs.drives import Delay, Elastic, Gain, Lag
from rigs.excitation import motion
from rigs.friction import Coulomb, Spring, Viscous
from rigs.law import Floats, Law
from rigs.machines import MACHINES
from rigs.showing import _again, _by_starts, _free, beside, visibility
from rigs.truth import Run, Stepping, Truth

SLIDER = mujoco.MjModel.from_xml_string(
    """<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody><body>
    <joint type="slide"/><geom size="0.1"/></body></worldbody></mujoco>"""
)


def test_free_runs_are_read_between_steps_too() -> None:
    """A clock that is fast by a part of a step in a sample is seen as that."""
    plain: Any = SimpleNamespace(model=SLIDER, applied=False)
    run: Any = SimpleNamespace(sent=np.zeros((100, 0)))
    at, start = 0.5004 + 0.01 * np.arange(5), np.array([0.2])
    found = _free(plain, run, 1.03, 0.0, at, start, np.array([2.0]))
    np.testing.assert_allclose(found[:, 0], 0.2 + 2.0 * 1.03 * (at - at[0]), atol=1e-12)


def test_what_is_distinct_is_what_no_start_makes_and_no_impact_hides() -> None:
    chain: Any = SimpleNamespace(noise=1e-3, rate=100.0, unknown=lambda v: np.full(v.shape, 1e-3))
    time = np.linspace(0.0, 0.5, 51)[:, None]
    still, at_rest = (np.zeros(1), np.zeros(1)), (np.zeros((51, 1)), np.zeros((51, 1)))

    def straight(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.asarray(q + v * time)

    def bent(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """After 0.25 s its way hangs on how far off the start is, to whichever side."""
        return straight(q, v) + np.where(time > 0.25, 100 * np.abs(q), 0.0)

    moved, curved = 0.1 + 0.3 * time, 0.4 * time**2
    assert (
        np.abs(_by_starts(SLIDER, straight, at_rest, straight(*still), chain).left(moved)).max()
        < 1e-6
    )
    seen = _by_starts(SLIDER, straight, at_rest, straight(*still), chain).left(moved + curved)
    beside = curved - np.polynomial.Polynomial.fit(time[:, 0], curved[:, 0], 1)(time)
    np.testing.assert_allclose(seen, beside / 1e-3, atol=1e-6)
    hidden = np.where(time > 0.25, 1e-2, 0.0)
    left = [
        np.abs(_by_starts(SLIDER, free, at_rest, free(*still), chain).left(hidden)).max()
        for free in (straight, bent)
    ]
    assert left[0] > 2.0 and left[1] < 0.25


Made = tuple[Truth, Truth, instruments.Chain, Run]


def made_of(*laws: Law, machine: str = "suite_pendulum", late: float = 0.0) -> Made:
    """A machine without laws and with them, what it is measured with, and how it moves."""
    made, stepping = MACHINES[machine], Stepping(1e-3, "rk4")
    plain, truth = (Truth(made, made.text(), stepping, some) for some in ((), laws))
    chain = instruments.drawn(plain.model, 100.0, (), np.random.default_rng(2))
    chain = dataclasses.replace(chain, late=late)
    one = motion(made, plain, np.random.default_rng(1), chain.noise)
    ticks = chain.ticks(2.0, np.random.default_rng(3))
    run = truth.run(one.qpos, one.qvel, 2.0, one.controller, ticks, chain.late)
    return plain, truth, chain, run


def shown(*laws: Law, machine: str = "suite_pendulum") -> tuple[dict[str, float], list[float]]:
    """How laws of a machine show, together and each beside the others."""
    plain, truth, chain, run = made_of(*laws, machine=machine)
    return visibility(plain, chain, [run], laws), beside(truth, plain, chain, run)


def test_what_another_law_does_as_well_does_not_show_beside_it() -> None:
    damping = Viscous("viscous_damping", "hinge", 0.1, 1.0)
    together, apart = shown(damping, Spring("hinge", 0.3, 1.0, 0.0))
    assert min(apart) > 0.03 * together["distinct"]
    together, apart = shown(damping, Viscous("viscous_damping", "hinge", 0.05, 1.0))
    assert together["distinct"] > 2.0 and max(apart) < 0.02 * together["distinct"]
    assert shown(damping)[1] == []


def test_an_offset_does_not_show_beside_a_spring_that_may_rest_elsewhere() -> None:
    bias, others = Misread("sensor_bias", "lift", 0.05, 1.0), list[float]()
    for other in (Viscous("viscous_damping", "lift", 0.2, 1.0), Spring("lift", 2.0, 1.0, 0.0)):
        others.append(shown(bias, other, machine="servo_arm")[1][0])
    assert others[0] > 20.0 * others[1]


def test_samples_beside_their_times_hide_what_is_fast() -> None:
    made, rng = Truth(MACHINES["suite_pendulum"], MACHINES["suite_pendulum"].text(),
                      Stepping(1e-3, "rk4"), ()), np.random.default_rng(0)  # fmt: skip
    white, jitter = (instruments.drawn(made.model, 100.0, some, rng) for some in ((), ("jitter",)))
    speeds = np.array([[0.0], [20.0]])
    np.testing.assert_allclose(white.unknown(speeds), white.noise)
    np.testing.assert_allclose(jitter.unknown(speeds)[:, 0],
                               np.hypot(jitter.noise, [0.0, 20.0 * 0.01 / 100.0]))  # fmt: skip


def test_a_part_of_a_run_is_the_same_once_more() -> None:
    """From a state that it had, its laws remember what they had done, and late commands arrive."""
    laws = (
        Lag("actuator_lag", "lift_servo", 0.05, 1.0),
        Elastic("lift", "lift_servo", 60.0, 1.0, 0.1),
        Delay("actuator_delay", "yaw_servo", 0.0233, 1.0),
        Coulomb("coulomb_friction", "yaw", 0.05, 1.0),
    )
    _, truth, chain, run = made_of(*laws, machine="servo_arm", late=0.0077)
    done = 0
    for first, last in ((0, 200), (400, 700), (900, 1000)):
        if first:
            _again(truth, run, chain, done, first - 1)
        done = first
        again = _again(copy.deepcopy(truth), run, chain, first, last)
        np.testing.assert_allclose(again.qpos, run.qpos[first : last + 1], atol=1e-9)


def test_commands_reach_a_rotor_after_all_that_changes_them() -> None:
    lag = Lag("actuator_lag", "lift_servo", 0.1, 1.0)
    gain = Gain("torque_gain", "lift_servo", 0.8, 1.0)
    soft = Elastic("lift", "lift_servo", 60.0, 1.0, 0.1)
    made = MACHINES["servo_arm"]

    def way(*laws: Law) -> Floats:
        truth = Truth(made, made.text(), Stepping(1e-3, "implicitfast"), laws)
        still, ticks = np.zeros(3), np.arange(0.0, 0.3, 0.01)
        step = np.full(3, 0.3)
        run = truth.run(still, still, 0.3, lambda now, *_: step * (now > 0.05), ticks, 0.0)
        return np.asarray(run.qpos[:, 1])

    both = way(lag, gain, soft)
    np.testing.assert_array_equal(both, way(soft, lag, gain))
    for fewer in ((soft,), (lag, soft), (gain, soft)):
        assert np.abs(both - way(*fewer)).max() > 0.005
