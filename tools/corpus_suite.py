"""Runs every task of dm_control's suite through both engines.

    python tools/corpus_suite.py --out out/corpus_suite [--backend mujoco] [--backend warp]

With `mujoco`: observations and rewards against dm_control's own over 1,000 random steps. With
`warp`: which tasks run, the largest difference of generalized positions from C MuJoCo over the
first 100 timesteps from the same state under the same controls, and in how many of 60 control
steps the check of `orbisim.agreement` would find it at fault (and how many of them in a row).
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from dm_control import suite as dm_suite

from orbisim import Backend, Scene, State, make_backend, suite
from orbisim.agreement import StepJudge
from orbisim.episodes import random_controls
from orbisim.errors import OrbiSimError
from orbisim.metrics import energies

STEPS = 1000
FIRST = 100
JUDGED = 60
CURVE = (1, 10, 20, 50, 100, 200, 500)


def main() -> int:
    """Writes JSON and Markdown tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/corpus_suite"))
    parser.add_argument("--backend", action="append", choices=["mujoco", "warp"])
    parser.add_argument("--only", default="", help="domains to run, comma-separated")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    only = set(filter(None, options.only.split(",")))
    for backend in options.backend or ["mujoco", "warp"]:
        run, table = RUNS[backend]
        rows = list(run(only))
        (options.out / f"{backend}.json").write_text(json.dumps(rows, indent=1))
        (options.out / f"{backend}.md").write_text(table(rows))
        print(table(rows))
    return 0


def equal_to_dm_control(only: set[str]) -> Iterator[dict[str, Any]]:
    """One row for each task: steps that are equal bit for bit."""
    for domain, task in suite.ALL_TASKS:
        if only and domain not in only:
            continue
        row: dict[str, Any] = {"task": f"{domain}-{task}", "equal_steps": 0, "note": ""}
        try:
            theirs = dm_suite.load(domain, task, task_kwargs={"random": 1})
            ours = suite.load(domain, task, task_kwargs={"random": 1})
            row["equal_steps"] = equal_steps(ours, theirs)
        except (RuntimeError, OrbiSimError) as error:
            row["note"] = " ".join(str(error).split())[:200]
        print(row, file=sys.stderr, flush=True)
        yield row


def equal_steps(ours: Any, theirs: Any) -> int:
    """Number of leading steps with the same rewards and observations."""
    ours.reset(), theirs.reset()
    spec = theirs.action_spec()
    low, high = np.maximum(spec.minimum, -1), np.minimum(spec.maximum, 1)
    rng = np.random.default_rng(0)
    for t in range(STEPS):
        action = rng.uniform(low, high, spec.shape)
        a, b = ours.step(action), theirs.step(action)
        same = a.reward == b.reward and all(
            np.array_equal(a.observation[k], b.observation[k]) for k in b.observation
        )
        if not same:
            return t
    return STEPS


def agreement_of_warp(only: set[str]) -> Iterator[dict[str, Any]]:
    """One row for each task: does it run with warp, and how far from C MuJoCo."""
    for domain, task in suite.ALL_TASKS:
        if only and domain not in only:
            continue
        row: dict[str, Any] = {"task": f"{domain}-{task}", "runs": False, "note": ""}
        started = time.monotonic()
        try:
            row |= one_task(domain, task)
        except Exception as error:  # a row of the table, whatever it is
            row["note"] = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
        row["seconds"] = round(time.monotonic() - started, 1)
        print(row, file=sys.stderr, flush=True)
        yield row


def one_task(domain: str, task: str) -> dict[str, Any]:
    """Divergence from C MuJoCo, contacts, and whether the task itself steps."""
    environment = suite.load(domain, task, task_kwargs={"random": 1})
    environment.reset()
    physics = environment.physics
    scene = Scene.from_model(physics.model.ptr, source=f"suite:{domain}-{task}")
    start: State = physics.snapshot()
    controls = random_controls(scene.model, 1, max(CURVE), scene.model.opt.timestep, 0)
    engines = [make_backend(name, scene) for name in ("mujoco", "warp")]
    a, b = (engine.rollout(start, controls, sensors=False) for engine in engines)
    difference = np.abs(a.qpos[0] - b.qpos[0]).max(axis=1)
    contacts = energies(scene.model, a.qpos[:, :FIRST], a.qvel[:, :FIRST]).contacts
    faulty = faulty_steps(scene, engines[1], start, controls[0], environment.control_timestep())
    physics.use_backend("warp")
    spec = environment.action_spec()
    for _ in range(5):
        step = environment.step(np.zeros(spec.shape))
    observed = np.concatenate([np.ravel(v) for v in step.observation.values()])
    return {
        "runs": True,
        "contacts": int(contacts.max()),
        "first_100": float(difference[:FIRST].max()),
        "curve": {str(t): float(difference[t - 1]) for t in CURVE},
        "faulty": sum(faulty),
        "faulty_in_a_row": max(
            (len(list(run)) for fault, run in groupby(faulty) if fault), default=0
        ),
        "task_finite": bool(np.isfinite(observed).all() and np.isfinite(step.reward)),
    }


def faulty_steps(
    scene: Scene, engine: Backend, state: State, controls: Any, control_step: float
) -> list[bool]:
    """Which control steps of an engine are at fault, each from the engine's own state."""
    judge, nstep = StepJudge(scene), max(1, round(control_step / engine.timestep))
    faulty = []
    for control in controls[: JUDGED * nstep : nstep]:
        after = engine.step(state, control[None], nstep)
        faulty.append(bool(judge.faults(state, control[None], nstep, after)))
        state = after
    return faulty


def mujoco_table(rows: list[dict[str, Any]]) -> str:
    """Summary in Markdown."""
    equal = sum(row["equal_steps"] == STEPS for row in rows)
    lines = [
        f"{equal} of {len(rows)} tasks: {STEPS} random steps equal dm_control's bit for bit.",
        "",
    ]
    lines += [
        f"- {row['task']}: {row['equal_steps']} equal steps {row['note']}"
        for row in rows
        if row["equal_steps"] < STEPS
    ]
    return "\n".join(lines) + "\n"


def warp_table(rows: list[dict[str, Any]]) -> str:
    """The table of docs/suite.md."""
    head = " | ".join(f"after {t}" for t in CURVE)
    lines = [
        f"| task | runs | contacts in the first {FIRST} steps | {head} | note |",
        "| --- | --- | --- |" + " --- |" * (len(CURVE) + 1),
    ]
    for row in rows:
        if not row["runs"]:
            lines.append(f"| {row['task']} | no |  |" + "  |" * len(CURVE) + f" {row['note']} |")
            continue
        curve = " | ".join(f"{row['curve'][str(t)]:.1e}" for t in CURVE)
        note = "" if row["task_finite"] else "observation or reward not finite"
        contacts = "none" if row["contacts"] == 0 else f"up to {row['contacts']}"
        lines.append(f"| {row['task']} | yes | {contacts} | {curve} | {note} |")
    faulty, longest = (max(r.get(k, 0) for r in rows) for k in ("faulty", "faulty_in_a_row"))
    summary = (
        f"At fault in at most {faulty} of {JUDGED} control steps of a task, {longest} in a row."
    )
    return "\n".join([*lines, "", summary]) + "\n"


RUNS = {
    "mujoco": (equal_to_dm_control, mujoco_table),
    "warp": (agreement_of_warp, warp_table),
}

if __name__ == "__main__":
    sys.exit(main())
