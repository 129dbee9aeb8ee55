"""Rounds a trained network's matrices to few bits so that what its layers give stays close.

Layer after layer, as they follow one another: each matrix is first fitted again to give, from the
inputs that the rounded layers before it now yield, what it gave before (least squares, held close
to what it was), and then rounded with feedback (`quantization.quantized`). The bias takes up the
mean of what is left.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.functional import unfold

from orbisim_world_model.quantization import Quantized, quantized

_DAMPING = 1e-4
"""Of the mean second moment of a layer's inputs, added to all."""
_ROWS = 2500
"""At most so many inputs of a layer are taken from each of its calls, spread over them."""


@torch.no_grad()  # type: ignore[untyped-decorator]
def calibrated(
    networks: Sequence[nn.Module], runs: Sequence[Callable[[Any], object]], bits: int
) -> list[dict[str, Quantized]]:
    """Rounds the weights of all linear layers and convolutions, in place.

    Args:
      networks: one or more, which may share layers. runs: what calls each of them (and copies of
        it) with representative inputs, the same each time.
      bits: of a weight (see `quantization.BITS`).

    Returns:
      For each network its matrices, by the name of the weight; those of layers that it shares with
      an earlier one stand there alone.
    """
    before = copy.deepcopy(list(networks))
    users: dict[nn.Module, list[tuple[int, str]]] = {}
    for number, (network, run) in enumerate(zip(networks, runs, strict=True)):
        layers = dict(network.named_modules())
        for name in _order(network, run):
            users.setdefault(layers[name], []).append((number, name))
    wanted: list[list[str]] = [[] for _ in networks]
    for places in users.values():
        for number, name in places:
            wanted[number].append(name)
    given = [_given(*each) for each in zip(before, wanted, runs, strict=True)]
    found: list[dict[str, Quantized]] = [{} for _ in networks]
    for layer, places in users.items():
        then, now = [], []
        for number, name in places:
            then.append(given[number].pop(name))
            now.append(_given(networks[number], [name], runs[number])[name])
        number, name = places[0]
        found[number][f"{name}.weight"] = _rounded(layer, torch.cat(then), torch.cat(now), bits)
    return found


def _rounded(layer: Any, then: Tensor, now: Tensor, bits: int) -> Quantized:
    """Changes a layer so that it gives of `now` [n, columns] what it gave of `then`."""
    weight = layer.weight.double().flatten(1)
    then, now = then.double(), now.double()
    used = (weight.abs().amax(0) > 0).double()  # columns and rows that are 0 stay so
    now, then = now * used, then * used
    moments = now.T @ now / len(now)
    mean = moments.diagonal().sum() / used.sum().clamp_min(1.0)
    damped = moments + torch.diag(torch.where(used > 0, _DAMPING * mean.clamp_min(1e-12), 1.0))
    drift = weight @ ((then - now).T @ now) / len(now)
    fitted = weight + torch.linalg.solve(damped, drift.T).T
    fitted = torch.where(weight.abs().amax(1, keepdim=True) > 0, fitted, 0.0)
    matrix = quantized(fitted.reshape(layer.weight.shape), bits, damped)
    rounded = matrix.weights()
    if layer.bias is not None:
        off = (then @ weight.T - now @ rounded.double().flatten(1).T).mean(0)
        layer.bias.add_(off.float())
    layer.weight.copy_(rounded)
    return matrix


class _Order:
    """Keeps the names of layers in the order in which they are called first."""

    def __init__(self) -> None:
        self.names: list[str] = []

    def hook(self, name: str) -> Any:
        def seen(*_: Any) -> None:
            if name not in self.names:
                self.names.append(name)

        return seen


def _order(network: nn.Module, run: Callable[[Any], object]) -> list[str]:
    """Names of the layers that a run calls, in the order in which it first does."""
    order = _Order()
    handles = [
        module.register_forward_pre_hook(order.hook(name))
        for name, module in network.named_modules()
        if isinstance(module, (nn.Linear, nn.Conv2d))
    ]
    run(network)
    for handle in handles:
        handle.remove()
    return order.names


def _given(
    network: nn.Module, names: Sequence[str], run: Callable[[Any], object]
) -> dict[str, Tensor]:
    """What layers are multiplied by in a run, each [n, columns]."""
    parts: dict[str, list[Tensor]] = {name: [] for name in names}

    def kept(name: str) -> Any:
        return lambda layer, given: parts[name].append(_rows(layer, given[0]))

    handles = [network.get_submodule(name).register_forward_pre_hook(kept(name)) for name in names]
    run(network)
    for handle in handles:
        handle.remove()
    return {name: torch.cat(rows) for name, rows in parts.items()}


def _rows(layer: nn.Module, given: Tensor) -> Tensor:
    """The inputs of a layer's products, [n, columns]; of many, a sample."""
    rows = given.flatten(0, -2)
    if isinstance(layer, nn.Conv2d):
        assert layer.groups == 1 and not isinstance(layer.padding, str)
        sizes = layer.kernel_size, layer.dilation, layer.padding, layer.stride
        rows = unfold(given.contiguous(), *sizes).transpose(1, 2).flatten(0, 1)
    return rows[:: -(-len(rows) // _ROWS)].clone()
