"""Hidden friction and density of fresh episodes of `push`, found by gradients and by mujoco.sysid.

    python tools/identify_push.py --data push_test.h5 --checkpoint CHECKPOINT [--episodes 100]
        [--classical 10] [--device cuda] [--json FILE]

Every episode has a table and cubes of its own. Declared are the task's nominal values (0.4, 400
kg/m^3); fitted are the friction of the table and the density of the cube that is pushed, from
windows of `--window` s in which a cube moves. All episodes are one batch for the learned model;
mujoco.sysid takes `--classical` of them, one after another.

Printed as JSON, for each parameter: relative error, median, 90 % and worst; share of true values
within the 95 % intervals and median width of these over the value; seconds.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import torch

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "backends")]

import from_source  # noqa: E402

from orbisim import load_scene, make_backend  # noqa: E402  (needs the path above)
from orbisim.identification.classical import identify_classical  # noqa: E402
from orbisim.identification.estimate import estimate  # noqa: E402
from orbisim.identification.learned import simulation  # noqa: E402
from orbisim.identification.parameters import parameters, patched  # noqa: E402
from orbisim.identification.windows import Grid  # noqa: E402

WANTED = "friction:table,density:cube1"
MOVES, CUBES = 0.005, 8
"""m, by which a cube moves in a window that counts; first coordinate of the cubes."""


def main() -> None:
    """Fits and prints."""
    options = _parser().parse_args()
    warnings.simplefilter("ignore")
    from_source.register("mujoco", "learned")
    from orbisim_world_model.packing import read_data

    pack = read_data([options.data])
    pack = pack.subset(torch.arange(min(options.episodes, pack.episodes)))
    scene = load_scene("task:push")
    wanted, truth = parameters(scene, WANTED), hidden(pack)
    result: dict[str, Any] = {"episodes": pack.episodes, "window_s": options.window}
    steps = round(options.window / pack.layout.timestep)
    windows, group = cut(pack, steps)
    backend: Any = make_backend(
        f"learned:{options.checkpoint}", scene, device=options.device, compiled=False
    )
    backend = _Sized(backend, pack, group)
    run = simulation(backend, wanted, windows, options.device)
    start = torch.tensor([[p.declared for p in wanted]], dtype=torch.float64)
    bounds = tuple(
        torch.tensor([getattr(p, end) for p in wanted], dtype=torch.float64).to(options.device)
        for end in ("low", "high")
    )
    began = time.monotonic()
    start = start.expand(pack.episodes, -1).to(options.device)
    group_on = group.to(options.device)
    found = estimate(run, start, bounds, group_on, options.steps, steps)
    seconds = time.monotonic() - began
    ours = [getattr(found, n).cpu().numpy() for n in ("values", "low", "high")]
    result["learned"] = {**rows(wanted, truth, *ours), "seconds": seconds, "windows": len(group)}
    print(json.dumps({"learned": result["learned"]}), flush=True)
    if options.classical:
        result["mujoco"] = classical(options, pack, scene, wanted, truth, windows, group)
        print(json.dumps({"mujoco": result["mujoco"]}), flush=True)
    if options.json:
        options.json.write_text(json.dumps(result, indent=1))


class _Sized:
    """The backend in worlds whose cubes have the sizes of each window's episode."""

    def __init__(self, backend: Any, pack: Any, group: Any) -> None:
        self.inner, self.attributes = backend, pack.attributes[group].to(backend.engine.device)
        self.name, self.model, self.surface = backend.name, backend.model, backend.surface
        self.entity_names = backend.entity_names
        columns = pack.layout.attributes
        given = self.attributes.clone()
        friction, mass = columns.index("friction_slide"), columns.index("mass")
        own = _volumes(pack)[group].to(given) * 400.0  # declared: density and cubes' own friction
        for axis in "xyz":
            given[..., columns.index(f"inertia_{axis}")] *= own / given[..., mass]
        given[..., mass], given[..., friction] = own, 0.4
        self.attributes = given

    def with_properties(self, state: Any, objects: Any = None, world: Any = None) -> Any:
        """As the backend's, with the sizes first."""
        state = self.inner.with_descriptors(state, attributes=self.attributes)
        return self.inner.with_properties(state, objects, world)

    def rollout(self, state: Any, controls: Any, **options: Any) -> Any:
        """The backend's."""
        return self.inner.rollout(state, controls, **options)


