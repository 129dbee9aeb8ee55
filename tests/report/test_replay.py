"""The page of `orbisim replay`."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import orbisim
from orbisim import load_scene
from orbisim.recording import capture
from orbisim.replay import Replay
from orbisim.report.replay import _by_time, _command, _most_telling, _summary, _times
from tests.recording.scenes import EVERYTHING, PENDULUM, simulate


@pytest.fixture(scope="module")
def result() -> Replay:
    scene = load_scene(PENDULUM)
    return orbisim.replay(scene, capture(scene, simulate(scene, 300), noise=1e-3), window=0.1)


def test_a_page_about_a_simulation_that_diverges(tmp_path: Path) -> None:
    stiff = EVERYTHING.replace('stiffness="20"', 'stiffness="1e9"')
    scene = load_scene(EVERYTHING)
    recording = capture(scene, simulate(scene, 100))
    result = orbisim.replay(load_scene(stiff), recording, window=0.1)
    assert result.diverged
    text = result.report(tmp_path).read_text()
    assert "became non-finite" in text


def test_quantiles_over_time() -> None:
    rng = np.random.default_rng(0)
    since, size = rng.uniform(0, 1, 100_000), rng.uniform(0, 1, 100_000)
    time, (low, middle, high) = _by_time(since, (1 + since) * size)
    assert len(time) == 120
    np.testing.assert_allclose(middle, (1 + time) * 0.5, rtol=0.1)
    np.testing.assert_allclose(high, (1 + time) * 0.95, rtol=0.05)
    np.testing.assert_allclose(low, (1 + time) * 0.05, rtol=0.5)
    few, _ = _by_time(since[:30], np.append(size[:29], np.nan))
    assert len(few) == 2


def test_how_many_times(result: Replay) -> None:
    words = [_times(ratio) for ratio in (0.5, 1.4, 2.5, 1234.0)]
    assert words == ["as large as that"] * 2 + ["2.5 times smaller", "1,234 times smaller"]


def test_one_sentence_and_the_command(result: Replay) -> None:
    text = _summary(result)
    assert text.startswith(f"Over {len(result.windows)} windows of 100 ms, joint positions are off")
    assert f"{result.rms:.3g} rad (rms)" in text
    assert _command(result).endswith("--backend mujoco --window 0.1")
    mapped = dataclasses.replace(result, map_file="a map.yaml")
    assert "--map 'a map.yaml' --backend" in _command(mapped)


def test_joint_positions_are_shown_first(result: Replay) -> None:
    assert _most_telling(result, 1) == list(result.positions)[:1]
    assert _most_telling(result, 100) == list(result.signals)


def test_a_page_stands_alone(result: Replay, tmp_path: Path) -> None:
    page = result.report(tmp_path).read_text()
    assert "The worst window" in page
    assert "The median window" in page
    assert _summary(result) in page
    assert 'src="http' not in page
