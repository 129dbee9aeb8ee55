"""The page of `orbisim diagnose --fleet`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any
from urllib.parse import quote

from orbisim.files.writing import write_text
from orbisim.fleet.run import ROBOTS, Fleet
from orbisim.fleet.table import RULE, Cell
from orbisim.report.page import number, render_page


def write_report(fleet: Fleet, path: Path) -> Path:
    """Writes the page; returns its path."""
    page = render_page(
        "fleet.html",
        scene=fleet.scene,
        summary=_summary(fleet),
        names=[one.name for one in fleet.robots],
        rows=[_row(fleet, row) for row in fleet.rows],
        robots=[_robot(fleet, one) for one in fleet.robots],
        rule=RULE,
    )
    write_text(path, page)
    return path


def _summary(fleet: Fleet) -> str:
    count, failed = len(fleet.robots), [r.name for r in fleet.robots if r.report is None]
    text = f"{count} robot{'s' * (count != 1)}; "
    if fleet.outliers:
        text += (
            f"{', '.join(fleet.outliers)} differ{'s' * (len(fleet.outliers) == 1)} from the others"
        )
    else:
        text += "none differs from the others"
    return text + (f"; no diagnosis of {', '.join(failed)}." if failed else ".")


def _row(fleet: Fleet, row: Any) -> dict[str, Any]:
    cells = [row.cells.get(one.name) for one in fleet.robots]
    return {
        "name": f"{row.effect} {row.target}" if row.effect != "left over" else "left over",
        "unit": row.unit if row.unit != "1" else row.parameter,
        "median": number(row.median),
        "cells": [_cell(cell) for cell in cells],
    }


def _cell(cell: Cell | None) -> dict[str, Any]:
    if cell is None or not cell.found:
        missing = cell is not None and cell.outlier
        return {"text": number(None), "interval": "", "outlier": missing}
    interval = f"{cell.low:.3g} to {cell.high:.3g}" if math.isfinite(cell.low) else ""
    return {"text": number(cell.value), "interval": interval, "outlier": cell.outlier}


def _robot(fleet: Fleet, one: Any) -> dict[str, Any]:
    found = f"{ROBOTS}/{quote(one.name)}/report.html"
    return {
        "name": one.name,
        "outlier": one.name in fleet.outliers,
        "link": found if one.report else "",
        "verdict": one.report["verdict"] if one.report else "no diagnosis",
        "text": one.report["sentence"] if one.report else one.problem,
    }
