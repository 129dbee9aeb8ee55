"""`train`: a whole training of a policy, with saves, live estimates of success, and curves."""

from __future__ import annotations

import copy
import dataclasses
import json
import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

import torch
from orbisim_world_model.progress_file import NAME as PROGRESS
from orbisim_world_model.progress_file import load_progress, save_progress
from orbisim_world_model.schedule import Clock
from torch import Tensor

from orbisim.errors import InputError, OrbiSimError
from orbisim.files.locking import claimed
from orbisim.files.reading import parse_json
from orbisim.files.writing import make_folder, output_errors, write_bytes, writing
from orbisim.tasks.sampling import episode_seed
from orbisim.version import VERSION
from orbisim_policies.apg import Apg, ApgConfig
from orbisim_policies.checkpoint import (
    MANIFEST,
    AnyPolicy,
    load_policy,
    read_manifest,
    save_policy,
)
from orbisim_policies.cloning import CloneConfig, Cloning
from orbisim_policies.demonstrations import Demonstrations, demonstrate
from orbisim_policies.differenced import DifferencedWorlds
from orbisim_policies.evaluate import in_mujoco, joined, starts_of, summary
from orbisim_policies.films import Films
from orbisim_policies.learned import DifferentiableWorlds, LearnedWorlds
from orbisim_policies.misread import MisreadProblem
from orbisim_policies.network import Policy
from orbisim_policies.problem import Problem, Starts
from orbisim_policies.push import PushProblem

METRICS, CURVES = "metrics.jsonl", "curves.png"
_COPIES = 8
"""Films whose errors each filmed beginning is seen with."""
Report = Callable[[dict[str, Any]], None]

DTYPES = (torch.float32, torch.float64, torch.int64, torch.uint8, torch.bool)
"""Of what a training goes on from."""


@dataclasses.dataclass(frozen=True)
class Run:
    """What is asked of a training.

    Attributes:
      out: folder for policy, metrics and curves.
      steps, limit: budgets in iterations and in seconds, preparation included; at least one.
      seed: of everything random. device: where to compute.
      starts: how many episodes' beginnings there are to draw from.
      demonstrations: episodes to imitate.
      check: episodes of each live estimate in MuJoCo, by which the policy that is kept is chosen; 0
        for none. check_every: seconds.
      save_every: seconds between saves. log_every: iterations between lines of metrics.
      resume: go on with what stands in `out`. start: folder of a policy to begin with.
      graph: CUDA graphs. compiled: torch compiles a control step (apg).
      nthread: threads of MuJoCo; 0 for one per usable core.
      films: what was read off films of the task's script: where episodes begin instead of at true
        states (apg), and what is imitated (bc); None where the state is known.
      errors: whether the policy sees states with the errors of the films (apg).
    """

    out: Path
    steps: int | None = None
    limit: float | None = None
    seed: int = 0
    device: str = "cpu"
    starts: int = 2048
    demonstrations: int = 500
    check: int = 64
    check_every: float = 60.0
    save_every: float = 60.0
    log_every: int = 10
    resume: bool = False
    start: Path | None = None
    graph: bool = True
    compiled: bool = False
    nthread: int = 0
    films: Films | None = None
    errors: bool = True


class Trainer(Protocol):
    """What a training is made of: `Apg`, `Cloning`, `Dreamer`."""

    done: int

    @property
    def current(self) -> AnyPolicy:
        """The policy as it is now: live estimates choose among these."""

    @property
    def chosen(self) -> AnyPolicy:
        """The policy to keep where nothing is known of it in MuJoCo."""

    @property
    def true_steps(self) -> int:
        """Control steps of C MuJoCo that it has made itself."""

    def step(self, progress: float) -> Tensor:
        """One iteration; what is logged of it."""

    def state(self) -> dict[str, Tensor]:
        """What is needed to go on."""

    def restore(self, tensors: dict[str, Tensor], done: int) -> None:
        """Takes what `state` gave."""


