"""The state of an unfinished training, so that it goes on where it was."""

from __future__ import annotations

import json
import math
from collections.abc import Collection
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from orbisim.errors import InputError
from orbisim.files.reading import parse_json
from orbisim.files.writing import make_folder, writing

NAME = "training.safetensors"


def save_progress(folder: Path, tensors: dict[str, Tensor], notes: dict[str, Any]) -> None:
    """Writes the optimiser's tensors and notes; a reader never sees half of them."""
    host = {name: tensor.detach().cpu().clone() for name, tensor in tensors.items()}
    with writing(make_folder(folder) / NAME, announce=False) as part:
        save_file(host, str(part), metadata={"notes": json.dumps(notes)})


def load_progress(
    folder: Path, dtypes: Collection[torch.dtype] = (torch.float32,)
) -> tuple[dict[str, Tensor], dict[str, Any]] | None:
    """What `save_progress` wrote, or None if nothing was.

    Args:
      folder: of the training. dtypes: which its tensors may have.

    Raises:
      InputError: the file is damaged.
    """
    path = folder / NAME
    if not path.exists():
        return None
    try:
        with safe_open(str(path), framework="pt") as file:
            notes = parse_json((file.metadata() or {}).get("notes", ""), f"{path}, notes")
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        kinds: dict[str, Any] = {"seed": int, "step": int, "seconds": (int, float), "config": dict}
        for name, kind in kinds.items():
            if not isinstance(notes.get(name), kind):
                raise ValueError(f"its notes have no {name}")
        for name in ("step", "seconds"):
            if not 0 <= notes[name] < math.inf:
                raise ValueError(f"its notes say {name} {notes[name]}")
        for name, tensor in tensors.items():
            if tensor.dtype not in dtypes or not torch.isfinite(tensor).all():
                known = " or ".join(sorted(str(one).removeprefix("torch.") for one in dtypes))
                raise ValueError(f"{name} is not finite numbers in {known}")
    except (OSError, SafetensorError, ValueError, RuntimeError) as error:
        said = " ".join(str(error).split())[:300]
        raise InputError(f"{path}: damaged; delete it to start afresh ({said})") from None
    return tensors, notes
