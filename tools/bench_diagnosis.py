"""How long a diagnosis takes, and how that grows with recordings and with targets.

    python tools/bench_diagnosis.py --out out/diagnosis --image docs/images/diagnosis_speed.svg

Serial arms with Coulomb friction at one joint, four recordings each, and with `--closed` (OUT of
tools/closing_the_loop.py, which has the recordings) 24 measured tosses of a cube, each diagnosed
with its report in a process of its own on two cores.
Writes `OUT/figures.json` and prints a table; a run that was stopped goes on from there. Time on the
clock says what a user waits; processor time hardly depends on other work.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import multiprocessing
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

import from_source

EPISODES = 4
CUBE, TOSSES = "contactnets_cube", 24
SERIES = ("goal", "length", "targets")


@dataclasses.dataclass(frozen=True)
class Case:
    """A diagnosis to be timed.

    Attributes:
      series: what it shows: `goal`, `length` or `targets`. scene: of mjcf_assets; or `serial`, or
        the name of a measured set.
      joints: of the arm. target: the joint with friction. torque: of the friction, N*m.
      seconds: duration of each recording. goal: s; None for none.
    """

    series: str
    scene: str
    joints: int
    target: str
    torque: float
    seconds: float = 8.0
    goal: float | None = None

    @property
    def label(self) -> str:
        """For the table."""
        if self.scene == CUBE:
            return f"thrown cube, measured, {TOSSES} tosses"
        name = self.scene if self.scene != "serial" else f"serial arm of {self.joints} joints"
        return f"{name}, {EPISODES} x {self.seconds:g} s"


def cases(
    seconds: float, lengths: Sequence[float], joints: Sequence[int], data: Path | None
) -> list[Case]:
    """All that is to be timed. data: see `_measured`; None for none."""
    return [
        Case("goal", "arm2", 2, "elbow", 0.12, seconds, 15.0),
        Case("goal", "serial", 7, "joint2", 0.1, seconds, 60.0),
        *([Case("goal", CUBE, 0, "cube", 0.0, 0.0, 120.0)] if data else []),
        Case("goal", "arm6", 6, "axis3", 2.0, seconds),
        *(Case("length", "arm2", 2, "elbow", 0.12, one) for one in lengths),
        *(Case("targets", "serial", count, "joint2", 0.1, seconds) for count in joints),
    ]


def serial_arm(count: int) -> str:
    """MJCF of an arm of links that get shorter, with hinges across each other and torque motors."""
    bodies, motors = "", ""
    for number in range(count, 0, -1):
        length, mass = 0.3 * 0.85 ** (number - 1), 1.5 * 0.7 ** (number - 1)
        axis = "0 1 0" if number % 3 else "1 0 0"
        above = 0.0 if number == 1 else -0.3 * 0.85 ** (number - 2)
        bodies = f"""
        <body name="link{number}" pos="0 0 {above:.6g}">
          <joint name="joint{number}" axis="{axis}" damping="{0.1 * mass:.6g}"/>
          <geom type="capsule" fromto="0 0 0 {0.3 * length:.6g} 0 {-length:.6g}" size="0.02"
                mass="{mass:.6g}" contype="0" conaffinity="0"/>{bodies}
        </body>"""
        torque = 4.0 * 0.55 ** (number - 1)
        motors = f"""
        <motor name="motor{number}" joint="joint{number}" ctrlrange="{-torque:.6g} {torque:.6g}"
               ctrllimited="true"/>{motors}"""
    return f"""
    <mujoco model="serial{count}">
      <compiler angle="radian"/>
      <option timestep="0.002" integrator="implicitfast"/>
      <worldbody>{bodies}
      </worldbody>
      <actuator>{motors}
      </actuator>
    </mujoco>"""


def timed(case: Case, cores: int, data: Path | None = None) -> dict[str, Any]:
    """Diagnoses, on so many cores; in a fresh process. data: see `_measured`."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, set(sorted(os.sched_getaffinity(0))[:cores]))
    from_source.register("mujoco")
    import orbisim
    from orbisim.effects import effect_names, find

    scene, recordings, held = _measured(data) if case.scene == CUBE and data else _injected(case)
    wanted = "sliding_friction" if case.scene == CUBE else "coulomb_friction"
    with tempfile.TemporaryDirectory() as out:
        clock, work = time.perf_counter(), time.process_time()
        found = orbisim.diagnose(scene, recordings, held, out=out, progress=False)
        seconds, processor = time.perf_counter() - clock, time.process_time() - work
    return dataclasses.asdict(case) | {
        "label": case.label,
        "clock_s": round(seconds, 2),
        "processor_s": round(processor, 2),
        "candidates": sum(len(find(name).targets(scene.model)) for name in effect_names()),
        "verdict": found.verdict,
        "found": [f"{one.effect} at {one.target}" for one in found.effects],
        "right": [(one.effect, one.target) for one in found.effects] == [(wanted, case.target)],
        "notes": list(found.notes),
    }


