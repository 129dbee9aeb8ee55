"""What has been experienced, as one stream of moments for each world."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor


class Moments(NamedTuple):
    """Moments [...], each with what led to it.

    Attributes:
      observation: [..., F]. action: [..., A] before it; 0 at the first of an episode.
      reward: [...] that came with it. first: whether an episode begins here.
      over: whether nothing comes after it; an episode that is merely cut off is not over.
    """

    observation: Tensor
    action: Tensor
    reward: Tensor
    first: Tensor
    over: Tensor


class Replay:
    """The last moments of each world, in float32.

    Args:
      worlds: how many. capacity: moments of all worlds together.
      observations, actions: how many. device: where they are kept.
    """

    def __init__(
        self, worlds: int, capacity: int, observations: int, actions: int, device: torch.device
    ) -> None:
        self.size = -(-capacity // worlds)
        self._widths = (observations, actions, 1, 1, 1)
        self.rows = torch.zeros((worlds, self.size, sum(self._widths)), device=device)
        self.count = torch.zeros(worlds, dtype=torch.long)
        """Moments of each world so far, those that were overwritten included."""

    def add(self, worlds: Tensor, moments: Moments) -> None:
        """One moment [M, ...] of each of these worlds [M]."""
        flat = [field.reshape(len(worlds), -1).float() for field in moments]
        place, device = self.count[worlds] % self.size, self.rows.device
        self.rows[worlds.to(device), place.to(device)] = torch.cat(flat, 1).to(device)
        self.count[worlds] += 1

    def sample(self, batch: int, length: int, chance: Tensor) -> Moments:
        """Sequences [length, batch, ...]; the worlds and where they begin are of `chance`.

        Args:
          chance: [2, batch] uniform, on the host. Every world has at least `length` moments.
        """
        world = (chance[0] * len(self.count)).long().clamp_max(len(self.count) - 1)
        kept = self.count[world].clamp_max(self.size)
        offset = (chance[1].double() * (kept - length + 1)).long().minimum(kept - length)
        oldest = torch.where(self.count[world] > self.size, self.count[world] % self.size, 0)
        place = (oldest + offset + torch.arange(length)[:, None]) % self.size
        device = self.rows.device
        found = self.rows[world.to(device), place.to(device)]  # [length, batch, ...]
        view, action, *flags = found.split(self._widths, -1)
        return Moments(view, action, *(flag[..., 0] for flag in flags))

    def ready(self, length: int) -> bool:
        """Whether every world has a sequence of this length."""
        return int(self.count.min()) >= length
