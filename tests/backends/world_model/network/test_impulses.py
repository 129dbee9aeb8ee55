"""The head of contacts' impulses takes the right tokens and pairs."""

from __future__ import annotations

import torch
from orbisim_world_model.contacts import Contacts
from orbisim_world_model.network.folded import FoldedNetwork
from orbisim_world_model.network.impulses import Impulses
from orbisim_world_model.trainer import new_model

from tests.backends.world_model.conftest import toy
from tests.backends.world_model.synthetic import PUSHER, simulate


def test_an_impulse_depends_on_both_sides_and_their_pair_alone() -> None:
    torch.manual_seed(0)
    contacts = Contacts(simulate(PUSHER, 1, 3, 2).layout)
    head = Impulses(8, 4, contacts)
    tokens, pairs = torch.randn(1, 3, 8), torch.randn(1, 3, 3, 4)
    before = head(tokens, pairs)
    assert before.shape == (1, contacts.pairs, 3)
    for token in range(3):
        other = tokens.clone()
        other[:, token] += 1.0
        changed = (head(other, pairs) != before)[0].any(1)
        touched = (contacts.token_one == token) | (contacts.token_other == token)
        assert torch.equal(changed, touched)


def test_the_folded_network_gives_the_same() -> None:
    pack = simulate(PUSHER, 2, 6, 2)
    model = new_model(pack, toy("contacts"), 0).eval()
    row, episode = pack.transitions()
    x, context = model.completed(pack.states(row)), pack.context(episode)
    inputs, memory = model.inputs(x, pack.ctrl[row], context), model.initial_memory(len(row))
    with torch.no_grad():
        ours = FoldedNetwork(model.network)(inputs, memory)
        theirs = model.network(inputs, memory)
    assert theirs.impulses is not None
    torch.testing.assert_close(ours.impulses, theirs.impulses, atol=1e-5, rtol=1e-4)
