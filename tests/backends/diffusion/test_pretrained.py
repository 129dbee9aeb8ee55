"""LPIPS and FVD by files of weights; these are random, the arithmetic is not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from orbisim_diffusion.pretrained import ALEXNET, I3D, LINEAR, load_pretrained
from orbisim_diffusion.quality import frechet
from torch import nn

from orbisim.errors import InputError

CPU = torch.device("cpu")
CHANNELS = (64, 192, 384, 256, 256)


def alexnet() -> nn.Sequential:
    """The features of torchvision's AlexNet, numbered as there."""
    torch.manual_seed(0)
    pool, relu = nn.MaxPool2d(3, 2), nn.ReLU()
    return nn.Sequential(
        nn.Conv2d(3, 64, 11, 4, 2), relu, pool,
        nn.Conv2d(64, 192, 5, 1, 2), relu, pool,
        nn.Conv2d(192, 384, 3, 1, 1), relu,
        nn.Conv2d(384, 256, 3, 1, 1), relu,
        nn.Conv2d(256, 256, 3, 1, 1), relu, pool,
    )  # fmt: skip


def write_lpips(folder: Path) -> tuple[nn.Sequential, list[torch.Tensor]]:
    network = alexnet()
    torch.save({f"features.{n}": v for n, v in network.state_dict().items()}, folder / ALEXNET)
    linear = [torch.rand(1, c, 1, 1) for c in CHANNELS]
    torch.save({f"lin{i}.model.1.weight": v for i, v in enumerate(linear)}, folder / LINEAR)
    return network, linear


class Mean(nn.Module):
    """Takes what I3D takes; its features are each channel's mean and deviation."""

    def forward(
        self, x: torch.Tensor, rescale: bool, resize: bool, return_features: bool
    ) -> torch.Tensor:
        assert not rescale and not resize and return_features
        assert x.shape[1:] == (3, 16, 224, 224)
        return torch.cat([x.mean((2, 3, 4)), x.std((2, 3, 4))], dim=1)


def images(seed: int, *shape: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randint(0, 256, (*shape, 64, 64, 3), generator=generator, dtype=torch.uint8)


def test_lpips_is_the_weighted_distance_of_unit_features(tmp_path: Path) -> None:
    network, linear = write_lpips(tmp_path)
    found = load_pretrained(tmp_path, CPU)
    assert found.lpips is not None and found.i3d is None
    a, b = images(0, 2), images(1, 2)
    expected, taps = torch.zeros(2), {1: 0, 4: 1, 7: 2, 9: 3, 11: 4}
    x, y = (
        (v.permute(0, 3, 1, 2) / 127.5 - 1 - torch.tensor([-0.030, -0.088, -0.188])[:, None, None])
        / torch.tensor([0.458, 0.448, 0.450])[:, None, None]
        for v in (a, b)
    )
    with torch.no_grad():
        for number, layer in enumerate(network):
            x, y = layer(x), layer(y)
            if number in taps:
                p, q = (nn.functional.normalize(v, dim=1) for v in (x, y))
                expected += ((p - q) ** 2 * linear[taps[number]]).sum(1).mean((1, 2))
    torch.testing.assert_close(found.lpips(a, b), expected, rtol=1e-4, atol=1e-6)
    assert float(found.lpips(a, a).max()) == 0.0


def test_fvd_is_the_frechet_distance_of_clips(tmp_path: Path) -> None:
    torch.jit.script(Mean()).save(str(tmp_path / I3D))
    found = load_pretrained(tmp_path, CPU)
    assert found.lpips is None and found.i3d is not None
    a, b = images(0, 3, 33), images(1, 3, 33) // 2
    distance, clips = found.i3d.distance(a, b)
    assert clips == 6  # two of each video; the last frame belongs to none
    x, y = (found.i3d(v).double().numpy() for v in (a, b))
    assert x.shape == (6, 6)
    np.testing.assert_allclose(x[:, :3], 0.0, atol=0.02)  # uniform values
    np.testing.assert_allclose(y[:, :3], -0.5, atol=0.02)
    assert distance == pytest.approx(frechet(x, y))
    assert found.i3d.distance(a, a)[0] == pytest.approx(0.0, abs=1e-6)


def test_what_is_wrong_with_files_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="neither"):
        load_pretrained(tmp_path, CPU)
    write_lpips(tmp_path)
    torch.save({"lin0.model.1.weight": torch.rand(1, 3, 1, 1)}, tmp_path / LINEAR)
    with pytest.raises(InputError, match=r"lin0.*\[1, 64, 1, 1\], got \[1, 3, 1, 1\]"):
        load_pretrained(tmp_path, CPU)
    (tmp_path / ALEXNET).write_bytes(b"no weights")
    with pytest.raises(InputError, match="no file of weights"):
        load_pretrained(tmp_path, CPU)
    (tmp_path / ALEXNET).unlink()
    (tmp_path / I3D).write_bytes(b"no model")
    with pytest.raises(InputError, match="TorchScript"):
        load_pretrained(tmp_path, CPU)
