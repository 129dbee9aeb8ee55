"""What the backend `hybrid` is trained on: recordings, and MuJoCo's own predictions for them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from orbisim.errors import InputError
from orbisim.registry import make_backend
from orbisim.scene import Scene, load_scene, named_scene
from orbisim.state import State
from orbisim_world_model.fitting import robot_parameters
from orbisim_world_model.pack import Pack, hands
from orbisim_world_model.reading import read_attributes, read_layout, read_settings
from orbisim_world_model.reading_parts import encoder_digest, repeated

_CHUNK = 4096
"""States that MuJoCo steps at a time: enough for all cores, little memory."""
_JITTER = 0.02
"""Worlds of one MuJoCo batch; share of the control step by which sampling may be uneven."""


def pack_recordings(paths: Sequence[Path], scene: str, timestep: float | None) -> Pack:
    """Recordings of a scene as episodes; velocities are estimated where none are recorded.

    Args:
      paths: files of `orbisim.Recording`.
      scene: what `load_scene` takes.
      timestep: the control step, s; the first recording's sampling interval if None.

    Raises:
      InputError: a recording is not sampled at the control step.
    """
    from orbisim.recording import Recording
    from orbisim.recording.binding import bind
    from orbisim.recording.initial import activations, starts

    loaded = load_scene(scene)
    parts: dict[str, list[Any]] = {name: [] for name in ("qpos", "qvel", "act", "ctrl")}
    lengths = []
    for path in paths:
        bound = bind(Recording.load(path), loaded)
        step = np.diff(bound.time)
        timestep = timestep or _multiple(float(np.median(step)), loaded)
        if np.abs(step - timestep).max() > _JITTER * timestep:
            raise InputError(
                f"{path}: sampled every {step.min():.4g} to {step.max():.4g} s; learned dynamics "
                f"need one sample for each control step of {timestep:.4g} s"
            )
        found = starts(bound)
        rows = np.arange(len(bound.time))
        for name, values in zip(
            parts,
            (found.qpos, found.qvel, activations(bound, found, rows), bound.ctrl),
            strict=True,
        ):
            parts[name].append(values)
        lengths.append(len(rows) - 1)
    assert timestep is not None
    tensors = {name: _float(np.concatenate(values)) for name, values in parts.items()}
    return _pack(loaded, timestep, tensors, lengths, [Path(path).name for path in paths])


def with_baseline(pack: Pack, scene: str | None) -> Pack:
    """The pack with MuJoCo's prediction of every next state.

    Args:
      pack: the data.
      scene: whose step it is; the nominal scene of the pack's task if None.

    Raises:
      InputError: the pack does not name a task, and no scene is given.
    """
    sources = [str(source.get("task", "")) for source in pack.notes["sources"]]
    loaded = load_scene(scene) if scene else named_scene((*sources, "")[0], "the data's task")
    backend = make_backend("mujoco", loaded)
    nstep = round(pack.layout.timestep / backend.timestep)
    predicted = []
    arrays = [a.double().numpy() for a in (pack.qpos, pack.qvel, pack.act, pack.ctrl)]
    for first in range(0, len(pack.qpos), _CHUNK):
        qpos, qvel, act, ctrl = (a[first : first + _CHUNK] for a in arrays)
        after = backend.step(State(np.zeros(len(qpos)), qpos, qvel, act), ctrl, nstep).numpy()
        predicted.append(np.concatenate([after.qpos, after.qvel, after.act], axis=1))
    return dataclasses.replace(pack, base=_float(np.concatenate(predicted)))


def _pack(
    scene: Scene, timestep: float, tensors: dict[str, Any], lengths: list[int], names: list[str]
) -> Pack:
    model = scene.model
    layout = read_layout(model, timestep, source=scene.source)
    rows, count = np.asarray(lengths) + 1, len(lengths)
    attributes = _float(read_attributes(model, layout))
    settings = _float(read_settings(model, layout))
    return Pack(
        layout=layout,
        **tensors,
        action=tensors["ctrl"],
        hand=hands(layout, tensors["qpos"], tensors["qvel"]),
        base=torch.zeros(int(rows.sum()), 0),
        start=torch.as_tensor(np.cumsum(rows) - rows),
        length=torch.as_tensor(lengths),
        attributes=attributes.expand(count, *attributes.shape).clone(),
        world=settings.expand(count, -1).clone(),
        mask=torch.ones(count, len(layout.objects)),
        group=torch.zeros(count, dtype=torch.long),
        **repeated(scene.model, layout, count),
        notes={
            "groups": ["recorded"],
            "sources": [{"task": scene.source, "file": name} for name in names],
            "robot": robot_parameters(model, layout),
            **({"shapes": encoder_digest()} if layout.parts else {}),
        },
    )


def _multiple(interval: float, scene: Scene) -> float:
    """The multiple of the scene's timestep that is nearest to a sampling interval."""
    own = float(scene.model.opt.timestep)
    return max(1, round(interval / own)) * own


def _float(array: Any) -> Any:
    return torch.as_tensor(np.ascontiguousarray(array), dtype=torch.float32)
