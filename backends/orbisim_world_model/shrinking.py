"""Writes a checkpoint again in few bits a weight (see `calibration` and `quantization`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import nn

from orbisim.errors import InputError
from orbisim.files.writing import make_folder
from orbisim_world_model.calibration import calibrated
from orbisim_world_model.checkpoint import WEIGHTS, load_checkpoint, save_checkpoint, write_parts
from orbisim_world_model.cloth.manifest import read_cloth_manifest
from orbisim_world_model.dynamics import Dynamics
from orbisim_world_model.manifest import read_manifest, variants
from orbisim_world_model.network.coupling import Block
from orbisim_world_model.network.objects import ObjectCentricNetwork
from orbisim_world_model.pack import Pack
from orbisim_world_model.quantization import Quantized, quantized
from orbisim_world_model.sampling import Windows, generator_of

_LENGTH, _SEQUENCES = 8, 1500
"""Control steps of the rollouts whose states are the inputs, and their number for one token."""


def save_in_few_bits(
    source: str | Path,
    target: str | Path,
    packs: Sequence[Pack] | None,
    bits: int,
    seed: int = 0,
) -> None:
    """Writes a checkpoint again with its networks' matrices in few bits.

    Args:
      source, target: folders, which may be one. What else there is in `source` is not copied.
      packs: episodes like those it was trained on, of each of its robots; None to round each
        weight to the nearest, which with 14 bits and more is less than half precision does.
      bits: of a weight (see `quantization.BITS`). seed: of the draw among the episodes.

    Raises:
      InputError: a file is missing or damaged, there are not as many packs as robots, or the
        network has a memory or no tokens.
    """
    manifest = read_manifest(source)
    count = len(variants(manifest))
    if packs is not None and len(packs) != count:
        raise InputError(f"{source}: knows {count} robots; got episodes of {len(packs)}")
    models = [load_checkpoint(source, variant=number).model for number in range(count)]
    if models[0].config.kind != "objects" or models[0].config.memory != "none":
        raise InputError(f"{source}: only networks with tokens and without memory are calibrated")
    for number, model in enumerate(models):
        model.share(models[:number])
    remove_unused(models)
    networks = [model.network for model in models]
    if packs is None:
        matrices = _nearest(networks, bits)
    else:
        runs = [_run(model, pack, seed) for model, pack in zip(models, packs, strict=True)]
        matrices = calibrated(networks, runs, bits)
    named = [{f"network.{name}": m for name, m in each.items()} for each in matrices]
    save_checkpoint(Path(target), models, manifest, named)


def save_cloth_in_few_bits(source: str | Path, target: str | Path, bits: int) -> None:
    """Writes a cloth's checkpoint again with its network's matrices rounded to the nearest.

    Raises:
      InputError: a file is missing or damaged, or has few bits already.
    """
    manifest = read_cloth_manifest(source)
    try:
        stored = load_file(str(Path(source) / WEIGHTS))
    except (OSError, SafetensorError) as error:
        raise InputError(f"{source}: a damaged checkpoint of a cloth ({error})") from None
    if any(tensor.dtype == torch.uint8 for tensor in stored.values()):
        raise InputError(f"{source}: has few bits a weight already; start from half precision")
    tensors: dict[str, torch.Tensor] = {}
    for name, tensor in stored.items():
        if name.startswith("network.") and tensor.dim() == 2:
            tensors |= quantized(tensor, bits).tensors(name)
        else:
            tensors[name] = tensor
    make_folder(Path(target))
    write_parts(Path(target), tensors, manifest)


@torch.no_grad()  # type: ignore[untyped-decorator]
def remove_unused(models: Sequence[Dynamics]) -> None:
    """Makes 0 what does not change the step of models without memory, in place.

    Their encoders see the same memory always, which becomes a bias, and their transition sees the
    same token twice, whose weights are added up. A robot alone has nobody to ask and no
    objects, one made of limbs no token of its own.

    Args:
      models: one for each robot; parts that they share are the same modules.
    """
    lead: ObjectCentricNetwork = models[0].network
    width = lead.start.shape[1]
    encoders = [(model.network.f_enc.robot, lead.start[0]) for model in models]
    encoders.append((lead.f_enc.objects, lead.start[1]))
    if lead.parts:
        encoders.append((lead.f_enc.parts, lead.start[2]))
    for layers, start in encoders:
        if layers is not None:
            first: Any = layers[0]
            first.bias += first.weight[:, :width] @ start
            first.weight[:, :width] = 0.0
    lead.start.zero_()
    if lead.f_tra.skip:
        first = lead.f_tra.layers[0]
        first.weight[:, width:] += first.weight[:, :width]
        first.weight[:, :width] = 0.0
    if not lead.count and not lead.parts:
        for block in lead.f_cp.blocks:
            assert isinstance(block, Block)
            block.qkv.weight[: 2 * width] = 0.0
            block.qkv.bias[: 2 * width] = 0.0
    unused = [] if lead.count else [lead.object_condition]
    unused += [m.network.robot_condition for m in models if not m.network.robot_token]
    for parameter in (p for module in unused for p in module.parameters()):
        parameter.zero_()


def _nearest(networks: Sequence[nn.Module], bits: int) -> list[dict[str, Quantized]]:
    """The matrices of each network's linear layers; those that are shared stand in the first."""
    found: list[dict[str, Quantized]] = []
    done: set[nn.Module] = set()
    for network in networks:
        layers = {n: m for n, m in network.named_modules() if isinstance(m, nn.Linear)}
        new = {name: layer for name, layer in layers.items() if layer not in done}
        found.append({f"{n}.weight": quantized(m.weight, bits) for n, m in new.items()})
        done |= set(new.values())
    return found


@torch.no_grad()  # type: ignore[untyped-decorator]
def _run(model: Dynamics, pack: Pack, seed: int) -> Callable[[Any], object]:
    """Calls a network with what it sees in true states and in short rollouts of the model."""
    length, size = min(_LENGTH, int(pack.length.max())), _SEQUENCES // model.sizes.tokens
    windows = Windows(pack, length, model.config)
    batch = windows.batch(*windows.draw(size, generator_of("cpu", seed, 0)))
    x, memory, given = model.completed(batch.states.at(0)), model.initial_memory(size), []
    for t in range(length):
        inputs = model.inputs(x, batch.control[t], batch.context)
        given.append((inputs, model.network.initial_memory(size)))
        step = model(x, memory, batch.control[t], batch.context)
        x, memory = step.state, step.memory

    def run(network: Any) -> None:
        for inputs, start in given:
            network(inputs, start)

    return run
