"""Behaviour cloning of `task:stack` from adapted demonstrations that succeed, judged in C MuJoCo.

    orbisim collect task:stack --subtask adapted --out stack_train.h5      # 2,200 episodes
    python tools/clone_stack.py train --data stack_train.h5 --out clone --noise 0
    python tools/clone_stack.py eval --policy clone --episodes 200 --workers 4 --json clone.json

The policy sees where the tool is told to be, the fingers, the cubes' poses, also as seen from the
tool and from each other, and since when its grip is as it is; it tells ten actions at once. With
`--noise S` each position of a cube is measured with a normal error of S m, and each angle with one
of 2 S / 0.01 degrees, drawn anew at every look, in training or, given to `eval`, when it acts.
`eval` plays episodes of 300 control steps that no demonstration has seen, in distribution and out
of it (OUTSIDE).
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
import torch
from safetensors.torch import load_file, save_file
from torch import nn

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "backends")]

from orbisim_policies.evaluate import wilson  # noqa: E402  (needs the path above)

from orbisim.tasks import EpisodeFile  # noqa: E402
from orbisim.tasks.arm import PANDA, ArmController  # noqa: E402
from orbisim.tasks.sampling import episode_seed, stream  # noqa: E402
from orbisim.tasks.stack import Stack  # noqa: E402
from orbisim.tasks.staging import opening_pose  # noqa: E402

Floats = npt.NDArray[np.float64]
STEPS = 300
"""Of an episode that a policy plays; demonstrations have 250."""
WIDTH = 512
CHUNK = 10
"""Actions that are told at once and carried out before the next look (Zhao et al. 2023): a clone of
single actions stays where demonstrations pause, before and after the fingers close."""
CHANGES = 4
"""Of the grip in an episode that succeeds: two cubes are taken and let go."""
LARGEST = np.array([PANDA.reach] * 3 + [PANDA.turn])
"""Of a control step: m, m, m, rad."""
BATCH, RATE = 512, 1e-3
TURN = np.deg2rad(2.0) / 0.01
"""rad of noise for each metre of it: 2 degrees with 1 cm, as `tools/eval_dynamics.py` has it."""
OUTSIDE: dict[str, dict[str, Any]] = {
    "in distribution": {},
    "smaller cubes (40 mm)": {"cube_half": (0.02, 0.02)},
    "larger cubes (50 mm)": {"cube_half": (0.025, 0.025)},
    "a wider area": {"x": (0.33, 0.68), "y": (-0.3, 0.3)},
    "slippery (0.05 to 0.15)": {"cube_friction": (0.05, 0.15), "table_friction": (0.05, 0.15)},
}
"""Changes to `StackConfig`. In distribution cubes have 45 mm and friction 0.2 to 0.6, and lie
within x 0.4 to 0.6 and y -0.22 to 0.22 m."""


@dataclasses.dataclass(frozen=True)
class Seen:
    """What is measured, over N states.

    Attributes:
      command: [N, 3] where the tool is told to be, m; how far it is behind would tell how fast it
        goes, and a clone that sees its own speed goes on as it went.
      told: [N] the turn about the vertical that it is told to have, rad; it points down.
      fingers: [N, 2], m. grip: [N] the command before, -1 open to 1 closed.
      changes, age: [N] how often the grip's command has changed, and for how many steps it has been
        as it is: the policy's only memory, without which it stays where demonstrations pass twice.
      cubes: [N, 3, 3], m. yaw: [N, 3] of an axis of each that lies flat, rad.
    """

    command: Floats
    told: Floats
    fingers: Floats
    grip: Floats
    changes: Floats
    age: Floats
    cubes: Floats
    yaw: Floats

    def blurred(self, noise: float, rng: np.random.Generator) -> Seen:
        """With errors of measurement; commands are known."""
        if not noise:
            return self
        n = rng.standard_normal
        return dataclasses.replace(
            self,
            cubes=self.cubes + noise * n(self.cubes.shape),
            yaw=self.yaw + TURN * noise * n(self.yaw.shape),
        )

    def features(self) -> npt.NDArray[np.float32]:
        """[N, F], of order one. Cubes look the same after a quarter turn."""
        away = self.cubes - self.command[:, None]
        between = np.stack(
            [self.cubes[:, 1] - self.cubes[:, 0], self.cubes[:, 2] - self.cubes[:, 1]], axis=1
        )
        count = len(self.command)
        rows = [
            self.own(),
            10 * away.reshape(count, 9),
            np.tanh(100 * away).reshape(count, 9),
            10 * between.reshape(count, 6),
            np.tanh(100 * between).reshape(count, 6),
            *(wave(4 * (self.yaw - self.told[:, None])) for wave in (np.sin, np.cos)),
            *(wave(4 * (self.yaw[:, 1:] - self.yaw[:, :1])) for wave in (np.sin, np.cos)),
        ]
        return np.concatenate(rows, axis=1).astype(np.float32)

    def own(self) -> npt.NDArray[np.float32]:
        """[N, 14] what the robot knows without seeing any cube."""
        rows: list[Any] = [
            10 * (self.command - [0.5, 0.0, 0.15]),
            np.sin(self.told)[:, None],
            np.cos(self.told)[:, None],
            50 * self.fingers,
            self.grip[:, None],
            *((self.changes == number)[:, None] for number in range(CHANGES)),
            self.age[:, None] / 30,
            np.exp(-self.age / 5)[:, None],
        ]
        return np.concatenate(rows, axis=1).astype(np.float32)


def flat_yaw(quat: Floats) -> Floats:
    """[...] of quaternions [..., 4]: turn of an axis that lies flat, rad."""
    w, x, y, z = np.moveaxis(quat, -1, 0)
    rows = np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
        ],
        -2,
    )
    axis = np.abs(rows[..., 2, :]).argmin(-1)[..., None]
    along = [np.take_along_axis(rows[..., k, :], axis, -1)[..., 0] for k in (0, 1)]
    return np.asarray(np.arctan2(along[1], along[0]))


class Policy(nn.Module):
    """Features [N, F] to the next actions [N, CHUNK, 5]: translation, turn about the vertical, both
    in units of the largest step, and the grip's logit."""

    def __init__(self, features: int) -> None:
        super().__init__()
        self.net = nn.Sequential(
            nn.Linear(features, WIDTH), nn.ELU(),
            nn.Linear(WIDTH, WIDTH), nn.ELU(),
            nn.Linear(WIDTH, 5 * CHUNK),
        )  # fmt: skip

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """See the class."""
        found: torch.Tensor = self.net(features)
        return found.unflatten(-1, (CHUNK, 5))


