"""Free runs on held-out data."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from orbisim.report.held_out import _growth, forces, growth, per_window
from orbisim.report.shape import Degree

DEGREE = Degree("elbow", "elbow", 1, 1, "rad", "N*m")


def replay(errors: int = 1, windows: int = 20) -> Any:
    """Windows of 1 s whose error grows with the time since their start, in each of so many."""
    time = np.linspace(0, 1, 101)
    error = {f"qpos/{i}": 0.3 * time for i in range(errors)}
    parts = [SimpleNamespace(time=7.0 * w + time, error=error, rms=0.1) for w in range(windows)]
    return SimpleNamespace(windows=parts, positions=tuple(error))


@pytest.mark.parametrize("errors", [1, 4])
def test_the_error_grows_as_it_does(errors: int) -> None:
    since, error = _growth(replay(errors))
    assert len(since) == 25
    assert since[0] == pytest.approx(0.02, abs=0.01)
    np.testing.assert_allclose(error, 0.3 * since * np.sqrt(errors), atol=0.01)


def test_what_is_not_known_does_not_count() -> None:
    one = replay()
    one.windows[0].error["qpos/0"][50:] = np.nan
    since, error = _growth(one)
    assert since.max() < 0.51
    assert np.isfinite(error).all()


def test_charts_name_what_they_show() -> None:
    sides = [("as declared", "#ff0000", replay(), None), ("after", "#00ff00", replay(), None)]
    for drawn in (growth(sides, "rad", 0.01), per_window(sides, "rad")):  # type: ignore[arg-type]
        for text in ("as declared", "after", "#ff0000", "#00ff00", "rad"):
            assert text in drawn
    courses = [("recorded", "#123456", np.zeros((5, 2)))]
    drawn = forces(np.arange(5.0), courses, DEGREE, "run.npz")
    assert "Force at elbow, held out: run.npz" in drawn
    assert "N*m" in drawn
