"""The model card: what a checkpoint is, for people."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from orbisim.files.writing import write_text
from orbisim_world_model.manifest import MANIFEST


def write_card(folder: Path, manifest: dict[str, Any]) -> None:
    """Writes `card.md` from a checkpoint's manifest."""
    write_text(folder / "card.md", card(manifest), announce=False)


def card(manifest: dict[str, Any]) -> str:
    """The card as Markdown."""
    layout, data = manifest["layout"], manifest["data"]
    tasks = sorted({str(source.get("task")) for source in data.get("sources", [])})
    lines = [
        f"# Learned dynamics of {', '.join(tasks)}",
        "",
        f"Configuration `{manifest['config']['name']}`, {manifest['parameters']:,} parameters, "
        f"one step is {manifest['control_timestep']:g} s. All numbers are in {MANIFEST}.",
        "",
        "## What it knows",
        "",
        f"- {_entities(manifest)}, {layout['nu']} controls.",
        *(
            f"- or {_entities(other)}, {other['layout']['nu']} controls."
            for other in manifest.get("variants", [])
        ),
        f"- {data['episodes']} episodes, {data['control_steps']:,} control steps "
        f"({', '.join(data.get('groups', []))}).",
        *_range_lines(manifest["ranges"]),
        "",
        *how_trained(manifest["training"]),
        "## How good it is",
        "",
        *metric_lines(manifest["metrics"]),
        "",
        "## What it is not for",
        "",
        "Scenes with other entities, another control step, or descriptors and states outside the "
        "ranges above. It conserves neither energy nor momentum exactly.",
        "",
    ]
    return "\n".join(lines)


def how_trained(training: dict[str, Any]) -> list[str]:
    """The section on it, by the manifest's entry."""
    return [
        "## How it was trained",
        "",
        f"{training['steps']:,} steps in {training['seconds']:g} s on {training['device']}, "
        f"{training['processes']} process(es), seed {training['seed']}.",
        "",
    ]


def _entities(manifest: dict[str, Any]) -> str:
    """Joints of the robot, objects, and parts of mechanisms where there are any."""
    parts = len(manifest["layout"].get("parts", ()))
    joints = len(manifest["layout"]["joints"]) - parts
    more = f", up to {parts} parts of a mechanism" if parts else ""
    return f"{joints} joints, {_objects(manifest)} objects{more}"


def _objects(manifest: dict[str, Any]) -> str:
    low, high = manifest["ranges"]["objects"]
    return str(high) if low == high else f"{low} to {high}"


def _range_lines(found: dict[str, Any]) -> list[str]:
    lines = []
    for group, title in (("attributes", "Objects"), ("settings", "World"), ("joints", "Joints")):
        varying = {n: r for n, r in found[group].items() if r[1] - r[0] > 1e-9}
        if varying:
            text = ", ".join(f"{n} {r[0]:.3g} to {r[1]:.3g}" for n, r in varying.items())
            lines.append(f"- {title}: {text}.")
    return lines


def worse_than_constant_velocity(metrics: dict[str, Any]) -> list[str]:
    """The horizons at which the median error is larger than if all moved on as they did."""
    lost = []
    for horizon, values in metrics.get("model", {}).items():
        other = metrics["constant_velocity"].get(horizon, {})
        own, still = (one.get("trajerr", {}).get("median", math.nan) for one in (values, other))
        if not own < still:
            lost.append(horizon)
    return lost


def metric_lines(metrics: dict[str, Any]) -> list[str]:
    """Tables of held-out errors by horizon, the model beside constant velocity."""
    if not metrics:
        return ["Not evaluated yet."]
    lines = [
        f"Median over {metrics['held_out_episodes']} held-out episodes, open loop.",
        "",
        "| control steps | quantity | model | constant velocity |",
        "| --- | --- | --- | --- |",
    ]
    for horizon, values in metrics["model"].items():
        other = metrics["constant_velocity"].get(horizon, {})
        for name, value in values.items():
            if isinstance(value, dict):
                against = other.get(name, {}).get("median", float("nan"))
                lines.append(f"| {horizon} | {name} | {value['median']:.4g} | {against:.4g} |")
    if metrics.get("horizons_left_out"):
        steps = ", ".join(map(str, metrics["horizons_left_out"]))
        lines += ["", f"There was no time to measure {steps} control steps."]
    for other in metrics.get("variants", []):
        lines += ["", "The next robot:", "", *metric_lines(other)]
    return lines