# -- demonstrations ----------------------------------------------------------------------------


def demonstrations(path: Path, most: int | None) -> tuple[Seen, Floats, int]:
    """What was seen at each step, and the actions that followed [N, CHUNK, 7], of episodes that
    succeed."""
    task, seen, actions = Stack(), [], []
    with EpisodeFile(path) as file:
        good = [i for i in range(len(file)) if file.attributes(i)["success"]][:most]
        names = ("qpos", "action", "objects/pos", "objects/quat")
        arm = ArmController(task.arm)
        for index in good:
            data = file.episode(index, names)
            action, steps = data["action"], len(data["action"])
            arm.reset(data["qpos"][0, : PANDA.joints])
            poses = []
            for row in action:
                poses.append((arm.pos, arm.rot))
                arm.step(row)
            grip = np.concatenate([[-1.0], action[:-1, 6]])
            changed = np.concatenate([[0.0], np.diff(grip) != 0])
            last = np.maximum.accumulate(np.arange(steps) * changed)
            seen.append(
                Seen(
                    command=np.array([pos for pos, _ in poses]),
                    told=np.array([yaw_of(rot) for _, rot in poses]),
                    fingers=data["qpos"][:steps, PANDA.joints : PANDA.joints + 2],
                    grip=grip,
                    changes=changed.cumsum(),
                    age=(np.arange(steps) - last).astype(float),
                    cubes=data["objects/pos"][:steps],
                    yaw=flat_yaw(data["objects/quat"][:steps]),
                )
            )
            still = np.concatenate([np.zeros(6), action[-1, 6:]])
            after = np.concatenate([action, np.broadcast_to(still, (CHUNK - 1, 7))])
            windows = np.lib.stride_tricks.sliding_window_view(after, CHUNK, axis=0)
            actions.append(windows.transpose(0, 2, 1))
    return joined(seen), np.concatenate(actions), len(good)


def yaw_of(rot: Floats) -> float:
    """Turn of a tool [3, 3] that points down, rad."""
    return float(np.arctan2(rot[1, 0], rot[0, 0]))


