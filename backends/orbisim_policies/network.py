"""The policy: a small network from observations to actions, and its value function."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import torch
from torch import Tensor, nn

from orbisim.errors import InputError

ACTIVATIONS: dict[str, Any] = {"elu": nn.ELU, "relu": nn.ReLU, "tanh": nn.Tanh}
_MOST = 4096
"""Units of a layer that a manifest may ask for: far beyond what has been trained."""


@dataclasses.dataclass(frozen=True)
class NetworkConfig:
    """Attributes: hidden: widths. activation: between layers. squash: `tanh` or `clip`."""

    hidden: tuple[int, ...] = (256, 256)
    activation: str = "elu"
    squash: str = "tanh"


class Policy(nn.Module):
    """Observations [N, F] to actions [N, A] from -1 to 1.

    Args:
      observations, actions: how many.
      config: of the network.

    Raises:
      InputError: the configuration is none.
    """

    def __init__(self, observations: int, actions: int, config: NetworkConfig) -> None:
        super().__init__()
        _check(config)
        self.config = config
        widths = [observations, *config.hidden]
        layers: list[nn.Module] = []
        for a, b in itertools.pairwise(widths):
            layers += [nn.Linear(a, b), ACTIVATIONS[config.activation]()]
        self.body = nn.Sequential(*layers)
        self.head = nn.Linear(widths[-1], actions)
        with torch.no_grad():
            self.head.weight.mul_(0.1)
            self.head.bias.zero_()

    def begin(self, count: int) -> Policy:
        """What acts through so many episodes: the policy itself, as it remembers nothing."""
        return self

    def raw(self, observation: Tensor) -> Tensor:
        """Before the bounds."""
        return self.head(self.body(observation))

    def forward(self, observation: Tensor, noise: Tensor | None = None) -> Tensor:
        """Actions, with noise added before the bounds."""
        raw = self.raw(observation)
        raw = raw if noise is None else raw + noise
        return raw.tanh() if self.config.squash == "tanh" else raw.clamp(-1.0, 1.0)


def value_network(observations: int, width: int = 256) -> nn.Sequential:
    """Observations [N, F] to values [N, 1]."""
    return nn.Sequential(
        nn.Linear(observations, width),
        nn.ELU(),
        nn.Linear(width, width),
        nn.ELU(),
        nn.Linear(width, 1),
    )


def _check(config: NetworkConfig) -> None:
    if config.activation not in ACTIVATIONS or config.squash not in ("tanh", "clip"):
        raise InputError(
            f"a policy has activation {', '.join(ACTIVATIONS)} and squash tanh or clip; got "
            f"{config.activation!r} and {config.squash!r}"
        )
    sizes = config.hidden
    if not 1 <= len(sizes) <= 8 or not all(1 <= size <= _MOST for size in sizes):
        raise InputError(f"a policy has 1 to 8 layers of 1 to {_MOST} units; got {list(sizes)}")
