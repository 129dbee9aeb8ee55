"""Hidden friction and density of fresh episodes of `push`: gradients, mujoco.sysid and CMA-ES.

    python tools/identify_push.py --data push_test.h5 --work DIR [--checkpoint CHECKPOINT]
        [--methods learned,sysid,cma] [--episodes 100] [--workers 32] [--device cuda]
        [--time-limit 300] [--json FILE]

Every episode has a table and cubes of its own. Declared are the task's nominal values (0.4, 400
kg/m^3); fitted are the friction of the table and the density of the cube that is pushed, from
windows of `--window` s in which a cube moves; of episodes with several of these the last is held
out. Sizes of cubes are known to all methods.

- learned: gradients through the checkpoint; all episodes are one batch.
- sysid: `mujoco.sysid` on C MuJoCo's rollouts, an episode on each core.
- cma: CMA-ES (package `cma`) on the same rollouts, for as many processor seconds as `sysid` took
  on that episode (so it comes after it).

DIR keeps what is done, so that the same command goes on after an end. With `--time-limit`, no
episode begins that might not end within it.

Printed as JSON, for each method: of each parameter the relative error, median, 90 % and worst, that
of the declared value, the share of true values within the 95 % intervals, their median width over
the value; `slide_mm`: by how much the pushed cube ends elsewhere than it did, in held-out windows
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

from orbisim import load_scene, make_backend  # noqa: E402
from orbisim.errors import InputError  # noqa: E402
from orbisim.identification.classical import (  # noqa: E402
    around,
    identify_classical,
    simulated,
)
from orbisim.identification.estimate import LARGE, estimate  # noqa: E402
from orbisim.identification.learned import Simulation  # noqa: E402
from orbisim.identification.parameters import parameters, patched  # noqa: E402
from orbisim.identification.windows import Grid  # noqa: E402

WANTED = "friction:table,density:cube1"
MOVES, CUBES = 0.005, 8
"""m, by which a cube moves in a window that counts; first coordinate of the cubes."""
SPREAD = 0.5
"""Of logarithms: CMA-ES's first step, from a declared value to the ends of what tasks draw."""
METHODS = ("learned", "sysid", "cma")


@dataclasses.dataclass(frozen=True)
class Problem:
    """One episode.

    Attributes:
      truth: friction and density. half: [N] half sides of the cubes, m.
      fit: windows to fit to. held: windows that are held out; both with steps of `timestep` s.
    """

    truth: np.ndarray
    half: np.ndarray
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
    from orbisim_world_model.packing import read_data

    pack = read_data([options.data])
    task = pack.notes["sources"][0]["task"]
    if task != "task:push":
        raise InputError(f"{options.data}: episodes of {task}; expected task:push")
    pack = pack.subset(torch.arange(min(options.episodes, pack.episodes)))
    problems = cut(pack, round(options.window / pack.layout.timestep))
    result: dict[str, Any] = {"episodes": len(problems), "window_s": options.window}
    for method in METHODS:
        if method not in options.methods.split(","):
            continue
        if method == "learned":
            fits = _kept(options, method, lambda: learned(pack, problems, options))
        else:
            fits = apart(method, problems, options, began)
        if fits:
            result[method] = summary(fits, problems)
            print(json.dumps({method: result[method]}), flush=True)
        if options.json:
            options.json.write_text(json.dumps(result, indent=1))
    return 0


# -- episodes ------------------------------------------------------------------------------------


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
        found[episode] = Problem(truth[episode], half, fit, spare, pack.layout.timestep)
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
    """The scene with the episode's cubes, and what is sought of it."""
    scene = load_scene("task:push")
    spec = scene.spec
    for number, half in enumerate(problem.half):
        spec.geom(f"cube{number + 1}").size = half
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


def learned(pack: Any, problems: dict[int, Problem], options: Any) -> dict[str, Any]:
    """All episodes as one batch, by gradients through the checkpoint."""
    scene = load_scene("task:push")
    wanted = parameters(scene, WANTED)
    numbers = list(problems)
    group = torch.tensor([i for i, e in enumerate(numbers) for _ in problems[e].fit.qpos])
    names = [f.name for f in dataclasses.fields(Grid)]
    windows = Grid(*(np.concatenate([getattr(problems[e].fit, n) for e in numbers]) for n in names))
    backend: Any = make_backend(
        f"learned:{options.checkpoint}", scene, device=options.device, compiled=False
    )
    episodes = torch.tensor(numbers)[group]
    run = Simulation(_Sized(backend, pack, episodes), wanted, windows, options.device)
    start = torch.tensor([[p.declared for p in wanted]], dtype=torch.float64)
    low, high = (
        torch.tensor([getattr(p, end) for p in wanted], dtype=torch.float64).to(options.device)
        for end in ("low", "high")
    )
    start = start.expand(len(numbers), -1).to(options.device)
    steps = windows.ctrl.shape[1]
    each: dict[str, Any] = {"windows": len(group)}
    for again in ("", "_again") if options.device != "cpu" else ("",):  # with graphs made before
        began, busy = time.monotonic(), time.process_time()
        found = estimate(run, start, (low, high), group.to(options.device), options.steps, steps)
        each[f"seconds{again}"] = time.monotonic() - began
        each[f"processor_seconds{again}"] = time.process_time() - busy
    each["recorded"] = backend.engine.recorded
    rows = {}
    for number, episode in enumerate(numbers):
        ends = [getattr(found, n)[number].tolist() for n in ("values", "low", "high")]
        rows[str(episode)] = {"values": ends[0], "low": ends[1], "high": ends[2]}
        rows[str(episode)]["slide"] = slide(problems[episode], ends[0])
    return {"rows": rows, **each, "device": options.device}


