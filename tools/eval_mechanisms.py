"""Errors of learned steps on episodes of mechanisms, beside constant velocity and C MuJoCo.

    orbisim collect task:mechanism:door --episodes 60 --subtask held_out --out held.h5
    python tools/eval_mechanisms.py --data held.h5 --checkpoint CHECKPOINT [CHECKPOINT ...]
        [--burn 1] [--mujoco 20] [--json FILE]

Open loop over whole episodes after `--burn` true steps, under the recorded controls. Printed as
JSON, for each model, at 10, 100 and 300 steps (or the last):
  part_angle (deg), part_travel (mm): the greatest error among an episode's hinges, and among its
    slides; hand_position (mm). Median, 90 % and worst over the episodes.
  lock: of the episodes, the share in which the part that a lock holds leaves its place where it
    does in truth, within a second, or stays where it does; and for those that open and those that
    stay by themselves. always_opens and never_opens are what guesses would have.
  success: the share in which the task's own criterion comes out as in truth.
`mujoco` is C MuJoCo with all effects from states whose robot joints are off by a normally
distributed milliradian each, on the first so many episodes.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "backends")]

from orbisim_world_model.checkpoint import load_for  # noqa: E402  (needs the path above)
from orbisim_world_model.config import ModelConfig  # noqa: E402
from orbisim_world_model.dynamics import Dynamics  # noqa: E402
from orbisim_world_model.evaluate import constant_velocity  # noqa: E402
from orbisim_world_model.layout import Layout  # noqa: E402
from orbisim_world_model.pack import Pack, hands  # noqa: E402
from orbisim_world_model.packing import pack_file  # noqa: E402
from orbisim_world_model.sampling import Windows  # noqa: E402
from orbisim_world_model.unroll import open_loop  # noqa: E402

from orbisim import make_backend, tasks  # noqa: E402
from orbisim.errors import InputError  # noqa: E402
from orbisim.state import State  # noqa: E402
from orbisim.tasks import EpisodeFile  # noqa: E402
from orbisim.tasks.mechanism import prefix  # noqa: E402

Floats = npt.NDArray[np.float64]
HORIZONS = (10, 100, 300)
SECOND = 20
"""Control steps."""
OFF = 1e-3
"""rad (m for fingers): standard deviation of the perturbed state's robot joints."""


@dataclasses.dataclass(frozen=True)
class Lock:
    """What is asked of an episode.

    Attributes:
      held: joint (number in the layout) that the lock holds; -1 without. at, width: its place.
      goal, beyond: joint of the task's criterion and where it must come.
    """

    held: int
    at: float
    width: float
    goal: int
    beyond: float


def main() -> None:
    """Rolls out and prints."""
    options = _parser().parse_args()
    result: dict[str, Any] = {}
    for path in options.data:
        pack = pack_file(path)
        locks = read_locks(path, pack.layout)
        paths: dict[str, tuple[Floats, Floats]] = {}
        models = {
            str(folder): load_for(folder, pack.layout).model.eval() for folder in options.checkpoint
        }
        models["constant_velocity"] = constant_velocity(pack, ModelConfig())
        for name, model in models.items():
            paths[name] = rolled(model, pack, options.burn)
        found = {name: figures(pack, locks, *path, options.burn) for name, path in paths.items()}
        if options.mujoco:
            few = pack.subset(torch.arange(min(options.mujoco, pack.episodes)))
            perturbed = resimulated(path, few)
            found["mujoco"] = figures(few, locks, *perturbed, 0)
        result[str(path)] = {"episodes": pack.episodes, "burn": options.burn, **found}
        print(json.dumps({str(path): result[str(path)]}), flush=True)
    if options.json:
        options.json.write_text(json.dumps(result, indent=1))


def rolled(model: Dynamics, pack: Pack, burn: int) -> tuple[Floats, Floats]:
    """Joints [T, E, J] and the hand's place [T, E, 3] after each step that follows the burn-in."""
    windows = Windows(pack, int(pack.length.min()), model.config)
    first = torch.cat([torch.zeros_like(pack.start[:1]), windows.ends[:-1]])
    batch = windows.batch(*windows.locate(first))
    found = open_loop(model, batch, burn)
    return found.q.double().numpy(), found.hand_pos.double().numpy()


