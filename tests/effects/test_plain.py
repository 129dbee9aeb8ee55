"""Plain MuJoCo with `effects.py` moves as the backend does."""

from __future__ import annotations

import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from orbisim import Scene, load_scene, make_backend
from orbisim.effects import EffectInstance, add_effects, effect_names, find, plain
from orbisim.effects.carry import PLAIN, save_with_effects
from orbisim.effects.residual_network import Input, Network, with_rest

from .arm import ARM, CTRL, start

INSTANCES = {
    "stribeck_friction": [
        ("elbow", {"coulomb": 0.2, "static": 0.5, "velocity": 3.0}, {}),
    ],
    "load_dependent_friction": [
        ("shoulder", {"coefficient": 0.2}, {}),
        ("elbow", {"coefficient": 0.3}, {"load": "external"}),
    ],
    "joint_coupling": [
        ("elbow", {"coefficient": 0.2}, {"other": "shoulder"}),
        ("elbow", {"coefficient": 2.0}, {"other": "shoulder", "by": "position"}),
        ("shoulder", {"coefficient": 0.5}, {"other": "elbow", "by": "velocity"}),
    ],
    "deadband": [
        ("m1", {"width": 0.4}, {}),
        ("m1", {"width": 1.0}, {"kind": "gate"}),
    ],
    "constant_force": [
        ("fore", {"magnitude": 3.0, "x": 1.0, "y": 2.0, "z": -2.0}, {}),
    ],
    "periodic_disturbance": [
        ("elbow", {"amplitude": 0.5, "frequency": 3.0, "phase": 0.2}, {}),
        (
            "ball",
            {"amplitude": 0.5, "frequency": 3.0, "phase": 0.2},
            {"x": "0", "y": "2", "z": "0"},
        ),
    ],
    "linear_drag": [("fore", {"coefficient": 0.4}, {})],
    "quadratic_drag": [("ball", {"coefficient": 0.4}, {})],
    "magnus": [("ball", {"coefficient": 0.4}, {})],
}
MECHANISMS = {
    "latch": [
        ("elbow", {"force": 5.0, "position": -0.7, "width": 0.2, "threshold": 0.6},
         {"other": "shoulder"}),
        ("elbow", {"force": 1.0, "position": -0.8, "width": 0.3, "threshold": 0.0}, {}),
    ],
    "detent": [("elbow", {"amplitude": 0.5, "pitch": 0.3, "position": 0.1}, {})],
}  # fmt: skip
NATIVE = {
    "backlash": ("elbow", {"width": 0.02}),
    "joint_flexibility": ("elbow", {"stiffness": 60.0, "damping": 0.1}),
    "actuator_lag": ("m1", {"time_constant": 0.03}),
    "actuator_delay": ("m1", {"delay": 0.012}),
}
"""With memory; MJCF has them."""
CASES = {
    f"{effect}, {number}": EffectInstance(effect, *arguments)
    for effect, some in (INSTANCES | MECHANISMS).items()
    for number, arguments in enumerate(some)
} | {effect: EffectInstance(effect, *arguments) for effect, arguments in NATIVE.items()}


def scene_with(*instances: EffectInstance, integrator: str = "implicitfast") -> Scene:
    text = ARM.replace('timestep="0.0005"', 'timestep="0.002"')
    return add_effects(load_scene(text.replace("implicitfast", integrator)), instances)


def controls(model: mujoco.MjModel) -> np.ndarray:
    wave = np.sin(0.9 * np.arange(30))[:, None] * np.ones(model.nu)
    return wave * np.resize(CTRL, model.nu)


def by_backend(scene: Scene) -> np.ndarray:
    engine = make_backend("mujoco", scene, nthread=1)
    qpos, qvel = started(scene.model)
    state = engine.reset().replace(qpos=qpos[None], qvel=qvel[None])
    rows = []
    for control in controls(scene.model):
        state = engine.step(state, control, nstep=4)
        rows.append(np.concatenate([state.qpos[0], state.qvel[0]]))
    return np.array(rows)


