"""Benchmarks as ratios within one run; `make bench`.

    python tools/bench.py [--only physics,rollout,import,help] [--json FILE]

Each figure is the median of alternating runs of OrbiSim and what it is measured against. What runs
on one thread is measured in processor time, so that other work on the machine counts less.
"""

from __future__ import annotations

import argparse
import functools
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

REPEATS = 7


def main() -> int:
    """Runs the chosen benchmarks and prints a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default=",".join(BENCHMARKS))
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows = [row for name in options.only.split(",") for row in BENCHMARKS[name]()]
    print("| what | OrbiSim | against | ratio | goal | reached |")
    print("| --- | --- | --- | --- | --- | --- |")
    for row in rows:
        print("| {what} | {ours} | {theirs} | {ratio:.3f} | {goal} | {reached} |".format(**row))
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))
    return 0


def paired(
    ours: Callable[[], float], theirs: Callable[[], float], repeats: int = REPEATS
) -> tuple[float, float, float]:
    """Medians of alternating measurements, and the median of their ratios."""
    ours(), theirs()
    pairs = [(ours(), theirs()) for _ in range(repeats)]
    ratio = statistics.median(a / b for a, b in pairs)
    return statistics.median(a for a, _ in pairs), statistics.median(b for _, b in pairs), ratio


def row(
    what: str, values: tuple[float, float, float], unit: str, goal: str, ok: bool
) -> dict[str, Any]:
    """One line of the table."""
    ours, theirs, ratio = values
    return {
        "what": what,
        "ours": f"{ours:.4g} {unit}",
        "theirs": f"{theirs:.4g} {unit}",
        "ratio": ratio,
        "goal": goal,
        "reached": "yes" if ok else "no",
    }


def physics() -> list[dict[str, Any]]:
    """Overhead of `Physics.step` over dm_control's, in processor time of one thread."""
    import numpy as np
    from dm_control import suite as dm_suite

    from orbisim import suite

    rows = []
    for domain, task in (("cartpole", "swingup"), ("humanoid", "walk")):
        plain = dm_suite.load(domain, task, task_kwargs={"random": 0}).physics
        ours = suite.load(domain, task, task_kwargs={"random": 0}).physics
        start = plain.get_state()
        count = 4_000 if domain == "cartpole" else 1_000

        def timed(physics: Any, start: Any = start, count: int = count) -> float:
            with physics.reset_context():
                physics.set_state(start)
            physics.set_control(np.zeros(physics.model.nu))
            step = physics.step
            began = time.process_time()
            for _ in range(count):
                step()
            return (time.process_time() - began) / count * 1e6

        values = paired(lambda p=ours: timed(p), lambda p=plain: timed(p), repeats=25)
        rows.append(
            row(
                f"`Physics.step`, {domain}, against dm_control's",
                values, "µs", "at most 1.05", values[2] <= 1.05,
            )
        )  # fmt: skip
    return rows


def rollout() -> list[dict[str, Any]]:
    """Throughput of a batched rollout against the faster of MuJoCo's own two."""
    import numpy as np

    from orbisim import make_backend
    from orbisim.suite import load_scene

    threads = os.cpu_count() or 1
    rows = []
    for name, nworld, steps in (("cartpole-swingup", 256, 500), ("humanoid-walk", 64, 100)):
        scene = load_scene(name)
        controls = np.random.default_rng(0).uniform(-1, 1, (nworld, steps, scene.model.nu))
        backend = make_backend("mujoco", scene, nworld=nworld)
        ours = _per_second(functools.partial(backend.rollout, backend.reset(), controls), controls)
        rivals = (
            _mujoco_rollout(scene.model, controls, threads),
            _mujoco_batch(scene.model, controls, threads),
        )
        values = min((paired(ours, theirs) for theirs in rivals), key=lambda v: v[2])
        rows.append(
            row(
                f"`rollout`, {name}, {nworld} worlds x {steps} steps, against the faster of "
                "`mujoco.rollout` and `mujoco.batch`",
                values, "steps/s", "at least 0.95", values[2] >= 0.95,
            )
        )  # fmt: skip
    return rows


def _per_second(work: Callable[[], object], controls: Any) -> Callable[[], float]:
    """Measures the steps per second of one rollout under `controls` [nworld, steps, nu]."""

    def measured() -> float:
        began = time.perf_counter()
        work()
        return controls.shape[0] * controls.shape[1] / (time.perf_counter() - began)

    return measured


def _mujoco_rollout(model: Any, controls: Any, threads: int) -> Callable[[], float]:
    import mujoco
    import mujoco.rollout
    import numpy as np

    data = mujoco.MjData(model)
    full = int(mujoco.mjtState.mjSTATE_FULLPHYSICS)
    start = np.empty(mujoco.mj_stateSize(model, full))
    mujoco.mj_getState(model, data, start, full)
    initial = np.tile(start, (len(controls), 1))
    datas = [mujoco.MjData(model) for _ in range(threads)]
    pool = mujoco.rollout.Rollout(nthread=threads)
    return _per_second(lambda: pool.rollout(model, datas, initial, controls), controls)


def _mujoco_batch(model: Any, controls: Any, threads: int) -> Callable[[], float]:
    import mujoco
    import mujoco.batch

    batch = mujoco.batch.Batch(model, len(controls), threads)
    full = int(mujoco.mjtState.mjSTATE_FULLPHYSICS)
    record = [full, "sensordata"] if model.nsensordata else [full]

    def roll() -> None:
        batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE)
        batch.rollout(controls.shape[1], controls, record=record)

    return _per_second(roll, controls)


def run(*arguments: str) -> float:
    """Seconds of processor time that a command takes as a whole process."""
    silent = subprocess.DEVNULL
    with_gl = {"MUJOCO_GL": "egl", **os.environ}  # or dm_control would look for a display only
    process = subprocess.Popen(arguments, stdout=silent, stderr=silent, env=with_gl)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, arguments)
    return used.ru_utime + used.ru_stime


def imports() -> list[dict[str, Any]]:
    """Time of `import orbisim`, by itself and with `Physics`."""
    theirs = "import mujoco, dm_control.mujoco"
    rows = []
    for what in ("import orbisim", "import orbisim; orbisim.Physics; orbisim.load_scene"):
        values = paired(
            lambda w=what: run(sys.executable, "-c", w), lambda: run(sys.executable, "-c", theirs)
        )
        name = f"`{what}`, against `{theirs}`"
        rows.append(row(name, values, "s", "at most 1.2", values[2] <= 1.2))
    return rows


def help_text() -> list[dict[str, Any]]:
    """Time of `orbisim --help`, against starting Python."""
    program = str(Path(sys.executable).with_name("orbisim"))
    values = paired(lambda: run(program, "--help"), lambda: run(sys.executable, "-c", "pass"))
    return [
        row(
            "`orbisim --help`, against an empty Python", values, "s", "under 0.5 s", values[0] < 0.5
        )
    ]


BENCHMARKS: dict[str, Callable[[], list[dict[str, Any]]]] = {
    "physics": physics,
    "rollout": rollout,
    "import": imports,
    "help": help_text,
}

if __name__ == "__main__":
    sys.exit(main())
