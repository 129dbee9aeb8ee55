"""One table and one figure of all policies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from orbisim_policies.evaluate import wilson

from paying.conditions import CONDITIONS, DUTIES

Rows = Sequence[Mapping[str, Any]]
WORDS = {
    "declared": "declared",
    "randomised": "randomised, no diagnosis",
    "hybrid": "hybrid",
    "diagnosed": "diagnosed",
    "true": "the machine's own scene",
}


def chosen(rows: Rows, scene: str, condition: str) -> list[Mapping[str, Any]]:
    """The policies of a scene under a condition, by seed."""
    mine = [row for row in rows if (row["scene"], row["condition"]) == (scene, condition)]
    return sorted(mine, key=lambda row: int(row["seed"]))


def pooled(rows: Rows, place: str) -> tuple[float, tuple[float, float]]:
    """Share of successes over the episodes of all seeds, with its 95 % interval."""
    wins = sum(row[place]["successes"] for row in rows)
    count = sum(row[place]["episodes"] for row in rows)
    return wins / count, wilson(wins, count)


def table(rows: Rows) -> str:
    """A line for each scene and condition."""
    lines = [
        "| scene | trained on | seeds | success on the machine, % | each seed | missed by, median "
        "| reward | success where it was trained, % |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for scene, duty in DUTIES.items():
        for condition in CONDITIONS:
            mine = chosen(rows, scene, condition)
            if not mine:
                continue
            share, (low, high) = pooled(mine, "machine")
            each = ", ".join(f"{100 * row['machine']['share']:.0f}" for row in mine)
            miss = np.median([row["machine"]["miss"]["median"] for row in mine])
            reward = np.mean([row["machine"]["reward"]["mean"] for row in mine])
            cells = [scene, WORDS[condition], str(len(mine))]
            cells += [f"{100 * share:.0f}, {100 * low:.0f} to {100 * high:.0f}", each]
            cells += [f"{miss:.1f} {duty.unit}", f"{reward:.2f}"]
            cells += [f"{100 * pooled(mine, 'own')[0]:.0f}"]
            lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def figure(rows: Rows, path: Path) -> None:
    """Success on the machine, with intervals of the episodes of all seeds, and every seed."""
    from matplotlib.figure import Figure

    scenes = [scene for scene in DUTIES if any(row["scene"] == scene for row in rows)]
    page = Figure(figsize=(2.6 * len(scenes) + 1.4, 3.0), layout="constrained")
    for column, scene in enumerate(scenes):
        axes = page.add_subplot(1, len(scenes), column + 1)
        for place, condition in enumerate(CONDITIONS):
            mine = chosen(rows, scene, condition)
            if not mine:
                axes.text(2, place, "not run", va="center", fontsize=8, color="#777777")
                continue
            share, (low, high) = pooled(mine, "machine")
            own = pooled(mine, "own")[0]
            axes.barh(place, 100 * share, color="#4878a8" if condition != "true" else "#999999")
            axes.plot([100 * low, 100 * high], [place, place], color="black", lw=1.2)
            points = [100 * row["machine"]["share"] for row in mine]
            axes.plot(points, [place] * len(points), "k.", ms=5)
            axes.plot([100 * own], [place], marker="|", ms=14, mew=2, color="#d07020", ls="")
        axes.set(xlim=(0, 102), ylim=(len(CONDITIONS) - 0.4, -0.6), title=scene)
        axes.set_yticks(range(len(CONDITIONS)))
        labels = [WORDS[c].replace(", ", ",\n").replace(" own ", " own\n") for c in CONDITIONS]
        axes.set_yticklabels(labels if column == 0 else [], fontsize=8)
        axes.set_xlabel("success, %", fontsize=8)
        axes.tick_params(axis="x", labelsize=8)
    page.savefig(path, dpi=110)
