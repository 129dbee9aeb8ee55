"""What closing the loop is worth: a policy for a machine that its scene does not describe.

A cart and pole whose rail has Coulomb friction and whose motor is late, which
mjcf_assets/cart_pole does not declare. The pole is to be balanced. Policies are trained by PPO on
four scenes and tried on the machine:

declared: the scene as it is. randomised: the scene with friction, masses, gain and delay drawn for
each episode. diagnosed: the scene with what `orbisim.diagnose` finds in four recordings of the
machine. true: the machine's own scene, which nobody has.

Everything is drawn anew with each seed: recordings, weights, episodes.
"""

from __future__ import annotations

import argparse
import concurrent.futures
import json
import multiprocessing
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch
from orbisim_policies.checkpoint import load_policy
from orbisim_policies.evaluate import in_mujoco, starts_of, summary
from orbisim_policies.network import NetworkConfig
from orbisim_policies.problem import Floats, Moment, Problem, Starts
from orbisim_policies.run import Run
from torch import Tensor

import orbisim
from orbisim.diagnosis.settings import Settings
from orbisim.effects import EffectInstance
from orbisim.effects.carry import add_effects
from orbisim.files.writing import write_json
from orbisim.scene import Scene, load_scene
from orbisim.testing import inject_effect

SCENE = Path(__file__).parents[1] / "mjcf_assets" / "cart_pole" / "scene.xml"
CONDITIONS = ("declared", "randomised", "diagnosed", "true")
MOST = 8.0
"""N, of the motor."""
_HISTORY = 8
"""Last actions that a policy sees."""


