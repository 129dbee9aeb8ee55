"""DreamerV3's latent dynamics, and the policy that acts on them (Hafner et al. 2023).

Shapes: N worlds, F observations, A actions, D of the deterministic state, S categorical variables
of C classes each.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import silu

from orbisim.errors import InputError

_UNIFORM = 0.01
"""Share of the uniform distribution in every categorical one ("unimix"), as DreamerV3 has it."""
_LEAST_STD, _MOST_STD = 0.1, 1.0
"""Of actions, as DreamerV3 has them."""
_MOST = 4096
"""Units of a layer that a manifest may ask for: far beyond what has been trained."""


@dataclasses.dataclass(frozen=True)
class LatentConfig:
    """Sizes: the smallest that DreamerV3's paper lists has 256 units, too.

    Attributes:
      units: of hidden layers. layers: of each network. deter: of the deterministic state.
      variables, classes: of the stochastic state.
    """

    units: int = 256
    layers: int = 2
    deter: int = 256
    variables: int = 16
    classes: int = 16


class Latent(NamedTuple):
    """Attributes: deter: [N, D]. stoch: [N, S * C], one-hot, with straight-through gradients."""

    deter: Tensor
    stoch: Tensor

    @property
    def feature(self) -> Tensor:
        """[N, D + S * C]."""
        return torch.cat([self.deter, self.stoch], -1)


class Layer(nn.Module):
    """Linear, normalised to a root mean square of one, SiLU."""

    def __init__(self, inputs: int, units: int) -> None:
        super().__init__()
        self.linear = nn.Linear(inputs, units, bias=False)
        self.norm = nn.RMSNorm(units, eps=1e-4)

    def forward(self, x: Tensor) -> Tensor:
        """[..., inputs] to [..., units]."""
        return silu(self.norm(self.linear(x)))


def network(inputs: int, config: LatentConfig, outputs: int, scale: float = 1.0) -> nn.Sequential:
    """Layers and a linear one, whose weights are multiplied by `scale` (0: zeros at first)."""
    widths = [inputs] + [config.units] * config.layers
    layers = [Layer(a, b) for a, b in itertools.pairwise(widths)]
    last = nn.Linear(widths[-1], outputs)
    with torch.no_grad():
        last.weight.mul_(scale)
        last.bias.zero_()
    return nn.Sequential(*layers, last)


class Recurrent(nn.Module):
    """The recurrent state-space model: how latent states follow each other.

    Args:
      observations, actions: how many. config: sizes.
    """

    def __init__(self, observations: int, actions: int, config: LatentConfig) -> None:
        super().__init__()
        self.config, logits = config, config.variables * config.classes
        self.encoder = nn.Sequential(
            Layer(observations, config.units),
            *(Layer(config.units, config.units) for _ in range(config.layers - 1)),
        )
        self.enter = Layer(logits + actions, config.units)
        self.gates = nn.Linear(config.units + config.deter, 3 * config.deter, bias=False)
        self.norm = nn.RMSNorm(3 * config.deter, eps=1e-4)
        one = dataclasses.replace(config, layers=1)
        self.prior = network(config.deter, one, logits)
        self.posterior = network(config.deter + config.units, one, logits)

    def initial(self, count: int) -> Latent:
        """Before an episode."""
        weight = self.gates.weight
        width = self.config.variables * self.config.classes
        zeros = (weight.new_zeros((count, size)) for size in (self.config.deter, width))
        return Latent(*zeros)

    def encode(self, observation: Tensor) -> Tensor:
        """[..., F] to [..., units]."""
        return self.encoder(symlog(observation))

    def advance(self, before: Latent, action: Tensor) -> Tensor:
        """The deterministic state [N, D] after an action [N, A]."""
        x = self.enter(torch.cat([before.stoch, action], -1))
        parts = self.norm(self.gates(torch.cat([x, before.deter], -1)))
        reset, candidate, update = parts.chunk(3, -1)
        candidate = torch.tanh(reset.sigmoid() * candidate)
        update = (update - 1.0).sigmoid()  # begins with remembering
        return update * candidate + (1.0 - update) * before.deter

    def expected(self, deter: Tensor) -> Tensor:
        """Log-probabilities [N, S, C] of what comes, without seeing it."""
        return self._logs(self.prior(deter))

    def inferred(self, deter: Tensor, embedded: Tensor) -> Tensor:
        """Log-probabilities [N, S, C], given an observation that is encoded."""
        return self._logs(self.posterior(torch.cat([deter, embedded], -1)))

    def _logs(self, logits: Tensor) -> Tensor:
        config = self.config
        shares = logits.unflatten(-1, (config.variables, config.classes)).softmax(-1)
        return ((1.0 - _UNIFORM) * shares + _UNIFORM / config.classes).log()


def drawn(logs: Tensor, gumbel: Tensor | None = None) -> Tensor:
    """[N, S * C]: one class of each variable, with the gradient of its probability.

    Args:
      logs: [N, S, C]. gumbel: noise of the same shape; the likeliest class if None.
    """
    index = (logs if gumbel is None else logs + gumbel).argmax(-1, keepdim=True)
    hard, shares = torch.zeros_like(logs).scatter(-1, index, 1.0), logs.exp()
    return (hard + shares - shares.detach()).flatten(-2)


class Actor(nn.Module):
    """From latent states to normal distributions of actions."""

    def __init__(self, actions: int, config: LatentConfig) -> None:
        super().__init__()
        width = config.deter + config.variables * config.classes
        self.body = network(width, config, 2 * actions, 0.01)

    def forward(self, feature: Tensor) -> tuple[Tensor, Tensor]:
        """Mean, from -1 to 1, and standard deviation [N, A]."""
        mean, spread = self.body(feature).chunk(2, -1)
        std = (_MOST_STD - _LEAST_STD) * (spread + 2.0).sigmoid() + _LEAST_STD
        return mean.tanh(), std


class LatentPolicy(nn.Module):
    """What is kept of a training: it remembers what it has seen in an episode.

    Args:
      observations, actions: how many. config: sizes.

    Raises:
      InputError: the configuration is none.
    """

    def __init__(self, observations: int, actions: int, config: LatentConfig) -> None:
        super().__init__()
        sizes = dataclasses.astuple(config)
        if not all(1 <= size <= _MOST for size in sizes):
            raise InputError(f"latent sizes are from 1 to {_MOST}; got {sizes}")
        self.config, self.actions = config, actions
        self.dynamics = Recurrent(observations, actions, config)
        self.actor = Actor(actions, config)

    def begin(self, count: int) -> Callable[[Tensor], Tensor]:
        """From observations [N, F] to actions [N, A], step by step through so many episodes."""
        latent = self.dynamics.initial(count)
        action = latent.deter.new_zeros((count, self.actions))

        def act(observation: Tensor) -> Tensor:
            nonlocal latent, action
            latent, action = self.step(latent, action, observation)
            return action

        return act

    def step(
        self,
        before: Latent,
        action: Tensor,
        observation: Tensor,
        gumbel: Tensor | None = None,
        noise: Tensor | None = None,
    ) -> tuple[Latent, Tensor]:
        """The latent state after an action and what was seen then, and the next action.

        Args:
          before: latent states. action: [N, A] before. observation: [N, F].
          gumbel: [N, S, C], of the stochastic state; its likeliest classes if None.
          noise: [N, A] standard normal, of actions; none if None.
        """
        deter = self.dynamics.advance(before, action)
        logs = self.dynamics.inferred(deter, self.dynamics.encode(observation))
        latent = Latent(deter, drawn(logs, gumbel))
        mean, std = self.actor(latent.feature)
        return latent, (mean if noise is None else mean + std * noise).clamp(-1.0, 1.0)


def symlog(x: Tensor) -> Tensor:
    """sign(x) ln(1 + |x|)."""
    return x.sign() * x.abs().log1p()


def symexp(x: Tensor) -> Tensor:
    """The inverse of `symlog`."""
    return x.sign() * x.abs().expm1()
