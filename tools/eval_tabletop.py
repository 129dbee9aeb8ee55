"""Learned rollouts of whole table-top episodes: errors, success told, more cubes, cost of a token.

    python tools/eval_tabletop.py episodes --data DATA/stack_test.h5 DATA/push_cubes_test.h5 \\
        --checkpoint one=out/tabletop cubes=ZOO/cubes --mujoco 40
    python tools/eval_tabletop.py counts --checkpoint one=out/tabletop --episodes 24
    python tools/eval_tabletop.py tokens --checkpoint one=out/tabletop --device cuda

`episodes` rolls out from the first state under the recorded controls to an episode's end. Errors
are means over an episode's cubes, as median, 90 % and worst over the episodes. Whether an episode
succeeds is told by the task's own measure of the predicted positions. `--mujoco N` also has C
MuJoCo roll out N episodes of each file from states whose arm joints are off by 1 mrad. `counts`
collects pushes of two to eight cubes (trained on: two to four) and measures the same. `tokens`
times a step and measures its memory with more and more cubes. Prints JSON; --json and --markdown
write files.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import torch

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "backends")]

from orbisim_world_model.checkpoint import load_checkpoint, load_for  # noqa: E402  (needs the path above)
from orbisim_world_model.config import ModelConfig  # noqa: E402
from orbisim_world_model.dynamics import Dynamics  # noqa: E402
from orbisim_world_model.entities import Context, Entities  # noqa: E402
from orbisim_world_model.evaluate import constant_velocity  # noqa: E402
from orbisim_world_model.layout import Layout  # noqa: E402
from orbisim_world_model.manifest import read_manifest, variants  # noqa: E402
from orbisim_world_model.pack import Pack, hands  # noqa: E402
from orbisim_world_model.packing import pack_file  # noqa: E402
from orbisim_world_model.rotation import conjugate, logarithm, multiply  # noqa: E402
from orbisim_world_model.sampling import Batch, Windows  # noqa: E402
from orbisim_world_model.unroll import open_loop  # noqa: E402

from orbisim import make_backend, tasks  # noqa: E402
from orbisim.state import State  # noqa: E402
from orbisim.tasks import EpisodeFile  # noqa: E402
from orbisim.tasks.collect import collect  # noqa: E402
from orbisim.tasks.push import PushConfig  # noqa: E402
from orbisim.tasks.push_cubes import PushCubes  # noqa: E402
from orbisim.tasks.tabletop import scatter  # noqa: E402

Floats = npt.NDArray[np.float64]
HORIZONS = (10, 100, 225)
"""Control steps; the last is the paper's for stack. An episode's end is added."""
OFF = 1e-3
"""rad: standard deviation of the perturbed states' arm joints."""
ROUNDS = 20
"""Steps that are timed, after five that are not."""


@dataclasses.dataclass(frozen=True)
class ManyConfig(PushConfig):
    """A number of cubes, and the room that eight of them need, m."""

    count: int = 4
    x: tuple[float, float] = (0.33, 0.68)
    y: tuple[float, float] = (-0.27, 0.27)


class ManyCubes(PushCubes):
    """The pushes of `push_cubes` among another number of cubes."""

    name: ClassVar[str] = "many_cubes"
    asset = "push_cubes"
    config: ManyConfig = ManyConfig()

    def count_of_cubes(self, subtask: str, rng: np.random.Generator) -> int:
        """As configured."""
        return self.config.count

    def _spread(self, setting: Any, rng: np.random.Generator) -> Any:
        return scatter(setting, self.config, rng)


def main() -> int:
    """Runs one of the measurements."""
    options = _parser().parse_args()
    named = dict(text.partition("=")[::2] for text in options.checkpoint)
    wrong = [text for text in options.checkpoint if "=" not in text]
    if wrong:
        print(f"checkpoints are given as NAME=FOLDER; got {wrong}", file=sys.stderr)
        return 2
    found: dict[str, Any] = {}
    for label, result in MEASUREMENTS[options.what](named, options):
        found[label] = result
        print(json.dumps({label: result}), flush=True)
        if options.json:
            options.json.write_text(json.dumps(found, indent=1))
    if options.markdown:
        options.markdown.write_text("\n".join(table(found)) + "\n")
    return 0