def resimulated(path: Path, pack: Pack) -> tuple[Floats, Floats]:
    """C MuJoCo from perturbed states, as `rolled`."""
    rng, layout = np.random.default_rng(0), pack.layout
    joints, places = [], []
    with EpisodeFile(path) as file:
        task = tasks.make(file.task, **file.config)
        for index in range(pack.episodes):
            known = file.attributes(index)
            scene = task.scene(known["subtask"], known["seed"])
            data = file.episode(index, ("qpos", "qvel", "act", "ctrl"))
            first = [data[name][:1].copy() for name in ("qpos", "qvel", "act")]
            own = [layout.joint_q[j] for j in layout.robot_joints]
            first[0][0, own] += OFF * rng.standard_normal(len(own))
            backend = make_backend("mujoco", scene)
            repeat = round(file.control_timestep / float(scene.model.opt.timestep))
            run = backend.rollout(State(np.zeros(1), *first), data["ctrl"][None], nstep=repeat)
            qpos = np.asarray(run.qpos)[0]
            q = np.zeros((len(qpos), len(layout.joints)))
            q[:, : qpos.shape[1]] = qpos  # parts that an instance lacks come last
            joints.append(q)
            hand = hands(layout, torch.as_tensor(q), torch.zeros(len(q), layout.nv).double())
            places.append(hand[:, :3].numpy())
    steps = min(map(len, joints))
    return (
        np.stack([q[:steps] for q in joints], axis=1),
        np.stack([place[:steps] for place in places], axis=1),
    )


def figures(pack: Pack, locks: list[Lock], q: Floats, hand: Floats, burn: int) -> dict[str, Any]:
    """Everything that is printed of one model's joints [T, E, J] and hands [T, E, 3]."""
    count, layout = len(q), pack.layout
    rows = pack.start[None] + burn + 1 + torch.arange(count)[:, None]
    true_q = pack.qpos[rows][..., list(layout.joint_q)].double().numpy()
    true_hand = pack.hand[rows][..., :3].double().numpy()
    hinge = pack.parts[..., layout.part_columns.index("type_hinge")].numpy()
    off = np.abs(q - true_q)[..., list(layout.parts)] * pack.part_mask.numpy()
    away = np.linalg.norm(hand - true_hand, axis=-1) * 1e3
    result: dict[str, Any] = {}
    for horizon in HORIZONS:
        at = min(horizon, count) - 1
        result[str(at + 1)] = {
            "part_angle": _row(np.rad2deg(off[at] * hinge).max(axis=1)),
            "part_travel": _row((off[at] * (1 - hinge)).max(axis=1) * 1e3),
            "hand_position": _row(away[at]),
        }
    return result | _locks(locks[: q.shape[1]], q, true_q)


def _locks(locks: list[Lock], q: Floats, true_q: Floats) -> dict[str, Any]:
    right, opens, success, reached = [], [], [], []
    for e, lock in enumerate(locks):
        beyond = [(np.sign(lock.beyond) * (x[:, e, lock.goal] - lock.beyond) > 0).any()
                  for x in (q, true_q)]  # fmt: skip
        success.append(beyond[0] == beyond[1])
        reached.append(beyond[1])
        if lock.held < 0:
            continue
        found, truth = (_leaves(x[:, e, lock.held], lock) for x in (q, true_q))
        opens.append(truth < len(q))
        # that it never leaves is a time beyond the last
        right.append((found < len(q)) == opens[-1] and abs(found - truth) <= SECOND)
    result: dict[str, Any] = {"success": {"as_in_truth": _mean(success), "truth": _mean(reached)}}
    if opens:
        told, there = np.array(right), np.array(opens)
        result["lock"] = {
            "episodes": len(opens),
            "right": _mean(told),
            "right_where_it_opens": _mean(told[there]),
            "right_where_it_stays": _mean(told[~there]),
            "never_opens": _mean(~there),
        }
    return result


def _leaves(q: Floats, lock: Lock) -> int:
    """The first step at which a joint has left where it is held; the number of steps if never."""
    away = np.abs(q - lock.at) > lock.width
    return int(away.argmax()) if away.any() else len(q)


def read_locks(path: Path, layout: Layout) -> list[Lock]:
    """What locks the mechanism of each episode of a file, and what its task wants."""
    found = []
    with EpisodeFile(path) as file:
        task: Any = tasks.make(file.task, **file.config)
        if not hasattr(task, "instance"):
            raise InputError(f"{path}: episodes of {file.task}; expected task:mechanism:*")
        for index in range(len(file)):
            known = file.attributes(index)
            made = task.instance(known["subtask"], known["seed"])
            start = prefix(made)
            goal, beyond = made.goal
            locks = [e for e in made.effects if e.effect == "latch" and "other" in e.options]
            held, place, width = -1, 0.0, 0.0
            if locks:
                held = layout.joints.index(start + locks[-1].target)
                place, width = (locks[-1].values[name] for name in ("position", "width"))
            found.append(Lock(held, place, width, layout.joints.index(start + goal), beyond))
    return found


def _row(values: Any) -> dict[str, float]:
    return {
        "median": float(np.median(values)),
        "p90": float(np.quantile(values, 0.9)),
        "worst": float(np.max(values)),
    }


def _mean(values: Any) -> float | None:
    return float(np.mean(values)) if len(values) else None


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, nargs="+", required=True)
    parser.add_argument("--checkpoint", type=Path, nargs="*", default=[])
    parser.add_argument("--burn", type=int, default=0)
    parser.add_argument("--mujoco", type=int, default=0)
    parser.add_argument("--json", type=Path)
    return parser


if __name__ == "__main__":
    main()
