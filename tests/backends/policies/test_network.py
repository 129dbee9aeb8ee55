from __future__ import annotations

import pytest
import torch
from orbisim_policies.network import NetworkConfig, Policy, value_network

from orbisim.errors import InputError


def test_actions_are_bounded_and_noise_comes_before_the_bounds() -> None:
    view = 50 * torch.randn(7, 5)
    for squash in ("tanh", "clip"):
        policy = Policy(5, 2, NetworkConfig((8,), "relu", squash))
        assert policy(view, torch.full((7, 2), 100.0)).max() == 1.0
        assert policy(view).abs().max() <= 1.0
    assert value_network(5)(view).shape == (7, 1)


def test_what_is_no_network_is_refused() -> None:
    for config in (NetworkConfig(()), NetworkConfig((0,)), NetworkConfig((4,), "swish")):
        with pytest.raises(InputError, match="a policy has"):
            Policy(3, 1, config)
