"""All that a training by Stable-Baselines3 goes on from, as tensors by name: nothing is pickled."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

_BUFFER = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


def state_of(model: Any) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Weights, optimisers, what was seen last, the replay buffer and all random numbers.

    Between two rollouts, as the buffer of PPO is empty there.

    Args:
      model: a learner of Stable-Baselines3 in the middle of `learn`.

    Returns:
      Tensors by name, and numbers for a JSON file.
    """
    found: dict[str, Tensor] = {}
    for name, values in model.get_parameters().items():
        found |= {f"{name}/{key}": tensor for key, tensor in _flat(values).items()}
    if (entropy := getattr(model, "log_ent_coef", None)) is not None:
        found["log_ent_coef"] = entropy.data
    found["last_obs"] = torch.as_tensor(model._last_obs)
    found["last_episode_starts"] = torch.as_tensor(model._last_episode_starts)
    if (buffer := getattr(model, "replay_buffer", None)) is not None:
        rows = len(buffer.rewards) if buffer.full else buffer.pos
        found |= {f"buffer/{n}": torch.as_tensor(getattr(buffer, n)[:rows]) for n in _BUFFER}
    kind, keys, place, has_gauss, gauss = np.random.get_state()  # noqa: NPY002 (the one that the library draws from)
    found["random/numpy"] = torch.as_tensor(np.asarray(keys, np.int64))
    found["random/torch"] = torch.get_rng_state()
    notes = {
        "timesteps": int(model.num_timesteps),
        "updates": int(model._n_updates),
        "place": [str(kind), int(place), int(has_gauss), float(gauss)],
        "position": 0 if buffer is None else int(buffer.pos),
        "action_space": model.action_space.np_random.bit_generator.state,
    }
    return {name: tensor.clone() for name, tensor in found.items()}, notes


def restore(model: Any, tensors: Mapping[str, Tensor], notes: Mapping[str, Any]) -> None:
    """Gives a fresh learner what `state_of` gave.

    Raises:
      KeyError, RuntimeError, ValueError: it is of another learner.
    """
    for name, values in model.get_parameters().items():
        given = {n.removeprefix(f"{name}/"): t for n, t in tensors.items() if _below(n, name)}
        part = _attribute(model, name)
        part.load_state_dict(_optimizer(values, given) if "param_groups" in values else given)
    if getattr(model, "log_ent_coef", None) is not None:
        model.log_ent_coef.data.copy_(tensors["log_ent_coef"])
    model._last_obs = tensors["last_obs"].numpy()
    model._last_episode_starts = tensors["last_episode_starts"].numpy()
    buffer = getattr(model, "replay_buffer", None)
    if buffer is not None:
        for name in _BUFFER:
            rows = tensors[f"buffer/{name}"].numpy()
            getattr(buffer, name)[: len(rows)] = rows
        buffer.pos, buffer.full = notes["position"], len(rows) == len(buffer.rewards)
    model.num_timesteps, model._n_updates = notes["timesteps"], notes["updates"]
    kind, place, has_gauss, gauss = notes["place"]
    keys = tensors["random/numpy"].numpy().astype(np.uint32)
    np.random.set_state((kind, keys, place, has_gauss, gauss))  # noqa: NPY002
    torch.set_rng_state(tensors["random/torch"])
    model.action_space.np_random.bit_generator.state = notes["action_space"]


def _flat(values: Mapping[str, Any]) -> dict[str, Tensor]:
    """The tensors of a state dict; of an optimiser's, those of each parameter."""
    if "param_groups" not in values:
        return dict(values)
    return {
        f"{number}/{name}": torch.as_tensor(value)
        for number, entry in values["state"].items()
        for name, value in entry.items()
    }


def _optimizer(fresh: Mapping[str, Any], given: Mapping[str, Tensor]) -> dict[str, Any]:
    state: dict[int, dict[str, Tensor]] = {}
    for name, value in given.items():
        number, _, key = name.partition("/")
        state.setdefault(int(number), {})[key] = value
    return {**fresh, "state": state}


def _below(name: str, part: str) -> bool:
    """Whether a tensor is of a part: `policy/...` is not of `policy.optimizer`."""
    return name.startswith(f"{part}/")


def _attribute(model: Any, dotted: str) -> Any:
    for name in dotted.split("."):
        model = getattr(model, name)
    return model
