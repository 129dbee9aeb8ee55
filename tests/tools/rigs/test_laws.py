"""Each law of the truth against what it is defined to do, in machines of one joint."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import numpy as np
import pytest

TOOLS = Path(__file__).resolve().parents[3] / "tools"
sys.path.insert(0, str(TOOLS))

from rigs import bodies, drives, friction  # noqa: E402  (needs the path above)
from rigs.law import Law  # noqa: E402
from rigs.machines import Machine  # noqa: E402
from rigs.truth import Run, Stepping, Truth  # noqa: E402

WHEEL = """<mujoco><option gravity="0 0 0"/><worldbody><body name="wheel">
<joint name="axle" axis="0 0 1" armature="0.02"/>
<geom type="cylinder" size="0.1 0.02" mass="2" contype="0" conaffinity="0"/></body></worldbody>
<actuator><motor name="motor" joint="axle"/></actuator></mujoco>"""
INERTIA = 2 * 0.1**2 / 2 + 0.02
"""About the axle, with the armature, kg*m^2."""
BALL = """<mujoco><worldbody><body name="ball" pos="0 0 9"><freejoint/>
<geom size="0.02" mass="0.5"/></body></worldbody></mujoco>"""

TRUTH_ONLY = (
    "machines law friction drives bodies strange truth excitation instruments draws sizing making"
)
"""Modules that make trials."""


def moved(
    text: str,
    laws: list[Law],
    *,
    speed: float = 0.0,
    duration: float = 0.5,
    command: float = 0.0,
    integrator: str = "implicitfast",
) -> Run:
    machine = Machine("made", "hand:none")
    truth = Truth(machine, text, Stepping(2e-4, integrator), laws)
    qvel = np.zeros(truth.model.nv)
    qvel[0] = speed
    given = np.full(truth.size, command)
    ticks = np.array([0.1])  # commanded from then on
    return truth.run(
        truth.model.qpos0.copy(), qvel, duration, lambda t, q, v: given, ticks, late=0.0
    )


@pytest.mark.parametrize("name", TRUTH_ONLY.split())
def test_what_makes_trials_knows_nothing_of_the_search(name: str) -> None:
    tree = ast.parse((TOOLS / "rigs" / f"{name}.py").read_text())
    imported = {
        alias.name.partition(".")[0]
        for node in ast.walk(tree)
        if isinstance(node, ast.Import)
        for alias in node.names
    } | {
        str(node.module).partition(".")[0]
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
    }
    assert imported <= {*sys.stdlib_module_names, "mujoco", "numpy", "rigs"}


def test_dry_friction_stops_a_wheel_in_the_time_that_mechanics_says() -> None:
    run = moved(WHEEL, [friction.Coulomb("", "axle", 0.3, 1.0)], speed=2.0)
    stops = INERTIA * 2.0 / 0.3
    assert run.time[np.argmax(np.abs(run.qvel[:, 0]) < 0.02)] == pytest.approx(stops, rel=0.02)
    assert abs(run.qvel[-1, 0]) < 1e-3  # and it sticks


def test_dry_friction_holds_against_less_torque_than_its_level() -> None:
    law = friction.Coulomb("", "axle", 0.3, 1.0)
    assert np.abs(moved(WHEEL, [law], command=0.2).qpos).max() < 6e-4
    assert moved(WHEEL, [law], command=0.4).qpos[-1, 0] > 0.1


def test_damping_decays_exponentially() -> None:
    run = moved(WHEEL, [friction.Viscous("", "axle", 0.1, 1.0)], speed=2.0)
    expected = 2.0 * np.exp(-0.1 * run.time / INERTIA)
    assert np.allclose(run.qvel[:, 0], expected, rtol=2e-3)


def test_a_delay_is_a_time_not_a_number_of_steps() -> None:
    late = moved(WHEEL, [drives.Delay("", "motor", 0.0333, 1.0)], command=1.0)
    begins = late.time[np.argmax(late.drive[:, 0] > 0.5)]
    assert begins == pytest.approx(0.1333, abs=2.1e-4)


def test_a_lag_takes_its_time_constant() -> None:
    run = moved(WHEEL, [drives.Lag("", "motor", 0.05, 1.0)], command=1.0)
    reached = run.time[np.argmax(run.drive[:, 0] > 1 - np.exp(-1))]
    assert reached == pytest.approx(0.15, abs=1e-3)
    step = run.time[1] - run.time[0]
    assert np.sum(1 - run.drive[run.time > 0.1 - step / 2, 0]) * step == pytest.approx(
        0.05, rel=1e-3
    )


def test_play_lets_the_rotor_go_before_the_link() -> None:
    run = moved(WHEEL, [drives.Play("axle", "motor", 0.02, 1.0)], command=0.5)
    gap = run.qpos[:, 0] - run.body[:, 0]  # the encoder is on the rotor
    begins = int(np.argmax(np.abs(run.body[:, 0]) > 1e-7))
    assert gap[begins] == pytest.approx(0.01, rel=0.05)
    assert gap.max() < 0.011  # flanks are stiff


def test_an_elastic_transmission_swings_at_its_frequency() -> None:
    stiffness = 40.0
    run = moved(
        WHEEL, [drives.Elastic("axle", "motor", stiffness, 1.0, 0.0)], command=0.5, duration=1.0
    )
    twist = (run.qpos - run.body)[run.time > 0.2, 0]
    twist = twist - twist.mean()
    crossings = np.sum((twist[:-1] < 0) & (twist[1:] >= 0))
    link, rotor = INERTIA - 0.02, 0.02
    swing = np.sqrt(stiffness * (1 / link + 1 / rotor)) / (2 * np.pi)
    assert crossings == pytest.approx(swing * 0.8, abs=1.0)


@pytest.mark.parametrize("integrator", ["implicitfast", "rk4"])
@pytest.mark.parametrize("kind", ["play", "elastic"])
def test_a_transmission_moves_a_light_link_like_a_heavy_one(kind: str, integrator: str) -> None:
    """The link has a fifth of the rotor's inertia; both share a momentum that the motor gives."""
    light = WHEEL.replace('mass="2"', 'mass="0.8"')
    law = (
        drives.Play("axle", "motor", 0.004, 1.0)
        if kind == "play"
        else drives.Elastic("axle", "motor", 60.0, 1.0, 0.02)
    )
    run = moved(light, [law], command=0.5, duration=1.0, integrator=integrator)
    link, rotor = 0.8 * 0.1**2 / 2, 0.02
    speed = np.gradient(run.qpos[:, 0], run.time)
    momentum = rotor * speed + link * run.rate[:, 0]
    given = 0.5 * np.clip(run.time - 0.1, 0.0, None)
    np.testing.assert_allclose(momentum[10:-10], given[10:-10], atol=0.01 * given[-1])
    assert np.abs(run.qpos[:, 0] - run.body[:, 0]).max() < 0.02