def hidden(pack: Any) -> Any:
    """[E, 2]: friction of the table and density of the first cube."""
    columns, settings = pack.layout.attributes, pack.layout.settings
    mass = pack.attributes[:, 0, columns.index("mass")]
    density = mass / _volumes(pack)[:, 0]
    friction = pack.world[:, settings.index("friction_slide")]
    return torch.stack([friction, density], dim=1).double().numpy()


def _volumes(pack: Any) -> Any:
    half = [pack.layout.attributes.index(f"half_{axis}") for axis in "xyz"]
    return 8 * pack.attributes[..., half].prod(-1)


def cut(pack: Any, steps: int) -> tuple[Grid, Any]:
    """Consecutive windows in which a cube moves, and their episodes."""
    parts, group = [], []
    for episode in range(pack.episodes):
        first, length = int(pack.start[episode]), int(pack.length[episode])
        for begin in range(first, first + length - steps + 1, steps):
            rows = slice(begin, begin + steps + 1)
            places = pack.qpos[rows, CUBES:].reshape(steps + 1, -1, 7)[..., :3]
            if float((places - places[:1]).norm(dim=-1).max()) < MOVES:
                continue
            group.append(episode)
            parts.append((begin, rows))
    take = lambda field, at: np.stack([getattr(pack, field)[at(b, r)] for b, r in parts])  # noqa: E731
    grid = Grid(
        take("qpos", lambda b, r: b).astype(float),
        take("qvel", lambda b, r: b).astype(float),
        np.zeros((len(parts), 0)),
        take("ctrl", lambda b, r: slice(b, b + steps)).astype(float),
        take("qpos", lambda b, r: slice(b + 1, b + steps + 1)).astype(float),
        np.array(group),
    )
    return grid, torch.tensor(group)


def classical(
    options: Any, pack: Any, scene: Any, wanted: Any, truth: Any, windows: Grid, group: Any
) -> dict[str, Any]:
    """mujoco.sysid on some of the episodes, with the right sizes."""
    import dataclasses

    columns = pack.layout.attributes
    ends: list[list[Any]] = [[], [], []]
    chosen = [e for e in range(pack.episodes) if bool((group == e).any())][: options.classical]
    began = time.monotonic()
    for episode in chosen:
        spec = scene.spec
        for number in range(len(pack.layout.objects)):
            half = float(pack.attributes[episode, number, columns.index("half_x")])
            spec.geom(f"cube{number + 1}").size = [half] * 3
        sized = type(scene).from_spec(spec, source=scene.source)
        mine = np.flatnonzero(group.numpy() == episode)
        part = Grid(*(getattr(windows, f.name)[mine] for f in dataclasses.fields(Grid)))
        substeps = round(pack.layout.timestep / float(sized.model.opt.timestep))
        fit = identify_classical(patched(sized, {}), wanted, part, substeps, options.steps)
        for column, field in zip(ends, (fit.values, fit.low, fit.high), strict=True):
            column.append(field[0].numpy())
    seconds = time.monotonic() - began
    ours = [np.stack(column) for column in ends]
    return {**rows(wanted, truth[chosen], *ours), "seconds": seconds, "episodes": len(chosen)}


def rows(wanted: Any, truth: Any, values: Any, low: Any, high: Any) -> dict[str, Any]:
    """What is printed of each parameter."""
    table = {}
    for number, parameter in enumerate(wanted):
        true, value = truth[:, number], values[:, number]
        error = np.abs(value / true - 1)
        declared = np.abs(parameter.declared / true - 1)
        inside = (low[:, number] <= true) & (true <= high[:, number])
        width = (high[:, number] - low[:, number]) / value
        table[parameter.label] = {
            "error": [float(np.quantile(error, q)) for q in (0.5, 0.9, 1.0)],
            "declared": [float(np.quantile(declared, q)) for q in (0.5, 0.9, 1.0)],
            "coverage": float(inside.mean()),
            "width": float(np.median(width)),
        }
    return table


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--checkpoint", type=Path, required=True)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--classical", type=int, default=0)
    parser.add_argument("--window", type=float, default=1.0)
    parser.add_argument("--steps", type=int, default=12)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--json", type=Path)
    return parser


if __name__ == "__main__":
    main()
