"""Hidden friction and density of pushed cubes: gradients, mujoco.sysid and CMA-ES.

    python tools/identify_push.py (--data push_test.h5 | --motions thrown=6,flick=2) --work DIR
        [--checkpoint CHECKPOINT] [--methods learned,sysid,cma] [--episodes 100] [--workers 32]
        [--device cuda] [--time-limit 300] [--seed 1] [--force 60] [--scan 16] [--json FILE]

Every episode has a table and cubes of its own. Declared are the task's nominal values (0.4, 400
kg/m^3); fitted are the friction of the table and the density of the cube that is pushed, from
windows of `--window` s in which a cube moves.

- `--data`: episodes of `task:push`; of those with several windows the last is held out. Sizes of
  cubes are known to all methods, the other cube's density and the cubes' friction are not.
- `--motions`: worlds of `task:shove`, made here by C MuJoCo, each with so many recordings of each
  of these subtasks to fit to, and one more of each that is held out. All that is not sought is
  known: cube 2 is the reference that the collision compares with.

- learned: gradients through the checkpoint; all episodes are one batch.
- sysid: `mujoco.sysid` on C MuJoCo's rollouts, an episode on each core.
- cma: CMA-ES (package `cma`) on the same rollouts, for as many processor seconds as `sysid` took
  on that episode (so it comes after it), times `--longer`.
- bound: no fit; what the recordings hold (Cramer and Rao): the standard deviations of relative
  errors that C MuJoCo's own slopes allow, taken over 10 % either way at the true values. `noise`:
  independent errors of 0.5 mm and 5 mrad in every sample; `model`: errors of 2 mm and 20 mrad that
  count once for each coordinate of a window, as those of a model that simulates it do.
- refined: the same search from what `learned` found, near it (so it comes after both).

DIR keeps what is done, so that the same command goes on after an end. With `--time-limit`, no
episode begins that might not end within it.

Printed as JSON, for each method: of each parameter the relative error, median, 90 % and worst, that
of the declared value, the share of true values within the 95 % intervals, their median width over
the value; `by_mass_ratio`: the density's error where cube 1 has less than a third of cube 2's mass,
more than three times it, or between (worlds, median of its size, median); `slide_mm`: by how much
the pushed cube ends elsewhere than it did, in held-out windows
simulated by C MuJoCo with declared and with found values, median and 90 %; seconds of the batch (on
a GPU also of the same once more, and whether its steps were recorded as graphs), or processor
seconds of an episode.
"""

from __future__ import annotations

import argparse
import concurrent.futures
import dataclasses
import json
import multiprocessing
import sys
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import torch

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "backends"), str(ROOT / "tools")]

import from_source  # noqa: E402  (needs the path above)

from orbisim import load_scene, make_backend, tasks  # noqa: E402
from orbisim.errors import InputError  # noqa: E402
from orbisim.identification.classical import (  # noqa: E402
    around,
    identify_classical,
    simulated,
)
from orbisim.identification.estimate import LARGE, PRIOR, estimate  # noqa: E402
from orbisim.identification.learned import Described, Simulation, bounds  # noqa: E402
from orbisim.identification.parameters import parameters, patched  # noqa: E402
from orbisim.identification.windows import Grid  # noqa: E402

WANTED = "friction:table,density:cube1"
MOVES, CUBES = 0.005, 8
"""m, by which a cube moves in a window that counts; first coordinate of the cubes."""
DECLARED = (0.4, 400.0)
"""The task's nominal friction and density."""
APART = 1000
"""From one world's seed to the next; its recordings have those in between."""
APART_BY = (0.0, 1 / 3, 3.0), (1 / 3, 3.0, np.inf)
"""Bounds of mass ratios that are told apart."""
LONG = {"strikes": 200}
"""Control steps of an episode of a subtask that goes on; others end with their window."""
SPREAD = 0.5
"""Of logarithms: CMA-ES's first step, from a declared value to the ends of what tasks draw."""
NEAR = 0.1
"""The same of a search that begins from what the learned model found."""
METHODS = ("bound", "learned", "sysid", "cma", "refined")
NOISE, WIDE = 0.25, 0.1
"""Of `bound`: in units of 2 mm and 20 mrad, and half the width of the differences of logarithms."""


