from __future__ import annotations

import pytest
import torch
from orbisim_policies.latent import Latent, LatentConfig, LatentPolicy, drawn, symexp, symlog

from orbisim.errors import InputError

SMALL = LatentConfig(units=8, layers=1, deter=6, variables=3, classes=4)


def test_draws_follow_their_probabilities_and_hand_gradients_on() -> None:
    shares = torch.tensor([0.1, 0.2, 0.7])
    logs = shares.log().expand(20_000, 1, 3).clone().requires_grad_()
    uniform = torch.rand(logs.shape, generator=torch.Generator().manual_seed(0))
    found = drawn(logs, -(-uniform.log()).log())
    assert torch.equal(found.detach().round().sum(1), torch.ones(len(found)))
    torch.testing.assert_close(found.detach().mean(0), shares, atol=0.02, rtol=0)
    (gradient,) = torch.autograd.grad(found[0, 2], logs)
    torch.testing.assert_close(gradient[0, 0, 2], shares[2])
    assert drawn(logs)[0].tolist() == pytest.approx([0.0, 0.0, 1.0])


def test_what_was_seen_before_is_remembered_until_a_new_episode() -> None:
    torch.manual_seed(0)
    policy = LatentPolicy(2, 1, SMALL)
    views = torch.randn(3, 5, 2)
    act = policy.begin(5)
    first = [act(view) for view in views]
    other = policy.begin(5)
    assert all(torch.equal(other(view), one) for view, one in zip(views, first, strict=True))
    assert not torch.equal(policy.begin(5)(views[2]), first[2])


def test_the_deterministic_state_stays_within_bounds() -> None:
    torch.manual_seed(0)
    dynamics = LatentPolicy(2, 1, SMALL).dynamics
    latent = dynamics.initial(4)
    for _ in range(50):
        deter = dynamics.advance(latent, torch.randn(4, 1))
        latent = Latent(deter, drawn(dynamics.expected(deter)))
    assert float(latent.deter.detach().abs().max()) < 1.0
    assert latent.feature.shape == (4, 6 + 12)
    logs = dynamics.expected(latent.deter)
    torch.testing.assert_close(logs.exp().sum(-1), torch.ones(4, 3))
    assert float(logs.detach().exp().min()) >= 0.01 / 4  # a share is uniform


def test_symlog_and_its_inverse() -> None:
    x = torch.tensor([-300.0, -1.0, 0.0, 1e-3, 40.0])
    torch.testing.assert_close(symexp(symlog(x)), x, rtol=1e-4, atol=1e-6)


def test_sizes_beyond_reason_are_refused() -> None:
    with pytest.raises(InputError, match="from 1 to 4096"):
        LatentPolicy(2, 1, LatentConfig(units=0))
