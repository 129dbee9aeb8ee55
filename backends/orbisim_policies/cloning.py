"""Behaviour cloning in plain torch."""

from __future__ import annotations

import dataclasses

import torch
from orbisim_world_model.optimizer import FlatAdamW
from orbisim_world_model.sampling import generator_of
from torch import Tensor

from orbisim_policies.demonstrations import Demonstrations
from orbisim_policies.network import NetworkConfig, Policy


@dataclasses.dataclass(frozen=True)
class CloneConfig:
    """How a policy is cloned.

    Attributes:
      batch: pairs at once. rate: of Adam, falling to nothing. network: of the policy.
    """

    batch: int = 2048
    rate: float = 1e-3
    network: NetworkConfig = dataclasses.field(default_factory=NetworkConfig)


class Cloning:
    """One training, resumable to the exact step: the mean squared error of actions.

    Args:
      data: what to imitate, on the device to train on.
      config: how.
      seed: of weights and batches.
    """

    def __init__(self, data: Demonstrations, config: CloneConfig, seed: int = 0) -> None:
        self.data, self.config, self.seed, self.done = data, config, seed, 0
        device = data.observations.device
        sizes = data.observations.shape[1], data.actions.shape[1]
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.policy = Policy(*sizes, config.network).to(device)
        self.optimizer = FlatAdamW(self.policy, 0.0, 1.0)

    def step(self, progress: float) -> Tensor:
        """One step; returns the loss."""
        data, device = self.data, self.data.observations.device
        generator = generator_of(device, self.seed, self.done)
        size = (self.config.batch,)
        index = torch.randint(len(data.actions), size, generator=generator, device=device)
        self.optimizer.rate.fill_(self.config.rate * (1.0 - progress))
        self.optimizer.zero_grad()
        error = self.policy(data.observations[index]) - data.actions[index]
        loss = error.square().mean()
        loss.backward()
        self.optimizer.step()
        self.done += 1
        return loss.detach()

    true_steps = 0
    """Of C MuJoCo that it makes itself."""

    @property
    def current(self) -> Policy:
        """The policy as it is now."""
        return self.policy

    @property
    def chosen(self) -> Policy:
        """The policy to keep."""
        return self.policy

    def state(self) -> dict[str, Tensor]:
        """What is needed to go on, by name."""
        return self.optimizer.state()

    def restore(self, tensors: dict[str, Tensor], done: int) -> None:
        """Takes what `state` gave after `done` steps."""
        self.optimizer.restore(tensors)
        self.done = done
