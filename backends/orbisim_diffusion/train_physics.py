"""The training of PhyInf: through the frozen dynamics, or on the true values."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

import torch
from orbisim_world_model.checkpoint import load_checkpoint as load_dynamics
from orbisim_world_model.differentiable import DifferentiableStep
from orbisim_world_model.pack import Pack
from orbisim_world_model.packing import read_groups
from orbisim_world_model.rotation import conjugate, logarithm, multiply
from orbisim_world_model.stepper import plain_step
from orbisim_world_model.zoo import find as find_dynamics
from orbisim_world_model.zoo import located
from torch import Tensor, nn

from orbisim.errors import InputError
from orbisim.scene import load_scene
from orbisim_diffusion.checkpoint import PHYSICS, add_part, digest
from orbisim_diffusion.config import TrainConfig
from orbisim_diffusion.estimate_physics import Reach, load_physics
from orbisim_diffusion.loop import Kept, Loop, mixed
from orbisim_diffusion.physics import (
    FRAMES,
    NORMAL,
    PhysicsInference,
    Posterior,
    divergence,
    log_likelihood,
)
from orbisim_diffusion.physics_data import (
    Truth,
    Windows,
    changed,
    densities,
    frictions,
    usable,
)
from orbisim_diffusion.training import Run

Objective = Literal["rollout", "values"]
TRAIN = TrainConfig(batch=512, rate=1e-3, warmup=100, decay=1e-2)
GO_ON = dataclasses.replace(TRAIN, batch=128, rate=3e-4, warmup=20)
"""Of what has been trained before: little is left to learn, which a CPU can, in smaller steps."""
HORIZON = 21
"""Steps of a free run in training: a window's 63 steps are three of them, so that gradients pass
through 1 s, as in the fit, and no contact that the model misses spoils a whole window."""
_PLACE, _TURN = 0.002, 0.02
"""m and rad: where the learned scales of a rollout's errors begin."""
_FASTER = 10.0
"""Times a weight's rate: the scales, logarithms that may be off by some units, go to where they
belong within the first hundreds of steps."""
_PULL = 3.0
"""Largest slope of a window's loss by a mean, in deviations of the prior, and by the logarithm of a
spread: what a prior that is two deviations away pulls with, and half as much."""
_TAILS = 4.0
"""Degrees of freedom of the errors' distribution (Student's): some rollouts miss a contact."""
_MOVES = 0.02
"""m, that an object goes in a window for its density, and the friction under it, to show; a quarter
of it in a piece."""
_APART = 16
"""Frames between the held-out windows."""


@dataclasses.dataclass(frozen=True)
class Task:
    """What PhyInf is trained on.

    Attributes:
      data, held: files of episodes, with or without images; held-out ones are a tenth of `data`
        if there are none.
      objective: `rollout`: the error of the frozen learned step's rollouts under what is inferred;
        `values`: the likelihood of the true values.
      dynamics: checkpoint of the dynamics; None for the zoo's that fits the data's task.
      graph: whether a GPU's steps are CUDA graphs.
      start: a vision checkpoint whose PhyInf, and whose prior, training goes on with (`GO_ON`), or
        None.
    """

    data: Sequence[Path]
    held: Sequence[Path] = ()
    objective: Objective = "rollout"
    dynamics: str | None = None
    graph: bool = True
    start: Path | None = None


def tune_physics(
    folder: Path,
    task: Task,
    run: Run,
    *,
    device: str = "cpu",
    report: Callable[[str], None] = print,
) -> dict[str, Any]:
    """Trains PhyInf and adds it to a vision checkpoint.

    Args:
      folder: of the checkpoint. task: see `Task`. run: see `Run`. device: where to compute.
      report: is told how it goes.

    Returns:
      Errors on held-out windows (see `physics_errors`).

    Raises:
      InputError: there is no checkpoint, or the episodes are none of a robot that pushes objects
        over a table.
    """
    on = torch.device(device)
    pack = _read(task.data).to(on)
    pack, held = (pack, _read(task.held).to(on)) if task.held else pack.split(0.1, seed=run.seed)
    where = _dynamics(task, pack)
    free = FreeRuns(pack, where, on, graph=task.graph)
    reach = Reach.of(pack, str(where.name), digest(where / "model.safetensors"))

    def keep(module: nn.Module) -> None:
        network = module.network if isinstance(module, _Trained) else module
        add_part(folder, PHYSICS, network, {}, dataclasses.asdict(reach))

    training, start = TRAIN, None
    if task.start is not None:
        training, start = GO_ON, load_physics(task.start)[0]
    model, loop = train_physics(
        task.objective, run, Windows(pack), free,
        training=training, start=start, report=report, kept=keep,
    )  # fmt: skip
    test = Windows(held)
    calibrate(model, test, run.seed)
    metrics = {
        "objective": task.objective,
        **physics_errors(model, test, run.seed),
        "steps": loop.step,
        "seconds": round(loop.seconds, 1),
        "episodes": pack.episodes,
    }
    add_part(folder, PHYSICS, model, metrics, dataclasses.asdict(reach))
    return metrics


