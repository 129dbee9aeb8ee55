from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from orbisim_policies.drawn import DrawnProblem
from orbisim_policies.learned import LearnedWorlds
from orbisim_policies.push import PushProblem
from orbisim_policies.suite import SuiteProblem
from orbisim_policies.true import TrueWorlds

from orbisim.cli.main import run
from orbisim.errors import InputError
from orbisim.vector import intervals


def report(*found: tuple[str, str, str, float, float]) -> dict[str, Any]:
    effects = [
        {
            "effect": effect,
            "target": target,
            "parameters": {name: {"value": (low + high) / 2, "unit": "", "ci95": [low, high]}},
        }
        for effect, target, name, low, high in found
    ]
    return {"schema": "orbisim.diagnosis/1", "verdict": "explained", "effects": effects}


FOUND = report(
    ("coulomb_friction", "slider", "torque", 0.5, 2.0),
    ("actuator_delay", "slide", "delay", 0.01, 0.05),
)


@pytest.fixture(scope="module")
def drawn(cartpole: SuiteProblem) -> DrawnProblem:
    return DrawnProblem(cartpole, intervals(FOUND), seed=3, count=3)


def test_worlds_are_those_of_the_drawn_scenes(cartpole: SuiteProblem, drawn: DrawnProblem) -> None:
    starts = drawn.draw(range(4))
    np.testing.assert_array_equal(starts.qpos, cartpole.draw(range(4)).qpos)
    assert len(np.unique(starts.params[:, -1])) > 1
    worlds = TrueWorlds(drawn, 4, nthread=1)
    worlds.begin(np.arange(4), starts)
    for _ in range(drawn.steps):
        worlds.step(torch.ones(4, 1))
    qpos = worlds.coordinates[0]
    for world in range(4):
        scene, _ = drawn.trials(1, world)
        assert 0.5 <= scene.model.dof_frictionloss[0] <= 2.0
        half = scene.model.opt.timestep / 2  # by which RK4 reads a delayed control too early
        assert 0.009 <= scene.model.actuator_delay[0] <= 0.05 + half
        data = mujoco.MjData(scene.model)
        data.qpos[:], data.qvel[:] = starts.qpos[world], starts.qvel[world]
        data.ctrl[:] = 1.0
        mujoco.mj_step(scene.model, data, drawn.steps)
        np.testing.assert_array_equal(qpos[world], data.qpos)
    worlds.close()


def test_the_friction_that_a_task_draws_is_replaced_and_its_masses_are_kept(
    push: PushProblem,
) -> None:
    found = report(("sliding_friction", "cube1", "coefficient", 0.1, 0.2))
    drawn = DrawnProblem(push, intervals(found), count=2)
    model = drawn.model
    for params in drawn.draw([1, 2]).params:
        drawn.write(model, params)
        assert 0.1 <= model.geom("cube1").friction[0] <= 0.2
        half, density = params[0], params[2]
        assert model.body("cube1").mass[0] == pytest.approx(8 * half**3 * density)
    heavy = report(("payload", "cube1", "mass", 0.1, 0.2))
    centre = {axis: {"value": 0.0, "unit": "m", "ci95": [0.0, 0.0]} for axis in "xyz"}
    heavy["effects"][0]["parameters"] |= {f"com_{axis}": row for axis, row in centre.items()}
    with pytest.raises(InputError, match="body_mass of body 'cube1', which the task draws itself"):
        DrawnProblem(push, intervals(heavy), count=2)


def test_what_does_not_fit_is_refused(push: PushProblem, drawn: DrawnProblem) -> None:
    loose = report(("backlash", "elbow", "width", 0.01, 0.02))
    with pytest.raises(InputError, match="adds joints or"):
        DrawnProblem(push, intervals(loose), count=2)
    with pytest.raises(InputError, match="does not see coulomb_friction of 'slider'"):
        LearnedWorlds(drawn, None, torch.device("cpu"))


def test_the_learned_step_sees_what_it_is_conditioned_on(push: PushProblem) -> None:
    found = report(("sliding_friction", "cube1", "coefficient", 0.1, 0.2))
    drawn = DrawnProblem(push, intervals(found), count=2)
    worlds = LearnedWorlds(drawn, None, torch.device("cpu"))
    pool = worlds.pool(drawn.draw([1]))
    column = worlds.layout.attributes.index("friction_slide")
    assert 0.1 <= float(pool.attributes[0, 0, column]) <= 0.2


def test_a_policy_is_trained_and_evaluated_in_what_was_diagnosed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("stable_baselines3")
    monkeypatch.setattr("orbisim_policies.drawn.SCENES", 2)
    path, out = tmp_path / "report.json", str(tmp_path / "p")
    path.write_text(json.dumps(FOUND))
    task, short = "suite:cartpole-swingup", ["--episode", "8", "--threads", "1"]
    words = ["train", "policy", task, "--method", "ppo", "--worlds", "2", "--steps", "256"]
    given = ["--randomize", str(path), "--check", "0", "--out", out, *short, "--device", "cpu"]
    assert run([*words, *given, "--json"]) == 0
    manifest = json.loads(capsys.readouterr().out)
    kept = manifest["randomize"]["effects"][0]
    assert kept == {
        "effect": "coulomb_friction",
        "target": "slider",
        "intervals": {"torque": [0.5, 2.0]},
    }
    words = ["eval", "policy", out, "--episodes", "2", "--seed", "0", "--model", "none", "--json"]
    values = []
    for more in ([], ["--randomize", str(path)]):
        assert run([*words, *more, "--threads", "1"]) == 0
        found = json.loads(capsys.readouterr().out)
        values.append(found["mujoco"]["reward"]["return"]["mean"])
        assert ("randomize" in found) == bool(more)
    assert values[0] != values[1]
    words = ["train", "policy", "push", "--method", "bc", "--steps", "1", "--device", "cpu"]
    assert run([*words, "--randomize", str(path), "--out", str(tmp_path / "q")]) == 2
    assert "slider" in capsys.readouterr().err
    path.write_text(json.dumps(report(("sliding_friction", "cube1", "coefficient", 0.1, 0.2))))
    assert run([*words, "--randomize", str(path), "--out", str(tmp_path / "q")]) == 2
    assert "imitates the script" in capsys.readouterr().err
