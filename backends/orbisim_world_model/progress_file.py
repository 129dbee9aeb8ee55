"""The state of an unfinished training, so that it goes on where it was."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from orbisim.errors import InputError

NAME = "training.safetensors"


def save_progress(folder: Path, tensors: dict[str, Tensor], notes: dict[str, Any]) -> None:
    """Writes the optimiser's tensors and notes; a reader never sees half of them."""
    folder.mkdir(parents=True, exist_ok=True)
    part = folder / f"{NAME}.part"
    host = {name: tensor.detach().cpu().clone() for name, tensor in tensors.items()}
    save_file(host, str(part), metadata={"notes": json.dumps(notes)})
    part.replace(folder / NAME)


def load_progress(folder: Path) -> tuple[dict[str, Tensor], dict[str, Any]] | None:
    """What `save_progress` wrote, or None if nothing was.

    Raises:
      InputError: the file is damaged.
    """
    path = folder / NAME
    if not path.exists():
        return None
    try:
        with safe_open(str(path), framework="pt") as file:
            notes = json.loads(file.metadata()["notes"])
            return {name: file.get_tensor(name) for name in file.keys()}, notes  # noqa: SIM118
    except (OSError, SafetensorError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: damaged; delete it to start afresh ({error})") from None
