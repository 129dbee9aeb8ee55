from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from orbisim_policies.films import Films
from orbisim_policies.learned import LearnedWorlds
from orbisim_policies.misread import Misreading, MisreadProblem
from orbisim_policies.problem import Moment
from orbisim_policies.push import HIDDEN, PushProblem
from orbisim_policies.rollout import acted, began, observation
from orbisim_policies.run import Run, train_apg, train_clone
from orbisim_policies.true import TrueWorlds

from orbisim.errors import InputError

COUNT = 3
SEEDS = [11, 12, 13]


def shaken(push: PushProblem, rng: np.random.Generator) -> Films:
    """Films of arms that stand still, read with errors that are known."""
    starts = push.draw(SEEDS)
    nq, nv = starts.qpos.shape[1], starts.qvel.shape[1]

    def each(values: Any) -> Any:
        return np.repeat(values[:, None], push.steps, axis=1)

    true = each(starts.qpos)
    read = true + rng.normal(0, 0.003, true.shape)
    for a in (11, 18):  # quaternions of the cubes
        read[..., a : a + 4] /= np.linalg.norm(read[..., a : a + 4], axis=-1, keepdims=True)
    params = push.unseen(torch.as_tensor(starts.params)).double().numpy()
    return Films(
        seeds=np.array(SEEDS),
        success=np.array([True, False, True]),
        true_qpos=true,
        true_qvel=np.zeros((COUNT, push.steps, nv)),
        qpos=read,
        qvel=rng.normal(0, 0.05, (COUNT, push.steps, nv)),
        seen=np.ones((COUNT, push.steps, 2), bool),
        ctrl=each(starts.ctrl),
        command=each(starts.command),
        action=rng.uniform(-1, 1, (COUNT, push.steps, push.actions)),
        params=params,
        notes={"task": push.name, "observe": "stainf", "camera": "side"},
    )


@pytest.fixture
def films(push: PushProblem) -> Films:
    return shaken(push, np.random.default_rng(0))


def test_states_are_seen_as_the_film_was_read(push: PushProblem, films: Films) -> None:
    misreading = Misreading(push.scene.model, films)
    for film in range(COUNT):
        for step in range(push.steps):
            given = (torch.as_tensor(films.true_qpos[film, step])[None].float(),)
            number, at = torch.tensor([float(film)]), torch.tensor([float(step)])
            speed = torch.zeros((1, films.qvel.shape[-1]))
            qpos, qvel = misreading.seen(*given, speed, number, at)
            np.testing.assert_allclose(qpos[0], films.qpos[film, step], atol=1e-6)
            np.testing.assert_allclose(qvel[0], films.qvel[film, step], atol=1e-6)


def test_errors_of_turns_are_those_of_the_body(push: PushProblem, films: Films) -> None:
    """A cube that is read as turned by an angle is seen as turned by it, however it stands."""
    turn = np.array([np.cos(0.2), 0.0, 0.0, np.sin(0.2)])  # 0.4 rad about the vertical
    read = np.array(films.true_qpos)
    read[..., 11:15] = turn
    read[..., 18:22] = films.true_qpos[..., 18:22]
    true = np.array(films.true_qpos)
    true[..., 11:15] = [1.0, 0.0, 0.0, 0.0]
    misreading = Misreading(push.scene.model, dataclasses.replace(films, qpos=read, true_qpos=true))
    qpos = torch.as_tensor(films.true_qpos[0, :1]).float()
    qpos[0, 11:15] = torch.tensor([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])  # a quarter
    zero = torch.zeros(1)
    seen, _ = misreading.seen(qpos, torch.zeros((1, 20)), zero, zero)
    half = (np.pi / 2 + 0.4) / 2
    np.testing.assert_allclose(seen[0, 11:15], [np.cos(half), 0, 0, np.sin(half)], atol=1e-6)


def test_a_policy_sees_what_the_film_shows_and_is_paid_for_what_is_true(
    push: PushProblem, films: Films
) -> None:
    """Along the film's own states, observations are those that are imitated; the reward is the
    plain problem's."""
    seen = MisreadProblem(push, films)
    shown = films.demonstrations(push)
    views = shown.observations.reshape(COUNT, push.steps, -1)
    starts = seen.numbered(push.draw(SEEDS), range(COUNT))

    def put(values: Any) -> torch.Tensor:
        return torch.as_tensor(values).float()

    command, params = put(starts.command), put(starts.params)
    score = seen.begin(put(films.true_qpos[:, 0]), put(films.true_qvel[:, 0]), command)
    plain = push.begin(put(films.true_qpos[:, 0]), put(films.true_qvel[:, 0]), command[:, :-1])
    for t in range(push.steps):
        true = put(films.true_qpos[:, t]), put(films.true_qvel[:, t])
        ctrl = put(films.ctrl[:, t])
        if t:
            score, plain = (
                seen.count(score, *true, ctrl),
                push.count(plain, *true, ctrl),
            )
        time = torch.full((COUNT,), t / push.steps)
        found = seen.observe(Moment(*true, command, params, score, time))
        torch.testing.assert_close(found, views[:, t], atol=2e-4, rtol=1e-4)
        exact = push.observe(Moment(*true, command[:, :-1], params, plain, time))
        assert (found - exact).abs().max() > 0.01
    torch.testing.assert_close(seen.value(score, true[0]), push.value(plain, true[0]))
    _, after = seen.control(command, torch.ones((COUNT, 4)))
    torch.testing.assert_close(after[:, -1], command[:, -1])


