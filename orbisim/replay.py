"""`orbisim.replay`: free-running simulation against recordings.

Every recording is cut into windows; each window starts from the recorded state and runs free under
the recorded controls to its end. The error of a signal is taken over all samples of all windows.
"""

from __future__ import annotations

import dataclasses
import inspect
import sys
import types
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from orbisim import plugins
from orbisim.backend import Backend
from orbisim.errors import InputError, RecordingError
from orbisim.files.writing import make_folder, write_json
from orbisim.freerun import WORLDS, Prepared, free_run
from orbisim.recording import Recording, bind
from orbisim.recording.bound import Bound
from orbisim.recording.clocks import slow
from orbisim.recording.degrees import MOST, suspected
from orbisim.recording.initial import Starts, Velocities, starts
from orbisim.recording.joints import joints
from orbisim.recording.recording import common_map
from orbisim.recording.windows import cut
from orbisim.registry import make_backend
from orbisim.scene import Scene, load_scene
from orbisim.scores import SignalError, Window, score

SCHEMA = "orbisim.replay/1"

__all__ = ["Replay", "SignalError", "Window", "prepare", "replay"]

_MOST_STEPS = 100_000
"""Timesteps between two samples: minutes, at usual timesteps; no measurement is so sparse."""


@dataclasses.dataclass(frozen=True, eq=False)
class Replay:
    """Result of `replay`.

    Attributes:
      scene, backend: as the user named them.
      window_s: duration of a window, s; 0 for whole recordings.
      recordings: the recordings, as the user named them.
      map_file: by which all of them were read, if there is one.
      windows: the windows, in the order of the recordings.
      signals: errors by signal. positions: those of them that are joint positions.
      rms: root mean squared norm of the error over joint positions (SI).
      notes: what was ignored, assumed or looks wrong.
    """

    scene: str
    backend: str
    window_s: float
    recordings: tuple[str, ...]
    windows: tuple[Window, ...]
    signals: Mapping[str, SignalError]
    positions: tuple[str, ...]
    rms: float
    notes: tuple[str, ...]
    map_file: str | None = None

    @property
    def diverged(self) -> int:
        """Number of windows in which the simulation became non-finite."""
        return sum(window.diverged for window in self.windows)

    @property
    def unit(self) -> str:
        """Unit of `rms`; joints that slide and joints that turn give "rad or m"."""
        units = {self.signals[name].unit for name in self.positions}
        return " or ".join(unit for unit in ("rad", "m") if unit in units)

    def noise_floor(self, name: str) -> float:
        """The rms that the noise of the measurement alone would give a signal; NaN if unknown."""
        width = next((w.measured[name].shape[1] for w in self.windows if name in w.measured), 1)
        axes = 3 if width == 4 and self.signals[name].unit == "rad" else width  # quaternions
        return float(self.signals[name].noise * np.sqrt(axes))

    def to_json(self) -> dict[str, Any]:
        """The result as contracts.md, section 2, has it; infinite and unknown numbers are None."""
        return {
            "schema": SCHEMA,
            "scene": self.scene,
            "backend": self.backend,
            "window_s": self.window_s,
            "windows": len(self.windows),
            "signals": {
                name: {
                    key: value if isinstance(value, str) else _finite(value)
                    for key, value in dataclasses.asdict(error).items()
                }
                for name, error in self.signals.items()
            },
            "overall": {"rms": _finite(self.rms)},
        }

    def report(self, folder: str | Path) -> Path:
        """Writes `report.html` and `report.json` into a folder; returns the path of the page."""
        folder = make_folder(folder)
        write_json(folder / "report.json", self.to_json())
        write_report = plugins.load("orbisim.reports", "replay", "report")
        page: Path = write_report(self, folder / "report.html")
        return page


def replay(
    scene: str | Path | Scene,
    recordings: Recording | str | Path | Sequence[Recording | str | Path],
    *,
    backend: str | Backend = "mujoco",
    window: float = 0.5,
    device: str | None = None,
    velocities: Velocities = "recorded",
) -> Replay:
    """Simulates windows of recordings from their recorded states and compares.

    Args:
      scene: a path or task name, or a scene.
      recordings: one or several, or paths of their files.
      backend: name or object.
      window: duration of a window, s; 0 runs each recording from its first sample to its end.
      device: where a backend given by name computes.
      velocities: whether windows start with the `recorded` velocities, where there are any, or with
        `smoothed` ones, differentiated from the positions.

    Raises:
      RecordingError: a recording cannot be read, does not fit the scene, or its state is nowhere
        known.
      SceneError: the scene cannot be read, or the backend cannot simulate it.
    """
    if velocities not in ("recorded", "smoothed"):
        raise InputError(f"velocities are 'recorded' or 'smoothed'; got {velocities!r}")
    loaded = scene if isinstance(scene, Scene) else load_scene(scene)
    named = loaded.source if isinstance(scene, Scene) else str(scene)
    prepared = [prepare(bind(one, loaded), window, velocities) for one in _load_all(recordings)]
    engine = _backend(backend, loaded, sum(len(one.windows) for one in prepared), device)
    runs = free_run(engine, loaded, prepared)
    scores = score(prepared, runs)
    return Replay(
        scene=named,
        backend=backend if isinstance(backend, str) else engine.name,
        window_s=float(window),
        recordings=tuple(one.bound.recording.source for one in prepared),
        windows=scores.windows,
        signals=scores.signals,
        positions=scores.positions,
        rms=scores.rms,
        notes=(*_notes(prepared, scores.windows), *_degrees(prepared, scores.signals)),
        map_file=common_map(one.bound.recording for one in prepared),
    )


