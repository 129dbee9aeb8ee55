"""Robots by effects, and which robot differs from the others."""

from __future__ import annotations

import csv
import dataclasses
import io
import math
from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from orbisim.effects import find

CUT = 3.5
"""Score from which a robot is an outlier (Iglewicz and Hoaglin, How to Detect and Handle Outliers,
1993, for scores by the median absolute deviation)."""
FEWEST = 4
"""Robots from which on a median and a deviation say something."""
_NORMAL = 1.4826
"""Standard deviation over median absolute deviation, of normally distributed numbers."""
_WIDTH = 1.96
"""Half of a 95 % interval in standard errors."""
_FACTOR = 2.0
"""What a robot leaves unexplained must be so many times the fleet's to be told."""
RULE = (
    f"A robot is an outlier in a number if it is more than {CUT:g} sqrt(s^2 + e^2) away from the "
    f"fleet's median; s is {_NORMAL} times the median absolute deviation over the robots, e the "
    "standard error of the robot's own number (a quarter of its 95 % interval, nearly). Where an "
    "effect was not found, its number is what changes nothing, with the median error of those "
    f"where it was. Fewer than {FEWEST} robots have no outliers."
)


@dataclasses.dataclass(frozen=True, eq=False)
class Robot:
    """A robot's diagnosis. report: its report.json; None if there is none. problem: why not."""

    name: str
    report: Mapping[str, Any] | None
    problem: str

    @property
    def left(self) -> float:
        """Held-out error over the noise floor, after; NaN if unknown."""
        error = self.report["error"] if self.report else {}
        after, floor = error.get("held_out", {}).get("after"), error.get("noise_floor")
        return float(after) / float(floor) if after is not None and floor else math.nan

    def to_json(self) -> dict[str, Any]:
        """An entry of `robots`."""
        if self.report is None:
            return {"robot": self.name, "problem": self.problem}
        keys = ("verdict", "sentence", "error")
        return {
            "robot": self.name,
            **{key: self.report[key] for key in keys},
            "folder": f"robots/{self.name}",
        }


@dataclasses.dataclass(frozen=True)
class Cell:
    """One number of a robot.

    Attributes:
      value, low, high: with its 95 % interval (NaN: none). found: whether the effect was found.
      score: distance from the median over its spread. outlier: by the rule.
    """

    value: float
    low: float
    high: float
    found: bool
    score: float
    outlier: bool


@dataclasses.dataclass(frozen=True, eq=False)
class Row:
    """An effect's first parameter over the fleet; the effect `left over` is what none explains."""

    effect: str
    target: str
    parameter: str
    unit: str
    median: float
    spread: float
    cells: Mapping[str, Cell]

    def to_json(self) -> dict[str, Any]:
        """An entry of `effects`."""
        cells = {
            name: {
                "value": _plain(c.value),
                "ci95": [_plain(c.low), _plain(c.high)],
                "found": c.found,
                "score": _plain(c.score),
                "outlier": c.outlier,
            }
            for name, c in self.cells.items()
        }
        return {
            "effect": self.effect, "target": self.target, "parameter": self.parameter,
            "unit": self.unit, "median": _plain(self.median), "spread": _plain(self.spread),
            "rule": RULE, "robots": cells,
        }  # fmt: skip