@dataclasses.dataclass(frozen=True)
class Problem:
    """One episode.

    Attributes:
      truth: friction and density. half: [N, 3] half sides of the cubes, m.
      density, friction: [N] of the cubes, as declared, kg/m^3 and 1.
      force: of the gripper at most, N; None where it is the scene's own.
      fit: windows to fit to. held: windows that are held out; both with steps of `timestep` s.
    """

    truth: np.ndarray
    half: np.ndarray
    density: np.ndarray
    friction: np.ndarray
    force: float | None
    fit: Grid
    held: Grid
    timestep: float


def main() -> int:
    """Fits what is not done yet, and prints."""
    options = _parser().parse_args()
    warnings.simplefilter("ignore")
    from_source.register("mujoco", "learned")
    unknown = [m for m in options.methods.split(",") if m not in METHODS]
    if unknown:
        print(f"unknown methods {unknown}; there are {list(METHODS)}", file=sys.stderr)
        return 2
    options.work.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    problems = read(options) if options.data else made(options)
    result: dict[str, Any] = {"episodes": len(problems), "window_s": options.window}
    if options.motions:
        result |= {"motions": options.motions, "seed": options.seed}
    for method in METHODS:
        if method not in options.methods.split(","):
            continue
        if method == "bound":
            result[method] = bound(problems)
        else:
            if method == "learned":
                fits = _kept(options, method, lambda: learned(problems, options))
            else:
                fits = apart(method, problems, options, began)
            if not fits:
                continue
            result[method] = summary(fits, problems)
        print(json.dumps({method: result[method]}), flush=True)
        if options.json:
            options.json.write_text(json.dumps(result, indent=1))
    return 0


# -- episodes ------------------------------------------------------------------------------------


def read(options: Any) -> dict[int, Problem]:
    """Episodes of `task:push` from a file."""
    from orbisim_world_model.packing import read_data

    pack = read_data([options.data])
    task = pack.notes["sources"][0]["task"]
    if task != "task:push":
        raise InputError(f"{options.data}: episodes of {task}; expected task:push")
    pack = pack.subset(torch.arange(min(options.episodes, pack.episodes)))
    return cut(pack, round(options.window / pack.layout.timestep))


def made(options: Any) -> dict[int, Problem]:
    """Worlds of `task:shove`, each with recordings of several motions.

    Raises:
      InputError: the motions are no subtasks with numbers above 0.
    """
    wanted = {}
    for text in options.motions.split(","):
        name, _, count = text.partition("=")
        if not count.isdigit() or not int(count):
            raise InputError(f"--motions {text!r}: expected a subtask and how often, thrown=6")
        wanted[name] = int(count)
    steps = round(options.window / tasks.make("shove").control_timestep)
    found, seed = {}, options.seed * APART
    while len(found) < options.episodes:
        problem = _world(wanted, seed, steps, options.force)
        if problem is not None:
            found[len(found)] = problem
        seed += APART
    return found


def _world(
    wanted: dict[str, int], seed: int, steps: int, force: float | None = None
) -> Problem | None:
    """One world's recordings; None if nothing moves in one motion's."""
    task: Any = tasks.make("shove", **({} if force is None else {"force": force}))
    fit, held = [], []
    for name, count in wanted.items():
        task.config = dataclasses.replace(task.config, steps=LONG.get(name, steps))
        windows = _recorded(task, name, seed, steps, count)
        if windows is None:
            return None
        fit.append(_rows(windows, slice(0, count)))
        held.append(_rows(windows, slice(count, None)))
    setting = task.setting(name, seed)
    half = np.array([[cube.half, cube.half * cube.aspect, cube.half] for cube in setting.cubes])
    return Problem(
        truth=np.array([setting.table_friction, setting.cubes[0].density]),
        half=half,
        density=np.array([DECLARED[1], *(cube.density for cube in setting.cubes[1:])]),
        friction=np.array([cube.friction for cube in setting.cubes]),
        force=task.config.force,
        fit=_joined(fit),
        held=_joined(held),
        timestep=task.control_timestep,
    )


