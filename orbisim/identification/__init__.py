"""`orbisim.identify`: descriptors of a scene from recordings, with intervals."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np

from orbisim.backend import Backend
from orbisim.errors import InputError
from orbisim.files.writing import make_folder, write_json
from orbisim.identification.classical import identify_classical
from orbisim.identification.estimate import Estimate
from orbisim.identification.learned import Conditioned, Guess, identify_learned
from orbisim.identification.parameters import Parameter, parameters, patched
from orbisim.identification.windows import Grid, grid
from orbisim.recording import Recording, bind
from orbisim.registry import make_backend
from orbisim.replay import prepare, replay
from orbisim.scene import Scene, load_scene

SCHEMA = "orbisim.identify/1"

__all__ = ["Identified", "Parameter", "identify"]


@dataclasses.dataclass(frozen=True, eq=False)
class Identified:
    """Result of `identify`.

    Attributes:
      scene, backend: as named. recordings: their sources.
      parameters: what was fitted. values, low, high: [P] and their 95 % intervals.
      augmented: the scene with these values.
      before, after: root mean squared position errors of free runs on C MuJoCo over windows of the
        same length (see `replay`), with the scene as declared and as identified; None if not asked.
      seconds: that the fit took. windows: how many there were.
    """

    scene: str
    backend: str
    recordings: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    values: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    augmented: Scene
    before: float | None
    after: float | None
    seconds: float
    windows: int

    def to_json(self) -> dict[str, Any]:
        """What `identified.json` holds."""
        rows = zip(self.parameters, self.values, self.low, self.high, strict=True)
        return {
            "schema": SCHEMA,
            "scene": self.scene,
            "backend": self.backend,
            "recordings": list(self.recordings),
            "windows": self.windows,
            "seconds": round(self.seconds, 3),
            "parameters": {
                p.label: {"value": v, "ci95": [a, b], "unit": p.unit, "declared": p.declared}
                for p, v, a, b in rows
            },
            "error": {"metric": "rms of free runs, MuJoCo", "before": self.before,
                      "after": self.after},
        }  # fmt: skip

    def save(self, folder: str | Path) -> Path:
        """Writes `identified.json` and `scene/scene.xml` with its files; returns the folder."""
        folder = make_folder(folder)
        write_json(folder / "identified.json", self.to_json())
        self.augmented.save(folder / "scene")
        return Path(folder)


def identify(
    scene: str | Path | Scene,
    recordings: Sequence[Recording | str | Path],
    params: str | Sequence[str],
    *,
    backend: str | Backend = "learned",
    window: float = 1.0,
    steps: int = 12,
    device: str = "cpu",
    check: bool = True,
    guess: Guess | None = None,
) -> Identified:
    """Fits descriptors of a scene to recordings.

    Args:
      scene: a path or task name, or a scene.
      recordings: one or several, or paths of their files.
      params: `friction:table,density:cube1` (see `identification.parameters`).
      backend: `learned`, `learned:PATH` for gradients through a frozen learned model; `mujoco` for
        mujoco.sysid.
      window: duration of the free runs that are held against the recordings, s.
      steps: of the search at most.
      device: where a learned model computes.
      check: whether to measure free runs of C MuJoCo before and after.
      guess: where the search begins and what it is weighed against, by labels such as
        `friction:table`: a value and the standard deviation of its logarithm, as a network
        (`orbisim_diffusion.estimate_physics`) gives them. What is not in it begins as declared.

    Raises:
      InputError: a parameter is none of the scene's, or none that the backend knows; a guess is
        not above 0, or for the backend `mujoco`, which takes none.
      RecordingError: a recording cannot be read, or does not fit the scene.
      SceneError: the scene cannot be read, or the backend cannot simulate it.
    """
    loaded = scene if isinstance(scene, Scene) else load_scene(scene)
    every = [one if isinstance(one, Recording) else Recording.load(one) for one in recordings]
    if not every:
        raise InputError("identification needs at least one recording")
    wanted = parameters(loaded, params)
    prepared = [prepare(bind(one, loaded), window) for one in every]
    named = backend if isinstance(backend, str) else backend.name
    _check_guess(guess or {}, named)
    began = time.monotonic()
    if named == "mujoco":
        interval = float(np.median([np.median(np.diff(one.bound.time)) for one in prepared]))
        substeps = max(1, round(interval / float(loaded.model.opt.timestep)))
        windows = grid(prepared, substeps * float(loaded.model.opt.timestep))
        found = identify_classical(loaded, wanted, windows, substeps, steps)
    else:
        windows, found = _by_gradients(loaded, wanted, prepared, backend, steps, device, guess)
    seconds = time.monotonic() - began
    values, low, high = (tuple(map(float, x[0])) for x in (found.values, found.low, found.high))
    augmented = patched(loaded, dict(zip(wanted, values, strict=True)))
    errors = (
        [replay(one, every, window=window).rms for one in (loaded, augmented)] if check else None
    )
    return Identified(
        scene=loaded.source if isinstance(scene, Scene) else str(scene),
        backend=named,
        recordings=tuple(one.bound.recording.source for one in prepared),
        parameters=wanted,
        values=values,
        low=low,
        high=high,
        augmented=augmented,
        before=errors[0] if errors else None,
        after=errors[1] if errors else None,
        seconds=seconds,
        windows=len(windows.qpos),
    )


def _by_gradients(
    scene: Scene,
    wanted: Any,
    prepared: Any,
    backend: str | Backend,
    steps: int,
    device: str,
    guess: Guess | None,
) -> tuple[Grid, Estimate]:
    """On a backend that is conditioned on descriptors."""
    engine: Any = backend
    if isinstance(backend, str):
        engine = make_backend(backend, scene, device=device, compiled=False)
    if not hasattr(engine, "with_properties") or not hasattr(engine, "surface"):
        raise InputError(
            f"backend {engine.name!r} is not conditioned on descriptors; use learned or mujoco"
        )
    windows = grid(prepared, engine.timestep)
    conditioned = cast(Conditioned, engine)
    return windows, identify_learned(conditioned, wanted, windows, steps, device, guess)


def _check_guess(guess: Guess, backend: str) -> None:
    """Raises `InputError` if there is a guess that makes no sense or that a backend cannot take."""
    if guess and backend == "mujoco":
        raise InputError("a guess is for a learned backend; mujoco.sysid begins as declared")
    for label, (value, spread) in guess.items():
        if not (0.0 < value < math.inf and 0.0 < spread < math.inf):
            raise InputError(
                f"guess of {label}: {value:g}, spread {spread:g}; both must be finite and above 0"
            )
