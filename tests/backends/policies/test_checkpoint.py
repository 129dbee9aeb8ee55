from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest
import torch
from orbisim_policies.checkpoint import load_policy, read_manifest, save_policy
from orbisim_policies.network import NetworkConfig, Policy
from orbisim_policies.suite import SuiteProblem

from orbisim.errors import InputError


@pytest.fixture
def folder(cartpole: SuiteProblem, tmp_path: Path) -> Path:
    policy = Policy(cartpole.observations, 1, NetworkConfig((4, 3), "tanh", "clip"))
    save_policy(tmp_path / "p", policy, cartpole, {"method": "apg"})
    return tmp_path / "p"


def test_a_policy_comes_back_as_it_was(cartpole: SuiteProblem, folder: Path) -> None:
    assert {path.name for path in folder.iterdir()} == {"manifest.json", "policy.safetensors"}
    policy = load_policy(folder, cartpole)
    again = Policy(cartpole.observations, 1, policy.config)
    again.load_state_dict(policy.state_dict())
    view = torch.randn(3, cartpole.observations)
    assert torch.equal(policy(view), again(view))
    assert policy.config == NetworkConfig((4, 3), "tanh", "clip")
    assert read_manifest(folder)["method"] == "apg"


def test_a_policy_for_another_scene_is_refused(cartpole: SuiteProblem, folder: Path) -> None:
    other = SuiteProblem("cartpole-swingup", 8)
    model = other.scene.model
    model.body_mass[1] *= 1.1
    other.scene = dataclasses.replace(other.scene.with_model(model))
    with pytest.raises(InputError, match="another scene"):
        load_policy(folder, other)
    with pytest.raises(InputError, match="suite:cartpole-swingup; got suite:pendulum-swingup"):
        load_policy(folder, SuiteProblem("pendulum-swingup", 8))


def test_what_is_damaged_is_refused(cartpole: SuiteProblem, folder: Path) -> None:
    manifest = json.loads((folder / "manifest.json").read_text())
    for name, value in {"actions": 2, "network": {"hidden": "many"}, "schema": "x"}.items():
        (folder / "manifest.json").write_text(json.dumps({**manifest, name: value}))
        with pytest.raises(InputError, match=r"manifest\.json"):
            load_policy(folder, cartpole)
    (folder / "manifest.json").write_text(json.dumps(manifest))
    (folder / "policy.safetensors").write_bytes(b"1234567890")
    with pytest.raises(InputError, match="damaged"):
        load_policy(folder, cartpole)
    with pytest.raises(InputError, match="not a policy"):
        read_manifest(folder.parent)
