"""Recordings along a scene: the reference motion, and timesteps between samples."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import orbisim
from orbisim.motion.samples import extent, prepare_all, substeps
from orbisim.recording.thinning import MOST_SAMPLES, thinned
from orbisim.testing import inject_effect

ARM = Path(__file__).parents[2] / "mjcf_assets" / "arm2" / "scene.xml"


@given(st.floats(1e-4, 0.1), st.floats(1e-4, 0.02))
def test_no_timestep_is_longer_than_declared_by_more_than_a_little(
    duration: float, timestep: float
) -> None:
    count = int(substeps(duration, timestep))
    assert duration / count <= 1.0501 * timestep
    assert count == 1 or duration / (count - 1) > 1.0499 * timestep


@pytest.mark.parametrize("clock", [0.97, 1.0, 1.0 + 1e-9, 1.014, 1.04])
def test_a_clock_that_is_a_little_off_costs_no_timestep(clock: float) -> None:
    """Five timesteps of 2 ms between samples."""
    np.testing.assert_array_equal(substeps(np.full(3, 0.01 * clock), 0.002), 5)


def test_deviations_are_measured_minus_reference_and_noise_is_pooled() -> None:
    arm = orbisim.load_scene(ARM)
    runs = inject_effect(arm, [], duration=1.0, episodes=2, noise=1e-3, seed=1)
    every = prepare_all(runs, arm)
    for run, one in zip(runs, every, strict=True):
        measured = np.stack([run["qpos/shoulder"], run["qpos/elbow"]], axis=1).squeeze()
        np.testing.assert_allclose(one.qpos + one.dq, measured, atol=1e-12)
        assert one.usable.all()
    np.testing.assert_allclose(every[0].q_noise, 1e-3, rtol=0.3)
    np.testing.assert_array_equal(every[0].q_noise, every[1].q_noise)
    assert extent(every).duration == pytest.approx(runs[0].duration)


def test_controls_between_the_samples_of_a_thinned_recording_are_those_of_the_whole() -> None:
    arm = orbisim.load_scene(ARM)
    (run,) = inject_effect(arm, [], duration=3.0, episodes=1, noise=1e-3, seed=1)
    window = float(4 * MOST_SAMPLES * np.diff(run.time).mean())
    (few,), (whole,) = prepare_all(thinned([run], window, []), arm), prepare_all([run], arm)
    assert len(whole) == pytest.approx(4 * len(few), abs=4)
    ctrl, force = few.inputs(4)
    within = 4 * (len(few) - 1)
    np.testing.assert_allclose(ctrl[:-1].reshape(within, -1), whole.ctrl[:within], atol=1e-12)
    np.testing.assert_allclose(force[:-1].reshape(within, -1), whole.force[:within], atol=1e-12)
    np.testing.assert_allclose(few.inputs(1)[0][:-1, 0], few.ctrl[:-1], atol=1e-12)
    assert np.ptp(ctrl[:-1], axis=1).max() > 0.1  # which means would have lost