def train_physics(
    objective: Objective,
    run: Run,
    windows: Windows,
    free: FreeRuns,
    *,
    training: TrainConfig = TRAIN,
    start: PhysicsInference | None = None,
    report: Callable[[str], None] = print,
    kept: Kept | None = None,
) -> tuple[PhysicsInference, Loop]:
    """Trains PhyInf on windows of a pack, through the frozen dynamics or on the true values.

    Args:
      objective: see `Task`. run: see `Run`. windows: of the training data.
      free: rollouts of the same data.
      training: how; a batch is of windows, at most as many as there are episodes.
      start: what to go on with; its prior stays.
      report: is told how it goes.
      kept: see `orbisim_diffusion.loop.Kept`; is given the network with what was learned with it.
    """
    torch.manual_seed(run.seed)
    pack = windows.pack
    module = _Trained().to(pack.device)
    there = pack.mask > 0
    if start is None:
        module.network.know(frictions(pack), densities(pack)[there])
    else:
        module.network.load_state_dict(start.state_dict())
    batch = min(training.batch, pack.episodes)
    loop = Loop(module, training, run.limit, run.progress, run.steps)

    def loss(_: int) -> Tensor:
        truth = windows.draw(batch)
        seen = windows.seen(truth)
        with mixed(pack.device):
            found = module.network(seen)
        if objective == "values":
            return -log_likelihood(found, truth.logs, truth.mask).mean()
        network = module.network
        kinds = network.kinds(found.mean.shape[1] - 1)
        found = _bounded(found, network.prior[kinds, 1], batch)
        # the evidence's lower bound (Kingma and Welling 2014), one sample a window
        drawn = found.mean + found.spread * torch.randn_like(found.mean)
        drawn = drawn.maximum(network.low[kinds]).minimum(network.high[kinds])
        told = module.told(*free(truth, drawn.exp()))
        return (divergence(found, network.prior[kinds], truth.mask) - told).mean()

    loop.run(loss, report=report, kept=kept)
    average = loop.average
    assert isinstance(average, _Trained)
    return average.network, loop


def _bounded(found: Posterior, width: Tensor, batch: int) -> Posterior:
    """The same, through which no window's gradient passes that is larger than `_PULL`.

    Else the few windows whose rollouts hang on a contact would decide, and those in which nothing
    moves, which know of the prior alone, would hardly count.
    """
    for values, unit in ((found.mean, width), (found.spread, found.spread.detach())):
        values.register_hook(lambda g, u=unit: (g * u * batch).clamp(-_PULL, _PULL) / (u * batch))
    return found


class _Trained(nn.Module):
    """PhyInf, and how far off rollouts are after each step, which is learned with it."""

    begun: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.network = PhysicsInference()
        self.register_buffer("begun", torch.tensor([_PLACE, _TURN]).log())
        self.grown = nn.Parameter(torch.zeros(HORIZON, 2))

    def told(self, errors: Tensor, moves: Tensor) -> Tensor:
        """[B]: log-likelihood of errors [B, S, T, N, 2, 3] of rollouts, m and rad.

        Student's distribution with a scale for each step and kind, over the objects that move
        [B, S, N] (those at rest have errors of nothing, and would make the scale as small). Errors
        at successive steps depend on each other: those of a free run count as one.
        """
        scale = (self.begun + _FASTER * self.grown)[None, None, :, None, :, None]
        tails = torch.log1p((errors / scale.exp()).square() / _TAILS)
        each = -0.5 * (_TAILS + 1.0) * tails - scale
        return (each.sum((-1, -2)).mean(2) * moves).sum((1, 2))


