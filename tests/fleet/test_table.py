"""Which robot differs from the others."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

import pytest

import orbisim
from orbisim.fleet.table import Robot, Row, csv_text, rows_of


def robot(name: str, *effects: tuple[str, str, float, float], left: float = 1.1) -> Robot:
    """A robot with effects of these names, targets, values and half intervals."""
    found = [
        {
            "effect": effect,
            "target": target,
            "parameters": {
                "gain" if effect == "torque_gain" else "torque": {
                    "value": value,
                    "unit": "N*m",
                    "ci95": [value - half, value + half],
                }
            },
        }
        for effect, target, value, half in effects
    ]
    error = {"held_out": {"before": 1.0, "after": left * 1e-3}, "noise_floor": 1e-3}
    report: dict[str, Any] = {
        "effects": found, "error": error, "verdict": "explained", "sentence": "So it is.",
    }  # fmt: skip
    return Robot(name, report, "")


def fleet(*values: float, half: float = 0.004) -> list[Robot]:
    return [
        robot(f"r{i}", ("coulomb_friction", "shoulder", value, half))
        for i, value in enumerate(values)
    ]


def table(arm: orbisim.Scene, robots: list[Robot]) -> dict[str, Row]:
    return {row.effect: row for row in rows_of(robots, arm.model)}


def marked(row: Row) -> set[str]:
    return {name for name, cell in row.cells.items() if cell.outlier}


USUAL = (0.100, 0.103, 0.098, 0.101, 0.097)


def test_a_robot_far_from_the_others_is_marked(arm: orbisim.Scene) -> None:
    row = table(arm, fleet(*USUAL, 0.16))["coulomb_friction"]
    assert marked(row) == {"r5"}
    assert row.median == pytest.approx(0.1005)
    assert not marked(table(arm, fleet(*USUAL, 0.107))["coulomb_friction"])


def test_a_number_that_is_not_known_well_is_not_marked(arm: orbisim.Scene) -> None:
    robots = [*fleet(*USUAL), robot("vague", ("coulomb_friction", "shoulder", 0.16, 0.05))]
    assert not marked(table(arm, robots)["coulomb_friction"])


def test_an_effect_that_only_one_robot_has_marks_it(arm: orbisim.Scene) -> None:
    robots = [*fleet(*USUAL), robot("worn", ("coulomb_friction", "elbow", 0.1, 0.01))]
    rows = {(r.effect, r.target): r for r in rows_of(robots, arm.model)}
    assert marked(rows["coulomb_friction", "elbow"]) == {"worn"}
    assert not rows["coulomb_friction", "elbow"].cells["r0"].found
    # and it lacks what all others have
    assert marked(rows["coulomb_friction", "shoulder"]) == {"worn"}
    faint = [*fleet(*USUAL), robot("faint", ("coulomb_friction", "elbow", 0.01, 0.02))]
    rows = {(r.effect, r.target): r for r in rows_of(faint, arm.model)}
    assert not marked(rows["coulomb_friction", "elbow"])


def test_a_factor_is_compared_with_one(arm: orbisim.Scene) -> None:
    robots = [*fleet(*USUAL), robot("weak", ("torque_gain", "elbow", 0.8, 0.01))]
    row = table(arm, robots)["torque_gain"]
    assert row.median == 1.0 and marked(row) == {"weak"}


def test_what_no_effect_explains_is_told(arm: orbisim.Scene) -> None:
    robots = [robot(f"r{i}", left=1.0 + 0.02 * i) for i in range(5)]
    assert not marked(table(arm, robots)["left over"])
    row = table(arm, [*robots, robot("odd", left=9.0)])["left over"]
    assert marked(row) == {"odd"} and row.cells["odd"].value == pytest.approx(9.0)


def test_few_robots_have_no_outliers(arm: orbisim.Scene) -> None:
    assert not marked(table(arm, fleet(0.1, 0.1, 0.9))["coulomb_friction"])


def test_rows_with_outliers_come_first(arm: orbisim.Scene) -> None:
    robots = [*fleet(*USUAL, 0.1), robot("weak", ("torque_gain", "elbow", 0.8, 0.01),
              ("coulomb_friction", "shoulder", 0.1, 0.004))]  # fmt: skip
    assert rows_of(robots, arm.model)[0].effect == "torque_gain"


def test_csv_has_a_line_for_each_number(arm: orbisim.Scene, tmp_path: Path) -> None:
    robots = [*fleet(*USUAL, 0.16), Robot("bad", None, "run0.npz: no time")]
    lines = list(csv.DictReader(io.StringIO(csv_text(robots, rows_of(robots, arm.model)))))
    assert len(lines) == 6 * 2 + 1
    worn = [line for line in lines if line["robot"] == "r5" and line["target"] == "shoulder"]
    assert worn[0]["outlier"] == "1" and float(worn[0]["low"]) == pytest.approx(0.156)
    assert lines[-1]["problem"] == "run0.npz: no time"
