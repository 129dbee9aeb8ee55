"""The model card of a learned cloth: what a checkpoint is, for people."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from orbisim.files.writing import write_text
from orbisim_world_model.card import how_trained
from orbisim_world_model.cloth.evaluate import BASELINES
from orbisim_world_model.manifest import MANIFEST

_QUANTITIES = {
    "vertex_position": "vertex error, mm",
    "penetration": "penetration, mm",
    "strain": "edge strain, %",
}


def write_cloth_card(folder: Path, manifest: dict[str, Any]) -> None:
    """Writes `card.md` from a checkpoint's manifest."""
    write_text(folder / "card.md", cloth_card(manifest), announce=False)


def cloth_card(manifest: dict[str, Any]) -> str:
    """The card as Markdown."""
    data, ranges = manifest["data"], manifest["ranges"]
    tasks = sorted({str(source.get("task")) for source in data["sources"]})
    varying = [
        f"{name} {low:.3g} to {high:.3g}"
        for name in ("vertices", "edge", "mass", "radius", "gravity", "sliding", "height")
        for low, high in [ranges[name]]
    ]
    lines = [
        f"# Learned cloth of {', '.join(tasks)}",
        "",
        f"Configuration `{manifest['config']['name']}` ({manifest['model']['kind']}), "
        f"{manifest['parameters']:,} parameters, one step is {manifest['control_timestep']:g} s. "
        f"All numbers are in {MANIFEST}.",
        "",
        "## What it knows",
        "",
        f"- {data['episodes']} episodes, {data['control_steps']:,} control steps "
        f"({', '.join(data['groups'])}).",
        f"- {'; '.join(varying)} (SI units).",
        "",
        *how_trained(manifest["training"]),
        "## How good it is",
        "",
        *cloth_lines(manifest["metrics"]),
        "",
        "## What it is not for",
        "",
        "Scenes in which more moves than one cloth, cloths that touch themselves, another control "
        "step, wind. Where folds go after the first contact is a guess in any simulator.",
        "",
    ]
    return "\n".join(lines)


def cloth_lines(metrics: dict[str, Any]) -> list[str]:
    """Table of held-out errors by horizon, the model beside what learned nothing."""
    if not metrics:
        return ["Not evaluated yet."]
    names = ["model", *(name for name in BASELINES if name in metrics)]
    lines = [
        f"Median / 90 % / largest over vertices (edges) of {metrics['held_out_episodes']} held-out "
        f"episodes ({', '.join(metrics['groups'])}), from the first state on. `known` falls freely "
        "and keeps edges and contacts without anything learned.",
        "",
        f"| control steps | quantity | {' | '.join(names)} |",
        f"| --- | --- |{' --- |' * len(names)}",
    ]
    for horizon, values in metrics["model"].items():
        for quantity, title in _QUANTITIES.items():
            cells = [_cell(metrics[name][horizon][quantity]) for name in names]
            lines.append(f"| {horizon} | {title} | {' | '.join(cells)} |")
        truth = [_cell(values[f"true_{quantity}"]) for quantity in ("penetration", "strain")]
        lines.append(
            f"| {horizon} | of the truth | penetration {truth[0]}, strain {truth[1]} |"
            + " |" * (len(names) - 1)
        )
    return lines


def _cell(value: dict[str, float]) -> str:
    return " / ".join(f"{value[name]:.3g}" for name in ("median", "p90", "worst"))


def worse_than_known(metrics: dict[str, Any]) -> list[str]:
    """The horizons at which the mean vertex error is larger than of what learned nothing."""
    lost = []
    for horizon, values in metrics.get("model", {}).items():
        others = [metrics[name][horizon] for name in BASELINES if name in metrics]
        least = min(one["vertex_position"]["mean"] for one in others)
        if not values["vertex_position"]["mean"] < least:
            lost.append(horizon)
    return lost
