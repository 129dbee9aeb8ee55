"""Worlds stepped by the learned dynamics, differentiable."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
import torch
from orbisim_world_model import zoo
from orbisim_world_model.checkpoint import load_checkpoint
from orbisim_world_model.engine import parts_of
from orbisim_world_model.entities import Context, Entities
from orbisim_world_model.fitting import fit
from orbisim_world_model.manifest import read_manifest
from orbisim_world_model.reading import read_attributes, read_settings
from orbisim_world_model.rotation import rotate_back, to_matrix
from torch import Tensor

from orbisim.errors import InputError
from orbisim_policies.problem import Problem, Starts


class Pool(NamedTuple):
    """Many starts as tensors on a device: qpos, qvel, act, command, params and descriptors."""

    qpos: Tensor
    qvel: Tensor
    act: Tensor
    command: Tensor
    params: Tensor
    attributes: Tensor
    settings: Tensor

    def at(self, index: Tensor) -> Pool:
        """Some of them."""
        return Pool(*(rows[index] for rows in self))


class DifferentiableWorlds(Protocol):
    """Worlds whose control steps have gradients, see `LearnedWorlds`.

    Attributes:
      name: of what steps them. problem, device: see there.
      true_per_step: control steps of C MuJoCo that one of theirs takes.
    """

    name: str
    problem: Problem
    device: torch.device
    true_per_step: int

    def pool(self, starts: Starts) -> Pool:
        """Starts as tensors."""

    def begin(self, starts: Pool) -> tuple[Entities, Context]:
        """The states, and what the step is conditioned on."""

    def step(self, x: Entities, control: Tensor, context: Context) -> Entities:
        """The states after a control step."""

    def coordinates(self, x: Entities) -> tuple[Tensor, Tensor]:
        """qpos [N, nq] and qvel [N, nv]."""


class LearnedWorlds:
    """The learned step of a problem's scene, in float32, with gradients.

    Gradients run through the network as it is trained: where `rest` keeps a box that is hardly
    touched exactly where it is, the value is that of the box at rest and the derivative that of
    the network, so that a touch that is not quite one yet is felt.

    Args:
      problem: whose scene is stepped.
      checkpoint: folder of the dynamics, or its name in the zoo; the zoo's that fits if None.
      device: where to compute.

    Raises:
      InputError: the checkpoint's step is not the problem's, it has a memory, or it does not see
        what episodes have beyond the task's scene.
      UnsupportedSceneError: the checkpoint does not fit the scene.
    """

    true_per_step = 0

    def __init__(
        self, problem: Problem, checkpoint: str | Path | None, device: torch.device
    ) -> None:
        scene = problem.scene
        folder = zoo.find(scene)[0] if checkpoint is None else zoo.located(checkpoint)
        found = fit(read_manifest(folder), scene)
        self.folder, self.problem, self.device = folder, problem, device
        self.name = folder.name
        self.layout = found.layout
        model = load_checkpoint(folder, found.layout, found.variant).model
        ratio = problem.timestep / self.layout.timestep
        if abs(ratio - round(ratio)) > 1e-6 or round(ratio) < 1:
            raise InputError(
                f"{folder}: takes steps of {self.layout.timestep:g} s; {problem.name} has control "
                f"steps of {problem.timestep:g} s, which must be a multiple of them"
            )
        self._check_seen()
        model.spread = None  # how far off it may be is no part of the step
        if model.config.memory != "none":
            raise InputError(f"{folder}: has a memory; policies are trained on dynamics without")
        self.substeps = round(ratio)
        self.model = model.to(device).requires_grad_(False).train()
        self._memory = self.model.initial_memory(1)
        self._parts = parts_of(scene, self.layout, device)
        index = self.layout._indices(str(device))
        self._to_qpos, self._to_qvel = index["to_qpos"], index["to_qvel"]

    def _check_seen(self) -> None:
        """Refuses episodes that differ from the task's scene in what the step does not see."""
        layout = self.layout
        for name, models in self.problem.alterations.items():
            plain, altered = (
                (read_attributes(m, layout), read_settings(m, layout)) for m in models
            )
            if all(np.array_equal(a, b) for a, b in zip(plain, altered, strict=True)):
                raise InputError(
                    f"{self.folder}: does not see {name}: it is conditioned on "
                    f"{', '.join((*layout.attributes, *layout.settings))}; train with --method ppo "
                    "or sac, which learn in mujoco"
                )

    def pool(self, starts: Starts) -> Pool:
        """Starts as tensors, with the descriptors of their scenes."""
        model, layout = copy.copy(self.problem.model), self.layout
        attributes, settings = [], []
        for params in starts.params:
            self.problem.write(model, params)
            attributes.append(torch.as_tensor(read_attributes(model, layout)))
            settings.append(torch.as_tensor(read_settings(model, layout)))
            if not starts.params.shape[1]:
                break
        count = len(starts)

        def put(values: Any) -> Tensor:
            return torch.as_tensor(values, dtype=torch.float32).to(self.device)

        described = [put(torch.stack(rows)) for rows in (attributes, settings)]
        spread = [rows.expand(count, *rows.shape[1:]).clone() for rows in described]
        act = torch.zeros((count, layout.na), device=self.device)
        given = (starts.qpos, starts.qvel, act, starts.command, starts.params)
        return Pool(*map(put, given), *spread)

    def begin(self, starts: Pool) -> tuple[Entities, Context]:
        """The states as the model sees them, and what it is conditioned on."""
        x = self.layout.split(starts.qpos, starts.qvel, starts.act)
        return self.model.completed(x), Context(starts.attributes, starts.settings, None)

    def step(self, x: Entities, control: Tensor, context: Context) -> Entities:
        """The states after a control step of the problem."""
        if self._parts is not None:
            context = context._replace(parts=self._parts.expand(len(context.attributes), -1, -1))
        for _ in range(self.substeps):
            x = self._step(x, control, context)
        return x

    def _step(self, x: Entities, control: Tensor, context: Context) -> Entities:
        memory = self._memory.expand(len(x.pos), *self._memory.shape[1:])
        after: Entities = self.model(x, memory, control, context).state
        if self.model.rest is None or not self.model.training:
            return after
        held = self.model.rest(x, after, context)
        return Entities(*(a + (h - a).detach() for a, h in zip(after, held, strict=True)))

    def coordinates(self, x: Entities) -> tuple[Tensor, Tensor]:
        """qpos [N, nq] and qvel [N, nv]: `Layout.join`, with its indices at hand for a compiler."""
        free_q = torch.cat([x.pos, x.quat], dim=-1).flatten(1)
        local = rotate_back(to_matrix(x.quat), x.ang)
        free_v = torch.cat([x.vel, local], dim=-1).flatten(1)
        qpos = torch.cat([x.q, free_q], dim=1)[:, self._to_qpos]
        return qpos, torch.cat([x.v, free_v], dim=1)[:, self._to_qvel]
