"""Equation RSSM as a whole: the object-centric recurrent state-space model."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from orbisim_world_model.articulation import LIMB_OUTPUTS, stopped
from orbisim_world_model.config import ModelConfig
from orbisim_world_model.contacts import Contacts
from orbisim_world_model.network.coupling import PAIR, Coupling, token_mask
from orbisim_world_model.network.decoder import Decoder
from orbisim_world_model.network.encoder import Encoder
from orbisim_world_model.network.impulses import Impulses
from orbisim_world_model.network.inputs import Inputs, Outputs, Sizes
from orbisim_world_model.network.recurrence import Recurrence
from orbisim_world_model.network.tokens import TokenNetwork
from orbisim_world_model.network.transition import Transition


class ObjectCentricNetwork(TokenNetwork):
    """Equation RSSM: one token for each entity, with its own latent z and memory h.

    The robot's token is conditioned on the action and the world, an object's and a part's on its
    own attributes and the world.
    """

    def __init__(self, sizes: Sizes, config: ModelConfig, contacts: Contacts | None = None) -> None:
        super().__init__()
        width = config.width
        self.remembers = config.memory == "gru"
        self.robot_token, self.count = int(sizes.robot > 0), sizes.many
        self.parts = sizes.parts
        # of the robot's, the objects' and the parts' memory
        self.start = nn.Parameter(torch.zeros(3 if sizes.parts or config.mixed else 2, width))
        objects = sizes.objects if sizes.many else 0
        self.f_enc = Encoder(sizes.robot, objects, width, sizes.part_features)
        self.f_cp = Coupling(width, config.layers, config.heads, config.expansion, sizes.edges)
        self.f_rec = Recurrence(width) if self.remembers else None
        self.f_tra = Transition(width, config.skip)
        moves = sizes.part_outputs
        self.f_dec = Decoder(width, sizes.robot_out, sizes.objects_out, sizes.many, moves)
        self.f_imp = None
        if contacts is not None and config.impulses:
            self.f_imp = Impulses(width, PAIR, contacts)
        if self.f_dec.parts is not None and moves == LIMB_OUTPUTS:
            stopped(self.f_dec.parts[-1].bias)
        elif self.f_dec.parts is not None:
            with torch.no_grad():
                self.f_dec.parts[-1].bias[2] = -3.0  # the hand carries few parts at a time
        self.robot_condition = _condition(sizes.control + sizes.world, width)
        self.object_condition = _condition(sizes.attributes + sizes.world, width)
        self.part_condition = None
        if sizes.parts:
            self.part_condition = _condition(sizes.part_attributes + sizes.world, width)

    def encode(self, inputs: Inputs, memory: Tensor) -> Tensor:
        """z_t = f_enc(h_t, x_t)."""
        return self.f_enc(memory, inputs.robot, inputs.objects, inputs.parts)

    def forward(self, inputs: Inputs, memory: Tensor, observe: bool = True) -> Outputs:
        """One step of equation RSSM."""
        mask = None
        if inputs.mask is not None:
            mask = token_mask(inputs.mask, bool(self.robot_token), inputs.part_mask)
        z = self.encode(inputs, memory)
        pairs = self.f_cp.pairs(inputs.edges)
        e = self.f_cp(z, self.condition(inputs), pairs, mask)
        h = e if self.f_rec is None else self.f_rec(memory, e)
        latent = self.f_tra(h, e)
        robot, objects = self.f_dec(latent)
        kept = memory if self.f_rec is None else h
        wanted = None if self.f_imp is None else self.f_imp(latent, pairs)
        moves = self.f_dec.part_numbers(latent)
        return Outputs(robot, objects, kept, latent, latent.new_zeros(()), wanted, moves)


def _condition(inputs: int, width: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, width), nn.SiLU(), nn.Linear(width, width), nn.SiLU())