class FreeRuns:
    """Rollouts of the frozen learned step over windows of a pack, in pieces of `HORIZON` steps.

    Each piece begins with the true state, so that gradients pass through `HORIZON` steps.

    Args:
      pack: of the episodes. checkpoint: of the dynamics. device: where to compute.
      graph: whether on a GPU steps and their backward passes are CUDA graphs.
    """

    def __init__(
        self, pack: Pack, checkpoint: Path, device: torch.device, *, graph: bool = True
    ) -> None:
        self.pack = pack
        model = load_dynamics(checkpoint, pack.layout).model.to(device).requires_grad_(False)
        model.spread = None  # how unsure it is plays no part
        self.model = model
        self.step: Any = plain_step(model)
        if graph and device.type == "cuda":
            self.step = DifferentiableStep(model, device)

    def __call__(self, truth: Truth, values: Tensor) -> tuple[Tensor, Tensor]:
        """Errors [B, S, T, N, 2, 3], m and rad, under values [B, 1 + N] with gradients to them.

        And [B, S, N]: 1 where an object moves in truth, else 0.
        """
        pack, device = self.pack, self.pack.device
        pieces = (FRAMES - 1) // HORIZON
        begin = truth.first[:, None] + HORIZON * torch.arange(pieces, device=device)
        count = begin.numel()
        first, repeat = begin.flatten(), pieces
        context = changed(
            pack.context(truth.episode.repeat_interleave(repeat)),
            pack,
            values.repeat_interleave(repeat, dim=0),
        )
        x = self.model.completed(pack.states(first))
        last, way = x.pos, torch.zeros_like(x.pos[..., 0])
        memory = self.model.initial_memory(count)
        places, turns = [], []
        for t in range(HORIZON):
            x, memory = self.step(x, memory, pack.ctrl[first + t], context)
            true = pack.states(first + t + 1)
            way = way + (true.pos - last).norm(dim=-1)
            last = true.pos
            places.append(x.pos - true.pos)
            turns.append(logarithm(multiply(x.quat, conjugate(true.quat))))
        errors = torch.stack([torch.stack(places, 1), torch.stack(turns, 1)], dim=3)
        # a rollout that diverged says nothing of the values under which it did
        errors = torch.where(torch.isfinite(errors), errors, torch.full_like(errors, 1.0))
        moves = (way > _MOVES / 4) * pack.mask[truth.episode.repeat_interleave(repeat)]
        shape = len(truth.first), pieces
        return errors.clamp(-1.0, 1.0).unflatten(0, shape), moves.unflatten(0, shape)


def _read(paths: Sequence[Path]) -> Pack:
    packs = read_groups(paths)
    if len(packs) != 1:
        raise InputError(f"{paths[0]} ...: episodes of {len(packs)} robots; expected one")
    return usable(packs[0])


def _dynamics(task: Task, pack: Pack) -> Path:
    """The folder of the dynamics' checkpoint."""
    if task.dynamics is not None:
        return located(task.dynamics.removeprefix("learned:"))
    return find_dynamics(load_scene(str(pack.notes["sources"][0]["task"])))[0]


@torch.no_grad()  # type: ignore[untyped-decorator]
def _held(model: PhysicsInference, windows: Windows, seed: int) -> Any:
    """Posteriors of held-out windows, half of them with noise, and their truth and way."""
    truth = windows.every(_APART)
    torch.manual_seed(seed + 1)
    means, spreads = [], []
    for part in torch.arange(len(truth.first), device=truth.first.device).split(1024):
        some = Truth(*(field[part] for field in truth))
        found = model.said(windows.seen(some))
        means.append(found.mean)
        spreads.append(found.spread)
    return torch.cat(means), torch.cat(spreads), truth, windows.way(truth)


