"""Live estimates of trainings in C MuJoCo: rewards against seconds and true-simulator steps."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from orbisim.files.writing import writing

PARTS = ("true_r1", "true_r2", "true_r3", "success_moved")


def read(folder: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Manifest (empty if the training did not end) and the lines with an estimate."""
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text()) if path.exists() else {}
    lines = (folder / "metrics.jsonl").read_text().splitlines()
    return manifest, [row for row in map(json.loads, lines) if PARTS[0] in row]


def true_steps(manifest: dict[str, Any], row: dict[str, Any]) -> int:
    """Steps of the true simulator until then: reinforcement learning makes them on the way."""
    learns_there = manifest.get("method", "sac") in ("sac", "ppo", "ppo_rnd")
    return int(row["step"] if learns_there else manifest["true_steps"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folders", nargs="+", type=Path, help="of trainings for task:push")
    parser.add_argument("--out", type=Path, default=Path("out/policies.png"))
    options = parser.parse_args()
    figure = Figure(figsize=(11, 5), layout="constrained")
    axes = figure.subplots(2, len(PARTS), sharey="col")
    for folder in options.folders:
        manifest, rows = read(folder)
        for column, name in enumerate(PARTS):
            values = [row[name] for row in rows]
            seconds = [row["seconds"] for row in rows]
            axes[0, column].plot(seconds, values, marker="o", ms=2, lw=1, label=folder.name)
            steps = [true_steps(manifest, row) for row in rows]
            axes[1, column].plot(steps, values, marker="o", ms=2, lw=1)
            axes[0, column].set(title=name.removeprefix("true_"), xlabel="s")
            axes[1, column].set(xlabel="steps of C MuJoCo", xscale="log")
    axes[0, 0].legend(frameon=False, fontsize=7)
    with writing(options.out) as part:
        figure.savefig(part, dpi=90)


if __name__ == "__main__":
    main()
