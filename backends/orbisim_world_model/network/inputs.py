"""What goes into a network and what comes out, whichever network it is."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from orbisim_world_model.articulation import Known
from orbisim_world_model.contacts import Geometry


class Inputs(NamedTuple):
    """Normalised numbers of one step.

    Attributes:
      robot: [B, F]. objects: [B, N, G]. edges: [B, K, K, E] or None.
      attributes: [B, N, D]. world: [B, W].
      control: [B, U], with the distances to its targets where the model sees them.
      mask: [B, N], 1 for objects and 0 for padding; None when every world has all objects.
      contacts: candidate contacts in SI units, where the model looks for them.
      parts: [B, P, H] of parts of mechanisms, part_attributes: [B, P, A], part_mask: [B, P] as
        `mask`; None without.
      known: of the limbs of articulated robots, in SI units; None without.
      scales: of the objects' AdaLN, where they were computed beforehand (`fused`).
    """

    robot: Tensor
    objects: Tensor
    edges: Tensor | None
    attributes: Tensor
    world: Tensor
    control: Tensor
    mask: Tensor | None
    contacts: Geometry | None = None
    parts: Tensor | None = None
    part_attributes: Tensor | None = None
    part_mask: Tensor | None = None
    known: Known | None = None
    scales: Tensor | None = None

    def flat(self) -> Tensor:
        """Everything in one vector [B, ...] for networks without tokens."""
        objects = torch.cat([self.objects, self.attributes], dim=-1)
        if self.mask is not None:
            objects = objects * self.mask[..., None]
        return torch.cat([self.robot, objects.flatten(1), self.world], dim=1)


class Outputs(NamedTuple):
    """Numbers of one step.

    Attributes:
      robot: [B, R]. objects: [B, N, O]: what `integrate.advance` turns into the next state.
      memory: [B, ...].
      latent: zhat_t.
      penalty: [] a loss of the network's own.
      impulses: [B, P, 3] what `Contacts.impulses` makes impulses of, or None.
      parts: [B, P, O] of the joints of parts (see `parts.OUTPUTS`) or limbs (see
        `articulation.LIMB_OUTPUTS`), or None.
    """

    robot: Tensor
    objects: Tensor
    memory: Tensor
    latent: Tensor
    penalty: Tensor
    impulses: Tensor | None = None
    parts: Tensor | None = None


class Sizes(NamedTuple):
    """Numbers of features and outputs: see `Inputs` and `Outputs`."""

    robot: int
    objects: int
    many: int
    edges: int
    attributes: int
    world: int
    control: int
    robot_out: int
    objects_out: int
    parts: int = 0
    part_features: int = 0
    part_attributes: int = 0
    part_outputs: int = 0

    @property
    def flat(self) -> int:
        """Length of `Inputs.flat`."""
        return self.robot + self.many * (self.objects + self.attributes) + self.world

    @property
    def tokens(self) -> int:
        """Number of tokens."""
        return self.many + int(self.robot > 0) + self.parts


class Network(Protocol):
    """One step of a learned model, on normalised numbers."""

    def initial_memory(self, batch: int) -> Tensor:
        """Memory [B, ...] when nothing is known of the past."""

    def encode(self, inputs: Inputs, memory: Tensor) -> Tensor:
        """z_t."""

    def __call__(self, inputs: Inputs, memory: Tensor, observe: bool) -> Outputs:
        """One step; with `observe` false, a network may go by its memory alone."""