def train_apg(
    problem: Problem,
    config: ApgConfig,
    run: Run,
    checkpoint: str | Path | None = None,
    report: Report = lambda _: None,
    *,
    differences: bool = False,
) -> dict[str, Any]:
    """Trains a policy by analytic gradients through the learned step; returns its manifest.

    Args:
      problem: on the CPU. config: of the training. run: budgets and folders.
      checkpoint: folder of the dynamics, or its name in the zoo; the zoo's that fits if None.
      differences: through finite differences of C MuJoCo instead, on the CPU.
      report: called with each line of metrics.

    Raises:
      InputError: no budget, or `out` holds another training.
      OrbiSimError: no objective is finite any more; what was saved before stays.
    """
    check_run(run)
    run = dataclasses.replace(run, device="cpu" if differences else run.device)
    clock, device = Clock(run.steps, run.limit), torch.device(run.device)
    problem = _as_seen(problem, run)
    if device.type == "cuda":
        torch.backends.cuda.matmul.allow_tf32 = True
    worlds: DifferentiableWorlds
    if differences:
        worlds, known = DifferencedWorlds(problem, run.nthread), 0
    else:
        worlds = learned = LearnedWorlds(problem.to(device), checkpoint, device)
        known = _true_steps(learned)
    if run.films is None:
        starts = problem.draw(training_seeds(problem, run))
    else:
        starts = _filmed(problem, run.films)
    pool = worlds.pool(starts)
    start = load_policy(run.start, problem) if run.start else None
    if start is not None and not isinstance(start, Policy):
        raise InputError(f"{run.start}: --start needs a policy without a memory; got DreamerV3's")
    speed = {"graph": run.graph, "compiled": run.compiled}
    trainer = Apg(worlds, pool, config, seed=run.seed, policy=start, **speed)
    names = ("objective", "finite", "value_loss", *problem.parts)
    notes = {
        "method": "apg",
        "config": dataclasses.asdict(config),
        "dynamics": worlds.name,
        "true_steps": known + _inherited(run),
        "start": run.start.name if run.start else "",
        **_seen(run),
        **problem.conditions,
    }
    return train_with(trainer, problem, run, clock, names, notes, report)


def train_clone(
    problem: PushProblem, config: CloneConfig, run: Run, report: Report = lambda _: None
) -> dict[str, Any]:
    """Clones the task's script; returns the manifest. Errors as `train_apg`."""
    check_run(run)
    clock = Clock(run.steps, run.limit)
    if run.films is None:
        seeds = training_seeds(problem, run)[: run.demonstrations]
        shown = demonstrate(problem, seeds, run.nthread)
    else:
        shown = run.films.demonstrations(problem)
    device = torch.device(run.device)
    data = Demonstrations(
        shown.observations.to(device),
        shown.actions.to(device),
        shown.success,
        shown.episodes,
        shown.steps,
    )
    trainer = Cloning(data, config, run.seed)
    notes = {
        "method": "bc",
        "config": dataclasses.asdict(config),
        "demonstrations": {"episodes": shown.episodes, "success": shown.success},
        "true_steps": shown.steps,
        **_seen(run),
        **problem.conditions,
    }
    return train_with(trainer, _as_seen(problem, run), run, clock, ("loss",), notes, report)


def _as_seen(problem: Problem, run: Run) -> Problem:
    """The problem as films show it, with their errors or without."""
    if run.films is None:
        return problem
    return MisreadProblem(problem, run.films if run.errors else run.films.exact)


