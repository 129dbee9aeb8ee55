"""`Painter`: a checkpoint on a device, from conditions to latents and images."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from orbisim.errors import InputError
from orbisim_diffusion import edm
from orbisim_diffusion.autoencoder import Autoencoder
from orbisim_diffusion.checkpoint import Checkpoint
from orbisim_diffusion.config import PATCH, Config
from orbisim_diffusion.denoiser import Condition, Denoiser

MOST_STEPS = 1000
"""Of a sampler: a few do, and a slip of the keyboard should not keep a machine busy for days."""


class Painter:
    """Encodes, samples and decodes.

    Args:
      autoencoder, denoiser: trained. one_step: used for a single step, if there is one.
      config: of both. device: where to.
    """

    def __init__(
        self,
        autoencoder: Autoencoder,
        denoiser: Denoiser,
        one_step: Denoiser | None,
        config: Config,
        device: torch.device,
    ) -> None:
        self.config, self.device = config, device
        self.autoencoder = autoencoder.to(device).eval().requires_grad_(False)
        self.denoiser = denoiser.to(device).eval().requires_grad_(False)
        self.one_step = (
            None if one_step is None else one_step.to(device).eval().requires_grad_(False)
        )

    @staticmethod
    def of(checkpoint: Checkpoint, device: torch.device) -> Painter:
        """The painter of a checkpoint."""
        return Painter(
            checkpoint.autoencoder,
            checkpoint.denoiser,
            checkpoint.one_step,
            checkpoint.config,
            device,
        )

    def encode(self, images: Tensor) -> Tensor:
        """Latents [N, C, h, w], as the denoiser sees them, of images [N, 3, H, W] from -1 to 1."""
        return self.autoencoder.encode(images).float() * self.config.denoiser.sigma_data

    def decode(self, latents: Tensor) -> Tensor:
        """Images [N, 3, H, W] of latents."""
        return self.autoencoder.decode(latents / self.config.denoiser.sigma_data)

    def shape(self, count: int, maps: Tensor) -> tuple[int, int, int, int]:
        """Shape of the latents that belong to condition maps."""
        height, width = (size // PATCH for size in maps.shape[-2:])
        return count, self.config.autoencoder.channels, height, width

    def history(self, past: Sequence[Tensor], count: int, maps: Tensor) -> tuple[Tensor, Tensor]:
        """Context [B, K, C, h, w] and anchor [B, C, h, w] of past latents, oldest first.

        The anchor is not perturbed: training perturbs it, so that it may be imperfect here.
        """
        shape = self.shape(count, maps)
        if not past:
            empty = torch.zeros((count, 0, *shape[1:]), device=self.device)
            return empty, torch.zeros(shape, device=self.device)
        return torch.stack(list(past), 1), past[-1]

    def paint(self, given: Condition, noise: Tensor, steps: int) -> Tensor:
        """The clean latent [B, C, h, w] of the frame that the condition describes.

        Args:
          given: the condition. noise: of unit variance, [B, C, h, w].
          steps: evaluations of the denoiser; 1 uses the one-step model if there is one.

        Raises:
          InputError: not 1 to 1000 steps.
        """
        if not 1 <= steps <= MOST_STEPS:
            raise InputError(f"a sampler takes 1 to {MOST_STEPS} steps; got {steps}")
        model = self.one_step if steps == 1 and self.one_step is not None else self.denoiser
        return edm.sample(lambda y, sigma: model(y, sigma, given), noise, steps)