def test_a_load_has_the_inertia_of_a_point_mass() -> None:
    law = bodies.Load("wheel", 0.5, np.array([0.1, 0.0, 0.0]), 1.0)
    run = moved(WHEEL, [law], command=1.0)
    gained = run.qvel[-1, 0] / (run.time[-1] - 0.1)
    assert gained == pytest.approx(1.0 / (INERTIA + 0.5 * 0.1**2), rel=2e-3)


def test_drag_and_lift_act_on_a_falling_ball() -> None:
    run = moved(BALL, [bodies.Air("ball", 0.4, 1.0, 0)], duration=1.0)
    expected = -(9.81 * 0.5 / 0.4) * (1 - np.exp(-0.4 * run.time / 0.5))
    assert np.allclose(run.qvel[:, 2], expected, atol=5e-3)
    risen = moved(BALL, [bodies.Lift("ball", 0.25, np.array([0, 0, -9.81]), 1.0)])
    assert risen.qvel[-1, 2] == pytest.approx(-9.81 * 0.5 * risen.time[-1], rel=1e-6)


def test_a_slope_turns_gravity_and_keeps_its_size() -> None:
    run = moved(BALL, [bodies.Slope(5.0, np.array([1.0, 0.0, 0.0]), 1.0)])
    speed = run.qvel[-1, :3]
    assert np.degrees(np.arctan2(abs(speed[1]), -speed[2])) == pytest.approx(5.0, rel=1e-6)


def test_a_ball_rebounds_the_less_the_more_the_contact_damps() -> None:
    found = [bodies.rebound(1e4, ratio) for ratio in (0.05, 0.2, 0.6)]
    assert 1 > found[0] > found[1] > found[2] > 0.05