def prepare(bound: Bound, window: float, velocities: Velocities = "recorded") -> Prepared:
    """A recording with its initial states and windows.

    Raises:
      RecordingError: the state is nowhere known.
    """
    _check_interval(bound, window)
    states = starts(bound, velocities)
    windows = cut(bound.time, window, states.usable)
    if not windows:
        raise RecordingError(
            bound.recording.source,
            f"no window can start: {_unknown(bound, states)}",
            remedy="missing samples are bridged over up to 256 sampling intervals",
        )
    late = len(set(cut(bound.time, window)) - set(windows))
    notes = [f"{late} windows start later or are left out, as the state is not known before"]
    return Prepared(bound, states, tuple(windows), tuple(notes if late else ()))


def _unknown(bound: Bound, states: Starts) -> str:
    """Why no sample is a whole state."""
    never = [
        joint.label
        for joint in joints(bound.model)
        if not (
            np.isfinite(states.qpos[:, joint.q]).all(axis=1)
            & np.isfinite(states.qvel[:, joint.v]).all(axis=1)
        ).any()
    ]
    if not never:
        return "at no sample are all joint positions known"
    return f"at no sample are position and velocity of {', '.join(map(repr, never))} known"


def _check_interval(bound: Bound, window: float) -> None:
    """Refuses samples that are too far apart for windows, or for any simulation between them."""
    if len(bound.time) < 2:
        return
    interval = float(np.median(np.diff(bound.time)))
    steps = interval / bound.model.opt.timestep
    if steps > _MOST_STEPS:
        raise RecordingError(
            bound.recording.source,
            f"samples are {interval:.4g} s apart, {steps:.3g} timesteps of the scene",
            element="'time'",
            remedy="time is in seconds; is it in other units?",
        )
    if window > 0 and not cut(bound.time, window):
        raise RecordingError(
            bound.recording.source,
            f"no window of {window:g} s holds two samples: they are {interval:.4g} s apart",
            remedy=slow(bound.time) or "give a longer window; time is in seconds",
        )


def _load_all(recordings: Any) -> list[Recording]:
    every = [recordings] if isinstance(recordings, (Recording, str, Path)) else list(recordings)
    if not every:
        raise InputError("replay needs at least one recording")
    return [one if isinstance(one, Recording) else Recording.load(one) for one in every]


def _backend(backend: str | Backend, scene: Scene, nworld: int, device: str | None) -> Backend:
    if isinstance(backend, Backend):
        return backend
    device = None if backend.partition(":")[0] == "mujoco" else device
    return make_backend(backend, scene, nworld=min(nworld, WORLDS), device=device)


def _notes(prepared: Sequence[Prepared], windows: Sequence[Window]) -> tuple[str, ...]:
    found = [
        f"{one.bound.recording.source}: {note}"
        for one in prepared
        for note in (*one.bound.notes, *one.states.notes, *one.notes)
    ]
    lost = sum(window.diverged for window in windows)
    if lost:
        found.append(f"the simulation became non-finite in {lost} of {len(windows)} windows")
    return tuple(found)


def _degrees(prepared: Sequence[Prepared], signals: Mapping[str, SignalError]) -> Iterator[str]:
    """The likely cause where angles are large and free runs have nothing to do with them."""
    named = {joint.label: joint for one in prepared for joint in suspected(one.bound)}
    missed = [
        name for name in named
        if (error := signals.get(f"qpos/{name}")) is not None and not error.rms < 1.0
    ]  # fmt: skip
    if missed:
        yield (
            f"{', '.join(f'qpos/{name}' for name in missed)}: angles beyond {MOST:g} rad, missed "
            "by more than 1 rad: are these degrees? Name the unit in the header, "
            f"'qpos/{missed[0]} [deg]', or in a map, 'unit: deg'"
        )


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


class _Callable(types.ModuleType):
    """`orbisim.replay` is the function, also after this module has been imported."""

    __call__ = staticmethod(replay)


sys.modules[__name__].__class__ = _Callable
__signature__ = inspect.signature(replay)
