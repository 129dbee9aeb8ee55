from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

pytest.importorskip("orbisim_diffusion")

from orbisim_policies import phyinf, workflows
from orbisim_policies.demonstrations import director
from orbisim_policies.evaluate import as_float
from orbisim_policies.filming import film
from orbisim_policies.films import Films
from orbisim_policies.push import HIDDEN, PushProblem
from orbisim_policies.suite import SuiteProblem
from orbisim_policies.true import TrueWorlds

from orbisim.errors import InputError


@pytest.fixture
def drawing() -> None:
    """Skips where nothing can be drawn."""
    from orbisim.host import gl

    if not gl.available_platforms():
        pytest.skip("no OpenGL here")


@pytest.mark.usefixtures("drawing")
def test_a_film_is_of_the_script_and_is_read_frame_by_frame(push: PushProblem) -> None:
    films = film(push, [5])
    starts = push.draw([5])
    assert films.qpos.shape == (1, push.steps, push.scene.model.nq)
    np.testing.assert_allclose(films.true_qpos[0, 0], starts.qpos[0], atol=1e-9)
    np.testing.assert_array_equal(films.command[0, 0], as_float(starts.command)[0].double())
    np.testing.assert_allclose(films.action[0, 0], director(push, 5).action(), atol=1e-6)
    off = np.abs(films.qpos - films.true_qpos)
    assert 0 < off[..., :6].max() < 0.1 and 0 < off[..., 8:11].max() < 0.05
    assert not films.qvel[0, 0].any() and films.qvel[0, 1].any()
    # of what no frame shows nothing is known; sizes are declared
    np.testing.assert_array_equal(films.params[0, :2], as_float(starts.params)[0, :2].double())
    assert not np.isclose(films.params[0, 2], starts.params[0, 2])
    told = films.notes["off"]["bodies_mm"]
    assert 0 < told["median"] <= told["worst"] < 50
    begins = films.starts()
    np.testing.assert_array_equal(begins.qpos[0], films.qpos[0, 0])
    assert not begins.qvel.any()


def test_what_has_no_script_cannot_be_filmed(cartpole: SuiteProblem) -> None:
    with pytest.raises(InputError, match="no script to film"):
        film(cartpole, [1])


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


OPTIONS: dict[str, Any] = {
    "episode": 3, "randomize": None, "seed": 0, "backend": None, "worlds": None, "rate": None,
    "noise": None, "horizon": 0, "observe": "stainf", "camera": "side", "films": None,
    "episodes": 1, "errors": True, "steps": 1, "check": 0, "threads": 1, "device": "cpu",
}  # fmt: skip


@pytest.mark.usefixtures("drawing")
def test_a_training_films_first_and_keeps_what_it_has_read(tmp_path: Path) -> None:
    options = {**OPTIONS, "out": tmp_path / "bc"}
    manifest = workflows.train("task:push", "bc", options, lambda _: None)
    assert manifest["films"]["episodes"] == 1 and manifest["films"]["observe"] == "stainf"
    # no window of a second is that short, so that all stays nominal
    assert manifest["films"]["phyinf"]["windows"] == 0
    path = tmp_path / "bc" / workflows.FILMS
    again = {**options, "out": tmp_path / "again", "films": path}
    other = workflows.train("task:push", "bc", again, lambda _: None)
    assert other["films"] == manifest["films"]
    with pytest.raises(InputError, match="read by stainf off camera side"):
        wrong = {**again, "out": tmp_path / "wrong", "observe": "objects"}
        workflows.train("task:push", "bc", wrong, lambda _: None)


@pytest.mark.parametrize(
    ("method", "options", "said"),
    [
        ("ppo", {}, "for --method apg and bc"),
        ("bc", {"steps": None}, "needs a budget"),
    ],
)
def test_what_does_not_go_together_is_refused_before_a_film(
    tmp_path: Path, method: str, options: dict[str, Any], said: str
) -> None:
    given = {**OPTIONS, "out": tmp_path, **options}
    with pytest.raises(InputError, match=said):
        workflows.train("task:push", method, given, lambda _: None)
