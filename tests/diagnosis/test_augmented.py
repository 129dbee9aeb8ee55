"""The augmented scene is a scene like any other: every command and `Physics` take it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dm_control import mujoco as dm_mujoco
from dm_control.rl import control

import orbisim
from orbisim.cli.main import run
from orbisim.effects import EffectInstance
from orbisim.effects.carry import save_with_effects
from orbisim.testing import inject_effect

HIDDEN = (
    EffectInstance("coulomb_friction", "elbow", {"torque": 0.12}),  # MJCF
    EffectInstance("joint_coupling", "elbow", {"coefficient": 0.3}, {"other": "shoulder"}),
    EffectInstance("actuator_lag", "shoulder", {"time_constant": 0.02}),  # a state more
)


@pytest.fixture(scope="module")
def augmented(arm: orbisim.Scene, tmp_path_factory: pytest.TempPathFactory) -> str:
    from orbisim.effects import add_effects

    folder = tmp_path_factory.mktemp("diagnosis") / "augmented"
    return str(save_with_effects(add_effects(arm, HIDDEN), folder))


@pytest.fixture(scope="module")
def recording(arm: orbisim.Scene, tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("recordings") / "run.npz"
    inject_effect(arm, HIDDEN, duration=3.0, episodes=1, noise=1e-4)[0].save(path)
    return str(path)


def said(capsys: pytest.CaptureFixture[str], *words: str) -> Any:
    assert run([*words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_replay(
    augmented: str, recording: str, arm: orbisim.Scene, capsys: pytest.CaptureFixture[str]
) -> None:
    after = said(capsys, "replay", augmented, recording)["overall"]["rms"]
    before = said(capsys, "replay", arm.source, recording)["overall"]["rms"]
    assert after < 0.002 < before / 5


def test_sim_and_compare(
    augmented: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said(capsys, "sim", augmented, "--duration", "0.2", "--out", str(tmp_path))
    assert (tmp_path / "trajectory.npz").is_file()
    found = said(
        capsys, "compare", augmented, "--a", "mujoco", "--b", "mujoco", "--episodes", "2",
        "--horizon", "0.2", "--no-video",
    )  # fmt: skip
    assert max(found["error"]["joint_position"]["p95"]) < 1e-9


def test_collect(augmented: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "episodes.h5")
    found = said(
        capsys, "collect", augmented, "--episodes", "4", "--set", "steps=20", "--out", out,
        "--workers", "1",
    )  # fmt: skip
    assert found["episodes"] == 4 and found["steps"] == 80


@pytest.mark.slow
def test_train(augmented: str, tmp_path: Path) -> None:
    pytest.importorskip("torch")
    data, out = str(tmp_path / "episodes.h5"), tmp_path / "checkpoint"
    sizes = ["model.width=32", "model.layers=1", "train.stages=1x1x8"]
    settings = [part for size in sizes for part in ("--set", size)]
    collecting = ["collect", augmented, "--episodes", "10", "--set", "steps=60", "--workers", "1"]
    assert run([*collecting, "--out", data]) == 0
    training = ["train", "dynamics", data, "--steps", "3", "--device", "cpu", "--out", str(out)]
    assert run([*training, *settings]) == 2  # data must not have files opened by their word
    assert run([*training, *settings, "--scene", augmented]) == 0
    assert (out / "model.safetensors").is_file()


class Reach(control.Task):  # type: ignore[misc]
    """A task of dm_control, on a physics of ours."""

    def initialize_episode(self, physics: Any) -> None:
        physics.data.qpos[:] = [0.4, -0.7]

    def before_step(self, action: Any, physics: Any) -> None:
        physics.set_control(action)

    def after_step(self, physics: Any) -> None:
        pass

    def action_spec(self, physics: Any) -> Any:
        return dm_mujoco.action_spec(physics)

    def get_observation(self, physics: Any) -> dict[str, Any]:
        return {"position": np.array(physics.data.qpos)}

    def get_reward(self, physics: Any) -> float:
        return 0.0


def positions(scene: str) -> np.ndarray:
    physics = orbisim.Physics.from_xml_path(scene)
    environment = control.Environment(physics, Reach(), control_timestep=0.01, time_limit=0.2)
    environment.reset()
    found = [environment.step(np.array([1.0, 0.0])).observation["position"] for _ in range(15)]
    return np.array(found)


def test_an_environment_feels_the_effects(augmented: str, arm: orbisim.Scene) -> None:
    engine = orbisim.make_backend("mujoco", orbisim.load_scene(augmented), nthread=1)
    state = engine.reset().replace(qpos=np.array([[0.4, -0.7]]))
    rows = []
    for _ in range(15):
        state = engine.step(state, np.array([[1.0, 0.0]]), nstep=5)
        rows.append(state.qpos[0])
    found = positions(augmented)
    assert np.allclose(found, rows, rtol=0, atol=1e-9)
    assert np.abs(found - positions(arm.source)).max() > 1e-3
