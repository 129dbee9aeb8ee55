from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("orbisim_diffusion")

from orbisim_policies import workflows
from orbisim_policies.demonstrations import director
from orbisim_policies.evaluate import as_float
from orbisim_policies.filming import film
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


def test_what_has_no_script_cannot_be_filmed(cartpole: SuiteProblem) -> None:
    with pytest.raises(InputError, match="no script to film"):
        film(cartpole, [1])


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
