"""Errors of simulated windows, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from orbisim import Recording, load_scene
from orbisim.freerun import Prepared, Run
from orbisim.recording import bind
from orbisim.recording.windows import Rows
from orbisim.replay import prepare
from orbisim.scores import Scores, score

SCENE = """
<mujoco>
  <worldbody>
    <body name="a"><joint name="x" type="slide"/><joint name="y" type="slide"/>
      <geom size=".1"/></body>
    <body name="b" pos="1 0 0"><joint name="turn" type="ball"/><geom size=".1" pos=".2 0 0"/></body>
  </worldbody>
</mujoco>
"""
TIME = 0.1 * np.arange(6)
REST = np.array([0.0, 0, 1, 0, 0, 0])


def about_z(angle: float) -> list[float]:
    return [np.cos(angle / 2), 0, 0, np.sin(angle / 2)]


def recorded(**missing: list[int]) -> Prepared:
    """Everything stands at its reference; some samples of some signals are missing."""
    signals = {
        "qpos/x": np.zeros(6),
        "qpos/y": np.zeros(6),
        "qpos/turn": np.tile([1.0, 0, 0, 0], (6, 1)),
    }
    for name, rows in missing.items():
        signals[f"qpos/{name}"][rows] = np.nan
    return prepare(bind(Recording(TIME, signals), load_scene(SCENE)), 0)


def run(qpos: np.ndarray, rows: Rows | None = None, *, diverged: bool = False) -> Run:
    rows = rows or Rows(0, 6)
    count = len(rows)
    time = TIME[rows.start : rows.stop]
    return Run(0, rows, time, qpos, np.zeros((count, 5)), np.zeros((count, 0)), None, diverged)


def moved(x: np.ndarray, y: float = 0.0, angle: float = 0.0) -> np.ndarray:
    qpos = np.tile(REST, (len(x), 1))
    qpos[:, 0], qpos[:, 1], qpos[:, 2:] = x, y, about_z(angle)
    return qpos


def test_errors_by_signal_and_over_all() -> None:
    x = np.array([0.0, 1, 2, 3, 4, 5])
    scores = score([recorded()], [run(moved(x, y=0.5, angle=0.3))])
    assert scores.positions == ("qpos/x", "qpos/y", "qpos/turn")
    by_name = scores.signals["qpos/x"]
    assert by_name.unit == "m"
    assert by_name.rms == pytest.approx(np.sqrt(np.mean(x**2)))
    assert by_name.median == 2.5
    assert by_name.p95 == pytest.approx(4.75)
    turn = scores.signals["qpos/turn"]
    assert (turn.unit, turn.rms, turn.median) == ("rad", pytest.approx(0.3), pytest.approx(0.3))
    assert scores.rms == pytest.approx(np.sqrt(np.mean(x**2) + 0.5**2 + 0.3**2))
    (window,) = scores.windows
    assert window.rms == scores.rms
    np.testing.assert_array_equal(window.simulated["qpos/x"][:, 0], x)
    np.testing.assert_array_equal(window.error["qpos/x"], x)


def test_missing_samples_count_for_nothing() -> None:
    scores = score([recorded(x=[1, 4])], [run(moved(np.array([1.0, 99, 1, 1, 99, 1])))])
    assert scores.signals["qpos/x"].rms == pytest.approx(1.0)
    assert np.isnan(scores.windows[0].error["qpos/x"]).tolist() == [0, 1, 0, 0, 1, 0]


def test_all_samples_of_all_windows_count_alike() -> None:
    """A long window weighs more than a short one."""
    short, long = Rows(0, 2), Rows(2, 6)
    runs = [run(moved(np.full(2, 3.0)), short), run(moved(np.zeros(4)), long)]
    scores = score([recorded()], runs)
    assert [w.rms for w in scores.windows] == [3.0, 0.0]
    assert scores.rms == pytest.approx(np.sqrt(2 * 9 / 6))
    assert [(w.start, w.stop) for w in scores.windows] == [(0, 2), (2, 6)]


def lost(rows: slice) -> Scores:
    qpos = moved(np.zeros(6))
    qpos[rows] = np.nan
    return score([recorded(x=[5])], [run(qpos, diverged=True)])


def test_what_is_lost_is_infinitely_wrong_but_where_nothing_was_measured() -> None:
    scores = lost(slice(4, 6))
    assert scores.windows[0].diverged
    error = scores.windows[0].error["qpos/x"]
    assert error[:5].tolist() == [0, 0, 0, 0, np.inf]
    assert np.isnan(error[5])
    assert scores.signals["qpos/x"].rms == scores.rms == np.inf
    assert scores.signals["qpos/x"].median == 0.0  # nothing is interpolated towards infinity
    assert scores.signals["qpos/x"].p95 == np.inf


def test_the_noise_is_the_recordings_own() -> None:
    rng = np.random.default_rng(0)
    time = 0.01 * np.arange(400)
    scene = load_scene(SCENE)
    parts = []
    for std in (0.01, 0.03):
        x = np.sin(3 * time) + std * rng.standard_normal(400)
        signals = {"qpos/x": x, "qpos/y": 0 * x, "qpos/turn": np.tile([1.0, 0, 0, 0], (400, 1))}
        parts.append(prepare(bind(Recording(time, signals), scene), 0))
    empty = np.zeros((400, 0))
    still = [
        Run(i, Rows(0, 400), time, moved(np.zeros(400)), np.zeros((400, 5)), empty, None, False)
        for i in range(2)
    ]
    scores = score(parts, still)
    expected = np.sqrt((0.01**2 + 0.03**2) / 2)
    assert scores.signals["qpos/x"].noise == pytest.approx(expected, rel=0.15)
    assert scores.rms == pytest.approx(np.sqrt(0.5 + expected**2), rel=0.05)
