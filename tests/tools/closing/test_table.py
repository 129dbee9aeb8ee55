"""The table of measured sets: what is in it, and which goals it says are reached."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "tools"))

from closing import running, scoring, table
from closing.plans import PLANS, Plan

from orbisim import Recording


def plan(name: str) -> Plan:
    return next(one for one in PLANS if one.name == name)


def result(error: float, *names: tuple[str, str], verdict: str = "partly_explained") -> Any:
    numbers = {"torque": {"value": 21.5, "ci95": [18.6, 24.4], "unit": "N"}}
    effects = [{"effect": e, "target": t, "parameters": numbers} for e, t in names]
    return {"held_out": {"all": error}, "effects": effects, "verdict": verdict, "seconds": 9.0}


def test_goals_are_reached_or_not() -> None:
    others = {"declared": result(22.0), "published": result(0.6), "recipe": result(0.9)}
    good = table.reached(
        plan("emps"), {**others, "diagnosed": result(0.61, ("coulomb_friction", "carriage"))}
    )
    assert good == {goal: True for goal in table.GOALS if goal != table.GOALS[2]}  # no sysid yet
    bad = table.reached(plan("emps"), {**others, "diagnosed": result(22.0, verdict="no_residual")})
    assert not any(bad.values())
    assert not any(
        table.reached(plan("emps"), {**others, "diagnosed": {"failure": "late"}}).values()
    )


def test_a_row_has_intervals_beside_the_literature() -> None:
    found = {"emps": {"diagnosed": result(0.61, ("coulomb_friction", "carriage"))}}
    text = table.markdown(found)
    assert "| - | 0.61 | - |" in text
    assert "coulomb_friction at carriage (torque 21.5 ± 2.9 N) | Coulomb 20.39 N" in text
    failed = table.markdown({"emps": {"diagnosed": {"failure": "no answer after 780 s"}}})
    assert "no answer after 780 s" in failed


def test_what_has_a_result_is_not_run_again(tmp_path: Path) -> None:
    path = running.path_of(tmp_path, "emps", "declared")
    path.parent.mkdir()
    path.write_text(json.dumps(result(22.0)))
    jobs = [running.Job("emps", "declared", 1.0)]
    assert not list(running.run_all(jobs, tmp_path, tmp_path, 1, 0.0))
    assert running.results_of(tmp_path)["emps"]["declared"]["held_out"]["all"] == 22.0
    # no time left: nothing is begun, and nothing is said to have failed
    jobs = [running.Job("emps", "recipe", 1.0)]
    assert not list(running.run_all(jobs, tmp_path, tmp_path, 1, 1e-9))


def test_the_plain_recipe_finds_friction_and_offset(tmp_path: Path) -> None:
    import numpy as np
    from scipy.integrate import cumulative_trapezoid

    time = np.arange(0, 8, 0.002)
    speed = 0.12 * np.sin(5 * time) + 0.06 * np.sin(2.2 * time + 1)
    position = cumulative_trapezoid(speed, time, initial=0)
    pushed = 95.1 * np.gradient(speed, time) + 20 * np.sign(speed) + 200 * speed - 3
    gain = float(plan("emps").scene().model.actuator_gainprm[0, 0])
    run = Recording(time, {"qpos/carriage": position, "ctrl/drive": pushed / gain})
    folder = tmp_path / "recordings" / "emps"
    folder.mkdir(parents=True)
    for name in ("fit.npz", "held.npz"):
        run.save(folder / name)
    split = {"fit": ["fit.npz"], "held_out": ["held.npz"]}
    (folder / "split.json").write_text(json.dumps(split))
    found = scoring.result_of(plan("emps"), "recipe", tmp_path, 1.0)
    values = {one["effect"]: one["value"] for one in found["numbers"]}
    assert values["coulomb_friction"] == pytest.approx(20, rel=0.1)
    assert values["viscous_damping"] == pytest.approx(200, rel=0.1)
    assert values["torque_bias"] == pytest.approx(3, rel=0.1)
    declared = scoring.result_of(plan("emps"), "declared", tmp_path, 1.0)
    assert found["held_out"]["all"] < 0.1 * declared["held_out"]["all"]