def _plain(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def rows_of(robots: Sequence[Robot], model: mujoco.MjModel) -> tuple[Row, ...]:
    """The table: every effect that some robot has, and what is left unexplained; rows with
    outliers first."""
    done = [one for one in robots if one.report is not None]
    kinds = {(str(e["effect"]), str(e["target"])): e for one in done for e in _effects(one)}
    rows = [_row(done, model, key, example) for key, example in sorted(kinds.items())]
    rows += [_left_over(done)] if done else []
    rows.sort(key=lambda row: not any(cell.outlier for cell in row.cells.values()))
    return tuple(rows)


def _effects(robot: Robot) -> list[Mapping[str, Any]]:
    return list(robot.report["effects"]) if robot.report else []


def _row(
    robots: Sequence[Robot], model: mujoco.MjModel, key: tuple[str, str], example: Mapping[str, Any]
) -> Row:
    effect, target = key
    parameter, first = next(iter(example["parameters"].items()))
    neutral = find(effect).neutral(model, target).get(parameter, 0)
    estimates = {}
    for one in robots:
        mine = [e for e in _effects(one) if (e["effect"], e["target"]) == key]
        estimates[one.name] = mine[0]["parameters"][parameter] if mine else None
    values = {n: float(e["value"]) if e else float(neutral) for n, e in estimates.items()}
    bounds = {n: _bounds(e) if e else (math.nan, math.nan) for n, e in estimates.items()}
    found = {n: e is not None for n, e in estimates.items()}
    return _judged((effect, target, parameter, str(first["unit"])), values, bounds, found)


def _bounds(estimate: Mapping[str, Any]) -> tuple[float, float]:
    low, high = (math.nan if x is None else float(x) for x in estimate["ci95"])
    return low, high


def _left_over(robots: Sequence[Robot]) -> Row:
    """Held-out error over the noise, compared by its logarithm."""
    left = {one.name: one.left for one in robots}
    logs = {n: math.log(max(v, 1.0)) if math.isfinite(v) else math.nan for n, v in left.items()}
    none = dict.fromkeys(left, (math.nan, math.nan))
    row = _judged(
        ("left over", "robot", "error over noise", "1"), logs, none, dict.fromkeys(left, True)
    )
    median = math.exp(row.median)
    cells = {}
    for name, cell in row.cells.items():
        far = cell.outlier and left[name] > _FACTOR * median
        cells[name] = dataclasses.replace(cell, value=left[name], outlier=far)
    return dataclasses.replace(row, median=median, spread=math.nan, cells=cells)


def _judged(
    names: tuple[str, str, str, str],
    values: Mapping[str, float],
    bounds: Mapping[str, tuple[float, float]],
    found: Mapping[str, bool],
) -> Row:
    """The row with its outliers, by the rule."""
    every = np.array([v for v in values.values() if math.isfinite(v)])
    median = float(np.median(every)) if len(every) else math.nan
    spread = _NORMAL * float(np.median(np.abs(every - median))) if len(every) else math.nan
    errors = {n: (high - low) / (2 * _WIDTH) for n, (low, high) in bounds.items()}
    known = [e for n, e in errors.items() if found[n] and math.isfinite(e)]
    usual = float(np.median(known)) if known else 0.0
    cells = {}
    for name, value in values.items():
        error = errors[name] if math.isfinite(errors[name]) else usual
        width = math.hypot(spread, error)
        # a fleet that is all alike: the rounding of the numbers is its spread
        score = abs(value - median) / max(width, 1e-9 * max(abs(median), 1e-9))
        outlier = len(every) >= FEWEST and math.isfinite(score) and score > CUT
        cells[name] = Cell(value, *bounds[name], found[name], score, outlier)
    return Row(*names, median, spread, cells)


_COLUMNS = "robot verdict effect target parameter unit value low high found score outlier problem"


def csv_text(robots: Sequence[Robot], rows: Sequence[Row]) -> str:
    """One line for each robot and number; robots without a diagnosis have one with the problem."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(_COLUMNS.split(" "))
    for one in robots:
        if one.report is None:
            writer.writerow([one.name, *[""] * 11, one.problem])
        for row in rows if one.report else ():
            c = row.cells[one.name]
            numbers = [f"{x:.8g}" if math.isfinite(x) else "" for x in (c.value, c.low, c.high)]
            verdict = one.report["verdict"] if one.report else ""
            writer.writerow(
                [one.name, verdict, row.effect, row.target, row.parameter, row.unit, *numbers,
                 int(c.found), f"{c.score:.3g}", int(c.outlier), ""]
            )  # fmt: skip
    return stream.getvalue()