def joined(seen: list[Seen]) -> Seen:
    """One after another."""
    names = [field.name for field in dataclasses.fields(Seen)]
    return Seen(**{name: np.concatenate([getattr(one, name) for one in seen]) for name in names})


def train(options: Any) -> dict[str, Any]:
    """Trains and writes a policy."""
    torch.manual_seed(options.seed)
    rng = np.random.default_rng(options.seed)
    seen, action, episodes = demonstrations(options.data, options.demonstrations)
    wanted = action[..., [0, 1, 2, 5]] / LARGEST
    target = torch.as_tensor(np.concatenate([wanted, action[..., 6:] > 0], axis=-1)).float()
    device = torch.device(options.device)
    features = torch.as_tensor(seen.blurred(options.noise, rng).features())
    mean, spread = features.mean(0), features.std(0).clamp_min(1e-3)
    policy = Policy(features.shape[1]).to(device)
    optimizer = torch.optim.AdamW(policy.parameters(), lr=RATE, weight_decay=1e-4)
    target, x = target.to(device), ((features - mean) / spread).to(device)
    every = max(1, options.steps // 20)
    began = time.monotonic()
    for step in range(options.steps):
        if options.noise and step and step % every == 0:  # other errors of measurement
            fresh = torch.as_tensor(seen.blurred(options.noise, rng).features())
            x = ((fresh - mean) / spread).to(device)
        rate = RATE * 0.5 * (1 + np.cos(np.pi * step / options.steps)) + 1e-6
        for group in optimizer.param_groups:
            group["lr"] = rate
        pick = torch.randint(len(x), (BATCH,), device=device)
        told, truth = policy(x[pick]), target[pick]
        motion = nn.functional.smooth_l1_loss(told[..., :4], truth[..., :4], beta=0.05)
        grip = nn.functional.binary_cross_entropy_with_logits(told[..., 4], truth[..., 4])
        optimizer.zero_grad()
        (motion + 0.1 * grip).backward()
        optimizer.step()
        if (step + 1) % every == 0:
            line = {
                "step": step + 1,
                "motion": float(motion.detach()),
                "grip": float(grip.detach()),
            }
            print(json.dumps({**line, "seconds": round(time.monotonic() - began, 1)}), flush=True)
    options.out.mkdir(parents=True, exist_ok=True)
    weights = {name: w.detach().cpu().contiguous() for name, w in policy.state_dict().items()}
    save_file({**weights, "mean": mean, "spread": spread}, options.out / "policy.safetensors")
    notes = {"demonstrations": episodes, "pairs": len(x), "noise": options.noise,
             "steps": options.steps, "seed": options.seed}  # fmt: skip
    (options.out / "manifest.json").write_text(json.dumps(notes, indent=1))
    return notes


# -- in MuJoCo ---------------------------------------------------------------------------------


class Episode:
    """An episode that a policy plays."""

    def __init__(self, task: Stack, seed: int) -> None:
        self.task, self.setting = task, task.setting("scripted", seed)
        script = task.script("scripted", self.setting, stream(seed, 1))
        self.arm = ArmController(task.arm)
        qpos, ctrl = opening_pose(script, self.arm)
        self.model = task.scene("scripted", seed).model
        self.data = mujoco.MjData(self.model)
        self.data.qpos[:], self.data.ctrl[:] = qpos, ctrl
        mujoco.mj_forward(self.model, self.data)
        self.grip, self.changes, self.age = -1.0, 0, 0
        names = [f"cube{i + 1}" for i in range(len(self.setting.cubes))]
        self.addresses = [int(self.model.joint(name).qposadr[0]) for name in names]
        self.substeps = round(task.control_timestep / self.model.opt.timestep)
        self.path = [self.cubes()]

    def cubes(self) -> Floats:
        """[3, 3], m."""
        return np.stack([self.data.qpos[a : a + 3] for a in self.addresses])

    def seen(self) -> Seen:
        """The present state, N = 1."""
        quat = np.stack([self.data.qpos[a + 3 : a + 7] for a in self.addresses])
        return Seen(
            command=self.arm.pos[None].copy(),
            told=np.array([yaw_of(self.arm.rot)]),
            fingers=self.data.qpos[None, PANDA.joints : PANDA.joints + 2].copy(),
            grip=np.array([self.grip]),
            changes=np.array([self.changes], float),
            age=np.array([self.age], float),
            cubes=self.cubes()[None],
            yaw=flat_yaw(quat)[None],
        )

    def act(self, action: Floats) -> None:
        """One control step."""
        changed = self.grip != float(action[6])
        self.grip, self.changes = float(action[6]), self.changes + changed
        self.age = 0 if changed else self.age + 1
        self.data.ctrl[:] = self.arm.step(action)
        mujoco.mj_step(self.model, self.data, self.substeps)
        self.path.append(self.cubes())

    @property
    def stacked(self) -> int:
        """How many cubes rest on the one below: 0, 1 or 2; with `success`, for good."""
        half = self.setting.cubes[0].half
        end, count = self.path[-1], 0
        for below, above in ((0, 1), (1, 2)):
            gap = end[above] - end[below]
            if abs(gap[2] - 2 * half) > 0.005 or np.linalg.norm(gap[:2]) > half:
                break
            count += 1
        return count


def play(folder: Path, changes: dict[str, Any], seeds: list[int], noise: float) -> list[Any]:
    """(success, cubes stacked) of each episode."""
    torch.set_num_threads(1)
    tensors = load_file(folder / "policy.safetensors")
    mean, spread = tensors.pop("mean"), tensors.pop("spread")
    policy = Policy(len(mean))
    policy.load_state_dict(tensors)
    task, found = Stack(**changes), []
    worlds = [Episode(task, seed) for seed in seeds]
    rng = np.random.default_rng(seeds[0] % 2**32)
    for _ in range(0, STEPS, CHUNK):
        seen = joined([world.seen() for world in worlds]).blurred(noise, rng)
        with torch.no_grad():
            told = policy((torch.as_tensor(seen.features()) - mean) / spread).double().numpy()
        actions = np.zeros((len(worlds), CHUNK, 7))
        actions[..., [0, 1, 2, 5]] = told[..., :4].clip(-1, 1) * LARGEST
        actions[..., 6] = np.where(told[..., 4] > 0, 1.0, -1.0)
        for world, rows in zip(worlds, actions, strict=True):
            for action in rows:
                world.act(action)
    for world in worlds:
        good = task.success("scripted", world.setting, np.array(world.path))
        found.append((bool(good), world.stacked))
    return found


def evaluate(options: Any) -> dict[str, Any]:
    """Shares of success in and out of distribution."""
    result: dict[str, Any] = {"policy": json.loads((options.policy / "manifest.json").read_text())}
    result |= {"noise": options.noise, "episodes": options.episodes}
    for name, changes in OUTSIDE.items():
        if options.only and name not in options.only:
            continue
        numbers = range(options.episodes)
        seeds = [episode_seed(options.seed, "stack", "clones", i) for i in numbers]
        parts = [seeds[i : i + options.at_once] for i in range(0, len(seeds), options.at_once)]
        jobs = [(options.policy, changes, part, options.noise) for part in parts]
        if options.workers > 1:
            with ProcessPoolExecutor(options.workers) as pool:
                played = list(pool.map(play, *zip(*jobs, strict=True)))
        else:
            played = [play(*job) for job in jobs]
        each = [one for part in played for one in part]
        wins = sum(good for good, _ in each)
        result[name] = {
            "success": wins / len(each),
            "ci95": wilson(wins, len(each)),
            "first cube stacked": float(np.mean([count > 0 for _, count in each])),
        }
        print(json.dumps({name: result[name]}), flush=True)
        if options.json:
            options.json.write_text(json.dumps(result, indent=1))
    return result


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="what", required=True)
    training = commands.add_parser("train")
    training.add_argument("--data", type=Path, required=True)
    training.add_argument("--out", type=Path, required=True)
    training.add_argument("--demonstrations", type=int, help="at most; all that succeed if absent")
    training.add_argument("--steps", type=int, default=20_000)
    training.add_argument("--device", default="cpu")
    playing = commands.add_parser("eval")
    playing.add_argument("--policy", type=Path, required=True)
    playing.add_argument("--episodes", type=int, default=200)
    playing.add_argument("--only", nargs="*", default=[])
    playing.add_argument("--workers", type=int, default=1)
    playing.add_argument("--at-once", type=int, default=25, help="episodes side by side")
    playing.add_argument("--json", type=Path)
    for one in (training, playing):
        one.add_argument("--noise", type=float, default=0.0, help="m")
        one.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if options.what == "train":
        print(json.dumps(train(options)))
    else:
        evaluate(options)


if __name__ == "__main__":
    main()
