"""What `recording info` says of a log."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from orbisim import load_scene
from orbisim.recording.files import opened
from orbisim.recording.summary import Summary, summarize

from .scenes import PENDULUM

pd = pytest.importorskip("pandas")

TIME = np.arange(0, 4, 0.01)


def of(folder: Path, **columns: object) -> Summary:
    pd.DataFrame({"time": TIME, **columns}).to_csv(folder / "log.csv", index=False)
    return summarize(opened(folder / "log.csv"))


def test_facts(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    wave = np.sin(3 * TIME) + 0.01 * rng.standard_normal(len(TIME))
    wave[:10] = np.nan
    found = of(tmp_path, wave=wave)
    (clock,), (column,) = found.clocks, found.columns
    assert (clock.samples, clock.gaps, clock.column) == (400, 0, "time")
    assert clock.rate_hz == pytest.approx(100)
    assert column.noise == pytest.approx(0.01, rel=0.2)
    assert (column.missing, column.step) == (pytest.approx(10 / 400), 0.0)


ODD = {
    "constant": (np.full(400, 3.0), "'x' stays at 3"),
    "coarse": (np.round(3 * np.sin(TIME)), "'x' moves in 5 steps only"),
    "slow": (np.repeat(np.sin(np.arange(80) / 9), 5), "'x' repeats itself in 80% of the samples"),
    "holes": (np.where(np.arange(400) % 3, np.sin(TIME), np.nan), "34% of its samples are missing"),
    "empty": (np.full(400, np.nan), "'x' has no values"),
}


@pytest.mark.parametrize("name", ODD)
def test_what_looks_odd(tmp_path: Path, name: str) -> None:
    values, text = ODD[name]
    assert any(text in one for one in of(tmp_path, x=values).suspicions)


def test_a_plain_log_raises_no_suspicion(tmp_path: Path) -> None:
    assert of(tmp_path, x=np.sin(TIME), y=np.cos(3 * TIME)).suspicions == ()


def test_gaps_and_times_that_do_not_increase(tmp_path: Path) -> None:
    time = TIME.copy()
    time[100:] += 0.5
    time[50] = time[49]
    found = of(tmp_path, time=time, x=np.sin(TIME))
    assert found.clocks[0].gaps == 1
    assert found.clocks[0].longest_s == pytest.approx(0.51)
    assert "'time' does not increase at 1 of 400 rows" in found.suspicions


def test_degrees_are_suspected_where_a_scene_says_angle(tmp_path: Path) -> None:
    frame = pd.DataFrame({"time": TIME, "hinge_pos": 80 * np.sin(TIME), "motor_cmd": np.cos(TIME)})
    frame.to_csv(tmp_path / "log.csv", index=False)
    found = summarize(opened(tmp_path / "log.csv"), load_scene(PENDULUM))
    assert any("are these degrees?" in text for text in found.suspicions)


def test_a_log_without_time_is_still_described(tmp_path: Path) -> None:
    pd.DataFrame({"a": [1.0, 2.0, 4.0]}).to_csv(tmp_path / "log.csv", index=False)
    found = summarize(opened(tmp_path / "log.csv"))
    assert found.clocks == ()
    assert found.columns[0].highest == 4.0
    assert "has no 'time'" in found.suspicions[0]