def episodes(named: dict[str, str], options: Any) -> Any:
    """Each file's figures, model by model."""
    for path in options.data:
        yield path.stem, of_file(path, named, options)


def of_file(path: Path, named: dict[str, str], options: Any) -> dict[str, Any]:
    """The figures of one file."""
    pack = pack_file(path).to(options.device)
    first = min(options.episodes or pack.episodes, pack.episodes)
    pack = pack.subset(torch.arange(first, device=pack.device))
    batch = whole(pack)
    truth = Entities(*(field[1:] for field in batch.states))
    tell, known = judge(path, first)
    result: dict[str, Any] = {"episodes": first, "steps": len(batch.control)}
    for name, folder in named.items():
        model = load_for(folder, pack.layout).model.eval().to(pack.device)
        predicted = open_loop(model, batch, 0)
        result[name] = figures(predicted, truth, pack.mask, batch.states, tell, known)
    still = constant_velocity(pack, ModelConfig())
    predicted = open_loop(still, batch, 0)
    result["constant_velocity"] = figures(predicted, truth, pack.mask, batch.states, tell, known)
    if options.mujoco:
        few = pack.subset(torch.arange(min(options.mujoco, first), device=pack.device))
        part = whole(few)
        run = resimulated(path, few)
        there = Entities(*(field[1:] for field in part.states))
        result["mujoco"] = figures(run, there, few.mask, part.states, tell, known)
    return result


def whole(pack: Pack) -> Batch:
    """Every episode from its start, as long as the shortest."""
    windows = Windows(pack, int(pack.length.min()), ModelConfig())
    return windows.batch(pack.start, torch.arange(pack.episodes, device=pack.device))


def judge(path: Path, count: int) -> tuple[Any, list[bool | None]]:
    """The task's measure as a function of episode and positions [T+1, N, 3]; and its truth."""
    with EpisodeFile(path) as file:
        task: Any = tasks.make(file.task, **file.config)
        known = [file.attributes(index) for index in range(count)]

    def tell(episode: int, cubes: Floats) -> bool | None:
        one = known[episode]
        setting = task.setting(one["subtask"], one["seed"])
        here = cubes[:, : len(setting.cubes)]
        answer: bool | None = task.success(one["subtask"], setting, here)
        return answer

    return tell, [one["success"] for one in known]


def figures(
    predicted: Entities,
    truth: Entities,
    mask: torch.Tensor,
    states: Entities,
    tell: Any,
    known: list[bool | None],
) -> dict[str, Any]:
    """Errors at the horizons and at the end, and how often success is told."""
    away = (predicted.pos - truth.pos).norm(dim=-1) * 1e3
    turn = torch.rad2deg(logarithm(multiply(predicted.quat, conjugate(truth.quat))).norm(dim=-1))
    hand = (predicted.hand_pos - truth.hand_pos).norm(dim=-1) * 1e3
    steps, count = len(away), mask.sum(1)
    result: dict[str, Any] = {}
    for horizon in sorted({*(h for h in HORIZONS if h < steps), steps}):
        at = horizon - 1
        result[str(horizon)] = {
            "position_mm": _row((away[at] * mask).sum(1) / count),
            "rotation_deg": _row((turn[at] * mask).sum(1) / count),
            "hand_mm": _row(hand[at]),
        }
    path = torch.cat([states.pos[:1], predicted.pos]).double().cpu().numpy()
    told = [(tell(e, path[:, e]), known[e]) for e in range(path.shape[1]) if known[e] is not None]
    if told:
        said, true = (np.array(values, bool) for values in zip(*told, strict=True))
        result["success"] = {
            "episodes": len(true),
            "truth": float(true.mean()),
            "told": float(said.mean()),
            "right": float((said == true).mean()),
            "right_where_it_succeeds": _mean((said == true)[true]),
            "right_where_it_fails": _mean((said == true)[~true]),
        }
    return result


