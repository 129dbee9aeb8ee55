"""Curves of a training as an image."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from orbisim.files.writing import writing

_CURVES, _MORE = ("step", "loss"), ("state_loss", "ratio")
"""What every line has, and what those of some models have."""
_MOST = 1e300
"""Larger numbers are no losses: axes cannot be drawn to them."""


def drawable(row: dict[str, Any]) -> bool:
    """Whether a line of the metrics has what is drawn."""
    numbers = [row.get(name) for name in _CURVES] + [row[name] for name in _MORE if name in row]
    return all(isinstance(n, (int, float)) and not abs(n) > _MOST for n in numbers)


def draw_curves(metrics: Path, image: Path) -> None:
    """Draws the losses of a metrics file over the training steps."""
    from matplotlib.figure import Figure

    rows = [json.loads(line) for line in metrics.read_text().splitlines()]
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.add_subplot()
    steps = [row["step"] for row in rows]
    axes.plot(steps, [row["loss"] for row in rows], label="all losses", lw=1)
    if all("state_loss" in row for row in rows):
        axes.plot(steps, [row["state_loss"] for row in rows], label="L_state", lw=1)
    axes.set(xlabel="training step", ylabel="loss", yscale="log")
    if all("ratio" in row for row in rows):
        other = axes.twinx()
        other.plot(steps, [row["ratio"] for row in rows], color="0.6", lw=1, label="AR ratio")
        other.set(ylabel="autoregressive ratio", ylim=(0, 1.05))
    axes.legend(loc="lower left", frameon=False)
    with writing(image, announce=False) as part:
        figure.savefig(part, dpi=120)
