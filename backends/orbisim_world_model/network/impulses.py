"""Impulses of candidate contacts, from the tokens of both sides and what they see of each other."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from orbisim_world_model.contacts import Contacts

_WIDTH = 96  # of the hidden layer; weights of checkpoints have this shape


class Impulses(nn.Module):
    """Three numbers for each pair of boxes (see `Contacts.impulses`).

    Args:
      width: of tokens. pair: of the features of pairs. contacts: the pairs.
    """

    def __init__(self, width: int, pair: int, contacts: Contacts) -> None:
        super().__init__()
        self.slots = contacts.slots
        for name in ("token_one", "token_other", "slot"):
            self.register_buffer(name, getattr(contacts, name), persistent=False)
        last = nn.Linear(_WIDTH, 3 * self.slots)
        nn.init.zeros_(last.bias)
        nn.init.normal_(last.weight, std=1e-2)
        self.layers = nn.Sequential(nn.Linear(2 * width + pair, _WIDTH), nn.SiLU(), last)
        chosen = torch.zeros(len(contacts.slot), self.slots)
        chosen[torch.arange(len(contacts.slot)), contacts.slot] = 1.0
        self.register_buffer("chosen", chosen[..., None], persistent=False)

    def forward(self, tokens: Tensor, pairs: Tensor) -> Tensor:
        """[B, P, 3] from tokens [B, K, width] and features of pairs [B, K, K, pair]."""
        a, b = tokens.index_select(1, self.token_one), tokens.index_select(1, self.token_other)
        count = tokens.shape[1]
        flat = pairs.flatten(1, 2).index_select(1, self.token_one * count + self.token_other)
        found = self.layers(torch.cat([a, b, flat], dim=-1)).unflatten(-1, (self.slots, 3))
        return (found * self.chosen.to(found.dtype)).sum(2)
