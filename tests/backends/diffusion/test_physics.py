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
from orbisim_world_model.rotation import exponential, multiply
from torch import Tensor


@pytest.fixture
def network() -> PhysicsInference:
    """Untrained, but one whose answers depend on what it sees."""
    torch.manual_seed(0)
    model = PhysicsInference().eval().requires_grad_(False)
    torch.nn.init.normal_(model.head.weight, std=0.5)
    model.head.bias[2:] = 5.0  # readings weigh about as much as the prior
    model.know(torch.tensor([0.2, 0.3, 0.6]), torch.tensor([150.0, 400.0, 900.0]))
    return model


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


def test_nor_does_which_way_all_of_it_is_turned(network: PhysicsInference) -> None:
    window, angle = seen(), torch.tensor(1.1)
    turn = exponential(torch.stack([torch.zeros(()), torch.zeros(()), angle]))
    c, s = angle.cos(), angle.sin()
    about = torch.tensor([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    turned = window._replace(
        pos=window.pos @ about.T,
        hand_pos=window.hand_pos @ about.T,
        hand_rot=about @ window.hand_rot,
        quat=multiply(turn.expand_as(window.quat), window.quat),
    )
    for a, b in zip(network(window), network(turned), strict=True):
        torch.testing.assert_close(a, b, atol=1e-4, rtol=0)


def test_before_training_a_reading_is_the_deceleration() -> None:
    model = PhysicsInference().eval().requires_grad_(False)
    model.know(torch.tensor([0.2, 0.3, 0.6]), torch.tensor([150.0, 400.0, 900.0]))
    model.head.bias[2:] = 50.0  # the prior counts for nothing
    time = 0.05 * torch.arange(FRAMES)
    for friction in (0.25, 0.4, 0.55):
        window = seen(count=1, objects=1)
        way = 20.0 * time - 0.5 * 9.81 * friction * time.square()
        pos = torch.zeros(1, FRAMES, 1, 3)
        pos[0, :, 0, 1] = way  # it never stops: 63 frames of 0.05 s
        known = torch.ones(1, FRAMES, 1)
        known[:, 0] = 0.0
        found = model(window._replace(pos=pos, known=known))
        assert float(found.mean[0, 0].exp()) == pytest.approx(friction, rel=0.01)


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
    for column, drawn, near in ((0, friction, 0.1), (1, density, 0.01), (2, density, 0.01)):
        away = (found.mean[:, column] - drawn.log().mean()).detach().abs()
        assert float(away.max()) < near * float(drawn.log().std())
        share = found.spread[:, column] / drawn.log().std()
        assert ((share > 0.9) & (share <= 1.001)).all()
    model.head.bias.data[:] = 50.0  # as sure as can be of the largest
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
