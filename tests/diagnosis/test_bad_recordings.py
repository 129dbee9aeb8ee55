"""Recordings with something wrong in them: a clear message, and never a wrong name."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import orbisim
from orbisim.diagnosis.settings import Settings
from orbisim.errors import InputError, RecordingError
from orbisim.recording import Recording
from orbisim.testing import inject_effect

ASSETS = Path(__file__).parents[2] / "mjcf_assets"
SETTINGS = Settings(patience=40.0)


@pytest.fixture(scope="module")
def clean(arm: orbisim.Scene) -> list[Recording]:
    """Four recordings of the arm without any effect."""
    return inject_effect(arm, [], seed=5, duration=2.5, episodes=4, noise=2e-4)


def _each(runs: list[Recording], change: Callable[[np.ndarray], np.ndarray]) -> list[Recording]:
    """Recordings of the positions and controls, the positions changed."""
    return [
        one.replace(
            signals={
                name: change(values) if name.startswith("qpos/") else values
                for name, values in one.signals.items()
                if not name.startswith("qvel")
            }
        )
        for one in runs
    ]


def _diagnosed(scene: orbisim.Scene, runs: list[Recording]) -> orbisim.Diagnosis:
    return orbisim.diagnose(scene, runs, settings=SETTINGS, progress=False)


@pytest.mark.slow
def test_clipped_positions(arm: orbisim.Scene, clean: list[Recording]) -> None:
    limit = 0.7 * min(np.abs(one["qpos/elbow"]).max() for one in clean)
    found = _diagnosed(arm, _each(clean, lambda q: np.clip(q, -limit, limit)))
    assert any("clipped;" in note and "count as missing" in note for note in found.notes)
    assert found.verdict in ("no_residual", "unexplained"), found.sentence
    assert not found.effects


def test_quantised_positions(arm: orbisim.Scene, clean: list[Recording]) -> None:
    step = 2 * np.pi / 4096
    found = _diagnosed(arm, _each(clean, lambda q: step * np.round(q / step)))
    assert not found.effects, found.sentence


def test_gaps(arm: orbisim.Scene, clean: list[Recording]) -> None:
    def holes(q: np.ndarray) -> np.ndarray:
        q = q.copy()
        q[100:130] = q[200:205] = np.nan
        return q

    found = _diagnosed(arm, _each(clean, holes))
    assert found.verdict == "no_residual", found.sentence


def test_time_that_jumps_back(tmp_path: Path, clean: list[Recording]) -> None:
    path = tmp_path / "run.csv"
    clean[0].save(path)
    lines = path.read_text().splitlines()
    lines[50:60] = lines[20:30]
    path.write_text("\n".join(lines))
    with pytest.raises(RecordingError, match="time"):
        orbisim.diagnose(ASSETS / "arm2" / "scene.xml", path, progress=False)


def test_a_scene_that_does_not_match(clean: list[Recording]) -> None:
    with pytest.raises(RecordingError, match="no such joint"):
        orbisim.diagnose(ASSETS / "cart_pole" / "scene.xml", clean, progress=False)


def test_held_out_data_too_short_is_said_before_the_search(
    arm: orbisim.Scene, clean: list[Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    def searched(*_: object) -> None:
        raise AssertionError("the search has begun")

    monkeypatch.setattr("orbisim.diagnosis.run.attribute", searched)
    short = clean[3].rows(slice(0, 4))
    with pytest.raises(InputError, match=r"held-out data .*no stretch of the recordings"):
        orbisim.diagnose(arm, clean[:3], short, progress=False)
