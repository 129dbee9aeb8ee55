from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

pytest.importorskip("orbisim_diffusion")

from orbisim_policies import pixels
from orbisim_policies.pixels import Played, Sight, evaluate_pixels, play
from orbisim_policies.push import PushProblem

from orbisim import State
from orbisim.errors import InputError
from orbisim.registry import make_renderer

pytestmark = pytest.mark.usefixtures("software_rendering")


@pytest.fixture
def software_rendering() -> None:
    """Skips where nothing can be drawn."""
    from orbisim.host import gl

    if not gl.available_platforms():
        pytest.skip("no OpenGL here")


def still(view: torch.Tensor) -> torch.Tensor:
    return torch.zeros((len(view), 4))


def test_an_episode_is_mujocos_and_states_are_those_of_the_frames(push: PushProblem) -> None:
    seen = []

    def watched(view: torch.Tensor) -> torch.Tensor:
        seen.append(view)
        return still(view)

    (played,) = play(push, watched, [5], "side", "stainf")
    assert len(seen) == push.steps and played.off.shape == (push.steps, 2)
    _, starts = push.trials(1, 5)
    np.testing.assert_allclose(played.qpos, starts.qpos[0], atol=0.02)  # nothing was done
    assert not played.lost and played.turned.max() < 0.2
    # of densities and friction it sees the middle of what is drawn, of sizes the true ones
    assert not seen[0][:, -3:].any() and seen[0][:, -5:-3].abs().sum() > 0


def test_episodes_in_lockstep_are_those_that_are_played_alone(push: PushProblem) -> None:
    def towards(view: torch.Tensor) -> torch.Tensor:
        return -view[:, 9:13].clamp(-1, 1)  # depends on what was read, and on nothing else

    together = play(push, towards, [5, 6], "side", "stainf")
    for one, seed in zip(together, [5, 6], strict=True):
        (alone,) = play(push, towards, [seed], "side", "stainf")
        assert one.off.shape == alone.off.shape == (push.steps, 2)
        np.testing.assert_allclose(one.off, alone.off, atol=1e-4)  # m
        np.testing.assert_allclose(one.qpos, alone.qpos, atol=1e-4)
        np.testing.assert_allclose(one.value, alone.value, atol=1e-3)
    assert np.abs(together[0].qpos - together[1].qpos).max() > 0.01


def test_an_episode_that_diverges_ends_alone(push: PushProblem) -> None:
    def odd(view: torch.Tensor) -> torch.Tensor:
        action = still(view)
        action[0] = torch.nan
        return action

    first, second = play(push, odd, [5, 6], "side", "stainf")
    _, starts = push.trials(1, 5)
    assert first.lost and len(first.off) == 1 and not first.value.any()
    np.testing.assert_array_equal(first.qpos, starts.qpos[0])
    assert not second.lost and len(second.off) == push.steps and second.value.any()


@pytest.mark.parametrize(
    ("how", "device", "sizes"),
    [("stainf", "cuda", [32, 18]), ("objects", "cuda", [1] * 50), ("stainf", "cpu", [1] * 50)],
)
def test_frames_are_read_together_where_a_gpu_reads_them(
    how: str, device: str, sizes: list[int]
) -> None:
    groups = pixels._groups(range(50), 1, how, device)
    assert [len(group) for group in groups] == sizes
    assert [seed for group in groups for seed in group] == list(range(50))
    assert pixels.processes(14, device) == (14 if device == "cpu" else 4)


def test_a_report_says_how_far_off_states_were(push: PushProblem) -> None:
    found = evaluate_pixels(push, still, [5], how="stainf")
    assert found["episodes"] == 1 and found["success"]["moved"]["share"] == 0.0
    states = found["states"]
    assert 0 < states["bodies_mm"]["median"] <= states["bodies_mm"]["worst"]
    assert states["joints_rad"]["median"] > 0 and states["seen"] == 1.0


def test_episodes_that_are_kept_are_not_played_again(
    push: PushProblem, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []

    def played(problem: PushProblem, policy: object, seeds: list[int], *_: object) -> list[Played]:
        (seed,) = seeds
        calls.append(seed)
        qpos = problem.trials(1, seed)[1].qpos[0]
        off = np.full((2, 2), 1e-3 * seed)
        value = np.zeros(len(problem.parts))
        return [Played(qpos, value, seed == 6, off, np.zeros(2), np.ones((2, 2), bool))]

    monkeypatch.setattr(pixels, "play", played)
    how: Any = {"how": "stainf", "kept": tmp_path, "label": "push"}
    first = evaluate_pixels(push, still, [5], **how)
    second = evaluate_pixels(push, still, [5, 6], **how)
    assert calls == [5, 6]
    assert (first["episodes"], second["episodes"]) == (1, 2)
    assert (first["diverged"], second["diverged"]) == (0, 1)
    assert second["states"]["bodies_mm"]["worst"] == pytest.approx(6.0)
    with pytest.raises(InputError, match="use another folder"):
        evaluate_pixels(push, still, [5], **(how | {"label": "push_ppo"}))


@pytest.mark.slow
def test_the_fit_makes_states_better(push: PushProblem) -> None:
    scene, starts = push.trials(1, 5)
    renderer = make_renderer("mujoco", scene)
    state = State(np.zeros(1), starts.qpos, starts.qvel, np.zeros((1, 0)))
    camera = int(scene.model.camera("side").id)
    joints, off = starts.qpos[0, :8], []
    for how in ("stainf", "infer", "objects"):
        sight = Sight(scene, camera, push.timestep, how)
        image = renderer.render(state, camera=camera, height=sight.size, width=sight.size)
        frame = np.asarray(image).reshape(sight.size, sight.size, 3)
        qpos, qvel, seen = sight.see(frame, joints)
        bodies = [body.qpos for body in sight.refiner.bodies]
        miss = [np.linalg.norm(qpos[b : b + 3] - starts.qpos[0, b : b + 3]) for b in bodies]
        off.append(np.array(miss)[seen].max())
        assert not qvel.any()  # of the first frame nothing is known
        again, speed, _ = sight.see(frame, joints)
        np.testing.assert_allclose(speed[-6:-3], (again - qpos)[-7:-4] / push.timestep, atol=1e-9)
    renderer.close()
    assert max(off[1:]) < 0.001 < off[0]
    assert pixels._network.cache_info().currsize == 1
