"""What is said before any effect is looked for."""

from __future__ import annotations

import numpy as np
import pytest

import orbisim
from orbisim.diagnosis.checks import coarse_timestep, disabled
from orbisim.effects import find
from orbisim.motion.samples import prepare_all
from orbisim.shooting.bench import make_bench
from orbisim.testing import inject_effect

PENDULUM = """<mujoco><option timestep="{step}" integrator="{way}">{flags}</option><worldbody>
<body><joint name="hinge" axis="0 1 0" damping=".01"/>
<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".5"/></body></worldbody>
<actuator><motor name="motor" joint="hinge" gear="1"/></actuator></mujoco>"""


def test_a_timestep_that_is_too_long_is_said() -> None:
    fine = orbisim.load_scene(PENDULUM.format(step=0.001, flags="", way="RK4"))
    runs = inject_effect(fine, [], duration=4.0, episodes=2, rate=50.0, noise=1e-4, seed=1)
    coarse = orbisim.load_scene(PENDULUM.format(step=0.02, flags="", way="Euler"))
    bench = make_bench(coarse, prepare_all(runs, coarse), 0.5)
    told = coarse_timestep(bench, 3.0)
    assert told is not None and "0.01 s instead of 0.02 s" in told
    assert coarse_timestep(bench, 1e4) is None  # an effect accounts for nearly all
    assert coarse_timestep(make_bench(fine, prepare_all(runs, fine), 0.5), 1.0) is None


def test_what_a_flag_makes_impossible_is_said_and_not_tried() -> None:
    plain = orbisim.load_scene(PENDULUM.format(step=0.002, flags="", way="Euler"))
    assert disabled(plain) == []
    flags = '<flag gravity="disable" constraint="disable"/>'
    scene = orbisim.load_scene(PENDULUM.format(step=0.002, flags=flags, way="Euler"))
    kept, lifted = disabled(scene)
    assert "constraint, gravity" in kept and "gravity_tilt" in kept and "sliding_friction" in kept
    assert "constraint" in lifted and "coulomb_friction" in lifted and "hard_stop" in lifted
    assert "viscous_damping" not in kept + lifted and "coulomb_friction" not in kept
    assert find("gravity_tilt").targets(scene.model) == ()
    assert find("coulomb_friction").targets(scene.model) == ("hinge",)
    assert find("viscous_damping").targets(scene.model) == ("hinge",)


@pytest.mark.parametrize("counts", [4096, 512])
def test_noise_is_not_below_an_encoders_rounding(counts: int) -> None:
    scene = orbisim.load_scene(PENDULUM.format(step=0.002, flags="", way="Euler"))
    step = 2 * np.pi / counts
    (run,) = inject_effect(scene, [], duration=4.0, episodes=1, noise=0.0, seed=1)
    position = np.round(run.signals["qpos/hinge"] / step) * step
    read = run.replace(signals={**run.signals, "qpos/hinge": position})
    bench = make_bench(scene, prepare_all([read], scene), 0.5)
    assert bench.noise[0][0] >= step / np.sqrt(12) * (1 - 1e-9)
