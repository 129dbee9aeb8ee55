"""Recordings: reading, checking, smoothing, and putting them into a scene's order."""

from orbisim.recording.binding import bind
from orbisim.recording.bound import Bound
from orbisim.recording.capture import capture
from orbisim.recording.motion import (
    Motion,
    SmoothedRotation,
    estimate_motion,
    smooth_rotation,
)
from orbisim.recording.noise import noise_std
from orbisim.recording.recording import Recording, load_recordings
from orbisim.recording.resampling import resample
from orbisim.recording.smoothing import Smoothed, smooth

__all__ = [
    "Bound",
    "Motion",
    "Recording",
    "Smoothed",
    "SmoothedRotation",
    "bind",
    "capture",
    "estimate_motion",
    "load_recordings",
    "noise_std",
    "resample",
    "smooth",
    "smooth_rotation",
]
