from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
import torch
from orbisim_policies.films import Films
from orbisim_policies.learned import LearnedWorlds
from orbisim_policies.misread import Misreading, MisreadProblem
from orbisim_policies.problem import Moment
from orbisim_policies.push import PushProblem
from orbisim_policies.rollout import acted, began, observation
from orbisim_policies.true import TrueWorlds

from tests.backends.policies.conftest import FILMED

COUNT = len(FILMED)


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
    starts = seen.numbered(push.draw(FILMED), range(COUNT))

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


def test_what_no_frame_shows_is_seen_as_nominal(push: PushProblem, films: Films) -> None:
    """And without errors nothing else is changed."""
    seen = MisreadProblem(push, films.exact)
    starts = seen.draw(FILMED)
    worlds = TrueWorlds(seen, COUNT, nthread=1)
    plain, nominal = (TrueWorlds(push, COUNT, 1, flag) for flag in (False, True))
    try:
        worlds.begin(np.arange(COUNT), starts)
        for other in (plain, nominal):
            other.begin(np.arange(COUNT), push.draw(FILMED))
        torch.testing.assert_close(worlds.observation(), nominal.observation())
        assert (worlds.observation() - plain.observation())[:, -3:].abs().min() > 1e-3
    finally:
        for each in (worlds, plain, nominal):
            each.close()


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
    starts = seen.draw(FILMED)
    assert starts.command[:, -1].tolist() == [seed % COUNT for seed in FILMED]
    worlds = TrueWorlds(seen, COUNT, nthread=1)
    plain = TrueWorlds(push, COUNT, nthread=1)
    try:
        worlds.begin(np.arange(COUNT), starts)
        plain.begin(np.arange(COUNT), push.draw(FILMED))
        action = torch.full((COUNT, 4), 0.5)
        assert not torch.equal(worlds.observation(), plain.observation())
        worlds.step(action)
        plain.step(action)
        np.testing.assert_array_equal(worlds.coordinates[0], plain.coordinates[0])
        assert torch.equal(worlds.measure(), plain.measure())
    finally:
        worlds.close()
        plain.close()


def test_a_step_makes_no_tensor_of_numbers_of_the_host(
    push: PushProblem, films: Films, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A CUDA graph cannot record what is copied from the host: iterations would take many times
    as long."""
    seen = MisreadProblem(push, films)
    starts = seen.numbered(push.draw(FILMED), range(COUNT))
    names = ("qpos", "qvel", "command", "params")
    given = {name: torch.as_tensor(getattr(starts, name)).float() for name in names}
    action = torch.zeros((COUNT, push.actions))

    def refused(*_: Any, **__: Any) -> Any:
        raise AssertionError("a tensor of numbers of the host")

    for name in ("tensor", "as_tensor", "from_numpy"):
        monkeypatch.setattr(torch, name, refused)
    qpos, qvel, command, params = given.values()
    score = seen.begin(qpos, qvel, command)
    seen.observe(Moment(qpos, qvel, command, params, score, torch.zeros(COUNT)))
    control, command = seen.control(command, action)
    score = seen.count(score, qpos, qvel, control)
    assert seen.value(score, qpos).isfinite().all()