def started(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """As `start`, where effects may have added joints."""
    qpos, qvel = np.array(model.qpos0), np.zeros(model.nv)
    declared = mujoco.MjModel.from_xml_string(ARM)
    for joint in range(declared.njnt):
        q, v = start(declared)
        name = declared.joint(joint).name
        wide = {0: (7, 6)}.get(int(declared.jnt_type[joint]), (1, 1))
        own, old = model.joint(name), declared.joint(joint)
        qpos[own.qposadr[0] : own.qposadr[0] + wide[0]] = q[old.qposadr[0] :][: wide[0]]
        qvel[own.dofadr[0] : own.dofadr[0] + wide[1]] = v[old.dofadr[0] :][: wide[1]]
    return qpos, qvel


def by_plain(scene: Scene, folder: Path) -> np.ndarray:
    """Loaded from the files, with the written module; a step at a time and several at once."""
    model = mujoco.MjModel.from_xml_path(str(save_with_effects(scene, folder)))
    step = runpy.run_path(str(folder / PLAIN))["Step"](model)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = started(model)
    rows = []
    for control in controls(model):
        data.ctrl[:] = control
        step(model, data, nstep=4)
        assert np.array_equal(data.ctrl, control)
        assert not data.qfrc_applied.any() and not data.xfrc_applied.any()
        rows.append(np.concatenate([data.qpos, data.qvel]))
    return np.array(rows)


@pytest.mark.parametrize("integrator", ["implicitfast", "Euler", "RK4"])
@pytest.mark.parametrize("case", CASES)
def test_the_trajectory_is_the_backends(case: str, integrator: str, tmp_path: Path) -> None:
    scene = scene_with(CASES[case], integrator=integrator)
    expected = by_backend(scene)
    np.testing.assert_allclose(by_plain(scene, tmp_path), expected, rtol=0, atol=1e-9)
    bare = by_backend(scene_with(integrator=integrator))
    if expected.shape == bare.shape:
        assert np.abs(expected - bare).max() > 1e-4  # it does something


def test_a_lag_below_a_timestep_is_the_backends_too(tmp_path: Path) -> None:
    """RK4 is given another form of it."""
    lag = EffectInstance("actuator_lag", "m1", {"time_constant": 0.0006})
    scene = scene_with(lag, integrator="RK4")
    np.testing.assert_allclose(by_plain(scene, tmp_path), by_backend(scene), rtol=0, atol=1e-9)


def test_several_effects_act_together(tmp_path: Path) -> None:
    names = ("stribeck_friction, 0", "joint_coupling, 2", "linear_drag, 0", "deadband, 0")
    scene = scene_with(*(CASES[name] for name in names))
    np.testing.assert_allclose(by_plain(scene, tmp_path), by_backend(scene), rtol=0, atol=1e-9)


def test_every_effect_that_is_not_native_is_covered() -> None:
    hooks = {n for n in effect_names() if not find(n).native and not find(n).measurement}
    # detents stand in scenes; a diagnosis calls them cogging
    assert hooks | {"detent"} == set(INSTANCES | MECHANISMS)
    assert {n for n in effect_names() if find(n).measurement} == set(plain.MEASURED)


def test_an_effect_of_measurement_is_passed_over(tmp_path: Path) -> None:
    scene = scene_with(EffectInstance("sensor_bias", "elbow", {"offset": 0.1}))
    np.testing.assert_allclose(by_plain(scene, tmp_path), by_backend(scene), rtol=0, atol=1e-9)


def test_a_learned_force_is_refused_in_words(tmp_path: Path) -> None:
    ones = np.ones(1)
    network = Network(
        joint="elbow", inputs=(Input("velocity", "elbow"),), centre=0 * ones, scale=ones,
        low=-ones, high=ones, layers=((np.eye(1), 0 * ones),),
    )  # fmt: skip
    scene = with_rest(scene_with(), [network])
    with pytest.raises(NotImplementedError, match="learned residual force"):
        plain.Step(scene.model)


def test_an_effect_without_a_formula_is_refused() -> None:
    entry = {"effect": "of_a_plug_in", "target": "elbow", "parameters": {}}
    model = mujoco.MjModel.from_xml_string(
        ARM.replace("<sensor>", f"<custom><text name='orbisim:effects' data='{_json(entry)}'/>"
                    "</custom><sensor>")
    )  # fmt: skip
    with pytest.raises(NotImplementedError, match="of_a_plug_in"):
        plain.Step(model)


def _json(entry: dict[str, Any]) -> str:
    return str([entry]).replace("'", "&quot;")


PROGRAM = """
import sys
sys.path.insert(0, sys.argv[1])
import mujoco, effects
model = mujoco.MjModel.from_xml_path(sys.argv[1] + "/scene.xml")
other = mujoco.MjModel.from_xml_path(sys.argv[1] + "/scene.xml")
effects.install(model)
for one in (model, other):
    data = mujoco.MjData(one)
    mujoco.mj_step(one, data, nstep=50)
    print(data.qvel[1])
print(sorted(n for n in sys.modules if n.partition(".")[0] in ("orbisim", "scipy")))
"""


def test_installed_it_acts_in_a_program_without_orbisim(tmp_path: Path) -> None:
    scene = scene_with(CASES["constant_force, 0"])
    save_with_effects(scene, tmp_path)
    ran = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(tmp_path)], capture_output=True, text=True, check=True
    )
    pushed, free, modules = ran.stdout.splitlines()
    assert abs(float(pushed) - float(free)) > 0.01 and modules == "[]"