def _recorded(task: Any, name: str, seed: int, steps: int, count: int) -> Grid | None:
    """`count` windows of a subtask and one more to be held out, of the seeds that follow `seed`."""
    long = task.steps > steps
    trials = task.trials(1 if long else count + 1, seed, name)
    start, ctrl = trials.initial, np.asarray(trials.sequence)
    backend: Any = make_backend("mujoco", trials.scene, nworld=len(ctrl))
    nstep = round(task.control_timestep / task.timestep)
    first = backend.reset(len(ctrl)).replace(qpos=start.qpos, qvel=start.qvel)
    path = backend.rollout(first, ctrl, nstep=nstep, sensors=False)
    qpos, qvel = (
        np.concatenate([np.asarray(a)[:, None], np.asarray(b)], 1)
        for a, b in ((start.qpos, path.qpos), (start.qvel, path.qvel))
    )
    begins = [(world, t) for world in range(len(ctrl)) for t in range(0, task.steps, steps)]
    rows = [(w, t) for w, t in begins if t + steps <= task.steps]
    rows = [(w, t) for w, t in rows if _moves(qpos[w, t : t + steps + 1, CUBES : CUBES + 3])]
    if len(rows) < count + 1:
        return None
    world, at = np.array(rows[: count + 1]).T
    later = at[:, None] + np.arange(steps)
    return Grid(
        qpos[world, at],
        qvel[world, at],
        np.zeros((len(at), 0)),
        ctrl[world[:, None], later],
        qpos[world[:, None], later + 1],
        np.zeros(len(at), int),
    )


def _moves(places: np.ndarray) -> bool:
    return float(np.linalg.norm(places - places[:1], axis=-1).max()) >= MOVES


def _rows(grid: Grid, which: slice) -> Grid:
    return Grid(*(getattr(grid, f.name)[which] for f in dataclasses.fields(Grid)))


def _joined(grids: list[Grid]) -> Grid:
    names = [f.name for f in dataclasses.fields(Grid)]
    return Grid(*(np.concatenate([getattr(g, n) for g in grids]) for n in names))


def cut(pack: Any, steps: int) -> dict[int, Problem]:
    """Episodes with a window in which a cube moves, by number."""
    columns = [pack.layout.attributes.index(f"half_{axis}") for axis in "xyz"]
    truth, found = hidden(pack), {}
    for episode in range(pack.episodes):
        first, length = int(pack.start[episode]), int(pack.length[episode])
        windows = []
        for begin in range(first, first + length - steps + 1, steps):
            places = pack.qpos[begin : begin + steps + 1, CUBES:].reshape(steps + 1, -1, 7)[..., :3]
            if float((places - places[:1]).norm(dim=-1).max()) >= MOVES:
                windows.append(begin)
        if not windows:
            continue
        held = windows[-1:] if len(windows) > 1 else []
        kept = windows[: len(windows) - len(held)]
        half = pack.attributes[episode][:, columns].double().numpy()
        fit, spare = (_grid(pack, begins, steps) for begins in (kept, held))
        density, friction = (np.full(len(half), value) for value in (DECLARED[1], DECLARED[0]))
        known = (half, density, friction, None)
        found[episode] = Problem(truth[episode], *known, fit, spare, pack.layout.timestep)
    return found


def _grid(pack: Any, begins: list[int], steps: int) -> Grid:
    at = np.array(begins, int)
    rows = at[:, None] + np.arange(steps)
    qpos, qvel, ctrl = (t.double().numpy() for t in (pack.qpos, pack.qvel, pack.ctrl))
    act = np.zeros((len(begins), 0))
    return Grid(qpos[at], qvel[at], act, ctrl[rows], qpos[rows + 1], np.zeros(len(begins), int))


def hidden(pack: Any) -> np.ndarray:
    """[E, 2]: friction of the table and density of the first cube."""
    columns, settings = pack.layout.attributes, pack.layout.settings
    mass = pack.attributes[:, 0, columns.index("mass")]
    half = [columns.index(f"half_{axis}") for axis in "xyz"]
    density = mass / (8 * pack.attributes[:, 0, half].prod(-1))
    friction = pack.world[:, settings.index("friction_slide")]
    return np.asarray(torch.stack([friction, density], dim=1).double())


def sized(problem: Problem) -> Any:
    """The scene with what is known of the episode, and what is sought of it."""
    scene = load_scene("task:push")
    spec = scene.spec
    for number, half in enumerate(problem.half):
        geom = spec.geom(f"cube{number + 1}")
        geom.size, geom.density = half, problem.density[number]
        geom.friction[0] = problem.friction[number]
    if problem.force is not None:
        spec.actuator("gripper").forcerange = [-problem.force, problem.force]
    scene = type(scene).from_spec(spec, source=scene.source)
    return scene, parameters(scene, WANTED)


