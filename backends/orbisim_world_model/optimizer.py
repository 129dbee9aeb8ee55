"""AdamW on one flat vector of all parameters.

A handful of kernels for the whole network, a state of three vectors that is saved as it is, and
one tensor to average over processes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import Tensor, nn

_BETAS, _TINY = (0.9, 0.98), 1e-9


class FlatAdamW:
    """AdamW (Loshchilov and Hutter) with clipping; weight decay acts on matrices alone.

    Args:
      module: its parameters become views of one vector.
      decay: weight decay.
      clip: largest norm of the gradient; a step whose gradient is not finite changes nothing.
    """

    def __init__(self, module: nn.Module, decay: float, clip: float) -> None:
        parameters = [p for p in module.parameters() if p.requires_grad]
        self.clip, self.decay = clip, decay
        device = parameters[0].device
        self.values = torch.cat([p.detach().reshape(-1) for p in parameters])
        self.gradient = torch.zeros_like(self.values)
        self.first, self.second = torch.zeros_like(self.values), torch.zeros_like(self.values)
        self.count = torch.zeros((), device=device)
        self.skipped = torch.zeros((), device=device)
        self.rate = torch.zeros((), device=device)
        decayed = [torch.full_like(p, float(p.dim() > 1)).reshape(-1) for p in parameters]
        self.decayed = torch.cat(decayed)
        offset = 0
        for p in parameters:
            end = offset + p.numel()
            p.data = self.values[offset:end].view_as(p)
            p.grad = self.gradient[offset:end].view_as(p)
            offset = end

    def zero_grad(self) -> None:
        """Forgets the gradient."""
        self.gradient.zero_()

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def step(self) -> None:
        """Moves the parameters along the gradient that `backward` left."""
        norm = self.gradient.norm()
        fine = torch.isfinite(norm).to(norm.dtype)
        scale = (self.clip / (norm + 1e-6)).clamp(max=1.0)
        g = torch.nan_to_num(self.gradient, 0.0, 0.0, 0.0) * torch.nan_to_num(scale * fine)
        self.count += fine
        self.skipped += 1.0 - fine
        a, b = _BETAS
        self.first.add_(fine * (1 - a) * (g - self.first))
        self.second.add_(fine * (1 - b) * (g * g - self.second))
        count = self.count.clamp_min(1.0)
        unbiased = self.first / (1 - torch.exp(count * math.log(a)))
        spread = (self.second / (1 - torch.exp(count * math.log(b)))).sqrt()
        update = unbiased / (spread + _TINY) + self.decay * self.decayed * self.values
        self.values.sub_(self.rate * fine * update)

    def state(self) -> dict[str, Tensor]:
        """What is needed to go on, by name."""
        names = ("values", "first", "second", "count", "skipped")
        return {name: getattr(self, name) for name in names}

    def restore(self, tensors: Mapping[str, Tensor]) -> None:
        """Takes what `state` gave, in place."""
        for name, tensor in self.state().items():
            tensor.copy_(tensors[name])
