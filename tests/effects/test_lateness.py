"""Drives are as late as they say: in all integrators, in steps of any length, in other steps."""

from __future__ import annotations

import mujoco
import mujoco.batch
import numpy as np
import pytest

from orbisim import Scene, load_scene
from orbisim.effects import EffectInstance, add_effects
from orbisim.effects.lateness import delay, kept_late
from orbisim.effects.stepping import Timesteps
from orbisim.motion.samples import prepare_all
from orbisim.recording import Recording
from orbisim.shooting.bench import make_bench
from orbisim.shooting.fits import Unknown
from orbisim.shooting.gauss_newton import gauss_newton
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.shooter import Variant
from orbisim.shooting.stepping import Stepping, stepping, with_stepping

SLED = """<mujoco><option timestep="{step}" integrator="{integrator}" gravity="0 0 0"/><worldbody>
  <body><joint name="rail" type="slide"/><geom size=".1" mass="1"/></body></worldbody>
  <actuator>{drive}</actuator></mujoco>"""
MOTOR = '<motor name="m" joint="rail"/>'
RK4, FAST = mujoco.mjtIntegrator.mjINT_RK4, mujoco.mjtIntegrator.mjINT_IMPLICITFAST


def sled(step: float, integrator: str, drive: str = MOTOR) -> Scene:
    return load_scene(SLED.format(step=step, integrator=integrator, drive=drive))


def late(scene: Scene, effect: str, seconds: float) -> Scene:
    name = {"actuator_lag": "time_constant", "actuator_delay": "delay"}[effect]
    return add_effects(scene, [EffectInstance(effect, "m", {name: seconds})])


def mean_delay(model: mujoco.MjModel, step: float | None = None) -> float:
    """How late a mass is, s, that a control of one timestep moves; in other steps than the model's
    own, if they are given, as searches take them."""
    batch = mujoco.batch.Batch(model, 1, 1)
    step = float(model.opt.timestep) if step is None else step
    Timesteps(model, batch).set(np.array([step]))
    count = 3000
    control = np.zeros((1, count, 1))
    control[0, 5] = 1.0  # once buffers have some steps in them
    kind = int(mujoco.mjtState.mjSTATE_CTRL)
    ends = batch.rollout(count, control, kind, ("qpos", "qvel"))
    assert ends["qvel"][0, -1, 0] == pytest.approx(step, rel=1e-6)
    return float((count - 5.5) * step - ends["qpos"][0, -1, 0] / step)


@pytest.mark.parametrize("step", [0.002, 0.005, 0.01])
@pytest.mark.parametrize("tau", [1e-5, 0.0009, 0.004, 0.0257, 0.3])
def test_a_lag_is_late_by_its_time_constant(step: float, tau: float) -> None:
    exact = late(sled(step, "RK4"), "actuator_lag", tau)
    assert mean_delay(exact.model) == pytest.approx(tau, abs=1e-7)
    for integrator in ("Euler", "implicitfast") if tau >= step / 2 else ():
        held = late(sled(step, integrator), "actuator_lag", tau)
        assert mean_delay(held.model) == pytest.approx(tau, abs=step**2 / (12 * tau))


@pytest.mark.parametrize("seconds", [0.004, 0.0333])
@pytest.mark.parametrize("effect", ["actuator_lag", "actuator_delay"])
@pytest.mark.parametrize("step", [0.0051, 0.008, 0.0105])
def test_drives_are_as_late_in_steps_that_sampling_asks_for(
    effect: str, seconds: float, step: float
) -> None:
    """But a delay is a timestep at least."""
    model = late(sled(0.01, "RK4"), effect, seconds).model
    least = step if effect == "actuator_delay" else 0.0
    assert mean_delay(model, step) == pytest.approx(max(seconds, least), abs=1e-6)