def slide(problem: Problem, values: Any) -> list[float]:
    """By how much, mm, the first cube ends elsewhere in held-out windows, with these values."""
    if not len(problem.held.qpos):
        return []
    scene, wanted = sized(problem)
    edited = patched(scene, dict(zip(wanted, map(float, values), strict=True)))
    count = len(problem.held.qpos)
    backend: Any = make_backend("mujoco", edited, nworld=count)
    start = backend.reset(count).replace(qpos=problem.held.qpos, qvel=problem.held.qvel)
    nstep = round(problem.timestep / float(edited.model.opt.timestep))
    path = backend.rollout(start, problem.held.ctrl, nstep=nstep, sensors=False)
    ends, there = (
        np.asarray(a)[:, -1, CUBES : CUBES + 3] for a in (path.qpos, problem.held.target)
    )
    return [float(v) for v in 1e3 * np.linalg.norm(ends - there, axis=-1)]


# -- gradients -----------------------------------------------------------------------------------


def learned(problems: dict[int, Problem], options: Any) -> dict[str, Any]:
    """All episodes as one batch, by gradients through the checkpoint."""
    scene = load_scene("task:push")
    wanted = parameters(scene, WANTED)
    numbers = list(problems)
    group = torch.tensor([i for i, e in enumerate(numbers) for _ in problems[e].fit.qpos])
    windows = _joined([problems[e].fit for e in numbers])
    backend: Any = make_backend(
        f"learned:{options.checkpoint}", scene, device=options.device, compiled=False
    )
    described = Described(backend, _sizes(list(problems.values()), group, backend))
    run = Simulation(described, wanted, windows, options.device)
    start = torch.tensor([[p.declared for p in wanted]], dtype=torch.float64)
    ends = [bounds(backend, parameter) for parameter in wanted]
    low, high = torch.tensor(ends, dtype=torch.float64, device=options.device).T
    start = start.expand(len(numbers), -1).to(options.device)
    steps = windows.ctrl.shape[1]
    each: dict[str, Any] = {"windows": len(group)}
    for again in ("", "_again") if options.device != "cpu" else ("",):  # with graphs made before
        began, busy = time.monotonic(), time.process_time()
        found = estimate(
            run, start, (low, high), group.to(options.device), options.steps, steps, options.scan
        )
        each[f"seconds{again}"] = time.monotonic() - began
        each[f"processor_seconds{again}"] = time.process_time() - busy
    each["recorded"] = backend.engine.recorded
    rows = {}
    for number, episode in enumerate(numbers):
        ends = [getattr(found, n)[number].tolist() for n in ("values", "low", "high")]
        rows[str(episode)] = {"values": ends[0], "low": ends[1], "high": ends[2]}
        rows[str(episode)]["slide"] = slide(problems[episode], ends[0])
    return {"rows": rows, **each, "device": options.device}


def _sizes(problems: list[Problem], group: torch.Tensor, backend: Any) -> torch.Tensor:
    """[W, ...]: attributes of each window's scene, with what is known of it."""
    from orbisim_world_model.reading import read_attributes

    rows = [read_attributes(sized(one)[0].model, backend.engine.layout) for one in problems]
    given = torch.as_tensor(np.stack(rows), dtype=torch.float32)
    return given[group].to(backend.engine.device)


# -- one episode a core --------------------------------------------------------------------------


def apart(method: str, problems: dict[int, Problem], options: Any, began: float) -> dict[str, Any]:
    """Episodes one by one, as many at once as there are workers."""
    name = f"{method}_{options.longer:g}" if method == "cma" and options.longer != 1 else method
    folder, rows, longest = options.work / name, {}, 0.0
    folder.mkdir(exist_ok=True)
    todo: list[Any] = []
    starts = {}
    if method == "refined" and _place(options, "learned").exists():
        starts = json.loads(_place(options, "learned").read_text())["rows"]
    for episode, problem in problems.items():
        path, before = folder / f"{episode}.json", options.work / "sysid" / f"{episode}.json"
        if path.exists():
            rows[str(episode)] = json.loads(path.read_text())
        elif method == "sysid":
            todo.append((episode, problem, None, None))
        elif before.exists() and (method == "cma" or str(episode) in starts):
            seconds = options.longer * json.loads(before.read_text())["processor_seconds"]
            begin = starts[str(episode)]["values"] if method == "refined" else None
            todo.append((episode, problem, seconds, begin))
    context = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(options.workers, mp_context=context) as pool:
        running: dict[Any, int] = {}
        while todo or running:
            left = options.time_limit - (time.monotonic() - began)
            if left < 1.5 * longest:
                todo = []  # what might not end does not begin
            while todo and len(running) < options.workers:
                episode, problem, seconds, begin = todo.pop(0)
                future = pool.submit(one, method, problem, options.steps, seconds, begin)
                running[future] = episode
            if not running:
                break
            done, _ = concurrent.futures.wait(
                running, return_when=concurrent.futures.FIRST_COMPLETED
            )
            for future in done:
                row, episode = future.result(), running.pop(future)
                longest = max(longest, row["seconds"])
                (folder / f"{episode}.json").write_text(json.dumps(row))
                rows[str(episode)] = row
    return {"rows": rows} if rows else {}


