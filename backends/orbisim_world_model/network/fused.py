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
from orbisim_world_model.network.fused_kernels import layers_kernel, spread_kernel, tokens_kernel
from orbisim_world_model.network.inputs import Inputs, Outputs, Sizes
from orbisim_world_model.network.objects import ObjectCentricNetwork
from orbisim_world_model.network.tokens import TokenNetwork
from orbisim_world_model.spread import MOST, MOST_GAIN

_MOST_TOKENS = 16
"""Of a world: as many rows as the smallest tile has."""
_SMALL = 512
"""Worlds up to which small tiles keep more of the GPU busy."""
_ROWS, _CHUNK = 64, 64
"""Of the kernel that makes tokens."""
_SPREAD_ROWS = 64
"""Of the kernel of variances."""
_LEAST = 16
"""Rows and columns that a product of the tensor cores has at least."""


class Tile(NamedTuple):
    """How the kernel is cut.

    Attributes:
      rows: of a program, tokens of whole worlds. chunk: hidden numbers at a time.
      part: numbers of heads at a time. columns: of AdaLN's numbers of a program.
      warps: of a program. stages: of loads under way.
    """

    rows: int
    chunk: int
    part: int
    columns: int
    warps: int
    stages: int


_FEW, _MANY = Tile(16, 128, 128, 128, 8, 3), Tile(64, 64, 64, 2048, 4, 3)
"""For up to `_SMALL` worlds, and for more. On an H100 the layers of one world take 64 microseconds,
those of 65,536 worlds 2.84 ms; in tiles of 128 rows and chunks of 32 numbers 3.00."""


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
        self.robot_condition, self.object_condition = None, None  # in the kernels
        self.part_condition, self.describes = None, True
        blocks = [block for block in network.f_cp.blocks if isinstance(block, Block)]
        self.tile = tile
        weights, biases = _Packed(), _Packed()
        outputs = _pack(network, blocks, weights, biases)
        self.sizes = [len(blocks), blocks[0].heads, self.start.shape[1], *outputs]
        self.register_buffer("weights", weights.joined().half(), persistent=False)
        # a parameter would be converted to half precision with the network
        self.biases = Exact(biases.joined())
        self.starts = weights.starts, biases.starts  # of the groups of `_pack`

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
            and _space(network.start.shape[1]) == network.start.shape[1]  # a power of two
        )

    def forward(self, inputs: Inputs, memory: Tensor, observe: bool = True) -> Outputs:
        """One step of equation RSSM; the latent is not given."""
        assert inputs.edges is not None
        scales = inputs.scales
        if scales is None:
            scales = self.scales(inputs.attributes, inputs.world)
        given = (inputs.robot, inputs.objects, inputs.edges, inputs.control, inputs.world)
        robot, objects = _network(
            *(tensor.contiguous() for tensor in given),
            scales,
            self.weights,
            self.biases.values,
            self.sizes,
            *self.starts,
            list(self._tile(len(inputs.robot))),
        )
        none = robot.new_zeros(())
        return Outputs(robot, objects, memory, none, none)

    def scales(
        self, attributes: Tensor, world: Tensor, part_attributes: Tensor | None = None
    ) -> Tensor:
        """Scales and shifts of all AdaLN of objects, [B, N, layers * 4 * width].

        Args:
          attributes: [B, N, D]. world: [B, W], both normalised. part_attributes: of none.
        """
        tile = self._tile(len(attributes))
        described = (attributes.contiguous(), world.contiguous())
        found: Tensor = _scales(
            *described, self.weights, self.biases.values, self.sizes, *self.starts, list(tile)
        )
        return found

    def _tile(self, worlds: int) -> Tile:
        """No larger than the network is."""
        layers, heads, width = self.sizes[:3]
        tile = self.tile or (_FEW if worlds <= _SMALL else _MANY)
        part = max(min(tile.part, width), width // heads)
        columns = min(tile.columns, layers * 4 * width)
        return tile._replace(chunk=min(tile.chunk, width), part=part, columns=columns)


class FusedSpread(nn.Module):
    """`Spread` as one kernel; products are of half precision.

    Args:
      spread: whose weights are taken over; it is not changed.
      sizes: of the features.
    """

    def __init__(self, spread: Any, sizes: Sizes) -> None:
        super().__init__()
        weights, biases = _Packed(), _Packed()
        more = sizes.control + sizes.world, sizes.attributes + sizes.world
        pads = (
            (spread.robot, (sizes.robot, more[0])),
            (spread.objects, (sizes.objects, more[1])),
            (spread.pair, (sizes.edges,)),
            (spread.sender, (spread.width,)),
            (spread.mix, (spread.width,)),
            (spread.gain, (spread.width,)),
            (spread.noise, (spread.width, spread.width)),
        )
        for layer, groups in pads:
            weights.begin()
            biases.begin()
            outputs = _space(layer.out_features)
            for part in layer.weight.detach().cpu().split(groups, dim=1):
                matrix = torch.zeros(_space(part.shape[1]), outputs)
                matrix[: part.shape[1], : part.shape[0]] = part.T
                weights.add(matrix)
            bias = torch.zeros(outputs)
            bias[: layer.out_features] = layer.bias.detach()
            biases.add(bias)
        self.width = _space(spread.width)
        self.starts = weights.starts, biases.starts
        self.register_buffer("weights", weights.joined().half(), persistent=False)
        self.register_buffer("biases", biases.joined(), persistent=False)
        self.register_buffer("start", spread.start.detach().clone(), persistent=False)

    @staticmethod
    def suits(sizes: Sizes) -> bool:
        """Whether there is everything that the kernel expects."""
        return bool(sizes.robot and sizes.many and sizes.edges) and not sizes.parts

    def forward(self, inputs: Inputs, variance: Tensor) -> Tensor:
        """See `Spread.forward`."""
        assert inputs.edges is not None
        given = (inputs.robot, inputs.objects, inputs.edges, inputs.control)
        described = (inputs.attributes, inputs.world, variance)
        found: Tensor = _spread(
            *(tensor.contiguous() for tensor in (*given, *described)),
            self.weights,
            self.biases,
            self.start,
            self.width,
            *self.starts,
        )
        return found


@torch.library.custom_op("orbisim::token_spread", mutates_args=())  # type: ignore[untyped-decorator]
def _spread(
    robot: Tensor,
    objects: Tensor,
    edges: Tensor,
    control: Tensor,
    attributes: Tensor,
    setting: Tensor,
    variance: Tensor,
    weights: Tensor,
    biases: Tensor,
    start: Tensor,
    width: int,
    starts: list[int],
    bias_starts: list[int],
) -> Tensor:
    """The variances [B, K, 2] after a step."""
    worlds, tokens = edges.shape[:2]
    found = torch.empty_like(variance)
    senders = variance.new_empty((worlds, tokens, width), dtype=torch.float16)
    spread_kernel[(-(-worlds // (_SPREAD_ROWS // tokens)),)](
        robot, objects, edges, control, attributes, setting, variance, weights, biases, start,
        senders, found, worlds,
        W=width, **_widths(robot, objects, edges, control, setting), ATTRIBUTES=attributes.shape[2],
        DESCRIBED_SPACE=_space(attributes.shape[2] + setting.shape[1]),
        MOST_GAIN=MOST_GAIN, MOST=MOST, AT=tuple(starts), AT_BIAS=tuple(bias_starts),
        NARROW=_LEAST, M=_SPREAD_ROWS,
    )  # fmt: skip
    return found


@_spread.register_fake  # type: ignore[untyped-decorator]
def _(*given: Any) -> Tensor:
    return torch.empty_like(given[6])


class Exact(nn.Module):
    """Numbers that stay in single precision whatever the network around them is converted to."""

    def __init__(self, values: Tensor) -> None:
        super().__init__()
        self.values: Tensor
        self.register_buffer("values", values, persistent=False)

    def _apply(self, function: Any, recurse: bool = True) -> Exact:
        self.values = self.values.to(function(self.values).device)
        return self


@torch.library.custom_op("orbisim::token_scales", mutates_args=())  # type: ignore[untyped-decorator]
def _scales(
    attributes: Tensor,
    setting: Tensor,
    weights: Tensor,
    biases: Tensor,
    sizes: list[int],
    starts: list[int],
    bias_starts: list[int],
    tile: list[int],
) -> Tensor:
    """See `FusedNetwork.scales`."""
    layers, _, width = sizes[:3]
    (worlds, many, columns), all_of = attributes.shape, layers * 4 * width
    found = attributes.new_empty((worlds, many, all_of), dtype=torch.float16)
    split = all_of // tile[3]
    none = found  # of what is not computed here
    tokens_kernel[(-(-worlds * many // _ROWS), split)](
        none, none, none, none, attributes, setting, none, none, none, found,
        weights, biases, worlds,
        K=many + 1, HAS_ROBOT=1, L=layers, W=width, PAIR=PAIR,
        ROBOT=1, ROBOT_SPACE=_LEAST, OBJECT=1, OBJECT_SPACE=_LEAST, EDGE=1, EDGE_SPACE=_LEAST,
        EDGE_HIDDEN=_LEAST, CONTROL=1, ATTRIBUTES=columns, SETTING=setting.shape[1],
        COMMAND_SPACE=_LEAST, DESCRIBED_SPACE=_space(columns + setting.shape[1]),
        AT=tuple(starts[:6]), AT_BIAS=tuple(bias_starts[:6]),
        COLUMNS=tile[3], CHUNK=min(_CHUNK, width), FIRST=3 + split, M=_ROWS,
    )  # fmt: skip
    return found


@_scales.register_fake  # type: ignore[untyped-decorator]
def _(attributes: Tensor, *rest: Any) -> Tensor:
    layers, _, width = rest[3][:3]
    shape = (*attributes.shape[:2], layers * 4 * width)
    return attributes.new_empty(shape, dtype=torch.float16)


@torch.library.custom_op("orbisim::token_network", mutates_args=())  # type: ignore[untyped-decorator]
def _network(
    robot: Tensor,
    objects: Tensor,
    edges: Tensor,
    control: Tensor,
    setting: Tensor,
    scales: Tensor,
    weights: Tensor,
    biases: Tensor,
    sizes: list[int],
    starts: list[int],
    bias_starts: list[int],
    tile: list[int],
) -> tuple[Tensor, Tensor]:
    """Numbers of the robot [B, R] and of objects [B, N, O].

    Args:
      robot: [B, F]. objects: [B, N, G]. edges: [B, K, K, E]. control: [B, U]. setting: [B, W].
      scales: [B or 1, N, layers * 4 * width], of objects.
      weights, biases, starts, bias_starts: see `_pack`.
      sizes: layers, heads, width, R and O. tile: see `Tile`.
    """
    layers, heads, width, robot_out, object_out = sizes
    worlds, tokens = edges.shape[:2]
    many, all_of = objects.shape[1], layers * 4 * width
    rows, chunk, part, columns, warps, stages = tile
    half = {"dtype": torch.float16}
    z = robot.new_empty((worlds, tokens, width), **half)
    pairs = robot.new_empty((worlds, tokens, tokens, PAIR), **half)
    robot_scales = robot.new_empty((worlds, all_of), **half)
    most = worlds * tokens * tokens
    tokens_kernel[(-(-most // _ROWS), 3 + all_of // columns)](
        robot, objects, edges, control, z, setting, z, pairs, robot_scales, z,
        weights, biases, worlds,
        L=layers, W=width, PAIR=PAIR, **_widths(robot, objects, edges, control, setting),
        EDGE_HIDDEN=bias_starts[1] - bias_starts[0] - PAIR, ATTRIBUTES=1, DESCRIBED_SPACE=_LEAST,
        AT=tuple(starts[:6]), AT_BIAS=tuple(bias_starts[:6]),
        COLUMNS=columns, CHUNK=min(_CHUNK, width), FIRST=0, M=_ROWS,
    )  # fmt: skip
    found = robot.new_empty((worlds, robot_out), dtype=torch.float32)
    moved = robot.new_empty((worlds, many, object_out), dtype=torch.float32)
    told = robot.new_empty((worlds, tokens, 2 * width), dtype=torch.float16)
    mix = (bias_starts[-3] - bias_starts[6]) // layers - 5 * width
    layers_kernel[(-(-worlds // (rows // tokens)),)](
        z, pairs, robot_scales, scales, int(len(scales) > 1), weights, biases, told,
        found, moved, worlds,
        K=tokens, HAS_ROBOT=tokens - many, L=layers, W=width, HEADS=heads, MIX=mix, PAIR=PAIR,
        ROBOT_OUT=robot_out, ROBOT_SPACE=_space(robot_out),
        OBJECT_OUT=object_out, OBJECT_SPACE=_space(object_out),
        AT=(starts[6], *starts[-3:]), AT_BIAS=(bias_starts[6], *bias_starts[-3:]),
        CHUNK=chunk, PART=part, M=rows, num_warps=warps, num_stages=stages,
    )  # fmt: skip
    return found, moved


@_network.register_fake  # type: ignore[untyped-decorator]
def _(robot: Tensor, objects: Tensor, *rest: Any) -> tuple[Tensor, Tensor]:
    robot_out, object_out = rest[6][3:]
    single = {"dtype": torch.float32}
    found = robot.new_empty((len(robot), robot_out), **single)
    return found, robot.new_empty((len(robot), objects.shape[1], object_out), **single)


def _widths(
    robot: Tensor, objects: Tensor, edges: Tensor, control: Tensor, setting: Tensor
) -> dict[str, int]:
    """How many tokens and numbers a kernel is given, and the room that it takes for them."""
    tokens, commands = edges.shape[1], control.shape[1] + setting.shape[1]
    return {
        "K": tokens,
        "HAS_ROBOT": tokens - objects.shape[1],
        "ROBOT": robot.shape[1],
        "ROBOT_SPACE": _space(robot.shape[1]),
        "OBJECT": objects.shape[2],
        "OBJECT_SPACE": _space(objects.shape[2]),
        "EDGE": edges.shape[3],
        "EDGE_SPACE": _space(edges.shape[3]),
        "CONTROL": control.shape[1],
        "SETTING": setting.shape[1],
        "COMMAND_SPACE": _space(commands),
    }


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


def _pack(network: Any, blocks: list[Any], weights: _Packed, biases: _Packed) -> tuple[int, int]:
    """Everything in the order in which the kernels read it; gives the numbers of outputs.

    Groups: features of pairs, encoder of the robot, of objects, condition of the robot, of objects,
    AdaLN of all layers, each layer, transition, decoder of the robot, of objects. Matrices have a
    row for each input; sides are filled up with zeros to powers of two, of at least 16.
    """

    def perceptron(first: Any, second: Any) -> None:
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
    encoders = network.f_enc.robot, network.f_enc.objects
    for encoder, start in zip(encoders, network.start[:2], strict=True):
        begin()
        layers: Any = encoder_of(encoder, start)
        perceptron(layers[0], layers[2])
        vectors(layers[3].weight, layers[3].bias)
    for condition in (network.robot_condition, network.object_condition):
        begin()
        perceptron(condition[0], condition[2])
    begin()
    norms = [norm for block in blocks for norm in (block.before_attention, block.before_mixing)]
    modulation = stacked([norm.modulation for norm in norms])
    weights.add(modulation.weight.T)
    vectors(modulation.bias)
    for block in blocks:
        begin()
        _pack_block(block, weights, biases)
    begin()
    norm, last = network.f_cp.norm, transition_of(network.f_tra.layers, network.f_tra.skip)
    vectors(norm.weight, norm.bias)
    perceptron(last[0], last[2])
    for head in (network.f_dec.robot, network.f_dec.objects):
        begin()
        perceptron(head[0], head[2])
    return network.f_dec.robot[2].out_features, network.f_dec.objects[2].out_features


def _pack_block(block: Any, weights: _Packed, biases: _Packed) -> None:
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
