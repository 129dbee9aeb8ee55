"""Data parallelism: `torchrun` starts the processes, each has a share of every batch."""

from __future__ import annotations

import os
from typing import Any

import torch
from torch import Tensor, distributed


def start(device: str) -> torch.device:
    """Joins the processes that `torchrun` started, if any; returns this one's device."""
    if int(os.environ.get("WORLD_SIZE", "1")) > 1 and not distributed.is_initialized():
        distributed.init_process_group("nccl" if device.startswith("cuda") else "gloo")
    if device == "cuda":
        local = int(os.environ.get("LOCAL_RANK", "0"))
        torch.cuda.set_device(local)
        return torch.device("cuda", local)
    return torch.device(device)


def stop() -> None:
    """Waits for the others and leaves the group."""
    if _on():
        distributed.barrier()
        distributed.destroy_process_group()


def size() -> int:
    """Number of processes."""
    return distributed.get_world_size() if _on() else 1


def rank() -> int:
    """Number of this process."""
    return distributed.get_rank() if _on() else 0


def shares(batch: int) -> slice:
    """This process' part of a batch."""
    each = -(-batch // size())
    return slice(rank() * each, min((rank() + 1) * each, batch))


def average(tensor: Tensor) -> None:
    """Mean over all processes, in place."""
    if _on():
        distributed.all_reduce(tensor)
        tensor /= size()


def agreed(value: float, device: Any) -> float:
    """The first process' value."""
    if not _on():
        return value
    tensor = torch.tensor(value, dtype=torch.float64, device=device)
    distributed.broadcast(tensor, 0)
    return float(tensor)


def _on() -> bool:
    return distributed.is_available() and distributed.is_initialized()
