"""dm_control's suite, with backends and renderers that can be chosen."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from dm_control import suite as _suite
from dm_control.rl import control

from orbisim.backend import Backend
from orbisim.episodes import Episodes
from orbisim.errors import UnknownNameError
from orbisim.host.engine_log import without_warnings
from orbisim.physics import adopt
from orbisim.renderer import Renderer
from orbisim.scene import Scene
from orbisim.state import State

ALL_TASKS: tuple[tuple[str, str], ...] = tuple(_suite.ALL_TASKS)
"""Every (domain, task) of the suite."""

BENCHMARKING: tuple[tuple[str, str], ...] = tuple(_suite.BENCHMARKING)
"""The (domain, task) pairs that dm_control tags as benchmarks."""


def load(
    domain_name: str,
    task_name: str,
    task_kwargs: Mapping[str, Any] | None = None,
    environment_kwargs: Mapping[str, Any] | None = None,
    visualize_reward: bool = False,
    backend: str | Backend = "mujoco",
    renderer: str | Renderer = "mujoco",
) -> control.Environment:
    """Loads a task of the suite as dm_control does, to be stepped by any backend.

    Args:
      domain_name: a domain of the suite (`cheetah`).
      task_name: one of its tasks (`run`).
      task_kwargs: passed to the task (`{"random": 0}` for a seed).
      environment_kwargs: passed to the environment (`{"flat_observation": True}`).
      visualize_reward: whether object colours show the reward.
      backend: see `Physics.use_backend`.
      renderer: see `Physics.use_renderer`.

    Raises:
      UnknownNameError: no such domain, task, backend or renderer.
      UnsupportedSceneError: the backend cannot simulate the task's scene.
    """
    check_name(domain_name, task_name)
    environment = make_environment(
        domain_name,
        task_name,
        task_kwargs=dict(task_kwargs or {}),
        environment_kwargs=dict(environment_kwargs or {}),
        visualize_reward=visualize_reward,
    )
    physics = adopt(environment.physics)
    physics.use_backend(backend)
    physics.use_renderer(renderer)
    return environment


def make_environment(domain_name: str, task_name: str, **kwargs: Any) -> control.Environment:
    """dm_control's own environment, made without a word on what its scene files declare: some have
    attributes that MuJoCo is about to drop, and users cannot change them."""
    with without_warnings("is deprecated"):
        return _suite.load(domain_name, task_name, **kwargs)


def load_scene(name: str) -> Scene:
    """The scene of a task, by `domain-task` (`cheetah-run`).

    Raises:
      UnknownNameError: no such task.
    """
    domain, task = split_name(name)
    environment = make_environment(domain, task, task_kwargs={"random": 0})
    return Scene.from_model(environment.physics.model.ptr, source=f"suite:{name}")


def episodes(name: str, count: int, seed: int) -> Episodes:
    """Initial states that a task itself draws, on the model of its first episode.

    Args:
      name: `domain-task`. count: number of episodes. seed: of the task.

    Raises:
      UnknownNameError: no such task.
    """
    environment = load(*split_name(name), task_kwargs={"random": seed})
    physics = environment.physics
    states: list[State] = []
    scene = None
    for _ in range(count):
        environment.reset()
        scene = scene or Scene.from_model(physics.model.ptr, source=f"suite:{name}")
        state: State = physics.snapshot()
        states.append(state.replace(time=np.zeros(1)))
    assert scene is not None
    return Episodes(dataclasses.replace(scene, name=name), State.stack(states))


def split_name(name: str) -> tuple[str, str]:
    """`cheetah-run` as (`cheetah`, `run`).

    Raises:
      UnknownNameError: no such task.
    """
    domain, _, task = name.partition("-")
    if (domain, task) not in ALL_TASKS:
        known = [f"{d}-{t}" for d, t in ALL_TASKS]
        raise UnknownNameError("task of the suite", name, known, "write domain-task")
    return domain, task


def check_name(domain: str, task: str) -> None:
    """Raises `UnknownNameError` unless the suite has this task in this domain."""
    domains = {d for d, _ in ALL_TASKS}
    if domain not in domains:
        raise UnknownNameError("domain of the suite", domain, domains)
    tasks = {t for d, t in ALL_TASKS if d == domain}
    if task not in tasks:
        raise UnknownNameError(f"task of domain {domain!r}", task, tasks)