def _filmed(problem: Problem, films: Films) -> Starts:
    """Beginnings as films show them; where the errors of films are seen, each with those of some.

    Each start has the errors of `_COPIES` films, its own first: the film of a beginning need not be
    that of what is seen later.
    """
    starts = films.starts()
    if not isinstance(problem, MisreadProblem):
        return starts
    count = len(films)
    strides = [copied * count // _COPIES for copied in range(min(_COPIES, count))]
    return joined(
        [problem.numbered(starts, [(i + s) % count for i in range(count)]) for s in strides]
    )


def _seen(run: Run) -> dict[str, Any]:
    """What the manifest says of films."""
    films = run.films
    if films is None:
        return {}
    return {"films": {"episodes": len(films), "digest": films.digest, "errors": run.errors,
                      **films.notes}}  # fmt: skip


def training_seeds(problem: Problem, run: Run) -> list[int]:
    """Seeds of the episodes that a training draws from; never those of an evaluation."""
    return [episode_seed(run.seed, problem.name, "policy training", i) for i in range(run.starts)]


def check_run(run: Run) -> None:
    """Checks what can be checked before anything is computed.

    Raises:
      InputError: no budget, or `out` holds another training.
    """
    if run.steps is None and run.limit is None:
        raise InputError("a training needs a budget: give --steps, --time-limit or both")
    known = [name for name in (PROGRESS, MANIFEST) if (run.out / name).exists()]
    if known and not run.resume:
        raise InputError(
            f"{run.out}: holds a training already ({known[0]}); go on with it by --resume, or "
            "choose another --out"
        )


def train_with(
    trainer: Trainer,
    problem: Problem,
    run: Run,
    clock: Clock,
    names: Sequence[str],
    notes: dict[str, Any],
    report: Report,
) -> dict[str, Any]:
    """A whole training; returns its manifest.

    Args:
      trainer: makes the iterations. problem: on the CPU. run: what is asked for.
      clock: its budgets. names: of what an iteration gives.
      notes: of the manifest, the same when a training goes on.
      report: called with each line of metrics.
    """
    with claimed(make_folder(run.out), "another training", "wait for it, or choose another --out"):
        _resume(trainer, clock, run, notes)
        begin_metrics(run.out / METRICS, clock.done)
        rows: list[Tensor] = []
        keeper = _Keeper(problem, run, notes, trainer)
        saved = checked = time.monotonic()
        while clock.progress < 1.0:
            rows.append(trainer.step(clock.progress).reshape(-1))
            clock.done += 1
            now = time.monotonic()
            if clock.done % run.log_every == 0:
                checks = {}
                if run.check and now - checked > run.check_every:
                    checks, checked = keeper.check(trainer.current, clock), time.monotonic()
                _log(rows, names, clock, keeper, checks, report)
            if now - saved > run.save_every:
                _save(trainer, clock, keeper, False)
                saved = time.monotonic()
        checks, last = {}, trainer.current
        if run.check and (best := trainer.chosen) is not last:
            checks = keeper.check(best, clock)
        if run.check:
            checks = keeper.check(last, clock)
        _log(rows, names, clock, keeper, checks, report)
        manifest = _save(trainer, clock, keeper, True)
        draw_curves(run.out)
    return manifest


class _Keeper:
    """Which policy stands in the folder: the best so far by its live estimates in MuJoCo.

    Without estimates it is the one that the training chooses itself.
    """

    def __init__(self, problem: Problem, run: Run, notes: dict[str, Any], trainer: Trainer) -> None:
        self.problem, self.run, self.notes, self.trainer = problem, run, notes, trainer
        self.best, self.steps, self.at = -math.inf, 0, 0
        if run.resume and (run.out / MANIFEST).exists():
            known = read_manifest(run.out).get("check", {})
            self.best, self.steps = known.get("reward", -math.inf), known.get("true_steps", 0)
            self.at = known.get("step", 0)

    @property
    def true_steps(self) -> int:
        """Control steps of C MuJoCo that the training has used."""
        return int(self.notes["true_steps"]) + self.trainer.true_steps

    def check(self, policy: AnyPolicy, clock: Clock) -> dict[str, Any]:
        """A live estimate: success and reward over a few episodes, the same each time."""
        problem, run = self.problem, self.run
        starts = starts_of(problem, run.check, run.seed, "checks")
        copied = copy.deepcopy(policy).cpu()
        found = summary(problem, starts, *in_mujoco(problem, copied, starts, run.nthread)[:2])
        self.steps += run.check * problem.steps
        shares = {f"success_{name}": row["share"] for name, row in found["success"].items()}
        means = {f"true_{name}": row["mean"] for name, row in found["reward"].items()}
        if sum(means.values()) > self.best:
            self.best, self.at = sum(means.values()), clock.done
            self.write(copied, clock, False)
        return {**shares, **means}

    def write(self, policy: AnyPolicy, clock: Clock, finished: bool) -> dict[str, Any]:
        """Writes the policy; returns its manifest."""
        manifest = self.manifest(clock, finished)
        save_policy(self.run.out, policy, self.problem, manifest)
        return manifest

    def manifest(self, clock: Clock, finished: bool) -> dict[str, Any]:
        """What is known of a policy at this time."""
        run, device = self.run, torch.device(self.run.device)
        check = {"episodes": run.check, "true_steps": self.steps}
        return {
            **self.notes,
            "true_steps": self.true_steps,
            "check": {**check, **({"reward": self.best, "step": self.at} if self.steps else {})},
            "training": {
                "seed": run.seed,
                "step": clock.done,
                "seconds": round(clock.elapsed, 1),
                "device": torch.cuda.get_device_name(device) if device.type == "cuda" else "cpu",
                "finished": finished,
            },
            "versions": {"torch": torch.__version__, "orbisim": VERSION},
        }


def _log(
    rows: list[Tensor],
    names: Sequence[str],
    clock: Clock,
    keeper: _Keeper,
    checks: dict[str, Any],
    report: Report,
) -> None:
    if not rows and not checks:
        return
    line: dict[str, Any] = {"step": clock.done, "seconds": round(clock.elapsed, 3)}
    line["true_steps"] = keeper.true_steps
    if rows:
        table = torch.stack(rows).double().cpu()
        fine = table[table.isfinite().all(1)]
        rows.clear()
        if not len(fine):
            raise OrbiSimError(
                f"training diverged: of the iterations up to {clock.done} since the last line of "
                "metrics, none was finite; lower the learning rate"
            )
        mean = fine.mean(0).tolist()
        line |= dict(zip(names, mean, strict=True)) | {"skipped": len(table) - len(fine)}
    append_metrics(keeper.run.out, {**line, **checks})
    report({**line, **checks})


def append_metrics(out: Path, line: dict[str, Any]) -> None:
    """Adds a line to the metrics of a training."""
    with output_errors(out / METRICS), (out / METRICS).open("a") as file:
        file.write(json.dumps(line) + "\n")


def begin_metrics(path: Path, done: int) -> None:
    """Leaves the lines of what is done: later ones are written again."""
    kept = []
    for line in path.read_bytes().splitlines(keepends=True) if path.exists() else ():
        whole = line.endswith(b"\n")
        if whole and parse_json(line, str(path)).get("step", 0) <= done:
            kept.append(line)
    write_bytes(path, b"".join(kept if done else ()), announce=False)


def _resume(trainer: Trainer, clock: Clock, run: Run, notes: dict[str, Any]) -> None:
    found = load_progress(run.out, DTYPES) if run.resume else None
    if found is None:
        return  # killed before the first save: the same as a fresh start
    tensors, known = found
    if known["config"] != json.loads(json.dumps(notes)):
        raise InputError(f"{run.out}: was trained with other settings; use another --out")
    if known["seed"] != run.seed:
        raise InputError(f"{run.out}: was trained with --seed {known['seed']}, not {run.seed}")
    shapes = {name: tensor.shape for name, tensor in trainer.state().items()}
    if shapes != {name: tensor.shape for name, tensor in tensors.items()}:
        raise InputError(f"{run.out}: was trained with other sizes; use another --out")
    trainer.restore(tensors, known["step"])
    clock.done, clock.spent = known["step"], known["seconds"]


def _save(trainer: Trainer, clock: Clock, keeper: _Keeper, finished: bool) -> dict[str, Any]:
    """Writes what is needed to go on, and the policy unless a better one stands there."""
    run = keeper.run
    where = {"seed": run.seed, "step": clock.done, "seconds": clock.elapsed}
    save_progress(run.out, trainer.state(), {"config": keeper.notes, **where})
    if not run.check or keeper.best == -math.inf:
        manifest = keeper.write(trainer.chosen, clock, finished)
    else:
        manifest = keeper.manifest(clock, finished)
        kept = load_policy(run.out, keeper.problem)
        save_policy(run.out, kept, keeper.problem, manifest)
    return {"task": keeper.problem.name, **manifest}


def _true_steps(worlds: LearnedWorlds) -> int:
    """Steps of the true simulator that the dynamics were trained on."""
    manifest = json.loads((worlds.folder / "manifest.json").read_text())
    return int(manifest["data"].get("control_steps", 0))


def _inherited(run: Run) -> int:
    """Of the policy that this one begins with, and of the films, once if both are of the same."""
    filmed = 0 if run.films is None else run.films.qpos.shape[0] * run.films.qpos.shape[1]
    if run.start is None:
        return filmed
    manifest = json.loads((run.start / MANIFEST).read_text())
    own = int(manifest.get("true_steps", 0)) if manifest.get("method") == "bc" else 0
    same = run.films is not None and manifest.get("films", {}).get("digest") == run.films.digest
    return own if same else own + filmed


def draw_curves(out: Path) -> None:
    """Draws what the metrics of a training say over its steps."""
    from matplotlib.figure import Figure

    rows = [json.loads(line) for line in (out / METRICS).read_text().splitlines()]
    names = [n for n in dict.fromkeys(n for row in rows for n in row) if n not in _AXES]
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.add_subplot()
    for name in names:
        points = [(row["seconds"], row[name]) for row in rows if name in row]
        marker = "o" if name.startswith(("success", "true")) else None
        axes.plot(*zip(*points, strict=True), label=name, lw=1, ms=3, marker=marker)
    axes.set(xlabel="s", ylabel="reward, share of successes")
    axes.legend(frameon=False, fontsize=7)
    with writing(out / CURVES, announce=False) as part:
        figure.savefig(part, dpi=120)


_AXES = ("step", "seconds", "true_steps", "value_loss", "skipped", "finite")