class Balance(Problem):
    """The pole is to stay up, the cart near the middle.

    Args:
      scene: of a cart and pole.
      randomise: draw friction (0 to 4 N), masses and gain (up to 30 % off) and a delay (0 to 7
        control steps) for each episode.
    """

    name, parts, sparse = "cart_pole-balance", ("reward",), False
    timestep, steps, actions = 0.02, 250, 1
    observations = 5 + _HISTORY

    def __init__(self, scene: Scene, randomise: bool = False) -> None:
        self.scene, self._randomise = scene, randomise
        self._data = mujoco.MjData(scene.model)

    def draw(self, seeds: Sequence[int]) -> Starts:
        """The pole up to 0.15 rad off, friction and the like by seed."""
        rows = [np.random.default_rng([seed, 7]) for seed in seeds]
        qpos = np.array([[r.uniform(-0.1, 0.1), np.pi + r.uniform(-0.15, 0.15)] for r in rows])
        qvel = np.array([r.uniform(-0.1, 0.1, 2) for r in rows])
        command, params = np.zeros((len(rows), _HISTORY + 1)), np.zeros((len(rows), 0))
        if self._randomise:
            params = np.array([[r.uniform(0, 4), *r.uniform(0.7, 1.3, 3)] for r in rows])
            command[:, -1] = [r.integers(0, _HISTORY) for r in rows]
        return Starts(qpos, qvel, np.zeros((len(rows), 1)), command, params)

    def write(self, model: mujoco.MjModel, params: Floats) -> None:
        """Friction of the rail, masses of cart and pole, gain of the motor."""
        if not len(params):
            return
        declared = self.scene.model
        model.dof_frictionloss[0] = params[0]
        for body, factor in ((1, params[1]), (2, params[2])):
            model.body_mass[body] = declared.body_mass[body] * factor
            model.body_inertia[body] = declared.body_inertia[body] * factor
        model.actuator_gainprm[0, 0] = declared.actuator_gainprm[0, 0] * params[3]
        mujoco.mj_setConst(model, self._data)

    def begin(self, qpos: Tensor, qvel: Tensor) -> Tensor:
        """[N, 1]: the mean reward."""
        return qpos.new_zeros((len(qpos), 2))

    def count(self, score: Tensor, qpos: Tensor, qvel: Tensor, control: Tensor) -> Tensor:
        """Up, near the middle; and the worst angle of the last second."""
        up = (1 - qpos[:, 1].cos()) / 2
        middle = (-(qpos[:, 0] / 0.7).square()).exp()
        reward = up.square() * (1 + middle) / 2 - 0.02 * (control[:, 0] / MOST).square()
        off = torch.maximum(score[:, 1] * 0.98, 1 - up)
        return torch.stack([score[:, 0] + reward / self.steps, off], 1)

    def value(self, score: Tensor, qpos: Tensor) -> Tensor:
        """The mean reward [N, 1]."""
        return score[:, :1]

    def observe(self, moment: Moment) -> Tensor:
        """Cart, pole, speeds and the last actions."""
        q, v = moment.qpos, moment.qvel
        angle = torch.stack([q[:, 1].cos(), 3 * q[:, 1].sin()], 1)
        speeds = (v / 2).clamp(-8, 8)
        return torch.cat([q[:, :1].clamp(-8, 8), angle, speeds, moment.command[:, :_HISTORY]], 1)

    def control(self, command: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """The motor's force; late by as many steps as the command says."""
        action = action.clamp(-1, 1)
        known = torch.cat([action, command[:, :_HISTORY]], 1)
        late = torch.nan_to_num(command[:, -1:]).long()
        after = torch.cat([known[:, :_HISTORY], command[:, -1:]], 1)
        return MOST * known.gather(1, late), after

    def success(self, start: Floats, qpos: Floats, value: Floats) -> Mapping[str, Any]:
        """Whether the pole is within 0.2 rad of upright and the cart within 1 m at the end."""
        angle = np.abs((qpos[:, 1] % (2 * np.pi)) - np.pi)
        return {"balanced": (angle < 0.2) & (np.abs(qpos[:, 0]) < 1.0)}


def machine(scene: Scene, friction: float, delay: float) -> tuple[Scene, list[EffectInstance]]:
    """The machine's scene, and what the declared one lacks."""
    effects = [
        EffectInstance("coulomb_friction", "cart", {"torque": friction}),
        EffectInstance("actuator_delay", "push", {"delay": delay}),
    ]
    return add_effects(scene, effects), effects


def train(condition: str, seed: int, options: argparse.Namespace) -> dict[str, Any]:
    """Trains one policy and tries it on the machine."""
    torch.set_num_threads(1)
    declared = load_scene(SCENE)
    real, effects = machine(declared, options.friction, options.delay)
    found: dict[str, Any] = {"condition": condition, "seed": seed}
    scene, began = declared, time.monotonic()
    if condition == "true":
        scene = real
    elif condition == "diagnosed":
        recordings = inject_effect(declared, effects, episodes=4, seed=seed)
        settings = Settings(seed=seed, patience=options.patience)
        diagnosis = orbisim.diagnose(declared, recordings, settings=settings, progress=False)
        scene = diagnosis.augmented_scene
        found["effects"] = [
            {
                "effect": e.effect,
                "target": e.target,
                "parameters": {name: p.value for name, p in e.parameters.items()},
            }
            for e in diagnosis.effects
        ]
        found["verdict"] = diagnosis.verdict
        found["diagnosis_s"] = round(time.monotonic() - began, 1)
    problem = Balance(scene, condition == "randomised")
    with tempfile.TemporaryDirectory() as folder:
        job = Run(Path(folder) / "p", steps=options.steps, seed=seed, check=0, nthread=1)
        # here, so that the tool says what it does where Stable-Baselines3 is missing
        from orbisim_policies.baselines import Baseline, train_baseline

        network = NetworkConfig((64, 64))
        config = Baseline("ppo", batch=32, window=128, rate=1e-3, network=network)
        train_baseline(problem, config, job)
        policy = load_policy(Path(folder) / "p", problem)
    trial = Balance(real)
    for name, place in (("machine", trial), ("own", problem)):
        starts = starts_of(place, options.episodes, seed)
        result = in_mujoco(place, policy, starts, nthread=1)
        found[name] = summary(place, starts, *result[:2])
    found["seconds"] = round(time.monotonic() - began, 1)
    return found


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """A line for each condition: medians over seeds, least and most."""
    lines = ["| trained on | balanced on the machine | reward | balanced where it was trained |"]
    lines.append("| --- | --- | --- | --- |")
    for condition in CONDITIONS:
        mine = [row for row in rows if row["condition"] == condition]
        if not mine:
            continue
        cells = [condition]
        for place, kind, name in (
            ("machine", "success", "balanced"),
            ("machine", "reward", "reward"),
            ("own", "success", "balanced"),
        ):
            key = "share" if kind == "success" else "mean"
            values = [row[place][kind][name][key] for row in mine]
            cells.append(f"{np.median(values):.2f} ({min(values):.2f} to {max(values):.2f})")
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("out/loop_pays.json"))
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--steps", type=int, default=128_000, help="of MuJoCo, for each policy")
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--friction", type=float, default=1.0, help="of the rail, N")
    parser.add_argument("--delay", type=float, default=0.08, help="of the motor, s")
    parser.add_argument("--patience", type=float, default=600.0, help="of a diagnosis, s")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--only", nargs="*", default=CONDITIONS, choices=CONDITIONS)
    options = parser.parse_args()
    jobs = [(c, seed) for seed in range(options.seeds) for c in options.only]
    rows: list[dict[str, Any]] = []
    failed = False
    context = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(options.jobs, context) as pool:
        futures = {pool.submit(train, c, seed, options): (c, seed) for c, seed in jobs}
        for future in concurrent.futures.as_completed(futures):
            if (error := future.exception()) is not None:
                print(f"{futures[future]}: {type(error).__name__}: {error}", flush=True)
                failed = True
                continue
            row = future.result()
            rows.append(row)
            share = row["machine"]["success"]["balanced"]["share"]
            print(
                f"{row['condition']:>11} seed {row['seed']}: {share:.2f}, {row['seconds']} s",
                flush=True,
            )
            settings = {**vars(options), "out": str(options.out)}
            write_json(options.out, {"options": settings, "rows": rows}, announce=False)
    print(table(rows))
    print(json.dumps({"rows": len(rows), "out": str(options.out)}))
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
