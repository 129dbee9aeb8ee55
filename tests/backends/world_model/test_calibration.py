"""Layers that are rounded to few bits give nearly what they gave."""

from __future__ import annotations

from typing import Any

import torch
from orbisim_world_model.calibration import calibrated
from orbisim_world_model.quantization import quantized
from torch import Tensor, nn


def _network() -> nn.Sequential:
    torch.manual_seed(0)
    return nn.Sequential(
        nn.Conv2d(3, 16, 3, 2, 1),
        nn.SiLU(),
        nn.Conv2d(16, 16, 3, padding=1, bias=False),
        nn.SiLU(),
        nn.Flatten(),
        nn.Linear(256, 8),
    )


def _run(images: Tensor) -> Any:
    return lambda network: network(images)


@torch.no_grad()  # type: ignore[untyped-decorator]
def test_rounded_layers_give_nearly_what_they_gave() -> None:
    mixed = torch.randn(4, 3 * 64)
    images, fresh = ((torch.randn(n, 4) @ mixed).reshape(n, 3, 8, 8) for n in (400, 50))
    network, plain = _network(), _network()
    exact = network(fresh)
    (matrices,) = calibrated([network], [_run(images)], 5)
    assert set(matrices) == {"0.weight", "2.weight", "5.weight"}
    for name, matrix in matrices.items():
        assert torch.equal(network.get_parameter(name), matrix.weights())
    for layer in (0, 2, 5):
        weight = plain[layer].weight
        weight.copy_(quantized(weight, 5).weights())
    errors = [(n(fresh) - exact).square().mean().sqrt() for n in (network, plain)]
    assert errors[0] < 0.5 * errors[1]


@torch.no_grad()  # type: ignore[untyped-decorator]
def test_networks_share_layers() -> None:
    shared = nn.Linear(4, 4)
    networks = [nn.Sequential(nn.Linear(3, 4), shared) for _ in range(2)]
    runs = [_run(torch.randn(50, 3)) for _ in range(2)]
    first, second = calibrated(networks, runs, 8)
    assert set(first) == {"0.weight", "1.weight"}
    assert set(second) == {"0.weight"}
    assert networks[0][1] is networks[1][1] is shared


@torch.no_grad()  # type: ignore[untyped-decorator]
def test_columns_and_rows_of_zeros_stay_so() -> None:
    layer = nn.Linear(70, 6)
    layer.weight[:, :64] = 0.0
    layer.weight[3] = 0.0
    (matrices,) = calibrated([nn.Sequential(layer)], [_run(torch.randn(90, 70))], 8)
    assert (matrices["0.weight"].peaks[:, :2] == 0).all()
    assert (layer.weight[3] == 0).all()
