"""PhyInf by itself: what it must not depend on, and what it says when nothing is shown."""

from __future__ import annotations

import math

import pytest
import torch
from orbisim_diffusion.physics import (
    FRAMES,
    PhysicsInference,
    Posterior,
    Window,
    divergence,
    log_likelihood,
)
from orbisim_world_model.rotation import exponential
from torch import Tensor


@pytest.fixture
def network() -> PhysicsInference:
    """Untrained, but one whose answers depend on what it sees."""
    torch.manual_seed(0)
    model = PhysicsInference().eval()
    for head in (model.density, model.friction):
        torch.nn.init.normal_(head[-1].weight, std=0.5)
    model.know(torch.tensor([0.2, 0.3, 0.6]), torch.tensor([150.0, 400.0, 900.0]))
    return model.requires_grad_(False)


def seen(count: int = 3, objects: int = 2) -> Window:
    generator = torch.Generator().manual_seed(1)

    def walk(*shape: int) -> Tensor:
        return 0.01 * torch.randn(count, FRAMES, *shape, generator=generator).cumsum(1)

    half = 0.02 + 0.01 * torch.rand(count, objects, 3, generator=generator)
    return Window(
        walk(3) + 0.3,
        torch.eye(3).expand(count, FRAMES, 3, 3),
        walk(objects, 3) + 0.05,
        exponential(walk(objects, 3)),
        torch.ones(count, FRAMES),
        torch.ones(count, FRAMES, objects),
        half,
        0.2 + 0.4 * torch.rand(count, objects, generator=generator),
        torch.ones(count, objects),
    )


def test_objects_have_no_order(network: PhysicsInference) -> None:
    window, order = seen(objects=3), [2, 0, 1]
    other = window._replace(
        **{n: getattr(window, n)[:, :, order] for n in ("pos", "quat", "known")},
        **{n: getattr(window, n)[:, order] for n in ("half", "friction", "present")},
    )
    one, two = network(window), network(other)
    assert one.mean.shape == one.spread.shape == (3, 4)
    assert float((one.mean[:, 1] - one.mean[:, 2]).abs().min()) > 1e-3  # objects differ
    for a, b in zip(one, two, strict=True):
        torch.testing.assert_close(a[:, [0, 3, 1, 2]], b, atol=1e-4, rtol=0)


def test_neither_where_nor_what_is_not_there_matters(network: PhysicsInference) -> None:
    window = seen()
    moved = torch.tensor([0.2, -0.4, 0.1])
    there = window._replace(pos=window.pos + moved, hand_pos=window.hand_pos + moved)

    def more(x: Tensor, axis: int) -> Tensor:
        return torch.cat([x, torch.zeros_like(x.narrow(axis, 0, 1)) + 0.7], dim=axis)

    padded = window._replace(
        **{n: more(getattr(window, n), 2) for n in ("pos", "quat", "known")},
        **{n: more(getattr(window, n), 1) for n in ("half", "friction")},
        present=torch.nn.functional.pad(window.present, (0, 1)),
    )
    one = network(window)
    for other in (network(there), network(padded)):
        for a, b in zip(one, other, strict=True):
            torch.testing.assert_close(a, b[:, :3], atol=1e-4, rtol=0)


def test_what_no_frame_shows_is_not_looked_at(network: PhysicsInference) -> None:
    window = seen()
    known = window.known.clone()
    known[:, 20:40, 1] = 0.0
    hidden = window._replace(known=known)
    strange = window.pos.clone()
    strange[:, 20:40, 1] = 7.0
    for a, b in zip(network(hidden), network(hidden._replace(pos=strange)), strict=True):
        torch.testing.assert_close(a, b, atol=1e-5, rtol=0)


def test_of_an_object_that_is_hardly_seen_it_says_the_prior(network: PhysicsInference) -> None:
    window = seen()
    known = window.known.clone()
    known[:, 5:, 1] = 0.0
    found = network.said(window._replace(known=known))
    torch.testing.assert_close(found.mean[:, 2], network.middle[1].expand(3))
    torch.testing.assert_close(found.spread[:, 2], network.width[1].expand(3))
    assert float((found.mean[:, 1] - network.middle[1]).abs().min()) > 1e-3


def test_it_begins_with_the_prior_and_stays_within_it() -> None:
    model = PhysicsInference().eval()
    friction, density = torch.tensor([0.2, 0.3, 0.6]), torch.tensor([150.0, 400.0, 900.0])
    model.know(friction, density)
    found = model(seen())
    for column, drawn in ((0, friction), (1, density), (2, density)):
        torch.testing.assert_close(found.mean[:, column], drawn.log().mean().expand(3))
        share = found.spread[:, column] / drawn.log().std()
        assert ((share > 0.85) & (share <= 1.0)).all()
    last = model.friction[-1].bias.data
    last[0], last[1] = 50.0, -50.0  # as sure as can be of the largest
    assert float(model(seen()).mean[0, 0].detach()) == pytest.approx(math.log(0.6), abs=1e-3)
    model.widen[:] = 5.0
    said = model.said(seen())
    assert (said.spread <= model.prior[model.kinds(2), 1] + 1e-6).all()


def test_likelihood_and_divergence_are_those_of_normal_distributions() -> None:
    found = Posterior(torch.tensor([[0.1, 0.5]]), torch.tensor([[0.3, 0.2]]))
    true, mask = torch.tensor([[0.4, 9.0]]), torch.tensor([[1.0, 0.0]])
    one, prior = torch.distributions.Normal(0.1, 0.3), torch.distributions.Normal(-0.2, 0.6)
    expected = one.log_prob(torch.tensor([0.4]))
    torch.testing.assert_close(log_likelihood(found, true, mask), expected)
    rows = torch.tensor([[-0.2, 0.6], [0.0, 1.0]])
    apart = torch.distributions.kl_divergence(one, prior)[None]
    torch.testing.assert_close(divergence(found, rows, mask), apart)
