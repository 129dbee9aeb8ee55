"""Attention over entities, against torch's own."""

from __future__ import annotations

import torch
from orbisim_world_model.network.coupling import Block, Coupling, token_mask


def test_attention_is_scaled_dot_product_attention() -> None:
    block, u = Block(8, 2, 2, 0), torch.randn(3, 5, 8)
    mask = torch.tensor([[1.0, 1, 1, 0, 1]]).expand(3, 5)
    q, k, v = (part.unflatten(-1, (2, 4)).transpose(1, 2) for part in block.qkv(u).chunk(3, -1))
    for given in (None, mask):
        allowed = None if given is None else (given[:, None, None, :] > 0)
        expected = torch.nn.functional.scaled_dot_product_attention(q, k, v, attn_mask=allowed)
        found = block.attention(u, None, given)
        torch.testing.assert_close(found, expected.transpose(1, 2).flatten(-2))


def test_a_single_token_looks_at_itself() -> None:
    block, u = Block(8, 2, 2, 0), torch.randn(3, 1, 8)
    torch.testing.assert_close(block.attention(u, None, None), block.qkv(u)[..., 16:])


def test_pairs_change_what_is_seen() -> None:
    coupling = Coupling(8, 2, 2, 2, edge=6)
    z, c, edges = torch.randn(2, 3, 8), torch.randn(2, 3, 8), torch.randn(2, 3, 3, 6)
    before = coupling(z, c, coupling.pairs(edges), None)
    other = edges.clone()
    other[:, 0, 2] += 1.0  # how the first sees the third
    with torch.no_grad():
        single = Coupling(8, 1, 2, 2, edge=6)
        seen = (single(z, c, single.pairs(each), None) for each in (other, edges))
        change = (next(seen) - next(seen)).abs().amax((0, 2))
    assert change[0] > 1e-6
    assert (change[1:] == 0).all()
    assert before.shape == (2, 3, 8)


def test_the_robot_is_always_there() -> None:
    mask = torch.tensor([[0.0, 1.0]])
    assert token_mask(mask, True).tolist() == [[1, 0, 1]]
    assert token_mask(mask, False) is mask