def resimulated(path: Path, pack: Pack) -> Entities:
    """C MuJoCo from perturbed states, [T, E, ...], as `open_loop`."""
    rng, layout, rows = np.random.default_rng(0), pack.layout, []
    with EpisodeFile(path) as file:
        task: Any = tasks.make(file.task, **file.config)
        for index in range(pack.episodes):
            known = file.attributes(index)
            scene = task.scene(known["subtask"], known["seed"])
            data = file.episode(index, ("qpos", "qvel", "act", "ctrl"))
            first: Any = [data[name][:1].copy() for name in ("qpos", "qvel", "act")]
            arm = [layout.joint_q[j] for j in layout.robot_joints if layout.robot[j][1]]
            first[0][0, arm] += OFF * rng.standard_normal(len(arm))
            backend = make_backend("mujoco", scene)
            repeat = round(file.control_timestep / float(scene.model.opt.timestep))
            run = backend.rollout(State(np.zeros(1), *first), data["ctrl"][None], nstep=repeat)
            found = [np.asarray(field)[0] for field in (run.qpos, run.qvel)]
            more = (layout.nq - found[0].shape[1], layout.nv - found[1].shape[1])
            padded = [np.pad(f, ((0, 0), (0, m))) for f, m in zip(found, more, strict=True)]
            rows.append([torch.as_tensor(p, dtype=torch.float32) for p in padded])
    steps = min(len(row[0]) for row in rows)
    each = []
    for qpos, qvel in rows:
        x = layout.split(qpos[:steps], qvel[:steps], torch.zeros(steps, layout.na))
        each.append(x._replace(hand=hands(layout, qpos[:steps], qvel[:steps])))
    return Entities(*(torch.stack(fields, dim=1) for fields in zip(*each, strict=True)))


def counts(named: dict[str, str], options: Any) -> Any:
    """Figures of pushes among two to eight cubes."""
    tasks.register("many_cubes", ManyCubes)
    with tempfile.TemporaryDirectory() as folder:
        for count in options.counts:
            path = Path(folder) / f"cubes_{count}.h5"
            changes = {"count": count}
            total = options.episodes or 24
            collect("many_cubes", path, episodes=total, workers=1, subtask="random", seed=11,
                    changes=changes)  # fmt: skip
            yield f"{count} cubes", of_file(path, named, options)


def tokens(named: dict[str, str], options: Any) -> Any:
    """Milliseconds and MiB of a control step by the number of cubes and of worlds."""
    for name, folder in named.items():
        for count in options.counts:
            for worlds in options.worlds:
                yield (
                    f"{name}, {count} cubes, {worlds} worlds",
                    cost(folder, count, worlds, options),
                )


def cost(folder: str, count: int, worlds: int, options: Any) -> dict[str, Any]:
    """Of one control step without gradients, not compiled."""
    device = torch.device(options.device)
    layout = Layout.from_dict(variants(read_manifest(folder))[0]["layout"])
    layout = with_objects(layout, count)
    model = load_checkpoint(folder, layout).model.eval().to(device)
    x, control, context = standing(model, layout, worlds, device)
    memory = model.initial_memory(worlds)
    with torch.no_grad():
        for _ in range(5):
            model(x, memory, control, context)
        _wait(device)
        if device.type == "cuda":
            torch.cuda.reset_peak_memory_stats(device)
            before = torch.cuda.memory_allocated(device)
        began = time.monotonic()
        for _ in range(ROUNDS):
            model(x, memory, control, context)
        _wait(device)
        seconds = (time.monotonic() - began) / ROUNDS
    result: dict[str, Any] = {"tokens": 1 + count, "ms": 1e3 * seconds}
    if device.type == "cuda":
        result["MiB"] = (torch.cuda.max_memory_allocated(device) - before) / 2**20
    return result


