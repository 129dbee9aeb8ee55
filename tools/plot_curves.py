"""Losses of several trainings against the seconds that they had.

    python tools/plot_curves.py push_fair_*/metrics.jsonl --out curves.png

A line for each training, named after its folder; seeds (`NAME-s0`, `NAME-s1`) share a colour.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from matplotlib.figure import Figure


def main() -> None:
    """Reads, draws, writes."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("metrics", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--prefix", default="push_fair_", help="left out of the names")
    options = parser.parse_args()
    colours: dict[str, str] = {}
    figure = Figure(figsize=(7, 3.6), layout="constrained")
    axes = figure.subplots()
    for path in options.metrics:
        rows = [json.loads(line) for line in path.read_text().splitlines()]
        name = path.parent.name.removeprefix(options.prefix).rpartition("-s")[0]
        name = name or path.parent.name
        label = None if name in colours else name
        colour = colours.setdefault(name, f"C{len(colours)}")
        seconds, losses = ([row[key] for row in rows] for key in ("seconds", "loss"))
        axes.plot(seconds, losses, color=colour, label=label, lw=1.2)
    axes.set(xlabel="seconds of training", ylabel="loss, in units of a step's change", yscale="log")
    axes.legend(frameon=False)
    figure.savefig(options.out, dpi=110)


if __name__ == "__main__":
    main()
