"""The object-centric network as two kernels for a GPU: the same function, for inference alone.

Compiled by torch, a step of `network.folded` writes the numbers of each layer into the GPU's memory
and reads them some ten times. Here they stay in registers (see `fused_kernels`).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from orbisim_world_model.network.coupling import PAIR, Block
from orbisim_world_model.network.folded import encoder_of, stacked, transition_of
from orbisim_world_model.network.fused_kernels import network_kernel, pair_kernel
from orbisim_world_model.network.inputs import Inputs, Outputs
from orbisim_world_model.network.objects import ObjectCentricNetwork
from orbisim_world_model.network.tokens import TokenNetwork

_MOST_TOKENS = 4
"""Of a world: the tiles of more do not fit into the registers."""
_LEAST = 16
"""Rows and columns that a product of the tensor cores has at least."""


class Tile(NamedTuple):
    """How the kernel is cut.

    Attributes:
      worlds: of a program. chunk: hidden numbers at a time. warps: of a program. stages: of loads
        under way.
    """

    worlds: int
    chunk: int
    warps: int
    stages: int


class FusedNetwork(TokenNetwork):
    """Equation RSSM with the weights of a trained network.

    Args:
      network: one that `suits`; it is not changed.
      tile: None for the one that suits the number of worlds.
    """

    def __init__(self, network: ObjectCentricNetwork, tile: Tile | None = None) -> None:
        super().__init__()
        self.robot_token, self.count, self.parts = network.robot_token, network.count, 0
        self.start = nn.Parameter(network.start.detach().clone())
        self.robot_condition = network.robot_condition
        self.object_condition = network.object_condition
        self.part_condition = None
        blocks = [block for block in network.f_cp.blocks if isinstance(block, Block)]
        norms = [norm for b in blocks for norm in (b.before_attention, b.before_mixing)]
        self.modulation = stacked([norm.modulation for norm in norms])
        self.tile = tile
        weights, biases, self.heads = _Packed(), _Packed(), blocks[0].heads
        self.outputs = _pack(network, blocks, weights, biases)
        self.register_buffer("weights", weights.joined().half(), persistent=False)
        # a parameter would be converted to half precision with the network
        self.biases = Exact(biases.joined())
        self.starts = weights.starts, biases.starts

    @staticmethod
    def suits(network: Any) -> bool:
        """Whether a network is one that the kernels compute."""
        return (
            isinstance(network, ObjectCentricNetwork)
            and not network.remembers
            and not network.parts
            and network.f_imp is None
            and network.f_cp.edge is not None
            and network.f_tra.skip
            and bool(network.robot_token and network.count)
            and network.robot_token + network.count <= _MOST_TOKENS
            and _space(network.start.shape[1]) == network.start.shape[1]
        )

    def forward(self, inputs: Inputs, memory: Tensor, observe: bool = True) -> Outputs:
        """One step of equation RSSM; the latent is not given."""
        assert inputs.edges is not None
        modulation = self.modulation(self.condition(inputs))
        given = (inputs.robot, inputs.objects, inputs.edges, modulation)
        robot, objects = _network(
            *(tensor.contiguous() for tensor in given),
            self.weights,
            self.biases.values,
            [self.heads, *self.outputs],
            *map(list, self.starts),
            list(self.tile or chosen_tile(len(inputs.robot))),
        )
        none = robot.new_zeros(())
        return Outputs(robot, objects, memory, none, none)


def chosen_tile(worlds: int) -> Tile:
    """What was fastest for a number of worlds."""
    return Tile(16, 128, 4, 2) if worlds <= 2048 else Tile(32, 64, 4, 2)


class Exact(nn.Module):
    """Numbers that stay in single precision whatever the network around them is converted to."""

    def __init__(self, values: Tensor) -> None:
        super().__init__()
        self.register_buffer("values", values, persistent=False)

    def _apply(self, function: Any, recurse: bool = True) -> Exact:
        self.values = self.values.to(function(self.values).device)
        return self


@torch.library.custom_op("orbisim::token_network", mutates_args=())
def _network(
    robot: Tensor,
    objects: Tensor,
    edges: Tensor,
    modulation: Tensor,
    weights: Tensor,
    biases: Tensor,
    sizes: list[int],
    starts: list[int],
    bias_starts: list[int],
    tile: list[int],
) -> tuple[Tensor, Tensor]:
    """Numbers of the robot [B, R] and of objects [B, N, O].

    Args:
      robot: [B, F]. objects: [B, N, G]. edges: [B, K, K, E].
      modulation: [B, K, layers * 4 * width], scale and shift of each AdaLN.
      weights, biases, starts, bias_starts: see `_pack`.
      sizes: heads, R and O. tile: see `Tile`.
    """
    heads, robot_out, object_out = sizes
    count, tokens = modulation.shape[:2]
    many = objects.shape[1]
    layers = len(starts) - 6
    width = modulation.shape[2] // (4 * layers)
    worlds, chunk, warps, stages = tile
    options = {"num_warps": warps, "num_stages": stages}
    pairs = edges.new_empty((count, tokens, tokens, PAIR), dtype=torch.float16)
    rows = count * tokens * tokens
    space = _space(edges.shape[-1])
    hidden = (bias_starts[1] - bias_starts[0] - PAIR)
    pair_kernel[(-(-rows // 64),)](
        edges, pairs, weights, biases, rows,
        E=edges.shape[-1], SPACE=space, HIDDEN=hidden, OUT=PAIR,
        AT=starts[0], AT_BIAS=bias_starts[0], M=64, num_warps=4,
    )  # fmt: skip
    found = robot.new_empty((count, robot_out), dtype=torch.float32)
    moved = robot.new_empty((count, many, object_out), dtype=torch.float32)
    layer = bias_starts[4] - bias_starts[3] if layers > 1 else bias_starts[-3] - bias_starts[3]
    mix = layer - 5 * width
    ends = (*range(1, 4), *range(-3, 0))
    network_kernel[(-(-count // worlds),)](
        robot, objects, pairs, modulation, weights, biases, found, moved, count,
        K=tokens, HAS_ROBOT=tokens - many, L=layers, W=width, HEADS=heads, MIX=mix, PAIR=PAIR,
        ROBOT=robot.shape[1], ROBOT_SPACE=_space(robot.shape[1]),
        OBJECT=objects.shape[2], OBJECT_SPACE=_space(objects.shape[2]),
        ROBOT_OUT=robot_out, OBJECT_OUT=object_out,
        ROBOT_SPACE_OUT=_space(robot_out), OBJECT_SPACE_OUT=_space(object_out),
        AT=tuple(starts[e] for e in ends), AT_BIAS=tuple(bias_starts[e] for e in ends),
        CHUNK=chunk, M=worlds, **options,
    )  # fmt: skip
    return found, moved


@_network.register_fake
def _(robot: Tensor, objects: Tensor, *rest: Any) -> tuple[Tensor, Tensor]:
    sizes = rest[4]
    single = {"dtype": torch.float32}
    found = robot.new_empty((len(robot), sizes[1]), **single)
    return found, robot.new_empty((len(robot), objects.shape[1], sizes[2]), **single)


class _Packed:
    """Matrices and vectors one after the other, and where the groups of them begin."""

    def __init__(self) -> None:
        self.parts: list[Tensor] = []
        self.starts: list[int] = []
        self.size = 0

    def begin(self) -> None:
        self.starts.append(self.size)

    def add(self, values: Tensor) -> None:
        flat = values.detach().float().cpu().flatten()
        self.parts.append(flat)
        self.size += len(flat)

    def joined(self) -> Tensor:
        return torch.cat(self.parts)


def _pack(
    network: ObjectCentricNetwork, blocks: list[Block], weights: _Packed, biases: _Packed
) -> tuple[int, int]:
    """Everything in the order in which the kernels read it; gives the numbers of outputs.

    Groups: features of pairs, encoder of the robot, of objects, each layer, transition, decoder of
    the robot, of objects. Matrices have a row for each input; sides are filled up with zeros to
    powers of two, of at least 16.
    """

    def perceptron(first: nn.Linear, second: nn.Linear) -> None:
        for layer in (first, second):
            inputs, outputs = _space(layer.in_features), _space(layer.out_features)
            matrix = torch.zeros(inputs, outputs)
            matrix[: layer.in_features, : layer.out_features] = layer.weight.detach().T
            weights.add(matrix)
            bias = torch.zeros(outputs)
            bias[: layer.out_features] = layer.bias.detach()
            biases.add(bias)

    def begin() -> None:
        weights.begin()
        biases.begin()

    def vectors(*values: Tensor) -> None:
        for vector in values:
            biases.add(vector)

    edge = network.f_cp.edge
    begin()
    perceptron(edge[0], edge[2])
    for encoder, start in zip((network.f_enc.robot, network.f_enc.objects), network.start):
        begin()
        layers = encoder_of(encoder, start)
        perceptron(layers[0], layers[2])
        vectors(layers[3].weight, layers[3].bias)
    for block in blocks:
        begin()
        _pack_block(block, weights, biases)
    begin()
    norm, layers = network.f_cp.norm, transition_of(network.f_tra.layers, network.f_tra.skip)
    vectors(norm.weight, norm.bias)
    perceptron(layers[0], layers[2])
    for head in (network.f_dec.robot, network.f_dec.objects):
        begin()
        perceptron(head[0], head[2])
    return network.f_dec.robot[2].out_features, network.f_dec.objects[2].out_features


def _pack_block(block: Block, weights: _Packed, biases: _Packed) -> None:
    width = block.qkv.in_features
    scale = torch.ones(3 * width)
    scale[:width] = (width // block.heads) ** -0.5  # of scores
    bias = block.qkv.bias.detach().cpu() * scale
    bias[width:] += block.pair.bias.detach().cpu()  # of keys and values, whatever the pair
    weights.add((block.qkv.weight.detach().cpu() * scale[:, None]).T)
    for matrix in (block.pair.weight, block.out.weight, block.mix[0].weight, block.mix[2].weight):
        weights.add(matrix.T)
    for vector in (bias, block.out.bias, block.mix[0].bias, block.mix[2].bias):
        biases.add(vector)


def _space(size: int) -> int:
    """The next power of two, of at least `_LEAST`."""
    return max(_LEAST, 1 << (size - 1).bit_length())
