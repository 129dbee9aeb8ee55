"""Readings at the end of a sensor's range."""

from __future__ import annotations

import numpy as np
import pytest

from orbisim.recording import Recording
from orbisim.recording.suspicious import within_range

TIME = np.arange(400) * 0.01
SWING = np.sin(3 * TIME)
NOISE = 2e-4 * np.random.default_rng(0).normal(size=len(TIME))


def _run(values: np.ndarray) -> Recording:
    return Recording(time=TIME, signals={"qpos/hinge": values})


def test_clipped_readings_are_missing() -> None:
    read = np.clip(SWING + NOISE, -0.6, 0.7)
    run = within_range(_run(read))
    found = run.signals["qpos/hinge"]
    beyond = (read == -0.6) | (read == 0.7)
    assert beyond.mean() > 0.3
    np.testing.assert_array_equal(np.isnan(found), beyond)
    np.testing.assert_array_equal(found[~beyond], read[~beyond])
    assert f"clipped; {beyond.sum()} of 400 readings count as missing" in run.notes[-1]


@pytest.mark.parametrize(
    "read",
    [
        SWING + NOISE,
        np.clip(SWING, -0.6, 0.7) + NOISE,
        np.round(np.clip(SWING, -0.6, 0.7) / 1.5e-3) * 1.5e-3,
        np.where(TIME < 0.5, 0.0, 1 - np.cos(np.maximum(TIME - 0.5, 0.0))),
    ],
    ids=["free", "hard stop", "rounded, hard stop", "from rest"],
)
def test_what_a_body_does_stays(read: np.ndarray) -> None:
    run = _run(read)
    assert within_range(run) is run
