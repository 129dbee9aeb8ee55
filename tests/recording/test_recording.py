"""The `Recording` value: immutable, comparable, cut, resampled."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import orbisim
from orbisim import Recording
from orbisim.errors import InputError, RecordingError
from orbisim.recording import resample
from orbisim.recording.quaternions import exp, log, multiply

from .scenes import EVERYTHING, simulate


@pytest.fixture
def recording():
    t = np.linspace(0, 2, 201)
    turn = exp(np.stack([0 * t, np.sin(t), t], axis=1))
    signals = {"qpos/a": np.sin(t), "ctrl/m": np.floor(10 * t + 1e-9), "xquat/b": turn}
    return Recording(t, signals)


def test_nobody_can_write_into_it(recording):
    values = np.zeros(2)
    other = Recording([0.0, 1.0], {"qpos/a": values})
    values[0] = 1
    assert other["qpos/a"][0] == 0
    with pytest.raises(ValueError, match="read-only"):
        recording.time[0] = 1
    with pytest.raises(ValueError, match="read-only"):
        recording["qpos/a"][0] = 1
    with pytest.raises(TypeError):
        recording.signals["qpos/a"] = 0


def test_equality_is_of_the_samples(recording):
    assert recording == recording.replace(source="elsewhere", notes=("x",), units={"qpos/a": "rad"})
    assert recording != recording.without("qpos/a")
    changed = np.array(recording["qpos/a"])
    changed[5] = np.nan
    other = recording.replace(signals={**recording.signals, "qpos/a": changed})
    assert other != recording
    assert other == pickle.loads(pickle.dumps(other))
    assert recording != 3


def test_unknown_signals_are_named(recording):
    with pytest.raises(RecordingError, match="'qpos/z' is not recorded; recorded: ctrl/m, qpos/a"):
        recording["qpos/z"]
    with pytest.raises(RecordingError, match="is not recorded"):
        recording.without("qpos/z")
    with pytest.raises(RecordingError, match="is not the name of a signal"):
        Recording([0.0], {"position": [1.0]})


def test_parts(recording):
    part = recording.between(0.5, 1.0)
    assert (part.time[0], part.time[-1], len(part)) == (0.5, 1.0, 51)
    assert set(recording.select(["ctrl/m"]).signals) == {"ctrl/m"}
    assert set(recording.select(lambda name: name.startswith("x")).signals) == {"xquat/b"}
    windows = recording.windows(0.5)
    assert [len(w) for w in windows] == [51] * 4
    assert recording.duration == 2.0


def test_resampling_follows_each_signal(recording):
    t = np.sort(np.random.default_rng(0).uniform(0, 2, 300))
    found = resample(recording, t)
    np.testing.assert_allclose(found["qpos/a"], np.sin(t), atol=2e-5)
    np.testing.assert_array_equal(
        found["ctrl/m"], np.floor(10 * np.floor(t * 100 + 1e-9) / 100 + 1e-9)
    )
    exact = exp(np.stack([0 * t, np.sin(t), t], axis=1))
    error = log(multiply(found["xquat/b"] * [1, -1, -1, -1], exact))
    assert np.abs(error).max() < 5e-5
    np.testing.assert_allclose(np.linalg.norm(found["xquat/b"], axis=1), 1, rtol=1e-12)


def test_resampling_at_its_own_times_changes_nothing(recording):
    assert resample(recording, recording.time) == recording


def test_resampling_keeps_gaps(recording):
    values = np.array(recording["qpos/a"])
    values[50] = np.nan
    gappy = recording.replace(signals={"qpos/a": values})
    found = resample(gappy, np.array([0.485, 0.495, 0.505, 0.515]))
    np.testing.assert_array_equal(np.isnan(found["qpos/a"]), [False, True, True, False])


def test_resampling_does_not_extrapolate(recording):
    with pytest.raises(InputError, match="reaches from 0 to 2 s"):
        resample(recording, np.array([1.0, 2.5]))


def test_whole_qpos_needs_the_scene_to_be_resampled():
    scene = orbisim.load_scene(EVERYTHING)
    trajectory = simulate(scene, 100)
    whole = Recording(np.arange(1, 101) * 0.002, {"qpos": trajectory.qpos[0]})
    t = whole.time[:-1] + 0.001
    with pytest.raises(InputError, match="pass the scene"):
        resample(whole, t)
    qpos = resample(whole, t, scene)["qpos"]
    for start in (5, 9):  # the cube's orientation and the ball joint
        np.testing.assert_allclose(np.linalg.norm(qpos[:, start : start + 4], axis=1), 1, rtol=1e-9)
    np.testing.assert_allclose(qpos, (whole["qpos"][1:] + whole["qpos"][:-1]) / 2, atol=1e-4)


def test_it_reads_well(recording):
    assert repr(recording) == (
        "Recording('recording', 201 samples over 2 s: ctrl/m, qpos/a, xquat/b)"
    )
