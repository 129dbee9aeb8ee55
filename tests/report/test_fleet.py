"""The page of a fleet."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import orbisim
from orbisim.fleet.run import Fleet
from orbisim.fleet.table import RULE, Robot, rows_of
from orbisim.report.fleet import write_report

SCENE = Path(__file__).parents[2] / "mjcf_assets" / "arm2" / "scene.xml"


def robot(name: str, level: float) -> Robot:
    torque = {"value": level, "unit": "N*m", "ci95": [level - 0.004, level + 0.004]}
    report: dict[str, Any] = {
        "effects": [{"effect": "coulomb_friction", "target": "elbow",
                     "parameters": {"torque": torque}}],
        "error": {"held_out": {"before": 1.0, "after": 1e-3}, "noise_floor": 1e-3},
        "verdict": "explained", "sentence": "The elbow drags.",
    }  # fmt: skip
    return Robot(name, report, "")


def page(robots: list[Robot], folder: Path) -> str:
    rows = rows_of(robots, orbisim.load_scene(SCENE).model)
    return write_report(Fleet("arm.xml", tuple(robots), rows), folder / "report.html").read_text()


def test_outliers_are_marked_and_every_robot_is_there(tmp_path: Path) -> None:
    robots = [robot(f"arm{i}", 0.1 + 0.001 * i) for i in range(5)]
    text = page([*robots, robot("worn one", 0.2), Robot("bad", None, "no <recordings>")], tmp_path)
    assert "worn one differs from the others; no diagnosis of bad." in text
    assert text.count("&#9888;") == 2  # in the table, and at its name
    assert "no &lt;recordings&gt;" in text and "no <recordings>" not in text
    assert 'href="robots/worn%20one/report.html"' in text and "0.196 to 0.204" in text
    assert "3.5 sqrt(s^2 + e^2)" in RULE and "3.5 sqrt(s^2 + e^2)" in text


def test_a_fleet_without_outliers_says_so(tmp_path: Path) -> None:
    text = page([robot(f"arm{i}", 0.1) for i in range(5)], tmp_path)
    assert "none differs from the others." in text and "&#9888;" not in text
