"""The paper's ablation without object-centric tokens: one global state vector."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from orbisim_world_model.config import ModelConfig
from orbisim_world_model.network.adaln import AdaptiveLayerNorm
from orbisim_world_model.network.inputs import Inputs, Outputs, Sizes
from orbisim_world_model.network.recurrence import Recurrence
from orbisim_world_model.network.transition import Transition


class GlobalNetwork(nn.Module):
    """Equation RSSM on one concatenated vector (robot, objects, attributes, world).

    The same functions; the coupling module is a perceptron of residual blocks instead of a
    transformer, since there is nothing to attend to.
    """

    def __init__(self, sizes: Sizes, config: ModelConfig) -> None:
        super().__init__()
        width = config.width
        self.sizes = sizes
        self.start = nn.Parameter(torch.zeros(width))
        self.f_enc = nn.Sequential(
            nn.Linear(sizes.flat + width, 2 * width),
            nn.SiLU(),
            nn.Linear(2 * width, width),
            nn.LayerNorm(width),
        )
        conditions = sizes.control + sizes.world + sizes.many * sizes.attributes
        self.conditions = nn.Sequential(nn.Linear(conditions, width), nn.SiLU())
        self.blocks = nn.ModuleList(_Block(width, config.expansion) for _ in range(config.layers))
        self.f_rec = Recurrence(width)
        self.f_tra = Transition(width, config.skip)
        outputs = sizes.robot_out + sizes.many * sizes.objects_out
        self.f_dec = nn.Sequential(
            nn.Linear(width, 2 * width), nn.SiLU(), nn.Linear(2 * width, outputs)
        )

    def initial_memory(self, batch: int) -> Tensor:
        """[B, width], learned."""
        return self.start.expand(batch, -1)

    def encode(self, inputs: Inputs, memory: Tensor) -> Tensor:
        """z_t = f_enc(h_t, x_t)."""
        return self.f_enc(torch.cat([memory, inputs.flat()], dim=1))

    def forward(self, inputs: Inputs, memory: Tensor, observe: bool = True) -> Outputs:
        """One step."""
        e = self.encode(inputs, memory)
        given = [inputs.control, inputs.world, inputs.attributes.flatten(1)]
        c = self.conditions(torch.cat(given, dim=1))
        for block in self.blocks:
            e = block(e, c)
        h = self.f_rec(memory, e)
        latent = self.f_tra(h, e)
        robot, objects = self.f_dec(latent).split(
            (self.sizes.robot_out, self.sizes.many * self.sizes.objects_out), dim=1
        )
        shaped = objects.unflatten(1, (self.sizes.many, self.sizes.objects_out))
        return Outputs(robot, shaped, h, latent, latent.new_zeros(()))


class _Block(nn.Module):
    def __init__(self, width: int, expansion: int) -> None:
        super().__init__()
        self.norm = AdaptiveLayerNorm(width, width)
        self.mix = nn.Sequential(
            nn.Linear(width, expansion * width), nn.SiLU(), nn.Linear(expansion * width, width)
        )

    def forward(self, u: Tensor, c: Tensor) -> Tensor:
        return u + self.mix(self.norm(u, c))