def test_gradients_run_through_what_is_seen(push: PushProblem, films: Films) -> None:
    seen = MisreadProblem(push, films)
    worlds = LearnedWorlds(seen, None, torch.device("cpu"))
    now = began(worlds, worlds.pool(seen.numbered(films.starts(), range(COUNT))))
    np.testing.assert_allclose(worlds.coordinates(now.x)[0], films.qpos[:, 0], atol=1e-3)

    def policy(view: torch.Tensor, noise: torch.Tensor) -> torch.Tensor:
        return view[:, :4] * weight + noise

    weight = torch.ones(4, requires_grad=True)
    now, _ = acted(worlds, policy, now, torch.zeros((COUNT, 4)), 0.1)  # type: ignore[arg-type]
    observation(worlds, now).sum().backward()
    assert weight.grad is not None and weight.grad.isfinite().all() and weight.grad.any()


def test_true_worlds_show_the_same_errors(push: PushProblem, films: Films) -> None:
    seen = MisreadProblem(push, films)
    starts = seen.draw(SEEDS)
    assert starts.command[:, -1].tolist() == [seed % COUNT for seed in SEEDS]
    worlds = TrueWorlds(seen, COUNT, nthread=1)
    plain = TrueWorlds(push, COUNT, nthread=1)
    try:
        worlds.begin(np.arange(COUNT), starts)
        plain.begin(np.arange(COUNT), push.draw(SEEDS))
        action = torch.full((COUNT, 4), 0.5)
        assert not torch.equal(worlds.observation(), plain.observation())
        worlds.step(action)
        plain.step(action)
        np.testing.assert_array_equal(worlds.coordinates[0], plain.coordinates[0])
        assert torch.equal(worlds.measure(), plain.measure())
    finally:
        worlds.close()
        plain.close()


def test_films_come_back_and_damaged_ones_are_refused(
    push: PushProblem, films: Films, tmp_path: Path
) -> None:
    path = tmp_path / "films.safetensors"
    films.save(path)
    again = Films.load(path, push)
    assert again.notes == films.notes and again.digest == films.digest
    for name, values in films.arrays.items():
        np.testing.assert_array_equal(getattr(again, name), values)
    with pytest.raises(InputError, match="4 steps"):
        Films.load(path, PushProblem(steps=4))
    dataclasses.replace(films, ctrl=films.ctrl[:, :-1]).save(path)
    with pytest.raises(InputError, match="ctrl has shape"):
        Films.load(path, push)
    path.write_bytes(b"no films")
    with pytest.raises(InputError, match="damaged"):
        Films.load(path, push)


@pytest.mark.parametrize("errors", [True, False])
def test_a_training_from_films_goes_on_exactly(
    push: PushProblem, films: Films, tmp_path: Path, errors: bool
) -> None:
    from orbisim_policies.apg import ApgConfig
    from orbisim_policies.cloning import CloneConfig

    films = dataclasses.replace(films, notes={**films.notes, "asked": COUNT})
    own: dict[str, Any] = {"films": films, "errors": errors, "check": 2, "nthread": 1}
    clone = train_clone(push, CloneConfig(batch=8), Run(tmp_path / "bc", steps=3, **own))
    assert clone["true_steps"] == COUNT * push.steps
    assert clone["films"]["digest"] == films.digest and clone["films"]["errors"] is errors
    config = ApgConfig(batch=2)
    begun: dict[str, Any] = {**own, "start": tmp_path / "bc"}
    whole = train_apg(push, config, Run(tmp_path / "whole", steps=2, **begun))
    train_apg(push, config, Run(tmp_path / "parts", steps=1, **begun))
    parts = train_apg(push, config, Run(tmp_path / "parts", steps=2, resume=True, **begun))
    # the films' steps are counted once: the clone has seen the same
    assert whole["true_steps"] == parts["true_steps"] > COUNT * push.steps
    one, other = ((tmp_path / n / "training.safetensors") for n in ("whole", "parts"))
    from safetensors.torch import load_file

    for name, tensor in load_file(str(one)).items():
        assert torch.equal(tensor, load_file(str(other))[name]), name


def test_hidden_parameters_are_where_they_are_said_to_be(push: PushProblem) -> None:
    import copy

    from orbisim.identification.parameters import parameters

    starts, model = push.draw([5]), copy.copy(push.model)
    push.write(model, starts.params[0])
    from orbisim.scene import Scene

    scene = Scene.from_model(model, source="written")
    for parameter in parameters(scene, list(HIDDEN)):
        expected = starts.params[0][HIDDEN[parameter.label]]
        assert parameter.declared == pytest.approx(expected, rel=1e-6), parameter.label
