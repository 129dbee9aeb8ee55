"""tools/loop_pays.py: the machine, and the delay that randomised episodes have."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

pytest.importorskip("stable_baselines3")

PATH = Path(__file__).parents[2] / "tools" / "loop_pays.py"


@pytest.fixture(scope="module")
def tool() -> Any:
    spec = importlib.util.spec_from_file_location("loop_pays", PATH)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["loop_pays"] = module
    spec.loader.exec_module(module)
    return module


def test_an_action_comes_so_many_steps_later(tool: Any) -> None:
    problem = tool.Balance(tool.load_scene(tool.SCENE))
    command = torch.zeros(3, tool._HISTORY + 1)
    command[:, -1] = torch.tensor([0.0, 1.0, 3.0])
    forces = []
    for value in (0.5, -0.5, 0.0, 0.0):
        force, command = problem.control(command, torch.full((3, 1), value))
        forces.append(force[:, 0] / tool.MOST)
    expected = [[0.5, 0.0, 0.0], [-0.5, 0.5, 0.0], [0.0, -0.5, 0.0], [0.0, 0.0, 0.5]]
    np.testing.assert_allclose(torch.stack(forces), expected)


def test_the_machine_lacks_what_the_scene_does_not_declare(tool: Any) -> None:
    declared = tool.load_scene(tool.SCENE)
    real, effects = tool.machine(declared, 1.0, 0.06)
    assert [e.effect for e in effects] == ["coulomb_friction", "actuator_delay"]
    assert real.model.dof_frictionloss[0] == 1.0
    assert real.model.actuator_delay[0] == pytest.approx(0.06, abs=1e-4)
    assert not declared.model.dof_frictionloss.any()


def test_randomised_episodes_differ_by_seed_and_declared_ones_do_not(tool: Any) -> None:
    scene = tool.load_scene(tool.SCENE)
    drawn = tool.Balance(scene, randomise=True).draw([1, 2, 1])
    np.testing.assert_array_equal(drawn.params[0], drawn.params[2])
    assert (drawn.params[0] != drawn.params[1]).all()
    assert tool.Balance(scene).draw([1]).params.size == 0
