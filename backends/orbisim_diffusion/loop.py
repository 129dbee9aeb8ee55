"""A training loop with a time limit, running averages, saves, and going on after a kill."""

from __future__ import annotations

import copy
import json
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from orbisim_world_model.plain import checked
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from orbisim.errors import InputError
from orbisim.files.reading import parse_json
from orbisim.files.writing import make_folder, writing
from orbisim_diffusion.config import TrainConfig

Loss = Callable[[int], Tensor]
Kept = Callable[[nn.Module], None]
"""Is given the running average at each save."""
_MOMENTS = ("exp_avg", "exp_avg_sq")
"""What AdamW keeps of each parameter, beside the number of steps."""


class Loop:
    """Trains a module.

    Args:
      module: its parameters that require gradients are trained.
      config: see `TrainConfig`.
      limit: s; what earlier runs took counts.
      progress: file from which it goes on, if it is there.
      steps: at most so many.
    """

    def __init__(
        self,
        module: nn.Module,
        config: TrainConfig,
        limit: float,
        progress: Path | None = None,
        steps: int | None = None,
    ) -> None:
        self.module, self.config, self.limit, self.steps = module, config, limit, steps
        self.progress = progress
        self.average = copy.deepcopy(module).eval().requires_grad_(False)
        self.parameters = [p for p in module.parameters() if p.requires_grad]
        self.optimizer = torch.optim.AdamW(
            self.parameters, lr=config.rate, betas=(0.9, 0.99), weight_decay=config.decay
        )
        self.step, self.before = 0, 0.0
        self.history: list[dict[str, float]] = []
        if progress is not None and progress.exists():
            self._resume(progress)
        self.started = time.monotonic()

    @property
    def seconds(self) -> float:
        """Spent so far, earlier runs included."""
        return self.before + time.monotonic() - self.started

    def run(
        self,
        loss: Loss,
        every: float = 30.0,
        report: Callable[..., None] = print,
        kept: Kept | None = None,
    ) -> None:
        """Trains until the limit; `loss` gives the loss of a step.

        Args:
          loss: of the number of the step.
          every: seconds between reports and saves.
          report: is told step, seconds and mean loss.
          kept: see `Kept`.
        """
        total, count, last = torch.zeros((), device=self.parameters[0].device), 0, self.seconds
        self.module.train()
        while self.seconds < self.limit and (self.steps is None or self.step < self.steps):
            total += self._one(loss)
            count += 1
            if self.seconds - last > every:
                line = {"step": self.step, "seconds": self.seconds, "loss": float(total) / count}
                self.history.append(line)
                report(json.dumps({k: round(v, 6) for k, v in line.items()}))
                self.save()
                if kept is not None:
                    kept(self.average)
                total, count, last = torch.zeros_like(total), 0, self.seconds
        if count:
            mean = float(total) / count
            if not math.isfinite(mean):
                raise InputError(f"the loss is {mean} after {self.step} steps; lower the rate")
            self.history.append({"step": self.step, "seconds": self.seconds, "loss": mean})
        self.save()

    def save(self) -> None:
        """Writes what is needed to go on; a reader never sees half of it."""
        if self.progress is None:
            return
        tensors = {f"module.{n}": t for n, t in self.module.state_dict().items()}
        tensors |= {f"average.{n}": t for n, t in self.average.state_dict().items()}
        for i, parameter in enumerate(self.parameters):
            for name, value in self.optimizer.state.get(parameter, {}).items():
                tensors[f"optimizer.{i}.{name}"] = value
        host = {n: t.detach().cpu().contiguous().clone() for n, t in tensors.items()}
        notes = {"step": self.step, "seconds": self.seconds, "history": self.history}
        make_folder(self.progress.parent)
        with writing(self.progress, announce=False) as part:
            save_file(host, str(part), metadata={"notes": json.dumps(notes)})

    def _one(self, loss: Loss) -> Tensor:
        share = self._rate_share()
        for group in self.optimizer.param_groups:
            group["lr"] = self.config.rate * share
        self.optimizer.zero_grad(set_to_none=True)
        value = loss(self.step)
        value.backward()
        torch.nn.utils.clip_grad_norm_(self.parameters, self.config.clip)
        self.optimizer.step()
        self.step += 1
        self._follow()
        return value.detach()

    def _rate_share(self) -> float:
        done = self.seconds / self.limit
        if self.steps is not None:
            done = max(done, self.step / self.steps)
        warm = min(1.0, (self.step + 1) / self.config.warmup)
        return warm * 0.5 * (1.0 + math.cos(math.pi * min(1.0, done)))

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def _follow(self) -> None:
        keep = min(self.config.average, (1.0 + self.step) / (10.0 + self.step))
        theirs, ours = self.average.state_dict(), self.module.state_dict()
        floats = [n for n, t in ours.items() if t.is_floating_point()]
        torch._foreach_lerp_([theirs[n] for n in floats], [ours[n] for n in floats], 1.0 - keep)

    def _resume(self, path: Path) -> None:
        try:
            with safe_open(str(path), framework="pt") as file:
                notes = parse_json((file.metadata() or {}).get("notes", ""), f"{path}, notes")
                tensors = {n: file.get_tensor(n) for n in file.keys()}  # noqa: SIM118
            if strange := [n for n, t in tensors.items() if not torch.isfinite(t).all()]:
                raise ValueError(f"{strange[0]} is not finite")
            self._take(tensors, notes)
        except (OSError, SafetensorError, LookupError, ValueError, RuntimeError) as error:
            said = " ".join(str(error).split())[:300]  # torch's messages have lines
            raise InputError(f"{path}: damaged; delete it to start afresh ({said})") from None

    def _take(self, tensors: dict[str, Tensor], notes: dict[str, Any]) -> None:
        def part(prefix: str) -> dict[str, Tensor]:
            return {n.removeprefix(prefix): t for n, t in tensors.items() if n.startswith(prefix)}

        self.module.load_state_dict(part("module."))
        self.average.load_state_dict(part("average."))
        device = self.parameters[0].device
        for i, parameter in enumerate(self.parameters):
            state = part(f"optimizer.{i}.")
            shapes = dict.fromkeys(_MOMENTS, parameter.shape) | {"step": torch.Size()}
            if state and shapes != {n: t.shape for n, t in state.items()}:
                raise ValueError(f"what the optimiser knew of parameter {i} does not fit it")
            self.optimizer.state[parameter] = {
                n: t if n == "step" else t.to(device) for n, t in state.items()
            }
        self.step = checked(int, notes["step"], "step")
        self.before = checked(float, notes["seconds"], "seconds")
        if self.step < 0 or self.before < 0.0:
            raise ValueError(f"step {self.step} after {self.before} s")
        self.history = list(checked(tuple[dict[str, float], ...], notes["history"], "history"))


def mixed(device: torch.device) -> Any:
    """Half precision (bfloat16) on a GPU, float32 elsewhere."""
    return torch.autocast(device.type, torch.bfloat16, enabled=device.type == "cuda")