def _injected(case: Case) -> tuple[Any, Any, None]:
    """A scene with friction that it does not declare."""
    import mjcf_assets
    import orbisim
    from orbisim.effects import EffectInstance
    from orbisim.testing import inject_effect

    source: str | Path = serial_arm(case.joints)
    if case.scene != "serial":
        source = Path(mjcf_assets.__file__).parent / case.scene / "scene.xml"
    scene = orbisim.load_scene(source, trusted=True)
    friction = EffectInstance("coulomb_friction", case.target, {"torque": case.torque})
    recordings = inject_effect(
        scene, friction, episodes=EPISODES, duration=case.seconds, noise=2e-4, seed=1
    )
    return scene, recordings, None


def _measured(data: Path) -> tuple[Any, Any, Any]:
    """The thrown cube as tools/closing_the_loop.py diagnoses it. data: its OUT."""
    from closing.plans import PLANS
    from closing.scoring import recordings_of

    plan = next(one for one in PLANS if one.name == CUBE)
    sets = recordings_of(plan, data)
    return plan.scene(), list(sets.fit[:TOSSES]), list(sets.held[:TOSSES])


def exponent(rows: Sequence[dict[str, Any]], size: str) -> float:
    """The power of a size that processor time grows with, by least squares of the logarithms."""
    if len(rows) < 2:
        return float("nan")
    sizes, work = (np.log([row[key] for row in rows]) for key in (size, "processor_s"))
    return float(np.polyfit(sizes, work, 1)[0])


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Markdown."""
    lines = [
        "| diagnosis | effects x targets | clock, s | processor, s | goal, s | found |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        goal = "" if row["goal"] is None else f"{row['goal']:g}"
        said = ", ".join(row["found"]) or row["verdict"]
        lines.append(
            f"| {row['label']} | {row['candidates']} | {row['clock_s']:.1f} | "
            f"{row['processor_s']:.1f} | {goal} | {said} |"
        )
    return "\n".join(lines)


def draw(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Time against length and against the number of candidates, with a straight line through the
    smallest case each."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, both = pyplot.subplots(1, 2, figsize=(8, 3), layout="constrained")
    for axes, series, size, words in (
        (both[0], "length", "seconds", "duration of each of four recordings, s"),
        (both[1], "targets", "candidates", "effects x targets"),
    ):
        some = sorted((row for row in rows if row["series"] == series), key=lambda r: r[size])
        if not some:
            continue
        sizes = np.array([row[size] for row in some])
        for key, mark in (("clock_s", "o-"), ("processor_s", "s-")):
            axes.plot(sizes, [row[key] for row in some], mark, ms=4, label=key.partition("_")[0])
        axes.plot(sizes, some[0]["processor_s"] * sizes / sizes[0], "k:", lw=1, label="linear")
        axes.set(xlabel=words, ylabel="s", ylim=(0, None))
        axes.set_title(f"processor time ~ size^{exponent(some, size):.2f}", fontsize=9)
        axes.legend(fontsize=7)
        if series == "targets":
            for row in some:
                axes.annotate(
                    f"{row['joints']} joints", (row[size], row["processor_s"]),
                    fontsize=6, xytext=(3, -8), textcoords="offset points",
                )  # fmt: skip
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    pyplot.close(figure)


def main() -> int:
    """Times all cases one after the other."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--image", type=Path, help="where the plot goes; by default into --out")
    parser.add_argument("--seconds", type=float, default=8.0, help="duration of a recording")
    parser.add_argument("--lengths", type=float, nargs="*", default=[4.0, 8.0, 16.0, 32.0])
    parser.add_argument("--joints", type=int, nargs="*", default=[2, 3, 4, 5, 6, 7])
    parser.add_argument("--closed", type=Path, help="OUT/recordings has the thrown cube")
    parser.add_argument("--only", nargs="*", default=list(SERIES), choices=SERIES)
    parser.add_argument("--cores", type=int, default=2)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    figures = args.out / "figures.json"
    rows: list[dict[str, Any]] = json.loads(figures.read_text()) if figures.exists() else []
    done = {(row["series"], row["label"]) for row in rows}
    wanted = [one for one in cases(args.seconds, args.lengths, args.joints, args.closed)
              if one.series in args.only and (one.series, one.label) not in done]  # fmt: skip
    fresh = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=fresh, max_tasks_per_child=1) as pool:
        for case in wanted:
            row = pool.submit(timed, case, args.cores, args.closed).result()
            rows.append(row)
            print(f"{row['label']}: {row['clock_s']} s, {row['found']}", file=sys.stderr)
            figures.write_text(json.dumps(rows, indent=1) + "\n")
    draw(rows, args.image or args.out / "speed.svg")
    print(table(rows))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
