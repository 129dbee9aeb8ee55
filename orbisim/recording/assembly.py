"""The signals of a recording as arrays in a scene's order."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from orbisim.errors import RecordingError, UnknownNameError
from orbisim.recording import names
from orbisim.recording.quaternions import continuous
from orbisim.recording.recording import Recording
from orbisim.recording.signal_units import check_unit
from orbisim.scene import Scene
from orbisim.scene.hidden import hidden_joints

Floats = npt.NDArray[np.float64]

_NORM_ERROR = 0.02
"""A quaternion whose norm is further from one is no orientation."""
_NORM_NOTE = 1e-3
"""One that is further from one than this is scaled, with a note."""


class Assembly:
    """Puts signals into arrays, refusing what does not fit.

    Attributes:
      recording, scene, model: what is put together. count: samples T.
      notes: what was ignored or assumed; grows.
    """

    def __init__(self, recording: Recording, scene: Scene) -> None:
        self.recording, self.scene, self.model = recording, scene, scene.model
        self.count = len(recording)
        self.notes = list(recording.notes)

    def check_names(self) -> None:
        """Raises `RecordingError` if a signal's target is not in the scene, or its unit not SI."""
        for name in self.recording.signals:
            kind, target = names.split(name)
            if target:
                self.check_name(name, names.KINDS[kind], target)
            if name in self.recording.units:
                check_unit(self.recording, name, self.model)

    def check_name(self, signal: str, element: str, target: str) -> None:
        """Raises `RecordingError` if the scene has no element of this name."""
        count = {
            "joint": self.model.njnt,
            "actuator": self.model.nactuator,
            "body": self.model.nbody,
            "sensor": self.model.nsensor,
        }[element]
        accessor = getattr(self.model, element)
        known = [accessor(i).name for i in range(count)]
        if target not in known or not target:
            error = UnknownNameError(element, target, filter(None, known))
            raise RecordingError(
                self.recording.source,
                f"scene {self.scene.name!r} has no such {element}: {error}",
                element=repr(signal),
                remedy="columns of a vector end in [0], [1], ..." if "/" in target else None,
            )

    def fill(self, kind: str, width: int, places: Mapping[str, slice]) -> Floats:
        """The whole array of a kind [T, width] from the array or the named signals."""
        signals = self.recording.signals
        full = np.full((self.count, width), np.nan)
        if kind in signals:
            shown = self.shown(width, signals[kind].shape[1], places)
            wanted = len(shown) if shown is not None else width
            self.check_width(kind, signals[kind], wanted, f"scene {self.scene.name!r}")
            full[:, slice(None) if shown is None else shown] = signals[kind]
        for name, values in signals.items():
            of, target = names.split(name)
            if of != kind or not target:
                continue
            place = places[target]
            columns = values.reshape(self.count, -1)
            self.check_width(name, columns, place.stop - place.start, f"{target!r}")
            self.check_once(kind, name, full[:, place], columns)
            full[:, place] = columns
        return full

    def shown(self, width: int, given: int, places: Mapping[str, slice]) -> list[int] | None:
        """Columns that a whole array of the declared scene fills, where effects added joints."""
        hidden = {
            c for n in hidden_joints(self.model) if n in places for c in range(width)[places[n]]
        }
        if not hidden or given != width - len(hidden):
            return None
        return [c for c in range(width) if c not in hidden]

    def check_width(self, name: str, values: Floats, width: int, what: str) -> None:
        """Raises `RecordingError` if a signal has another number of columns."""
        if values.shape[1] != width:
            raise RecordingError(
                self.recording.source,
                f"has {values.shape[1]} columns; {what} needs {width}",
                element=repr(name),
            )

    def check_once(self, kind: str, name: str, before: Floats, now: Floats) -> None:
        """Raises `RecordingError` if two signals give different values for the same thing."""
        both = np.isfinite(before) & np.isfinite(now)
        if (before[both] != now[both]).any():
            raise RecordingError(
                self.recording.source,
                f"differs from what {kind!r} holds for it",
                element=repr(name),
                remedy="record it once",
            )

    def poses(self, kind: str, width: int) -> dict[int, Floats]:
        """The recorded `xpos` or `xquat` [T, width] by body number."""
        found = {}
        for name, values in self.recording.signals.items():
            of, target = names.split(name)
            if of == kind and target and np.isfinite(values).any():
                self.check_width(name, values.reshape(self.count, -1), width, "a vector")
                body = self.model.body(target).id
                found[body] = self.unit(values, name) if kind == "xquat" else values
                if self.model.body_mocapid[body] >= 0:
                    self.notes.append(f"{name!r}: a mocap body stays where the scene puts it")
        return found

    def sensors(self) -> Floats:
        """The recorded sensor data [T, nsensordata]."""
        model = self.model
        places = {
            model.sensor(i).name: slice(
                int(model.sensor_adr[i]), int(model.sensor_adr[i] + model.sensor_dim[i])
            )
            for i in range(model.nsensor)
        }
        named = self.fill("sensor", model.nsensordata, places)
        whole = self.fill("sensordata", model.nsensordata, {})
        self.check_once("sensordata", "sensor", whole, named)
        return np.where(np.isfinite(named), named, whole)

    def unit(self, values: Floats, name: str) -> Floats:
        """Quaternions of unit norm without sign flips; rows with a missing component are NaN."""
        norm = np.linalg.norm(values, axis=1)
        off = np.abs(norm - 1.0)
        bad = np.flatnonzero(off > _NORM_ERROR)
        if bad.size:
            raise RecordingError(
                self.recording.source,
                f"row {bad[0]} is not a unit quaternion: its norm is {norm[bad[0]]:.4g}",
                element=repr(name),
                remedy="record w, x, y, z, and NaN for a missing sample",
            )
        if off[np.isfinite(off)].max(initial=0.0) > _NORM_NOTE:
            self.notes.append(f"{name!r}: norms are up to {np.nanmax(off):.2g} off one; scaled")
        return continuous(np.asarray(values / norm[:, None]))