def one(
    method: str,
    problem: Problem,
    steps: int,
    seconds: float | None,
    begin: list[float] | None = None,
) -> dict[str, Any]:
    """One episode by one of the classical methods; `begin` is where a refinement starts."""
    warnings.simplefilter("ignore")
    from_source.register("mujoco")
    scene, wanted = sized(problem)
    substeps = round(problem.timestep / float(scene.model.opt.timestep))
    began, busy = time.monotonic(), time.process_time()
    if method == "sysid":
        found = identify_classical(patched(scene, {}), wanted, problem.fit, substeps, steps)
    else:
        assert seconds is not None
        found = evolved(scene, wanted, problem.fit, substeps, seconds, begin)
    spent = {"seconds": time.monotonic() - began, "processor_seconds": time.process_time() - busy}
    ends = {name: getattr(found, name)[0].tolist() for name in ("values", "low", "high")}
    return {**ends, **spent, "slide": slide(problem, ends["values"])}


def evolved(
    scene: Any, wanted: Any, grid: Grid, substeps: int, seconds: float, begin: Any = None
) -> Any:
    """CMA-ES (Hansen, "The CMA Evolution Strategy", 2016) on Cauchy's loss of the same errors.

    It starts from declared values, or with small steps from those given as `begin`.
    """
    import cma

    run = simulated(scene, wanted, grid, substeps)

    def cost(logarithms: Any) -> float:
        each = (run(np.asarray(logarithms)) / LARGE).square()
        return float(0.5 * LARGE**2 * torch.log1p(each).sum() / grid.ctrl.shape[1])

    bounds = [np.log([getattr(p, end) for p in wanted]) for end in ("low", "high")]
    start = np.log([p.declared for p in wanted] if begin is None else begin)
    start = np.clip(start, *bounds)
    search = cma.CMAEvolutionStrategy(
        start,
        SPREAD if begin is None else NEAR,
        {"bounds": [list(b) for b in bounds], "seed": 1, "verbose": -9},
    )
    ends = time.process_time() + seconds
    while not search.stop() and time.process_time() < ends:
        tried = search.ask()
        search.tell(tried, [cost(t) for t in tried])
    best = search.result.xbest if search.result.xbest is not None else start
    return around(run, wanted, np.asarray(best, float), grid, float(search.result.fbest))


def bound(problems: dict[int, Problem]) -> dict[str, Any]:
    """Smallest standard deviations of relative errors that the recordings allow (see above)."""
    found: dict[str, list[np.ndarray]] = {"noise": [], "model": []}
    names: list[str] = []
    for problem in problems.values():
        scene, wanted = sized(problem)
        names = [p.label for p in wanted]
        nstep = round(problem.timestep / float(scene.model.opt.timestep))
        run, true = simulated(scene, wanted, problem.fit, nstep), np.log(problem.truth)
        slopes = [
            (run(true + e) - run(true - e)).numpy().ravel() / (2 * WIDE)
            for e in WIDE * np.eye(len(true))
        ]
        curvature = np.stack(slopes) @ np.stack(slopes).T
        for name, scale in (("noise", NOISE**2), ("model", problem.fit.ctrl.shape[1])):
            prior = np.eye(len(true)) / np.log(PRIOR) ** 2
            found[name].append(np.sqrt(np.diag(np.linalg.inv(curvature / scale + prior))))
    return {
        name: {
            label: _quantiles(column) for label, column in zip(names, np.array(rows).T, strict=True)
        }
        for name, rows in found.items()
    }


