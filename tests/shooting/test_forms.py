"""Other forms of the same data."""

from __future__ import annotations

import numpy as np
import pytest

import orbisim
from orbisim.motion.samples import prepare_all
from orbisim.recording import Recording
from orbisim.recording.command_clock import Lead
from orbisim.shooting.bench import Bench, make_bench
from orbisim.shooting.forms import asked, command_clock, in_scene, leading, read_as
from orbisim.shooting.stepping import Stepping, stepping, with_stepping
from orbisim.testing import inject_effect

PENDULUM = """<mujoco><option timestep="0.002"/><worldbody>
<body><joint name="hinge" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".3"/></body></worldbody>
<actuator><motor name="motor" joint="hinge"/></actuator></mujoco>"""


@pytest.fixture(scope="module")
def scene() -> orbisim.Scene:
    return orbisim.load_scene(PENDULUM)


def _bench(scene: orbisim.Scene, runs: list[Recording]) -> Bench:
    return make_bench(scene, prepare_all(runs, scene), 0.5)


def _runs(scene: orbisim.Scene, period: float | None = None) -> list[Recording]:
    """Two recordings at 100 Hz, of commands that change by a clock if there is one."""
    runs = inject_effect(scene, [], rate=100.0, duration=4.0, episodes=2, noise=1e-3, seed=0)
    if period is None:
        return runs
    rng, clocked = np.random.default_rng(0), []
    for one in runs:
        ticks = np.floor(one.time / period).astype(int)
        (name,) = (name for name in one.signals if name.startswith("ctrl"))
        values = rng.normal(size=ticks.max() + 1)[ticks].reshape(one.signals[name].shape)
        clocked.append(one.replace(signals={**one.signals, name: values}))
    return clocked


def test_commands_that_change_often_are_asked_for_their_time(scene: orbisim.Scene) -> None:
    often, seldom = _runs(scene, 0.023), _runs(scene, 1.0)
    assert asked(_bench(scene, often)).lead == Lead()
    assert asked(_bench(scene, seldom)).lead is None


def test_the_clock_is_that_of_most_logs(scene: orbisim.Scene) -> None:
    bench = asked(_bench(scene, _runs(scene, 0.023)))
    found = command_clock(bench)
    assert found is not None and found.clock and found.period == pytest.approx(0.023, rel=1e-3)
    assert command_clock(bench.led(found)) is None  # it is asked already
    assert command_clock(asked(_bench(scene, _runs(scene, 0.02)))) is None  # a multiple: no clock


def test_other_data_are_read_in_the_form_of_a_bench(scene: orbisim.Scene) -> None:
    bench = _bench(scene, _runs(scene, 0.023))
    finer = with_stepping(scene, Stepping(0.001, stepping(scene).integrator))
    assert in_scene(bench, scene) is bench and read_as(bench, bench) is bench
    there = in_scene(bench, finer)
    assert there.scene is finer and not np.array_equal(
        there.intervals.defect, bench.intervals.defect
    )
    early = leading(there, Lead(0.5))
    other = read_as(bench, early)
    assert other.scene is finer and other.lead == Lead(0.5)
    np.testing.assert_allclose(other.intervals.defect, early.intervals.defect)
    assert not np.array_equal(early.intervals.defect, there.intervals.defect)
