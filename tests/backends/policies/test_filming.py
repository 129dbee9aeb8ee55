from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("orbisim_diffusion")

from orbisim_mujoco.renderer import MujocoRenderer
from orbisim_policies import filming, workflows
from orbisim_policies.demonstrations import director
from orbisim_policies.evaluate import as_float
from orbisim_policies.filming import Film, film
from orbisim_policies.pixels import Sight
from orbisim_policies.push import PushProblem
from orbisim_policies.suite import SuiteProblem

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


@pytest.mark.usefixtures("drawing")
def test_films_are_kept_and_a_limit_ends_with_those_that_are_ready(
    push: PushProblem, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[int] = []

    def counted(problem: PushProblem, seed: int, *rest: Any) -> tuple[int, Film]:
        read.append(seed)
        return whole(problem, seed, *rest)

    whole = filming._read
    monkeypatch.setattr(filming, "_read", counted)
    some = film(push, [5, 6, 7], kept=tmp_path, limit=1e-6)
    assert read == [5] and list(some.seeds) == [5]
    assert some.notes["asked"] == 3
    every = film(push, [5, 6], kept=tmp_path)
    assert read == [5, 6] and list(every.seeds) == [5, 6]
    np.testing.assert_array_equal(every.qpos[0], some.qpos[0])
    with pytest.raises(InputError, match="use another folder"):
        film(push, [5], kept=tmp_path, camera="front")


@pytest.mark.usefixtures("drawing")
def test_every_frame_that_is_drawn_is_read_and_nothing_is_solved_twice(
    push: PushProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: dict[str, int] = {}
    control = PushProblem.control

    def counted(owner: type, name: str) -> None:
        whole = getattr(owner, name)

        def call(*args: Any, **named: Any) -> Any:
            calls[name] = calls.get(name, 0) + 1
            return whole(*args, **named)

        monkeypatch.setattr(owner, name, call)

    for owner, name in ((MujocoRenderer, "render"), (PushProblem, "control"), (Sight, "take")):
        counted(owner, name)
    films = film(push, [5, 6])
    assert calls["render"] == calls["take"] == 2 * push.steps
    assert calls["control"] == push.steps  # of both episodes at once
    assert films.ctrl.shape == (2, push.steps, push.scene.model.nu)
    # what the servos were given is what the commands ask for
    for t in range(push.steps):
        before, action = (as_float(values[:, t]) for values in (films.command, films.action))
        np.testing.assert_allclose(films.ctrl[:, t], control(push, before, action)[0], atol=1e-6)


@pytest.mark.usefixtures("drawing")
def test_processes_film_what_one_films(push: PushProblem) -> None:
    one, two = film(push, [5, 6]), film(push, [5, 6], workers=2)
    np.testing.assert_array_equal(one.true_qpos, two.true_qpos)
    np.testing.assert_allclose(one.qpos, two.qpos, atol=1e-5)


def test_what_has_no_script_cannot_be_filmed(cartpole: SuiteProblem) -> None:
    with pytest.raises(InputError, match="no script to film"):
        film(cartpole, [1])


OPTIONS: dict[str, Any] = {
    "episode": 3, "randomize": None, "seed": 0, "backend": None, "worlds": None, "rate": None,
    "noise": None, "horizon": 0, "observe": "stainf", "camera": "side", "films": None,
    "episodes": 1, "film_limit": None, "errors": True, "steps": 1, "check": 0, "threads": 1,
    "device": "cpu",
}  # fmt: skip


@pytest.mark.usefixtures("drawing")
def test_a_training_films_first_and_keeps_what_it_has_read(tmp_path: Path) -> None:
    options = {**OPTIONS, "out": tmp_path / "bc", "episodes": 2, "film_limit": 1e-6}
    manifest = workflows.train("task:push", "bc", options, lambda _: None)
    assert manifest["films"]["episodes"] == 1 and manifest["films"]["asked"] == 2
    assert manifest["films"]["observe"] == "stainf"
    # no window of a second is that short, so that all stays nominal
    assert manifest["films"]["phyinf"]["windows"] == 0
    path = tmp_path / "bc" / workflows.FILMS
    assert not (tmp_path / "bc" / workflows.FILMED).exists()
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
