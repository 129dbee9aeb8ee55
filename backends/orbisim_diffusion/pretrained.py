"""LPIPS and FVD, by backbones that are not shipped: files that the user has.

LPIPS (Zhang et al. 2018), version 0.1 with AlexNet, and FVD (Unterthiner et al. 2019) with the I3D
of StyleGAN-V (Skorokhodov et al. 2022), clips of 16 frames.
"""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from orbisim.errors import InputError
from orbisim_diffusion.features import CLIP
from orbisim_diffusion.quality import frechet

ALEXNET, LINEAR, I3D = "alexnet-owt-7be5be79.pth", "alex.pth", "i3d_torchscript.pt"
"""Files as they are distributed: AlexNet of torchvision, the five linear layers of the package
lpips (weights/v0.1), and the I3D in TorchScript."""
_SHIFT, _SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)
"""LPIPS's own normalisation of images from -1 to 1."""
_LAYERS = (
    (0, 3, 64, 11, 4, 2),
    (3, 64, 192, 5, 1, 2),
    (6, 192, 384, 3, 1, 1),
    (8, 384, 256, 3, 1, 1),
    (10, 256, 256, 3, 1, 1),
)
"""Of AlexNet: number among its features, channels in and out, kernel, stride, padding."""
_POOLED = (3, 6)
"""Layers that come after a maximum over 3 x 3, stride 2."""
_SIDE = 224
"""Pixels of I3D's input."""
_BATCH = 64  # frames at once, so that memory does not grow with the number of videos


class Pretrained(NamedTuple):
    """What of the two is there."""

    lpips: Lpips | None
    i3d: I3d | None


def load_pretrained(folder: Path, device: torch.device) -> Pretrained:
    """What the files in a folder allow.

    Raises:
      InputError: it has neither all files of LPIPS nor that of FVD, or one is not what it should.
    """
    lpips = all((folder / name).is_file() for name in (ALEXNET, LINEAR))
    video = (folder / I3D).is_file()
    if not (lpips or video):
        raise InputError(
            f"{folder}: has neither {ALEXNET} and {LINEAR} (for LPIPS) nor {I3D} (for FVD); put "
            "them there"
        )
    return Pretrained(
        Lpips(folder, device) if lpips else None, I3d(folder / I3D, device) if video else None
    )


class Lpips(nn.Module):
    """LPIPS 0.1 with AlexNet.

    Args:
      folder: with the two files. device: where to compute.
    """

    def __init__(self, folder: Path, device: torch.device) -> None:
        super().__init__()
        backbone, linear = (_weights(folder / name) for name in (ALEXNET, LINEAR))
        self.layers = nn.ModuleList()
        self.linear: list[Tensor] = []
        for i, (number, wide, out, kernel, stride, padding) in enumerate(_LAYERS):
            layer = nn.Conv2d(wide, out, kernel, stride, padding)
            names = [f"features.{number}.weight", f"features.{number}.bias"]
            layer.weight.data = _of(backbone, names[0], layer.weight.shape, folder / ALEXNET)
            layer.bias.data = _of(backbone, names[1], layer.bias.shape, folder / ALEXNET)
            self.layers.append(layer)
            shape = torch.Size((1, out, 1, 1))
            told = _of(linear, f"lin{i}.model.1.weight", shape, folder / LINEAR)
            self.linear.append(told.to(device))
        self.to(device).requires_grad_(False)
        self.shift, self.scale = (
            torch.tensor(v, device=device)[:, None, None] for v in (_SHIFT, _SCALE)
        )

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def forward(self, a: Tensor, b: Tensor) -> Tensor:
        """Distance [N] of uint8 images [N, H, W, 3]."""
        x, y = (
            ((v.movedim(-1, -3).float() / 127.5 - 1.0) - self.shift) / self.scale for v in (a, b)
        )
        total = torch.zeros(len(a), device=x.device)
        for row, layer, linear in zip(_LAYERS, self.layers, self.linear, strict=True):
            if row[0] in _POOLED:
                x, y = (nn.functional.max_pool2d(v, 3, 2) for v in (x, y))
            x, y = (torch.relu(layer(v)) for v in (x, y))
            p, q = (v / (v.square().sum(1, keepdim=True).sqrt() + 1e-10) for v in (x, y))
            total += ((p - q).square() * linear).sum(1).mean((1, 2))
        return total


class I3d:
    """Features of clips for FVD.

    Args:
      path: of the TorchScript file. device: where to compute.
    """

    def __init__(self, path: Path, device: torch.device) -> None:
        try:
            self.model: Any = torch.jit.load(path, map_location=device).eval()
        except (RuntimeError, ValueError) as error:
            raise InputError(f"{path}: is no TorchScript file ({error})") from None

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def __call__(self, videos: Tensor) -> Tensor:
        """Features [clips, D] of uint8 videos [E, T, H, W, 3], in clips of 16 frames."""
        count = videos.shape[1] // CLIP
        clips = videos[:, : count * CLIP].unflatten(1, (count, CLIP)).flatten(0, 1)
        found = []
        for part in clips.split(_BATCH // CLIP):
            frames = part.flatten(0, 1).movedim(-1, 1).float() / 127.5 - 1.0
            frames = nn.functional.interpolate(
                frames, (_SIDE, _SIDE), mode="bilinear", align_corners=False
            )
            given = frames.unflatten(0, (len(part), CLIP)).movedim(2, 1)
            found.append(self.model(given, rescale=False, resize=False, return_features=True))
        return torch.cat(found)

    def distance(self, a: Tensor, b: Tensor) -> tuple[float, int]:
        """FVD of videos [E, T, H, W, 3], and the number of clips of each side."""
        x, y = (self(v).double().cpu().numpy() for v in (a, b))
        return frechet(x, y), len(x)


def _weights(path: Path) -> dict[str, Tensor]:
    try:
        found = torch.load(path, map_location="cpu", weights_only=True)
    except (RuntimeError, pickle.UnpicklingError, EOFError) as error:
        raise InputError(f"{path}: is no file of weights ({error})") from None
    if not isinstance(found, dict):
        raise InputError(f"{path}: holds {type(found).__name__}; a dictionary of weights is needed")
    return found


def _of(weights: dict[str, Tensor], name: str, shape: torch.Size, path: Path) -> Tensor:
    value = weights.get(name)
    if value is None or value.shape != shape:
        got = "nothing" if value is None else list(value.shape)
        raise InputError(f"{path}: {name} should be {list(shape)}, got {got}")
    return value.float()
