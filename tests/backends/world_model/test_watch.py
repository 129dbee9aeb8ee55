"""Ranges are checked at every step, in every path; worlds, steps and entities are named."""

from __future__ import annotations

import dataclasses
import shutil
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from orbisim_world_model.backend import LearnedBackend, OutsideTrainingWarning
from orbisim_world_model.entities import Entities
from orbisim_world_model.run import Run, train
from orbisim_world_model.watch import OUTSIDE

from orbisim import load_scene, make_backend
from orbisim.errors import DivergedError
from tests.backends.world_model.conftest import toy
from tests.backends.world_model.synthetic import TABLE, simulate

WAYS = ["steps", "rollout", "batch", "gradients"]
if any(map(shutil.which, ("cc", "gcc", "clang"))):
    WAYS.append("native")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("table")
    train(simulate(TABLE, 6, 30, 4), toy(), Run(out=folder, steps=30))
    return folder


def _backend(folder: Path, way: str) -> LearnedBackend:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OutsideTrainingWarning)
        name, native = f"learned:{folder}", way == "native"
        backend = make_backend(name, load_scene(TABLE), device="cpu", native=native)
    assert isinstance(backend, LearnedBackend)
    return backend


def _moves(backend: LearnedBackend, way: str, push: Callable[[Entities, int], Entities]) -> None:
    """Has the backend's step do something of our own, counted by steps."""
    count = 0
    engine, layout = backend.engine, backend.engine.layout

    def step(x: Entities, memory: Any, *_: Any) -> Any:
        nonlocal count
        count += 1
        return push(x, count), memory

    def native(qpos: Any, qvel: Any, act: Any, control: Any, memory: Any) -> Any:
        x = layout.split(*(torch.as_tensor(np.asarray(a, np.float32)) for a in (qpos, qvel, act)))
        after, _ = step(x, memory)
        return [*(a.numpy() for a in layout.join(after)), memory]

    if way == "native":
        engine.native = native
    elif way == "gradients":
        engine._step_exactly = step  # type: ignore[method-assign]
    else:
        real = engine.stepper

        class Stepper:
            model, completed = real.model, real.completed
            initial_memory, described = real.initial_memory, real.described
            __call__ = staticmethod(step)

        engine.stepper = Stepper()  # type: ignore[assignment]


def _run(backend: LearnedBackend, way: str, steps: int) -> Any:
    """The last state."""
    state = backend.reset(3 if way == "batch" else 1)
    if way in ("rollout", "batch"):
        return backend.rollout(state, np.zeros((state.nworld, steps, 2))).final
    if way == "gradients":
        qpos = torch.tensor(state.qpos, requires_grad=True)
        state = dataclasses.replace(
            state,
            **{n: torch.tensor(getattr(state, n)) for n in ("time", "qvel", "act")},
            qpos=qpos,
        )
    for _ in range(steps):
        state = backend.step(state)
    return state


@pytest.mark.parametrize("way", WAYS)
def test_leaving_the_training_data_is_noticed_at_the_step_it_happens(
    folder: Path, way: str
) -> None:
    backend = _backend(folder, way)

    def push(x: Entities, step: int) -> Entities:
        pos = x.pos.clone()
        pos[-1, 1, 0] += 20.0 if step == 4 else 0.0  # the second object of the last world
        return x._replace(pos=pos)

    _moves(backend, way, push)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        final = _run(backend, way, 6)
    found = [str(w.message) for w in said if "left the training data" in str(w.message)]
    world = 2 if way == "batch" else 0
    step = 3 if way in ("rollout", "batch") else 0  # of this call
    assert len(found) == 1, found  # once, though it stays outside
    assert f"world {world}, step {step} (t = 0.08 s), 'two' left" in found[0]
    assert "an object's x is at 19" in found[0]
    outside = np.asarray(final.memory[OUTSIDE])
    assert outside[world, 2] == pytest.approx(4 * backend.timestep)
    assert np.isinf(np.delete(outside.ravel(), 3 * world + 2)).all()