# -- figures -------------------------------------------------------------------------------------


def summary(fits: dict[str, Any], problems: dict[int, Problem]) -> dict[str, Any]:
    """What is printed of one method."""
    wanted = parameters(load_scene("task:push"), WANTED)
    rows = {int(episode): row for episode, row in fits["rows"].items() if int(episode) in problems}
    truth = np.array([problems[e].truth for e in rows])
    values, low, high = (np.array([r[n] for r in rows.values()]) for n in ("values", "low", "high"))
    table: dict[str, Any] = {"episodes": len(rows)}
    for number, parameter in enumerate(wanted):
        true, value = truth[:, number], values[:, number]
        inside = (low[:, number] <= true) & (true <= high[:, number])
        width = (high[:, number] - low[:, number]) / value
        table[parameter.label] = {
            "error": _quantiles(np.abs(value / true - 1)),
            "declared": _quantiles(np.abs(parameter.declared / true - 1)),
            "coverage": float(inside.mean()),
            "width": float(np.median(width)),
        }
    if all(problems[e].force is not None for e in rows):
        table["by_mass_ratio"] = by_ratio(values[:, 1], [problems[e] for e in rows])
    after = [v for row in rows.values() for v in row["slide"]]
    declared = [p.declared for p in wanted]
    before = [v for episode in rows for v in slide(problems[episode], declared)]
    table["slide_mm"] = {"declared": _quantiles(before), "found": _quantiles(after)}
    for name in ("seconds", "processor_seconds", "seconds_again", "recorded", "windows", "device"):
        if name in fits:
            table[name] = fits[name]
    spent = [row["processor_seconds"] for row in rows.values() if "processor_seconds" in row]
    if spent:
        table["processor_seconds_each"] = _quantiles(spent)
    return table


def by_ratio(densities: np.ndarray, chosen: list[Problem]) -> dict[str, Any]:
    """Relative errors of density where cube 1 is much lighter than the reference, like it, heavier.

    By each: worlds, the median error regardless of sign, and with it.
    """
    volumes = np.array([problem.half.prod(-1) for problem in chosen])
    true = np.array([problem.truth[1] for problem in chosen])
    ratio = true * volumes[:, 0] / (np.array([p.density[1] for p in chosen]) * volumes[:, 1])
    found, off = {}, densities / true - 1
    for name, low, high in zip(("lighter", "like", "heavier"), *APART_BY, strict=True):
        part = off[(low < ratio) & (ratio <= high)]
        if len(part):
            medians = float(np.median(np.abs(part))), float(np.median(part))
            found[name] = [len(part), *medians]
    return found


def _quantiles(values: Any) -> list[float]:
    """Median, 90 % and worst; empty of nothing."""
    return [float(np.quantile(values, q)) for q in (0.5, 0.9, 1.0)] if len(values) else []


def _place(options: Any, name: str) -> Path:
    scanned = f"_scan{options.scan}" if options.scan else ""
    path: Path = options.work / f"{name}_{options.checkpoint.name}{scanned}.json"
    return path


def _kept(options: Any, name: str, make: Any) -> dict[str, Any]:
    path = _place(options, name)
    if not path.exists():
        path.write_text(json.dumps(make()))
    found: dict[str, Any] = json.loads(path.read_text())
    return found


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    zoo = ROOT / "backends" / "orbisim_world_model" / "zoo"
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--data", type=Path, help="episodes of task:push")
    source.add_argument("--motions", help="subtasks of task:shove and how often: thrown=6,lifted=2")
    parser.add_argument("--seed", type=int, default=1, help="of the worlds of --motions")
    parser.add_argument("--force", type=float, help="of the gripper, N; the task's own if none")
    parser.add_argument("--work", type=Path, required=True, help="folder for what is done")
    parser.add_argument("--checkpoint", type=Path, default=zoo / "push_contacts")
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--window", type=float, default=1.0)
    parser.add_argument("--steps", type=int, default=12)
    parser.add_argument("--scan", type=int, default=0, help="points that gradients try first")
    parser.add_argument("--longer", type=float, default=1.0, help="CMA-ES, times sysid's seconds")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--time-limit", type=float, default=1e9, help="seconds, of the classical")
    parser.add_argument("--json", type=Path)
    return parser


if __name__ == "__main__":
    sys.exit(main())
