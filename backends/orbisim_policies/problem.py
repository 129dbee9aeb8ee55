"""`Problem`: what a policy is trained for, in tensors that carry gradients.

Shapes: N worlds, F observations, A actions, P parameters of a scene, S numbers of a score.
"""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbisim.scene import Scene

Floats = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Starts:
    """Where episodes begin.

    Attributes:
      qpos: [N, nq]. qvel: [N, nv]. ctrl: [N, nu].
      command: [N, C] what the controller remembers. params: [N, P] of the scene.
    """

    qpos: Floats
    qvel: Floats
    ctrl: Floats
    command: Floats
    params: Floats

    def __len__(self) -> int:
        return len(self.qpos)

    def at(self, index: object) -> Starts:
        """Some of them."""
        fields = (getattr(self, field.name) for field in dataclasses.fields(self))
        return Starts(*(rows[index] for rows in fields))


class Moment(NamedTuple):
    """What there is at one time.

    Attributes:
      qpos: [N, nq]. qvel: [N, nv]. command: [N, C]. params: [N, P].
      score: [N, S] of the episode so far. time: [N] share of the episode that is over.
    """

    qpos: Tensor
    qvel: Tensor
    command: Tensor
    params: Tensor
    score: Tensor
    time: Tensor


class Problem(abc.ABC):
    """Episodes with a reward, as functions of tensors.

    The same functions serve the learned step, which is differentiated, and MuJoCo.

    Attributes:
      name: as `orbisim train policy` takes it.
      scene: the nominal one; a policy belongs to it.
      timestep: of control, s. steps: of an episode.
      actions: number of action components, each from -1 to 1. observations: of the policy.
      parts: names of what the reward is the sum of.
      sparse: whether the reward is given at the end of an episode only.
    """

    name: str
    scene: Scene
    timestep: float
    steps: int
    actions: int
    observations: int
    parts: tuple[str, ...]
    sparse: bool

    @abc.abstractmethod
    def draw(self, seeds: Sequence[int]) -> Starts:
        """Where the episodes of these seeds begin."""

    def trials(self, count: int, seed: int) -> tuple[Scene, Starts]:
        """Episodes in one scene, as one backend steps them."""
        return self.scene, self.draw(range(seed, seed + count))

    @abc.abstractmethod
    def begin(self, qpos: Tensor, qvel: Tensor, command: Tensor) -> Tensor:
        """The score [N, S] before the first step; the command is that of the start [N, C]."""

    @abc.abstractmethod
    def count(self, score: Tensor, qpos: Tensor, qvel: Tensor, control: Tensor) -> Tensor:
        """The score after a step that led to this state."""

    @abc.abstractmethod
    def value(self, score: Tensor, qpos: Tensor) -> Tensor:
        """[N, parts]: what the episode is worth if it ends here."""

    def measure(self, score: Tensor, qpos: Tensor) -> Tensor:
        """[N, parts]: what evaluations report; the value, unless the task has its own reward."""
        return self.value(score, qpos)

    @abc.abstractmethod
    def observe(self, moment: Moment) -> Tensor:
        """[N, F], of order one."""

    def unseen(self, params: Tensor) -> Tensor:
        """Parameters [N, P] as known from images: what no image shows has its nominal value."""
        return params

    @abc.abstractmethod
    def control(self, command: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """Controls [N, nu] of actions [N, A], and the command after them."""

    @abc.abstractmethod
    def success(self, starts: Starts, qpos: Floats, value: Floats) -> Mapping[str, Any]:
        """By definition, whether episodes [N] succeeded.

        Args:
          starts: where they began. qpos: at the end [N, nq]. value: `measure` [N, parts].
        """

    @property
    def template(self) -> Scene:
        """The scene with the model that `write` starts from."""
        return self.scene

    @property
    def model(self) -> mujoco.MjModel:
        """What `write` starts from."""
        return self.template.model

    @property
    def backend(self) -> str:
        """What steps the true worlds: C MuJoCo, or a backend that corrects it (`hybrid:PATH`)."""
        return "mujoco"

    @property
    def conditions(self) -> Mapping[str, Any]:
        """What a manifest says of the episodes beside the task's name."""
        return {}

    @property
    def alterations(self) -> Mapping[str, tuple[mujoco.MjModel, mujoco.MjModel]]:
        """By name, what episodes have beyond the task's own scene: models without and with it."""
        return {}

    def write(self, model: mujoco.MjModel, params: Floats) -> None:  # noqa: B027
        """Makes a copy of `model` that of an episode with these parameters [P]."""

    def to(self, device: torch.device) -> Problem:
        """The same with its constants on a device."""
        return self
