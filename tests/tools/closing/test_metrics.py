"""The metrics by which measured data sets are scored."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import orbisim
from orbisim import Recording
from orbisim.effects import EffectInstance, add_effects

TOOLS = Path(__file__).resolve().parents[3] / "tools"
SLIDE = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>
  <body><joint name="x" type="slide" axis="1 0 0" stiffness="40"/><geom size=".05" mass="1"/></body>
</worldbody><actuator><motor name="push" joint="x"/></actuator></mujoco>"""


@pytest.fixture(scope="module", autouse=True)
def _tools_on_path() -> Iterator[None]:
    sys.path.insert(0, str(TOOLS))
    yield
    sys.path.remove(str(TOOLS))


def metrics() -> Any:
    return importlib.import_module("closing.metrics")


def scene() -> orbisim.Scene:
    return orbisim.load_scene(SLIDE)


def test_a_noisy_start_does_not_count_from_the_best_one() -> None:
    time = np.arange(0, 2, 0.01)
    true = 0.3 * np.cos(np.sqrt(40) * time)
    noisy = true + 0.003 * np.random.default_rng(0).standard_normal(len(time))
    run = Recording(time=time, signals={"qpos/x": noisy})
    found = metrics().best_start(2.0).measure(scene(), [run], ())
    assert found.figures["all"] == pytest.approx(0.003, rel=0.15)


def test_the_force_that_drives_the_motion_is_not_missing() -> None:
    time = np.arange(0, 4, 0.01)
    motion, second = 0.2 * np.sin(3 * time), -1.8 * np.sin(3 * time)
    force = second + 40 * motion
    run = Recording(time=time, signals={"qpos/x": motion, "ctrl/push": force + 0.5})
    found = metrics().torque_residual(scene, 10.0).measure(scene(), [run], ())
    assert found.figures["all axes"] == pytest.approx(0.5, rel=0.02)


def test_forces_are_missing_at_the_declared_joints_alone() -> None:
    """An elastic transmission adds a joint, which no recording shows."""
    time = np.arange(0, 4, 0.01)
    motion, second = 0.2 * np.sin(3 * time), -1.8 * np.sin(3 * time)
    run = Recording(time=time, signals={"qpos/x": motion, "ctrl/push": second + 40 * motion})
    spring = EffectInstance("joint_flexibility", "x", {"stiffness": 1e6, "damping": 1.0})
    elastic = add_effects(scene(), [spring])
    assert elastic.model.nv == 2
    found = metrics().torque_residual(scene, 10.0).measure(elastic, [run], ())
    assert set(found.figures) == {"all axes", "x"} and found.figures["all axes"] < 0.05


def test_every_set_is_in_one_half_and_has_recordings() -> None:
    plans = importlib.import_module("closing.plans").PLANS
    sets = {one.name for one in importlib.import_module("import_measured").DATA_SETS}
    assert {one.name for one in plans} == sets
    assert {one.half for one in plans} == {"developed", "judged"}
    told = (TOOLS.parent / "docs" / "closing-the-loop.md").read_text()
    rows = {row.split("|")[1].strip(): row for row in told.splitlines() if row.startswith("| ")}
    for one in plans:
        assert one.name in rows[one.half]