class _Sized:
    """The backend in worlds whose cubes have the sizes of each window's episode."""

    def __init__(self, backend: Any, pack: Any, episodes: Any) -> None:
        self.inner = backend
        self.name, self.model, self.surface = backend.name, backend.model, backend.surface
        self.entity_names = backend.entity_names
        columns = pack.layout.attributes
        given = pack.attributes[episodes].to(backend.engine.device).clone()
        friction, mass = columns.index("friction_slide"), columns.index("mass")
        half = [columns.index(f"half_{axis}") for axis in "xyz"]
        own = 8 * given[..., half].prod(-1) * 400.0  # declared: density and cubes' own friction
        for axis in "xyz":
            given[..., columns.index(f"inertia_{axis}")] *= own / given[..., mass]
        given[..., mass], given[..., friction] = own, 0.4
        self.attributes = given

    def with_properties(self, state: Any, objects: Any = None, world: Any = None) -> Any:
        """As the backend's, with the sizes first."""
        copies = torch.cat([self.attributes] * (state.nworld // len(self.attributes)))
        state = self.inner.with_descriptors(state, attributes=copies)
        return self.inner.with_properties(state, objects, world)

    def rollout(self, state: Any, controls: Any, **options: Any) -> Any:
        """The backend's."""
        return self.inner.rollout(state, controls, **options)


# -- one episode a core --------------------------------------------------------------------------


def apart(method: str, problems: dict[int, Problem], options: Any, began: float) -> dict[str, Any]:
    """Episodes one by one, as many at once as there are workers."""
    folder, rows, longest = options.work / method, {}, 0.0
    folder.mkdir(exist_ok=True)
    todo = []
    for episode, problem in problems.items():
        path, before = folder / f"{episode}.json", options.work / "sysid" / f"{episode}.json"
        if path.exists():
            rows[str(episode)] = json.loads(path.read_text())
        elif method == "sysid":
            todo.append((episode, problem, None))
        elif before.exists():
            todo.append((episode, problem, json.loads(before.read_text())["processor_seconds"]))
    context = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(options.workers, mp_context=context) as pool:
        running: dict[Any, int] = {}
        while todo or running:
            left = options.time_limit - (time.monotonic() - began)
            if left < 1.5 * longest:
                todo = []  # what might not end does not begin
            while todo and len(running) < options.workers:
                episode, problem, seconds = todo.pop(0)
                running[pool.submit(one, method, problem, options.steps, seconds)] = episode
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


def one(method: str, problem: Problem, steps: int, seconds: float | None) -> dict[str, Any]:
    """One episode by one of the classical methods."""
    warnings.simplefilter("ignore")
    from_source.register("mujoco")
    scene, wanted = sized(problem)
    substeps = round(problem.timestep / float(scene.model.opt.timestep))
    began, busy = time.monotonic(), time.process_time()
    if method == "sysid":
        found = identify_classical(patched(scene, {}), wanted, problem.fit, substeps, steps)
    else:
        assert seconds is not None
        found = evolved(scene, wanted, problem.fit, substeps, seconds)
    spent = {"seconds": time.monotonic() - began, "processor_seconds": time.process_time() - busy}
    ends = {name: getattr(found, name)[0].tolist() for name in ("values", "low", "high")}
    return {**ends, **spent, "slide": slide(problem, ends["values"])}


def evolved(scene: Any, wanted: Any, grid: Grid, substeps: int, seconds: float) -> Any:
    """CMA-ES (Hansen, "The CMA Evolution Strategy", 2016) on Cauchy's loss of the same errors."""
    import cma

    run = simulated(scene, wanted, grid, substeps)

    def cost(logarithms: Any) -> float:
        each = (run(np.asarray(logarithms)) / LARGE).square()
        return float(0.5 * LARGE**2 * torch.log1p(each).sum() / grid.ctrl.shape[1])

    bounds = [np.log([getattr(p, end) for p in wanted]) for end in ("low", "high")]
    start = np.log([p.declared for p in wanted])
    search = cma.CMAEvolutionStrategy(
        start, SPREAD, {"bounds": [list(b) for b in bounds], "seed": 1, "verbose": -9}
    )
    ends = time.process_time() + seconds
    while not search.stop() and time.process_time() < ends:
        tried = search.ask()
        search.tell(tried, [cost(t) for t in tried])
    best = search.result.xbest if search.result.xbest is not None else start
    return around(run, wanted, np.asarray(best, float), grid, float(search.result.fbest))


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


def _quantiles(values: Any) -> list[float]:
    """Median, 90 % and worst; empty of nothing."""
    return [float(np.quantile(values, q)) for q in (0.5, 0.9, 1.0)] if len(values) else []


def _kept(options: Any, name: str, make: Any) -> dict[str, Any]:
    path = options.work / f"{name}_{options.checkpoint.name}.json"
    if not path.exists():
        path.write_text(json.dumps(make()))
    found: dict[str, Any] = json.loads(path.read_text())
    return found


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    zoo = ROOT / "backends" / "orbisim_world_model" / "zoo"
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--work", type=Path, required=True, help="folder for what is done")
    parser.add_argument("--checkpoint", type=Path, default=zoo / "push_contacts")
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--window", type=float, default=1.0)
    parser.add_argument("--steps", type=int, default=12)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--time-limit", type=float, default=1e9, help="seconds, of the classical")
    parser.add_argument("--json", type=Path)
    return parser


if __name__ == "__main__":
    sys.exit(main())
