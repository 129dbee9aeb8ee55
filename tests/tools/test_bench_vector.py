"""Figures of mujoco_playground that another Python measures, whatever becomes of it."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import orbisim

pytest.importorskip("gymnasium")
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))

import bench_vector

MEASURES = """#!/bin/sh
task=$3
while [ "$1" != --out ]; do shift; done
echo '{"found": {"'$task'": 1.0}}' > "$2"
"""


def options(folder: Path, then: str, limit: float = 0.0) -> Any:
    python = folder / "python"
    python.write_text(MEASURES + then)
    python.chmod(0o755)
    return argparse.Namespace(
        playground=str(python),
        playground_tasks=["cheetah-run", "walker-walk"],
        playground_worlds=[64],
        seconds=0.1,
        repeats=1,
        impl="jax",
        contacts=0,
        limit=limit,
        begun=time.monotonic(),
    )


@pytest.mark.parametrize(
    ("then", "limit", "failed"),
    [("", 0.0, None), ("exit 3", 0.0, "exit status 3"), ("exec sleep 60", 5.0, "out of time")],
)
def test_what_playground_has_measured_is_kept(
    tmp_path: Path, then: str, limit: float, failed: str | None
) -> None:
    found = bench_vector.playground(options(tmp_path, then, limit))
    assert found["found"] == {"CheetahRun": 1.0}
    assert found.get("failed") == failed


def test_where_the_time_of_a_step_goes() -> None:
    placed = pytest.importorskip("tests.vector.placed")
    environment = orbisim.vector.load(
        "cartpole", "swingup", 2, placed.PlacedBackend(), seed=0, arrays="torch"
    )
    actions = [np.zeros((2, 1))] * 3
    found = bench_vector.profiled(environment, actions, 5)
    assert set(found) == {"step", "task", "rest", "together", "reset", "graph"}
    assert found["step"] > 0 and found["task"] > 0
    assert found["graph"] == "a CPU has no graphs"
    assert "step" not in vars(environment._worlds), "it is as it was"
    assert environment.step(actions[0]).reward.shape == (2,)
