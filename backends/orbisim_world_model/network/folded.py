"""The object-centric network prepared for inference: the same function in fewer, larger products.

- Keys and values of pairs are never formed. Since a pair's key is P_k p_ij, its score is
  (P_k^T q_i) . p_ij, and P_k^T joins the products that give q, k and v; likewise P_v joins the
  output's.
- The scales and shifts of all AdaLN depend on the condition alone: one product for all layers; and
  where no token is a robot's, which is conditioned on its control, once for many steps (`scales`).
- A model without memory always sees the same one, which becomes a bias of the encoder.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn.functional import layer_norm

from orbisim_world_model.network.coupling import Block, token_mask
from orbisim_world_model.network.inputs import Inputs, Outputs
from orbisim_world_model.network.objects import ObjectCentricNetwork
from orbisim_world_model.network.tokens import TokenNetwork


class FoldedNetwork(TokenNetwork):
    """Equation RSSM with the weights of a trained network; for inference alone.

    Args:
      network: whose weights are taken over; it is not changed.
    """

    def __init__(self, network: ObjectCentricNetwork) -> None:
        super().__init__()
        self.remembers = network.remembers
        self.robot_token, self.count = network.robot_token, network.count
        self.parts, self.part_condition = network.parts, network.part_condition
        self.start = nn.Parameter(network.start.detach().clone())
        encoder = network.f_enc
        self.robot = encoder_of(encoder.robot, None if self.remembers else self.start[0])
        self.objects = encoder_of(encoder.objects, None if self.remembers else self.start[1])
        self.moving = None
        if encoder.parts is not None:
            self.moving = encoder_of(encoder.parts, None if self.remembers else self.start[2])
        self.edge, self.f_imp = network.f_cp.edge, network.f_imp
        blocks = [block for block in network.f_cp.blocks if isinstance(block, Block)]
        norms = [norm for b in blocks for norm in (b.before_attention, b.before_mixing)]
        self.modulation = stacked([norm.modulation for norm in norms])
        self.blocks = nn.ModuleList(FoldedBlock(block) for block in blocks)
        self.norm, self.f_rec, self.f_dec = network.f_cp.norm, network.f_rec, network.f_dec
        self.skip = network.f_tra.skip
        layers = network.f_tra.layers
        self.transition = layers if self.remembers else transition_of(layers, self.skip)
        self.robot_condition = network.robot_condition
        self.object_condition = network.object_condition
        self.describes = not self.robot_token

    def encode(self, inputs: Inputs, memory: Tensor) -> Tensor:
        """z_t = f_enc(h_t, x_t)."""
        parts = []
        for encoder, seen, first in (
            (self.robot, inputs.robot[:, None], 0),
            (self.objects, inputs.objects, self.robot_token),
            (self.moving, inputs.parts, self.robot_token + self.count),
        ):
            if encoder is not None and seen is not None:
                h = memory[:, first : first + seen.shape[1]]
                parts.append(encoder(torch.cat([h, seen], -1) if self.remembers else seen))
        return parts[0] if len(parts) == 1 else torch.cat(parts, dim=1)

    def forward(self, inputs: Inputs, memory: Tensor, observe: bool = True) -> Outputs:
        """One step of equation RSSM."""
        mask = None
        if inputs.mask is not None:
            mask = token_mask(inputs.mask, bool(self.robot_token), inputs.part_mask)
        z = self.encode(inputs, memory)
        pairs = None if self.edge is None else self.edge(inputs.edges)
        found = inputs.scales
        if found is None:
            found = self.modulation(self.condition(inputs))
        scales = found.chunk(4 * len(self.blocks), dim=-1)
        for number, block in enumerate(self.blocks):
            z = block(z, scales[4 * number : 4 * number + 4], pairs, mask)
        e = self.norm(z)
        if self.f_rec is None:
            h, latent = memory, e + self.transition(e) if self.skip else self.transition(e)
        else:
            h = self.f_rec(memory, e)
            seen = torch.cat([h, e], dim=-1) if self.skip else h
            latent = e + self.transition(seen) if self.skip else self.transition(seen)
        robot, objects = self.f_dec(latent)
        wanted = None if self.f_imp is None else self.f_imp(latent, pairs)
        moves = self.f_dec.part_numbers(latent)
        return Outputs(robot, objects, h, latent, latent.new_zeros(()), wanted, moves)

    def scales(
        self, attributes: Tensor, world: Tensor, part_attributes: Tensor | None = None
    ) -> Tensor:
        """Scales and shifts of all AdaLN, [B, K, layers * 4 * width], of a network without robot.

        Args:
          attributes: [B, N, D]. world: [B, W]. part_attributes: [B, P, A]. All normalised.
        """
        found: Tensor = self.modulation(
            torch.cat(self.described(attributes, world, part_attributes), dim=1)
        )
        return found


class FoldedBlock(nn.Module):
    """Self-attention over entities and a feed-forward layer (see `coupling.Block`)."""

    def __init__(self, block: Block) -> None:
        super().__init__()
        width, self.heads = block.qkv.in_features, block.heads
        self.width = width
        self.pair = 0 if block.pair is None else block.pair.in_features
        size = width // self.heads
        weight, bias = block.qkv.weight.detach().double(), block.qkv.bias.detach().double()
        scale = torch.ones(3 * width, dtype=torch.double, device=weight.device)
        scale[:width] = size**-0.5
        weight, bias = weight * scale[:, None], bias * scale
        out, shift = block.out.weight.detach().double(), block.out.bias.detach().double()
        if block.pair is not None:
            split = (self.heads, size)
            keys, values = block.pair.weight.detach().double().chunk(2)
            keys, values = keys.unflatten(0, split), values.unflatten(0, split)  # [H, D, P]
            query = weight[:width].unflatten(0, split)  # [H, D, width]
            more = (keys.transpose(1, 2) @ query).flatten(0, 1)  # [H P, width]
            also = (keys.transpose(1, 2) @ bias[:width].view(*split, 1)).flatten()
            weight, bias = torch.cat([weight, more]), torch.cat([bias, also])
            shift = shift + out @ block.pair.bias.detach().double()[width:]
            out = out.unflatten(1, split)  # [width, H, D]
            spread = torch.einsum("whd,hdp->whp", out, values)
            out = torch.cat([out, spread], dim=2).flatten(1)
        self.project, self.out = _linear(weight, bias), _linear(out, shift)
        self.mix = block.mix

    def forward(
        self, z: Tensor, scales: tuple[Tensor, ...], pairs: Tensor | None, mask: Tensor | None
    ) -> Tensor:
        """[B, K, width]; `scales` are gamma and beta of both AdaLN."""
        shape = (self.width,)
        u = scales[0] * layer_norm(z, shape) + scales[1]
        z = z + self.out(self.attention(self.project(u), pairs, mask))
        return z + self.mix(scales[2] * layer_norm(z, shape) + scales[3])

    def attention(self, projected: Tensor, pairs: Tensor | None, mask: Tensor | None) -> Tensor:
        """[B, K, heads * (D + P)]: what each token sees of the others and of the pairs."""
        width, heads = self.width, self.heads
        if projected.shape[1] == 1 and pairs is None:
            return projected[..., 2 * width : 3 * width]
        q, k, v, asks = projected.split((width, width, width, heads * self.pair), dim=-1)
        split = (heads, width // heads)
        q, k, v = q.unflatten(-1, split), k.unflatten(-1, split), v.unflatten(-1, split)
        if pairs is None and not projected.is_cuda:
            return _attended(q, k, v, mask)
        products = q[:, :, None] * k[:, None]  # [B, K, K, heads, D]
        seen = v[:, None]
        if pairs is not None:
            asks = asks.unflatten(-1, (heads, self.pair))[:, :, None]  # [B, K, 1, heads, P]
            told = pairs[:, :, :, None]  # [B, K, K, 1, P]
            for part in range(0, self.pair, split[1]):  # P is a multiple of D: one sum for both
                chosen = slice(part, part + split[1])
                products = products + asks[..., chosen] * told[..., chosen]
            spread = (-1, *pairs.shape[1:3], heads, -1)
            seen = torch.cat([seen.expand(spread), told.expand(spread)], dim=-1)
        score = products.sum(-1)  # [B, K, K, heads]
        if mask is not None:
            score = score.masked_fill(mask[:, None, :, None] == 0, -1e4)
        return (score.softmax(dim=2)[..., None] * seen).sum(2).flatten(-2)


def _attended(q: Tensor, k: Tensor, v: Tensor, mask: Tensor | None) -> Tensor:
    """[B, K, heads * D] of tokens [B, K, heads, D] without pairs, by products of matrices.

    On a GPU a world's are too small to be worth a kernel each.
    """
    score = q.transpose(1, 2) @ k.permute(0, 2, 3, 1)  # [B, heads, K, K]
    if mask is not None:
        score = score.masked_fill(mask[:, None, None] == 0, -1e4)
    return (score.softmax(dim=-1) @ v.transpose(1, 2)).transpose(1, 2).flatten(-2)


def _linear(weight: Tensor, bias: Tensor) -> nn.Linear:
    layer = nn.Linear(weight.shape[1], weight.shape[0], device="meta")
    layer.weight = nn.Parameter(weight.float().contiguous())
    layer.bias = nn.Parameter(bias.float().contiguous())
    return layer


def stacked(layers: list[nn.Linear]) -> nn.Linear:
    """One layer that gives the outputs of all of them after one another."""
    weights = torch.cat([layer.weight.detach() for layer in layers])
    return _linear(weights, torch.cat([layer.bias.detach() for layer in layers]))


def encoder_of(layers: nn.Sequential | None, start: Tensor | None) -> nn.Sequential | None:
    """A perceptron that begins with the memory; a constant one becomes part of the bias."""
    if layers is None or start is None:
        return layers
    first = layers[0]
    assert isinstance(first, nn.Linear)
    weight, width = first.weight.detach().double(), len(start)
    bias = first.bias.detach().double() + weight[:, :width] @ start.detach().double()
    return nn.Sequential(_linear(weight[:, width:], bias), *list(layers)[1:])


def transition_of(layers: nn.Sequential, skip: bool) -> nn.Sequential:
    """The transition where h and e are the same: (W_h + W_e) e."""
    first = layers[0]
    if not skip:
        return layers
    assert isinstance(first, nn.Linear)
    parts = first.weight.detach().double().chunk(2, dim=1)
    return nn.Sequential(_linear(parts[0] + parts[1], first.bias.detach()), *list(layers)[1:])
