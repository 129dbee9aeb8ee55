from __future__ import annotations

import dataclasses

import torch
from orbisim_policies.cloning import CloneConfig, Cloning
from orbisim_policies.demonstrations import Demonstrations
from orbisim_policies.network import NetworkConfig


def test_actions_are_imitated_and_a_training_goes_on_exactly() -> None:
    view = torch.randn(256, 3, generator=torch.Generator().manual_seed(0))
    data = Demonstrations(view, (view[:, :1] * 0.5).tanh(), 1.0, 1, 256)
    config = dataclasses.replace(CloneConfig(), batch=64, rate=1e-2, network=NetworkConfig((16,)))
    first = Cloning(data, config, 0)
    losses = [float(first.step(i / 100)) for i in range(60)]
    assert losses[-1] < 0.1 * losses[0]
    second = Cloning(data, config, 0)
    second.restore({name: tensor.clone() for name, tensor in first.state().items()}, 60)
    assert torch.equal(first.step(0.6), second.step(0.6))
