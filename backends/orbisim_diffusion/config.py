"""Configurations: frozen values, written to and read from JSON."""

from __future__ import annotations

import dataclasses
from typing import Any, Literal, get_args

from orbisim.errors import UnknownNameError

PATCH = 8
"""Pixels along a side that one latent stands for."""
MOST_CONTEXT = 6
"""Largest number of context frames K (paper, appendix B.2)."""

Buffer = Literal["colour", "normals", "depth", "instance", "light"]
"""A geometry buffer: base colour; normals; inverse depth and position (each says how far away what
is seen is, so that they are left out together); shares of static, robot and object geoms; how much
of the scene's light is met."""


@dataclasses.dataclass(frozen=True)
class AutoencoderConfig:
    """The KL autoencoder.

    Attributes:
      channels: of a latent. widths: of the features at a half, a quarter and an eighth of the
        image's size. blocks: residual blocks at each of these sizes; the decoder has one more.
    """

    channels: int = 8
    widths: tuple[int, int, int] = (64, 96, 112)
    blocks: int = 2


@dataclasses.dataclass(frozen=True)
class DenoiserConfig:
    """The denoising network.

    Attributes:
      maps: spatial condition maps: `geometry` (depth, normals, instance, base colour and position
        by ray casting), `heatmaps` (one Gaussian for each entity, and depth; the paper's), or
        `none`.
      left_out: geometry buffers that are no input.
      tokens: what cross-attention goes to: `geoms` (one token for each geom), `one` (a single one
        of all geoms' features, one after another), or `controls` (those of the last steps; with
        `maps` of `none` nothing of the state is known).
      widths: of the features at the latents' size and at half of it.
      blocks: residual blocks at each size, on the way down and on the way up.
      heads: of attention. token: width of the object tokens.
      noisy_context: context frames get the target's noise, too, with their clean latents beside
        (the paper); else they are given clean only.
      sigma_data: standard deviation of the latents as the network gets them.
      noise_mean, noise_std: of ln sigma in training.
      consecutive: probability that context frames are the ones just before, in training.
      anchor: range of the noise on the anchor latent, log-uniform.
    """

    maps: Literal["geometry", "heatmaps", "none"] = "geometry"
    left_out: tuple[Buffer, ...] = ()
    tokens: Literal["geoms", "one", "controls"] = "geoms"
    widths: tuple[int, int] = (80, 112)
    blocks: int = 2
    heads: int = 4
    token: int = 80
    noisy_context: bool = False
    sigma_data: float = 1.0
    noise_mean: float = 0.4
    noise_std: float = 1.6
    consecutive: float = 0.5
    anchor: tuple[float, float] = (0.01, 0.3)


@dataclasses.dataclass(frozen=True)
class TrainConfig:
    """How a part is trained.

    Attributes:
      batch: samples a step. rate: largest learning rate, reached after `warmup` steps; it falls to
        0 at the end on half a cosine over the time limit. decay: of weights. clip: of gradients.
      average: share that the running average of the weights keeps at each step.
    """

    batch: int = 256
    rate: float = 1e-3
    warmup: int = 200
    decay: float = 1e-4
    clip: float = 1.0
    average: float = 0.998


@dataclasses.dataclass(frozen=True)
class Config:
    """Everything about a vision model but its data.

    Attributes:
      name: of the preset. size: height and width of the images it is trained on, pixels.
    """

    name: str = "default"
    size: int = 128
    autoencoder: AutoencoderConfig = AutoencoderConfig()
    denoiser: DenoiserConfig = DenoiserConfig()
    train_autoencoder: TrainConfig = TrainConfig(batch=128)
    train_denoiser: TrainConfig = TrainConfig(batch=256)
    train_one_step: TrainConfig = TrainConfig(batch=128, rate=3e-4)


PRESETS: dict[str, Config] = {
    "default": Config(),
    "paper": Config(
        name="paper",
        denoiser=DenoiserConfig(maps="heatmaps", noisy_context=True, noise_mean=1.2, noise_std=1.6),
    ),
    "no_decoupling": Config(
        name="no_decoupling",
        denoiser=DenoiserConfig(maps="none", tokens="controls", consecutive=1.0),
    ),
    "no_random_sampling": Config(
        name="no_random_sampling", denoiser=DenoiserConfig(consecutive=1.0)
    ),
    "no_object_centric": Config(name="no_object_centric", denoiser=DenoiserConfig(tokens="one")),
    **{
        f"no_{buffer}": Config(name=f"no_{buffer}", denoiser=DenoiserConfig(left_out=(buffer,)))
        for buffer in get_args(Buffer)
    },
    "tiny": Config(
        name="tiny",
        size=32,
        autoencoder=AutoencoderConfig(channels=4, widths=(8, 16, 16), blocks=1),
        denoiser=DenoiserConfig(widths=(16, 16), blocks=1, heads=2, token=16),
        train_autoencoder=TrainConfig(batch=8),
        train_denoiser=TrainConfig(batch=8),
        train_one_step=TrainConfig(batch=4),
    ),
}
"""`no_...` each leave one thing of `default` out: the paper's ablations (docs/equations.md), and
the geometry buffers one by one.
`tiny` is for tests: it trains in seconds and shows little."""


def preset(name: str) -> Config:
    """A configuration by name.

    Raises:
      UnknownNameError: there is none.
    """
    if name not in PRESETS:
        raise UnknownNameError("configuration", name, PRESETS)
    return PRESETS[name]


def to_dict(config: Any) -> dict[str, Any]:
    """For JSON."""
    return dataclasses.asdict(config)
