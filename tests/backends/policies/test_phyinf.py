from __future__ import annotations

import copy
import dataclasses
from typing import Any

import numpy as np
import pytest
import torch
from orbisim_policies import phyinf
from orbisim_policies.demonstrations import director
from orbisim_policies.evaluate import as_float
from orbisim_policies.films import Films
from orbisim_policies.push import HIDDEN, PushProblem
from orbisim_policies.suite import SuiteProblem
from orbisim_policies.true import TrueWorlds

from orbisim.errors import InputError
from orbisim.identification.parameters import parameters
from orbisim.scene import Scene


def exact(problem: PushProblem, seeds: list[int]) -> Films:
    """The script's episodes, read without errors and without pixels."""
    starts = problem.draw(seeds)
    scripts, rows = [director(problem, seed) for seed in seeds], []
    worlds = TrueWorlds(problem, len(seeds), nthread=1)
    command = as_float(starts.command)
    try:
        worlds.begin(np.arange(len(seeds)), starts)
        for _ in range(problem.steps):
            action = torch.as_tensor(np.array([one.action() for one in scripts])).float()
            control, after = problem.control(command, action)
            given = (control.double().numpy(), command.double().numpy(), action.double().numpy())
            rows.append((*worlds.coordinates, *given))
            command = after
            worlds.step(action)
    finally:
        worlds.close()
    qpos, qvel, ctrl, before, actions = (np.stack(c, 1) for c in zip(*rows, strict=True))
    params = problem.unseen(as_float(starts.params)).double().numpy()
    each: dict[str, Any] = {"qpos": qpos, "qvel": qvel, "ctrl": ctrl, "command": before}
    return Films(
        np.array(seeds), np.ones(len(seeds), bool), qpos, qvel, **each,
        seen=np.ones((*qpos.shape[:2], 2), bool), action=actions, params=params, notes={},
    )  # fmt: skip


@pytest.mark.slow
def test_what_no_frame_shows_is_inferred_where_cubes_move(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(phyinf, "_STEPS", 4)  # of the search: enough to see where it goes
    problem = PushProblem()
    films = exact(problem, [3])
    still = dataclasses.replace(
        films, **{n: np.repeat(getattr(films, n)[:, :1], 64, 1) for n in ("qpos", "qvel", "ctrl")}
    )
    arrays = {
        name: np.concatenate([values, still.arrays[name]]) for name, values in films.arrays.items()
    }
    both = Films(**arrays, notes={})
    found = phyinf.inferred(problem, both, "push_contacts", "cpu")
    columns = list(HIDDEN.values())
    np.testing.assert_array_equal(found.params[1], both.params[1])  # nothing moves there
    assert found.notes["phyinf"]["moving"] == 1
    moved = found.params[0, columns]
    assert (moved != both.params[0, columns]).all() and (moved > 0).all()
    # friction, from exact states, comes nearer than the nominal one
    true = problem.draw([3]).params[0, 6]
    off = [abs(np.log(p[0, 6] / true)) for p in (both.params, found.params)]
    assert off[1] < off[0], off
    # sizes, and the cubes' own friction, are left as they are
    np.testing.assert_array_equal(found.params[:, [0, 1, 4, 5]], both.params[:, [0, 1, 4, 5]])


def test_films_that_are_short_leave_all_nominal(push: PushProblem, films: Films) -> None:
    found = phyinf.inferred(push, films, "push_contacts", "cpu")
    np.testing.assert_array_equal(found.params, films.params)
    notes = found.notes["phyinf"]
    assert notes["windows"] == notes["moving"] == 0
    for off in notes["off_percent"].values():
        assert off["nominal"] == off["inferred"] > 0


def test_other_tasks_have_nothing_to_infer(cartpole: SuiteProblem, films: Films) -> None:
    with pytest.raises(InputError, match="nothing can be inferred"):
        phyinf.inferred(cartpole, films, None, "cpu")


def test_hidden_parameters_are_where_they_are_said_to_be(push: PushProblem) -> None:
    starts, model = push.draw([5]), copy.copy(push.model)
    push.write(model, starts.params[0])
    scene = Scene.from_model(model, source="written")
    for parameter in parameters(scene, list(HIDDEN)):
        expected = starts.params[0][HIDDEN[parameter.label]]
        assert parameter.declared == pytest.approx(expected, rel=1e-6), parameter.label
