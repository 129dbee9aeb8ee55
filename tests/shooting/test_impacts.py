"""What can be predicted through impacts, and what they leave unknown."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import orbisim
from orbisim.motion.samples import prepare_all
from orbisim.shooting.bench import Bench, make_bench
from orbisim.shooting.impacts import _BLUR, _JUMP_REACH, _of_the_step, foreseen, near_jump
from orbisim.shooting.shooter import Shooter, Variant
from orbisim.shooting.windows import Windows
from orbisim.testing import inject_effect

DROP = """<mujoco><option timestep="0.002"/><worldbody>
<geom name="floor" type="plane" size="5 5 0.1"/>
<body pos="0 0 {height}"><freejoint name="free"/><geom {shape} mass="0.2"/></body>
</worldbody></mujoco>"""
BALL, BOX = 'type="sphere" size="0.05"', 'type="box" size="0.04 0.03 0.02"'


def _thrown(shape: str, starts: list[list[float]], duration: float, window: float) -> Bench:
    """Recordings of a body above a floor, of the scene as it is declared.

    Args:
      starts: position, orientation and velocity of each.
    """
    scene = orbisim.load_scene(DROP.format(shape=shape, height=starts[0][2]))
    runs = inject_effect(
        scene, [], starts=starts, duration=duration, episodes=len(starts), noise=2e-4, seed=1
    )
    return make_bench(scene, prepare_all(runs, scene), window)


@pytest.fixture(scope="module")
def tumbled() -> Bench:
    """A box that is thrown three times, turning, and tumbles over the floor."""
    speeds = ((0.5, 2.0), (0.8, -4.0), (-0.6, 3.0))
    pose, turned = [0.0, 0.0, 0.4], [0.8, 0.6, 0.0, 0.0]
    starts = [[*pose, *turned, along, 0.2, 0.0, 3.0, turn, 1.0] for along, turn in speeds]
    return _thrown(BOX, starts, 1.5, 0.5)


@pytest.fixture(scope="module")
def dropped() -> Bench:
    """A ball that is dropped from three heights."""
    starts = [[0.0, 0.0, z, 1.0, 0.0, 0.0, 0.0, *[0.0] * 6] for z in (0.6, 0.7, 0.8)]
    return _thrown(BALL, starts, 0.6, 0.5)


def _first_impact(bench: Bench, window: int) -> int | None:
    """Samples of a window before the first near an impact; None if there is none."""
    begin = int(bench.intervals.row[bench.windows.first[window]])
    near = near_jump(bench.samples[int(bench.windows.recording[window])])
    inside = np.flatnonzero(near[begin : begin + bench.windows.length + 1])
    return int(inside[0]) if len(inside) else None


@pytest.mark.parametrize("name", ["dropped", "tumbled"])
def test_nothing_scatters_before_the_first_impact(
    name: str, request: pytest.FixtureRequest
) -> None:
    bench: Bench = request.getfixturevalue(name)
    scatter, flown = bench.windows.scatter, 0
    assert bench.contacts and scatter is not None
    assert scatter.shape == (len(bench.windows), bench.windows.length + 1, 12)
    for window, each in enumerate(scatter):
        first = _first_impact(bench, window)
        if first is not None and first > _BLUR:
            assert each[: first - _BLUR].max() < 0.05
            assert each[first - _BLUR :].max() > 1.0
            flown += 1
    assert flown >= 3


def test_what_tumbles_scatters_more_than_what_bounces_once(dropped: Bench, tumbled: Bench) -> None:
    ball, box = dropped.windows.scatter, tumbled.windows.scatter
    assert ball is not None and box is not None
    assert box.max() > 10 * ball.max() > 10.0


def test_where_nothing_touches_nothing_scatters() -> None:
    up = [0.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0, 0.5, 0.2, 2.0, 3.0, 0.0, 1.0]
    bench = _thrown(BALL, [up, up], 0.6, 0.3)
    assert not bench.contacts
    assert bench.windows.scatter is None and bench.windows.horizon is None
    assert bench.shooter(bench.fit).whitening is None


def _cut(bench: Bench) -> Windows:
    """The windows, of which nothing is foreseen yet."""
    return dataclasses.replace(bench.windows, horizon=None, scatter=None)


def test_a_run_that_grows_apart_is_cut(tumbled: Bench) -> None:
    """Where corners hit the floor, a start that is off by a part of the noise ends elsewhere."""
    horizon = tumbled.windows.horizon
    assert horizon is not None
    cut = horizon < tumbled.windows.length
    assert cut.any() and not cut.all()
    for window in np.flatnonzero(cut.any(axis=1)):
        first = _first_impact(tumbled, int(window))
        assert first is not None and horizon[window].min() >= first
    # starts that differ by a hundredth stay together for longer
    windows = _cut(tumbled)
    finer = tumbled.noise[0] / 100, tumbled.noise[1] / 100
    shooter = Shooter(tumbled.scene, tumbled.samples, tumbled.intervals, windows, finer)
    again = foreseen(shooter, tumbled.intervals, windows, finer)
    assert again.horizon is not None
    assert (again.horizon < windows.length).sum() < cut.sum()


def test_a_ball_that_bounces_can_be_predicted_to_the_end(dropped: Bench) -> None:
    assert dropped.windows.horizon is not None
    assert (dropped.windows.horizon == dropped.windows.length).all()


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast", "RK4"])
def test_what_a_step_does_to_all_motion_is_none_of_its_impacts(integrator: str) -> None:
    """A body that flies freely, of which every sample is said to be near an impact."""
    text = DROP.format(shape=BALL, height=3.0)
    text = text.replace('timestep="0.002"', f'timestep="0.002" integrator="{integrator}"')
    scene = orbisim.load_scene(text)
    start = [0.0, 0.0, 3.0, 1.0, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0]
    runs = inject_effect(scene, [], starts=[start], duration=0.4, episodes=1, noise=2e-4, seed=1)
    samples = [
        dataclasses.replace(one, jumps=np.ones_like(one.jumps)) for one in prepare_all(runs, scene)
    ]
    bench = make_bench(scene, samples, 0.3)
    shooter = bench.shooter(np.ones(len(bench.windows), bool))
    base = shooter.simulate(Variant(scene), np.zeros((len(shooter), 12)))
    off = _of_the_step(shooter, bench.intervals, bench.noise, base)
    assert np.abs(off).max() < 1e-9  # the half step itself moves it by 1.5 mm


def test_what_is_not_measured_is_not_foreseen(dropped: Bench) -> None:
    windows, noise = _cut(dropped), (dropped.noise[0], np.full(6, np.inf))
    shooter = Shooter(dropped.scene, dropped.samples, dropped.intervals, windows, noise)
    found = foreseen(shooter, dropped.intervals, windows, noise)
    assert found.horizon is not None and found.scatter is not None
    assert not found.horizon[:, 6:].any() and (found.horizon[:, :6] > 0).all()
    assert np.isfinite(found.scatter).all()
    assert windows.scatter is None  # another is made


@pytest.mark.parametrize("place", [0, 2, 10, 18])
def test_an_impact_is_near_some_samples_to_either_side(place: int) -> None:
    jumps = np.zeros((19, 2), bool)
    jumps[place, 1] = True
    one: Any = SimpleNamespace(jumps=jumps)
    samples = np.arange(20)
    np.testing.assert_array_equal(near_jump(one), abs(samples - place) <= _JUMP_REACH)


def test_without_an_impact_none_is_near() -> None:
    one: Any = SimpleNamespace(jumps=np.zeros((19, 2), bool))
    assert not near_jump(one).any() and len(near_jump(one)) == 20
