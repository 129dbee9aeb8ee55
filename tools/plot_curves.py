"""Losses of several trainings, and their held-out errors, against the seconds that they had.

    python tools/plot_curves.py push_fair_*/metrics.jsonl --out curves.png [--errors FILE ...]

A line for each training, named after its folder; seeds (`NAME-s0`, `NAME-s1`) share a colour. With
--errors (files of tools/kept_errors.py) a second panel has the errors of the objects' positions on
held-out episodes, the median as a line and the 90 % dotted.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure


def main() -> None:
    """Reads, draws, writes."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("metrics", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--prefix", default="push_fair_", help="left out of the names")
    parser.add_argument("--errors", type=Path, nargs="*", default=[])
    options = parser.parse_args()
    colours: dict[str, str] = {}
    figure = Figure(figsize=(11 if options.errors else 7, 3.6), layout="constrained")
    panels = figure.subplots(1, 1 + bool(options.errors), squeeze=False)[0]
    for path in options.metrics:
        rows = [json.loads(line) for line in path.read_text().splitlines()]
        style = _style(path.parent.name, options.prefix, colours)
        seconds, losses = ([row[key] for row in rows] for key in ("seconds", "loss"))
        panels[0].plot(seconds, losses, lw=1.2, **style)
    panels[0].set(ylabel="loss, in units of a step's change")
    for path in options.errors:
        for name, rows in json.loads(path.read_text()).items():
            style = _style(name, options.prefix, colours) | {"label": None}
            seconds = [row["seconds"] for row in rows]
            for column, line in ((0, "-"), (1, ":")):
                values = [row["errors"]["object_position"][column] for row in rows]
                panels[1].plot(seconds, values, line, marker=".", lw=1.2, **style)
            panels[1].set(ylabel="held-out position, mm (90 %: dotted)")
    for axes in panels:
        axes.set(xlabel="seconds of training", yscale="log")
    panels[0].legend(frameon=False)
    figure.savefig(options.out, dpi=110)


def _style(folder: str, prefix: str, colours: dict[str, str]) -> dict[str, Any]:
    """Colour of a training, and its name where it is the first of that colour."""
    name = folder.removeprefix(prefix)
    name = name.rpartition("-s")[0] or name
    label = None if name in colours else name
    return {"color": colours.setdefault(name, f"C{len(colours)}"), "label": label}


if __name__ == "__main__":
    main()