@pytest.mark.parametrize("way", WAYS)
def test_steps_within_a_held_control_are_looked_at(folder: Path, way: str) -> None:
    """An object that is far off after the second of three steps only, and lost in the fifth."""
    backend = _backend(folder, way)

    def push(x: Entities, step: int) -> Entities:
        pos = x.pos.clone()
        pos[-1, 1, 0] = 20.0 if step == 2 else 1e6 if step == 5 else 0.0
        return x._replace(pos=pos)

    _moves(backend, way, push)
    state = backend.reset(3 if way == "batch" else 1)
    if way == "gradients":
        fields = {n: torch.tensor(getattr(state, n)) for n in ("time", "qpos", "qvel", "act")}
        state = dataclasses.replace(state, **fields)
        state.qpos.requires_grad_(True)
    world, rolled = (2 if way == "batch" else 0), way in ("rollout", "batch")
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        if rolled:
            path = backend.rollout(state, np.zeros((state.nworld, 2, 2)), nstep=3)
            assert path.diverged_at.tolist() == [*[-1] * world, 1]
            assert np.isfinite(path.qpos[world, 0]).all() and np.isnan(path.qpos[world, 1]).all()
            assert path.time[0] == pytest.approx([3 * backend.timestep, 6 * backend.timestep])
            outside = path.final.memory[OUTSIDE]
        else:
            state = backend.step(state, nstep=3)
            outside = state.memory[OUTSIDE]
            with pytest.raises(DivergedError, match="'two'"):
                backend.step(state, nstep=3)
    assert np.asarray(outside)[world, 2] == pytest.approx(2 * backend.timestep)
    found = [str(w.message) for w in said if "left the training data" in str(w.message)]
    assert len(found) == 1 and f"(t = {2 * backend.timestep:g} s), 'two' left" in found[0]


def test_a_command_far_from_those_of_training_is_named(folder: Path) -> None:
    backend = _backend(folder, "rollout")
    model = backend.engine.stepper.model
    std, mean = model.see_control.std.clone(), model.see_control.mean
    controls = mean[:2].expand(2, 4, 2).double().numpy().copy()

    def said() -> list[str]:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            backend.rollout(backend.reset(2), controls)
        return [str(w.message) for w in caught if "commanded" in str(w.message)]

    assert not said()
    controls[1, 2, 1] += 20.0 * float(std[1])
    (text,) = said()
    assert "world 1, step 2 (t = 0.04 s): joint 'y' is commanded 3.4" in text


def _compiled(way: str, what: str) -> Any:
    """A step is compiled for each; one of them by default."""
    return pytest.mark.slow if way == "native" and what != "joint" else ()


@pytest.mark.parametrize(
    ("way", "what"),
    [
        pytest.param(way, what, marks=_compiled(way, what))
        for way in WAYS
        for what in ("speed", "height", "joint", "number")
    ],
)
def test_what_no_physics_allows_diverges(folder: Path, way: str, what: str) -> None:
    backend = _backend(folder, way)

    def push(x: Entities, step: int) -> Entities:
        if step != 3:
            return x
        changes = {
            "speed": {"vel": x.vel + 300.0},
            "height": {"pos": x.pos + torch.tensor([0.0, 0.0, 100.0])},
            "joint": {"q": x.q + 2.0},
            "number": {"ang": x.ang * torch.nan},
        }
        return x._replace(**changes[what])

    _moves(backend, way, push)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OutsideTrainingWarning)
        name = "robot" if what == "joint" else "one"
        if way in ("rollout", "batch"):
            state = backend.reset(2)
            path = backend.rollout(state, np.zeros((2, 5, 2)))
            assert path.diverged_at.tolist() == [2, 2]
            assert np.isfinite(path.qpos[:, :2]).all() and np.isnan(path.qpos[:, 2:]).all()
            _moves(backend, way, push)
            with pytest.raises(DivergedError, match=r"world 0 first, at step 2"):
                backend.rollout(state, np.zeros((2, 5, 2)), raise_on_divergence=True)
        else:
            with pytest.raises(DivergedError, match=f"by {name!r}"):
                _run(backend, way, 5)


def test_bounds_nest(folder: Path) -> None:
    """What `calm` lets pass, neither `outside` nor `lost` would object to."""
    guard = _backend(folder, "steps").engine.guard
    layout = guard.layout
    rng = np.random.default_rng(0)
    passed = 0
    for _ in range(2000):
        low, high = np.maximum(guard._low, -30.0), np.minimum(guard._high, 30.0)
        row = rng.uniform(low, high)
        at = rng.integers(len(row))
        row[at] += rng.choice([0.0, 0.0, 1.0, -1.0]) * rng.exponential(high[at] - low[at])
        qpos, qvel = row[None, : layout.nq], row[None, layout.nq :]
        act = np.zeros((1, 0))
        if not guard.calm(qpos, qvel, act):
            continue
        passed += 1
        x = layout.split(*(torch.as_tensor(a).float() for a in (qpos, qvel, act)))
        assert not guard.outside(x).any() and not guard.lost(x, x).any()
    assert passed > 500
