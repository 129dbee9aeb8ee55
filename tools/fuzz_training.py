"""Kinds of what trainings leave, for `fuzz_files`: how to write, damage and read it."""

from __future__ import annotations

import functools
import json
import random
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from fuzz_mutations import BYTES
from fuzz_values import damage_safetensors, damaged_json

sys.path.insert(0, str(Path(__file__).parent.parent))
from orbisim.errors import DivergedError
from orbisim.registry import make_backend, make_renderer

_STEPS = 3

# -- an unfinished training of dynamics ----------------------------------------------------------


@functools.cache
def _pack() -> Any:
    from orbisim.testing.scenes import CARTPOLE
    from tests.backends.world_model.synthetic import simulate

    return simulate(CARTPOLE, 3, 12, 1)


def _train(folder: Path, resume: bool) -> None:
    from orbisim_world_model.run import Run, train

    from tests.backends.world_model.conftest import toy

    small = toy(model__width=8, model__layers=1, model__heads=1)
    train(_pack(), small, Run(out=folder, steps=_STEPS, horizons=(1,), burn=0, resume=resume))


def _make_progress(folder: Path) -> None:
    _train(folder, resume=False)
    for path in folder.iterdir():
        if path.name not in ("training.safetensors", "metrics.jsonl"):
            path.unlink()


def _damage_progress(folder: Path, rng: random.Random) -> None:
    if rng.random() < 0.7:
        damage_safetensors(folder / "training.safetensors", rng)
        return
    path = folder / "metrics.jsonl"
    lines = path.read_text().splitlines()
    number = rng.randrange(len(lines))
    lines[number] = damaged_json(json.loads(lines[number]), rng)
    path.write_text("\n".join(lines) + "\n")


def _read_progress(folder: Path) -> None:
    _train(folder, resume=True)


# -- vision --------------------------------------------------------------------------------------


@functools.cache
def _arm() -> Any:
    from tests.backends.diffusion.tiny import arm

    return arm()


def _make_vision(folder: Path) -> None:
    from tests.backends.diffusion.tiny import save_tiny

    save_tiny(folder, _arm())


def _damage_vision(folder: Path, rng: random.Random) -> None:
    from orbisim_diffusion.checkpoint import MANIFEST, digest

    manifest = folder / MANIFEST
    document = json.loads(manifest.read_text())
    if rng.random() < 0.5:
        manifest.write_text(damaged_json(document, rng))
        return
    name = rng.choice(sorted(document["files"]))
    path = folder / f"{name}.safetensors"
    if rng.random() < 0.3:
        path.write_bytes(rng.choice(BYTES)(path.read_bytes() or b"\n", rng))
    else:
        damage_safetensors(path, rng)
    if rng.random() < 0.9:  # else it is refused for its hash already
        document["files"][name]["sha256"] = digest(path)
        manifest.write_text(json.dumps(document))


def _read_vision(folder: Path) -> None:
    renderer = make_renderer("diffusion", _arm(), argument=str(folder), device="cpu")
    try:
        renderer.render(make_backend("mujoco", _arm()).reset(), camera="side", height=32, width=32)
    except DivergedError:
        return  # the weights were read, and what they lead to was said


def _loop(folder: Path, steps: int) -> None:
    import torch
    from orbisim_diffusion.config import TrainConfig
    from orbisim_diffusion.loop import Loop

    torch.manual_seed(0)
    layer = torch.nn.Linear(3, 2)
    loop = Loop(layer, TrainConfig(warmup=1), 1e6, folder / "progress.safetensors", steps)
    loop.run(lambda _: (layer(torch.ones(4, 3)) ** 2).mean(), report=lambda _: None)


def _make_loop(folder: Path) -> None:
    _loop(folder, _STEPS)


def _damage_loop(folder: Path, rng: random.Random) -> None:
    damage_safetensors(folder / "progress.safetensors", rng)


def _read_loop(folder: Path) -> None:
    _loop(folder, _STEPS + 2)


# -- PhyInf, a part of a vision checkpoint -------------------------------------------------------


@functools.cache
def _push() -> Any:
    from orbisim.tasks import make

    return make("push").scene("push", 0)


def _make_physics(folder: Path) -> None:
    import torch
    from orbisim_diffusion.checkpoint import PHYSICS, add_part
    from orbisim_diffusion.physics import PhysicsInference

    _make_vision(folder)
    torch.manual_seed(0)
    network, model = PhysicsInference(), _push().model
    network.know(torch.tensor([0.2, 0.3, 0.6]), torch.tensor([150.0, 400.0, 900.0]))
    joints = [model.joint(j).name for j in range(model.njnt) if model.jnt_type[j] >= 2]
    reach = {"joints": joints, "hand": "tcp", "surface": "table", "timestep": 0.05}
    reach |= {"half": [0.02, 0.032], "dynamics": "push", "sha256": 64 * "0"}
    add_part(folder, PHYSICS, network, {}, reach)


def _read_physics(folder: Path) -> None:
    from orbisim_diffusion.estimate_physics import has_physics, infer_physics, load_physics

    if has_physics(folder):
        network, reach = load_physics(folder)
        said = infer_physics(_push(), [_still()], network, reach)
        assert all(np.isfinite([one.low, one.value, one.high]).all() for one in said.values())
    else:
        load_physics(folder)


@functools.cache
def _still() -> Any:
    from orbisim.recording import Recording

    qpos = np.tile(_push().model.key_qpos[0], (70, 1))
    return Recording(0.05 * np.arange(70), {"qpos": qpos})


# -- films that policies are trained from --------------------------------------------------------


@functools.cache
def _filmed() -> Any:
    from orbisim_policies.push import PushProblem

    return PushProblem(steps=3)


def _make_films(folder: Path) -> None:
    from orbisim_policies.films import Films

    problem = _filmed()
    starts = problem.draw([0, 1])

    def each(values: Any) -> Any:
        return np.repeat(values[:, None], problem.steps, axis=1)

    places, speeds, ctrl, command = map(
        each, (starts.qpos, starts.qvel, starts.ctrl, starts.command)
    )
    seen, done = np.ones((2, problem.steps, 2), bool), np.array([True, False])
    action = np.zeros((2, problem.steps, problem.actions))
    notes = {"task": problem.name, "observe": "stainf", "camera": "side"}
    films = Films(
        np.arange(2), done, places, speeds, places, speeds, seen, ctrl, command, action,
        starts.params, notes,
    )  # fmt: skip
    films.save(folder / "films.safetensors")


def _damage_films(folder: Path, rng: random.Random) -> None:
    damage_safetensors(folder / "films.safetensors", rng)


def _read_films(folder: Path) -> None:
    from orbisim_policies.films import Films
    from orbisim_policies.misread import MisreadProblem

    problem = _filmed()
    films = Films.load(folder / "films.safetensors", problem)
    films.demonstrations(problem)
    seen = MisreadProblem(problem, films)
    seen.numbered(films.starts(), range(len(films)))


PARTS: dict[str, tuple[Callable[..., Any], Callable[..., Any], Callable[..., Any], str]] = {
    "progress": (_make_progress, _damage_progress, _read_progress, "*"),
    "vision": (_make_vision, _damage_vision, _read_vision, "*.json"),
    "vision_progress": (_make_loop, _damage_loop, _read_loop, "*"),
    "physics": (_make_physics, _damage_vision, _read_physics, "*.json"),
    "films": (_make_films, _damage_films, _read_films, "*"),
}
"""How to make, damage and read each kind, and which files have their bytes damaged."""