def with_objects(layout: Layout, count: int) -> Layout:
    """The layout with so many objects; they come last."""
    nq = layout.nq - 7 * len(layout.objects)
    nv = layout.nv - 6 * len(layout.objects)
    numbers = range(count)
    return dataclasses.replace(
        layout,
        nq=nq + 7 * count,
        nv=nv + 6 * count,
        objects=tuple(f"cube{i + 1}" for i in numbers),
        object_q=tuple(nq + 7 * i for i in numbers),
        object_v=tuple(nv + 6 * i for i in numbers),
    )


def standing(
    model: Dynamics, layout: Layout, worlds: int, device: torch.device
) -> tuple[Entities, torch.Tensor, Context]:
    """Cubes in a row, the arm at zero."""
    count = len(layout.objects)
    qpos, qvel = torch.zeros(worlds, layout.nq), torch.zeros(worlds, layout.nv)
    for i, address in enumerate(layout.object_q):
        qpos[:, address : address + 3] = torch.tensor([0.4, 0.07 * i - 0.3, 0.025])
        qpos[:, address + 3] = 1.0
    x = layout.split(qpos, qvel, torch.zeros(worlds, layout.na))
    x = model.completed(Entities(*(field.to(device) for field in x)))
    attributes = torch.full((worlds, count, len(layout.attributes)), 0.025, device=device)
    world = torch.full((worlds, len(layout.settings)), 0.4, device=device)
    context = Context(attributes, world, torch.ones(worlds, count, device=device))
    return x, torch.zeros(worlds, layout.nu, device=device), context


def _wait(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def table(found: dict[str, Any]) -> list[str]:
    """Rows for docs/benchmarks.md."""
    lines = []
    for label, result in found.items():
        if "ms" in result:
            more = f" | {result['MiB']:.1f}" if "MiB" in result else ""
            lines.append(f"| {label} | {result['tokens']} | {result['ms']:.2f}{more} |")
            continue
        for name, values in result.items():
            if not isinstance(values, dict):
                continue
            for horizon, row in values.items():
                if not horizon.isdigit():
                    continue
                cells = [_three(row[k]) for k in ("position_mm", "rotation_deg", "hand_mm")]
                lines.append(f"| {label} | {name} | {horizon} | {' | '.join(cells)} |")
            if "success" in values:
                lines.append(f"| {label} | {name} | success | {_success(values['success'])} |")
    return lines


def _three(row: dict[str, float]) -> str:
    return " / ".join(f"{row[key]:.2g}" for key in ("median", "p90", "worst"))


def _success(row: dict[str, Any]) -> str:
    names = ("right", "right_where_it_succeeds", "right_where_it_fails", "truth")
    return ", ".join(f"{n} {'-' if row[n] is None else f'{row[n]:.0%}'}" for n in names)


def _row(values: torch.Tensor) -> dict[str, float]:
    rows = torch.nan_to_num(values.double(), nan=float("inf")).cpu().numpy()
    return {
        "median": float(np.median(rows)),
        "p90": float(np.quantile(rows, 0.9)),
        "worst": float(rows.max()),
    }


def _mean(values: Any) -> float | None:
    return float(np.mean(values)) if len(values) else None


MEASUREMENTS: dict[str, Any] = {"episodes": episodes, "counts": counts, "tokens": tokens}


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=tuple(MEASUREMENTS))
    parser.add_argument("--checkpoint", nargs="+", default=[], metavar="NAME=FOLDER")
    parser.add_argument("--data", type=Path, nargs="*", default=[])
    parser.add_argument("--episodes", type=int, help="of each file, at most")
    parser.add_argument("--counts", type=int, nargs="+", default=[2, 3, 4, 5, 6, 8])
    parser.add_argument("--worlds", type=int, nargs="+", default=[1, 256])
    parser.add_argument("--mujoco", type=int, default=0)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--markdown", type=Path)
    return parser


if __name__ == "__main__":
    sys.exit(main())