@pytest.mark.parametrize("before", ["Euler", "RK4"])
def test_delays_are_as_long_in_a_scene_that_is_stepped_otherwise(before: str) -> None:
    given = late(sled(0.002, before), "actuator_delay", 0.0333)
    exact = with_stepping(given, Stepping(0.0035, int(RK4)))
    assert mean_delay(exact.model) == pytest.approx(0.0333, abs=1e-6)
    back = with_stepping(exact, stepping(given))
    assert back.model.actuator_delay[0] == pytest.approx(given.model.actuator_delay[0])


@pytest.mark.parametrize("kind", ["filter", "filterexact"])
@pytest.mark.parametrize("integrator", ["Euler", "RK4"])
def test_declared_dynamics_stay_as_they_are(kind: str, integrator: str) -> None:
    drive = f'<general name="m" joint="rail" dyntype="{kind}" dynprm="0.03"/>'
    scene = sled(0.01, integrator, drive)
    assert not kept_late(scene.model, np.array([0.002]))
    for other in (RK4, FAST):
        model = with_stepping(scene, Stepping(0.002, int(other))).model
        assert model.actuator_dynprm[0, 0] == 0.03
        assert model.actuator_dyntype[0] == scene.model.actuator_dyntype[0]


def test_what_stages_make_of_delays_is_undone() -> None:
    """A scene that is stepped by RK4, then otherwise, then by RK4 again."""
    delays = np.linspace(0.001, 0.03, 59)
    given = delay(delays, 0.005, int(RK4))
    model = sled(0.005, "RK4", MOTOR.replace("/>", ' delay="0.02" nsample="9"/>')).model
    for seconds, number in zip(delays, given, strict=True):
        model.actuator_delay[0] = number
        euler = kept_late(model, np.array([0.005]), int(FAST))["actuator_delay"][0, 0]
        assert euler == pytest.approx(seconds)


def recorded(tau: float, seed: int) -> Recording:
    """Of a mass of 1 kg behind a lag, by hand in steps of 0.2 ms; forces are held for 10 ms."""
    fine, rng = 2e-4, np.random.default_rng(seed)
    forces, each = rng.normal(size=301), round(0.01 / 2e-4)
    kept = np.exp(-fine / tau)
    mean = tau / fine * (1 - kept)
    place, speed, shown = 0.0, 0.0, forces[0]
    rows = []
    for force in forces:
        rows.append((place, speed))
        for _ in range(each):
            pushed = force + (shown - force) * mean
            shown = force + (shown - force) * kept
            place += fine * speed + 0.5 * fine**2 * pushed
            speed += fine * pushed
    seen = np.array(rows) + rng.normal(size=(len(rows), 2)) * [1e-5, 1e-4]
    signals = {"qpos/rail": seen[:, 0], "qvel/rail": seen[:, 1], "ctrl/m": forces}
    return Recording(0.01 * np.arange(len(rows)), signals)


@pytest.mark.parametrize("tau", [0.0125, 0.0257])
@pytest.mark.parametrize(
    ("step", "integrator"),
    [(0.01, "RK4"), (0.016, "RK4"), (0.002, "implicitfast"), (0.002, "Euler")],
)  # longer steps than 10 ms are cut to those of the log
def test_fits_find_the_time_constant_of_a_machine(tau: float, step: float, integrator: str) -> None:
    declared = sled(step, integrator)
    runs = [recorded(tau, seed) for seed in range(2)]
    if integrator != "RK4":  # its velocities are not those of the samples
        runs = [one.replace(signals={k: one[k] for k in ("qpos/rail", "ctrl/m")}) for one in runs]
    bench = make_bench(declared, prepare_all(runs, declared), 0.3)

    def build(values: np.ndarray) -> Variant:
        lag = EffectInstance("actuator_lag", "m", {"time_constant": float(values[0])})
        return Hypothesis((lag,)).variant(declared)

    start = Unknown("time_constant", 0.02, 1e-5, 1.0, 1e-4)
    found = gauss_newton(bench.shooter(bench.fit), build, [start], iterations=10)
    deviation = float(np.sqrt(found.covariance[0, 0]))
    assert deviation < 0.01 * tau
    assert found.values[0] == pytest.approx(tau, abs=3 * deviation)
