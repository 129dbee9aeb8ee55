"""Whether the tensors of a pack from a file fit together."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from orbisim.errors import InputError
from orbisim_world_model.layout import Layout

_WHOLE = ("start", "length", "group")
_NUMBERS = (
    "qpos",
    "qvel",
    "act",
    "ctrl",
    "action",
    "base",
    "attributes",
    "world",
    "mask",
    "parts",
    "part_mask",
)


def check_tensors(
    layout: Layout, tensors: Mapping[str, Tensor], notes: Mapping[str, Any], path: str
) -> None:
    """Checks the tensors of a pack from a file (see `Pack` for their shapes).

    Raises:
      InputError: one is missing, unknown, or of the wrong type or shape; an episode lies outside
        of the rows, or is of a group without a name.
    """
    names = {*_NUMBERS, *_WHOLE}
    for name in sorted(names ^ tensors.keys()):
        raise InputError(f"{path}: {'lacks' if name in names else 'has an unknown'} tensor {name}")
    expected = _shapes(layout, tensors)
    for name, tensor in tensors.items():
        kind = torch.int64 if name in _WHOLE else torch.float32
        if tensor.dtype != kind or tuple(tensor.shape) != expected[name]:
            raise InputError(
                f"{path}: tensor {name} is {tensor.dtype} of shape {tuple(tensor.shape)}; "
                f"expected {kind} of shape {expected[name]}"
            )
    _check_notes(notes, path)
    start, length, rows = tensors["start"], tensors["length"], len(tensors["qpos"])
    inside = (start >= 0) & (length >= 1) & (start < rows) & (length < rows - start)
    named = (tensors["group"] >= 0) & (tensors["group"] < len(notes["groups"]))
    for number in torch.nonzero(~(inside & named))[:1, 0].tolist():
        raise InputError(f"{path}: episode {number} lies outside of the data or has no group")


def _shapes(layout: Layout, tensors: Mapping[str, Tensor]) -> dict[str, tuple[int, ...]]:
    rows, episodes = (tensors[name].shape[:1].numel() for name in ("qpos", "start"))
    action, base = (tensors[name].shape[-1:].numel() for name in ("action", "base"))
    objects = len(layout.objects)
    state = layout.nq + layout.nv + layout.na
    return {
        "qpos": (rows, layout.nq),
        "qvel": (rows, layout.nv),
        "act": (rows, layout.na),
        "ctrl": (rows, layout.nu),
        "action": (rows, action),
        "base": (rows, state if base else 0),
        "start": (episodes,),
        "length": (episodes,),
        "group": (episodes,),
        "attributes": (episodes, objects, len(layout.attributes)),
        "world": (episodes, len(layout.settings)),
        "mask": (episodes, objects),
        "parts": (episodes, len(layout.parts), len(layout.part_columns)),
        "part_mask": (episodes, len(layout.parts)),
    }


def _check_notes(notes: Mapping[str, Any], path: str) -> None:
    groups, sources = notes.get("groups"), notes.get("sources")
    if not isinstance(groups, list) or not all(isinstance(name, str) for name in groups):
        raise InputError(f"{path}: notes.groups is not a list of names")
    if not isinstance(sources, list) or not all(isinstance(one, dict) for one in sources):
        raise InputError(f"{path}: notes.sources is not a list of objects")
