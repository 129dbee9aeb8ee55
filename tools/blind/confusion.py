"""What was injected against what was reported first."""

from __future__ import annotations

import csv
import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from blind.outcomes import Outcome


def _confusion(outcomes: Sequence[Outcome]) -> tuple[list[str], list[str], np.ndarray]:
    """Injected (rows) against reported first (columns); `: elsewhere` is a wrong target."""
    rows = sorted({str(o.truths[0]["effect"]) for o in outcomes})
    names = {_column(o) for o in outcomes}
    columns = [name for name in rows if name in names] + sorted(names - set(rows))
    table = np.zeros((len(rows), len(columns)), int)
    for o in outcomes:
        table[rows.index(str(o.truths[0]["effect"])), columns.index(_column(o))] += 1
    return rows, columns, table


def _column(o: Outcome) -> str:
    if o.found and o.found[0]["effect"] == o.truths[0]["effect"] and not o.right:
        return f"{o.first}: elsewhere"
    return "failed" if o.failure else o.first


def _all_rows(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Single effects; no effect and effects outside the catalogue as rows of their own."""
    found = [o for o in outcomes if o.kind == "single"]
    for o in outcomes:
        if o.kind in ("none", "outside"):
            label = "(none)" if o.kind == "none" else f"(outside) {o.outside}"
            stand_in = {"effect": label, "target": "", "parameters": {}}
            found.append(dataclasses.replace(o, truths=(stand_in,)))
    return found


def instead_table(outcomes: Sequence[Outcome]) -> list[str]:
    """What was reported first instead, by injected effect."""
    if not outcomes:
        return []
    lines = [
        "",
        "## What was said",
        "",
        "| injected | n | right | instead |",
        "| --- | --- | --- | --- |",
    ]
    rows, columns, table = _confusion(outcomes)
    for i, name in enumerate(rows):
        instead = [
            f"{columns[j]} {table[i, j]}"
            for j in np.argsort(-table[i])
            if table[i, j] and columns[j] != name
        ]
        right = table[i, columns.index(name)] if name in columns else 0
        lines.append(f"| {name} | {table[i].sum()} | {right} | {', '.join(instead) or '-'} |")
    return lines


def write_confusion(outcomes: Sequence[Outcome], out: Path) -> None:
    some = _all_rows(outcomes)
    if not some:
        return
    rows, columns, table = _confusion(some)
    with (out / "confusion.csv").open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["injected", *columns])
        writer.writerows([name, *map(int, row)] for name, row in zip(rows, table, strict=True))
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    size = (4 + 0.24 * len(columns), 3 + 0.22 * len(rows))
    figure, axes = pyplot.subplots(figsize=size, layout="constrained")
    shares = table / np.maximum(table.sum(axis=1, keepdims=True), 1)
    axes.imshow(shares, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    for i, j in zip(*np.nonzero(table), strict=True):
        colour = "white" if shares[i, j] > 0.6 else "black"
        axes.text(j, i, table[i, j], ha="center", va="center", fontsize=7, color=colour)
    axes.set_xticks(range(len(columns)), columns, rotation=90, fontsize=7)
    axes.set_yticks(range(len(rows)), rows, fontsize=7)
    axes.set_xlabel("reported first")
    axes.set_ylabel("injected")
    figure.savefig(out / "confusion.png", dpi=150)
    pyplot.close(figure)
