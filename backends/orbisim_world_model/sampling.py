"""Draws training sequences; the batch of a step depends on the seed and the step's number alone."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from orbisim.errors import InputError
from orbisim_world_model.config import ModelConfig
from orbisim_world_model.entities import Context, Entities
from orbisim_world_model.pack import Pack


class Batch(NamedTuple):
    """Sequences of L steps.

    Attributes:
      states: fields [L+1, B, ...].
      control: [L, B, U].
      context: of each sequence.
      base: what the classical step predicts from each state, fields [L, B, ...]; None without.
    """

    states: Entities
    control: Tensor
    context: Context
    base: Entities | None = None


class Windows:
    """All sequences of a length within the episodes of a pack.

    Args:
      pack: the data.
      length: number of steps L; episodes that are shorter are left out.
      config: says which control is used.
    """

    def __init__(self, pack: Pack, length: int, config: ModelConfig) -> None:
        self.pack, self.length = pack, length
        self.controls = pack.controls(config)
        self.corrects = config.baseline != "none"
        if self.corrects and not pack.base.shape[1]:
            raise InputError("the data hold no classical predictions: give --residual-on mujoco")
        counts = (pack.length - length + 1).clamp_min(0)
        self.ends = torch.cumsum(counts, 0)
        self.firsts = self.ends - counts
        self.count = int(self.ends[-1])
        if not self.count:
            raise InputError(
                f"no episode has {length} control steps; the longest has {int(pack.length.max())}"
            )

    def draw(self, size: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """First rows and episodes [B] of the sequences of one training step."""
        number = torch.randint(self.count, (size,), generator=generator, device=self.pack.device)
        return self.locate(number)

    def locate(self, number: Tensor) -> tuple[Tensor, Tensor]:
        """First rows and episodes of sequences by number."""
        episode = torch.searchsorted(self.ends, number, right=True)
        return self.pack.start[episode] + number - self.firsts[episode], episode

    def batch(self, row: Tensor, episode: Tensor) -> Batch:
        """The sequences that begin at these rows."""
        steps = torch.arange(self.length + 1, device=row.device)
        rows = row[None] + steps[:, None]  # [L+1, B]
        flat = self.pack.states(rows)
        states = Entities(*(field.unflatten(0, rows.shape) for field in flat))
        base = None
        if self.corrects:
            flat = self.pack.predictions(rows[:-1])
            base = Entities(*(field.unflatten(0, rows[:-1].shape) for field in flat))
        return Batch(states, self.controls[rows[:-1]], self.pack.context(episode), base)


def generator_of(device: Any, seed: int, step: int) -> torch.Generator:
    """The random numbers of one training step, wherever the training was resumed."""
    generator = torch.Generator(device)
    generator.manual_seed(seed * 1_000_000_007 + step)
    return generator
