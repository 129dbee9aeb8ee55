"""Velocities that were made of the positions are told from those that were measured."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import scipy.signal

import orbisim
from orbisim.recording import Recording
from orbisim.recording.derived import independent
from orbisim.testing import inject_effect

Floats = npt.NDArray[np.float64]
NOISE = 1e-3
STEP = 0.01
ARM = Path(__file__).parents[2] / "mjcf_assets" / "arm2" / "scene.xml"


def _motion(seed: int, count: int = 500) -> tuple[Floats, Floats, Floats]:
    """Stamps, and positions and velocities [T, 2] of two joints; positions with noise."""
    rng, time = np.random.default_rng(seed), STEP * np.arange(count)
    rate, phase = rng.uniform(3, 9, (3, 2)), rng.uniform(0, 6, (3, 2))
    angle = time[:, None, None] * rate + phase
    velocity = (rate * np.cos(angle)).sum(axis=1)
    return time, np.sin(angle).sum(axis=1) + NOISE * rng.normal(size=(count, 2)), velocity


def _filtered(q: Floats, constant: float) -> Floats:
    """Differences through a first-order low pass of a time constant, s."""
    keep, found = np.exp(-STEP / constant), np.zeros_like(q)
    for k in range(1, len(q)):
        found[k] = keep * found[k - 1] + (1 - keep) * (q[k] - q[k - 1]) / STEP
    return found


def _joined(time: Floats, q: Floats, v: Floats) -> Recording:
    return Recording(time, {"qpos": q, "qvel": v, "ctrl": q}, source="run")


def _parted(time: Floats, q: Floats, v: Floats) -> Recording:
    return Recording(time, {"qpos/a": q[:, 0], "qvel/a": v[:, 0], "torque/a": q[:, 1]})


@pytest.mark.parametrize("form", [_joined, _parted])
@pytest.mark.parametrize("constant", [1e-6, 0.0106])
def test_differences_and_filters_are_left_out(form, constant: float) -> None:  # type: ignore[no-untyped-def]
    runs = []
    for seed in range(3):
        time, q, _ = _motion(seed)
        runs.append(form(time, q, _filtered(q, constant)))
    found, others = independent(runs[:2], runs[2:])
    for one in (*found, *others):
        assert not any(name.startswith("qvel") for name in one.signals)
        assert any(name.startswith("qpos") for name in one.signals)
        assert sum("made of the positions" in note for note in one.notes) == 1


@pytest.mark.parametrize(
    "smoothed",
    [
        lambda q: np.gradient(q, STEP, axis=0),
        lambda q: scipy.signal.savgol_filter(q, 21, 3, deriv=1, delta=STEP, axis=0),
        lambda q: scipy.signal.filtfilt(
            *scipy.signal.butter(2, 0.3), np.gradient(q, STEP, axis=0), axis=0
        ),
    ],
    ids=["central", "polynomials", "to and fro"],
)
def test_filters_that_are_not_late_are_told_too(smoothed) -> None:  # type: ignore[no-untyped-def]
    """Logs are smoothed afterwards, from both sides."""
    runs = []
    for seed in range(3):
        time, q, _ = _motion(seed)
        runs.append(_joined(time, q, smoothed(q)))
    assert all("qvel" not in one.signals for one in independent(runs)[0])


@pytest.mark.parametrize("noise", [1e-4, 0.1])
def test_measured_velocities_stay(noise: float) -> None:
    """By a good sensor and by a poor one, whether they are late or not."""
    runs = []
    for seed in range(3):
        time, q, v = _motion(seed)
        late = np.stack([np.interp(time - 0.008, time, c) for c in v.T], axis=1)
        rng = np.random.default_rng(seed + 100)  # none of the positions' numbers once more
        runs.append(_joined(time, q, late + noise * rng.normal(size=v.shape)))
    assert all(a is b for a, b in zip(independent(runs)[0], runs, strict=True))


def test_what_cannot_be_told_stays() -> None:
    """At rest, too short, of a free body, without velocities, or in few of the recordings."""
    time, q, v = _motion(0)
    made = _joined(time, q, _filtered(q, 0.0106))
    for one in (
        _joined(time, np.zeros_like(q), np.zeros_like(q)),
        made.rows(np.arange(60)),
        Recording(time, {"qpos": np.ones((len(time), 7)), "qvel": np.ones((len(time), 6))}),
        Recording(time, {"qpos": q}),
    ):
        assert independent([one])[0][0] is one
    measured = [_joined(time, q, v + 0.01 * np.random.default_rng(k + 100).normal(size=v.shape))
                for k in range(2)]  # fmt: skip
    assert independent([made, *measured])[0][0] is made


def test_late_velocities_are_no_residual() -> None:
    """A right scene misses velocities that a filter of 15 Hz has made."""
    arm = orbisim.load_scene(ARM)
    runs = []
    for one in inject_effect(arm, [], duration=4.0, episodes=3, noise=5e-4, seed=3):
        signals = dict(one.signals)
        for name in [n for n in signals if n.startswith("qvel")]:
            signals[name] = _filtered(signals["qpos" + name[4:]], 0.0106)
        runs.append(one.replace(signals=signals))
    result = orbisim.diagnose(arm, runs, progress=False)
    assert result.verdict == "no_residual"
    assert any("were made of the positions" in note for note in result.notes)