@torch.no_grad()  # type: ignore[untyped-decorator]
def calibrate(model: PhysicsInference, windows: Windows, seed: int = 0) -> None:
    """Widens spreads until 95 % of held-out true values are where it says, if they are not.

    One factor for friction and one for densities, over windows in which something moves. They are
    never narrowed: where nothing moves, a spread is that of what tasks draw.
    """
    model.widen.fill_(1.0)
    mean, spread, truth, way = _held(model, windows, seed)
    off = (truth.logs - mean).abs() / spread / NORMAL
    shown = _shown(way)
    for number, columns in enumerate((slice(0, 1), slice(1, None))):
        chosen = (truth.mask[:, columns] > 0) & shown[:, columns]
        values = off[:, columns][chosen]
        if len(values):
            model.widen[number] = torch.quantile(values[:_MOST], 0.95).clamp(1.0, 10.0)


_MOST = 2**20
"""Values that a quantile is taken of; torch takes no more than 16 million."""


def _shown(way: Tensor) -> Tensor:
    """[B, 1 + N]: whether an object moves (friction: any)."""
    moves = way > _MOVES
    return torch.cat([moves.any(1, keepdim=True), moves], dim=1)


def physics_errors(model: PhysicsInference, windows: Windows, seed: int = 0) -> dict[str, float]:
    """Of held-out windows, where something moves and where nothing does.

    Percent that friction and density are off (median), and that the prior's mean would be off; the
    share of true values within the 95 % intervals; the median spread over the prior's; by how much
    the log-likelihood of true values is above the prior's (mean, and 95 % interval by resampling
    episodes, whose windows are alike).
    """
    mean, spread, truth, way = _held(model, windows, seed)
    found: dict[str, float] = {"windows": len(mean)}
    kinds = model.kinds(mean.shape[1] - 1)
    prior, low, high = model.prior[kinds], model.low[kinds], model.high[kinds]
    off = 100.0 * ((mean - truth.logs).exp() - 1.0).abs()
    told = _density(mean, spread, truth.logs) - _density(prior[:, 0], prior[:, 1], truth.logs)
    generator = torch.Generator().manual_seed(seed)
    blind = 100.0 * ((prior[:, 0] - truth.logs).exp() - 1.0).abs()
    below, above = (mean - NORMAL * spread).maximum(low), (mean + NORMAL * spread).minimum(high)
    inside = (below <= truth.logs + 1e-6) & (truth.logs <= above + 1e-6)
    shown = _shown(way)
    for name, columns in (("friction", slice(0, 1)), ("density", slice(1, None))):
        for which, chosen in (("moving", shown), ("still", ~shown)):
            some = (chosen & (truth.mask > 0))[:, columns]
            if not bool(some.any()):
                continue
            rows = {
                "percent": off[:, columns][some].median(),
                "percent_of_prior": blind[:, columns][some].median(),
                "covered": inside[:, columns][some].float().mean(),
                "spread_share": (spread / prior[:, 1])[:, columns][some].median(),
                **_gain(told[:, columns], some, truth.episode, generator),
            }
            found |= {f"{name}_{which}_{k}": round(float(v), 4) for k, v in rows.items()}
    if not all(math.isfinite(v) for v in found.values()):
        raise InputError("PhyInf answers numbers that are not finite; lower the rate")
    return found


def _density(mean: Tensor, spread: Tensor, value: Tensor) -> Tensor:
    """Logarithm of a normal density, but for a constant."""
    return -0.5 * ((value - mean) / spread).square() - spread.log()


_RESAMPLED = 1000
"""Times, for an interval of 95 %."""


def _gain(
    told: Tensor, some: Tensor, episode: Tensor, generator: torch.Generator
) -> dict[str, Tensor]:
    """Mean of `told` [B, K] where `some`, and its 95 % interval by resampling the B's episodes."""
    number = torch.unique(episode, return_inverse=True)[1].cpu()
    total, count = torch.zeros(2, int(number.max()) + 1, dtype=torch.float64)
    total.index_add_(0, number, (told * some).sum(1).double().cpu())
    count.index_add_(0, number, some.sum(1).double().cpu())
    drawn = torch.randint(len(total), (_RESAMPLED, len(total)), generator=generator)
    means = total[drawn].sum(1) / count[drawn].sum(1).clamp_min(1.0)
    low, high = torch.quantile(means, torch.tensor([0.025, 0.975], dtype=torch.float64))
    return {"gain": total.sum() / count.sum(), "gain_low": low, "gain_high": high}
