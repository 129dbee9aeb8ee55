"""The peers, which get what the diagnosis gets and are scored on the same held-out windows.

`recipe`: what an engineer does first. Inverse dynamics along the smoothed motion, then least
squares of Coulomb and viscous friction, armature and an offset at every joint, none of them less
than nothing; smoothed as wide as makes free runs of the recordings fitted to best. A number is
named if its 95 % interval leaves out zero and held-out error falls by 2 %, the largest first.
`sysid`: `mujoco.sysid` with armature, friction loss, damping and stiffness of every joint, begun at
the declared values.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import from_source
import mujoco
import numpy as np
import numpy.typing as npt
from scipy.optimize import lsq_linear
from scipy.signal import savgol_filter

from rigs.diagnosing import recordings_of, scene_of

Floats = npt.NDArray[np.float64]

WINDOW = 0.5
"""Of the free runs by which all are scored, s."""
GATE = 0.02
"""Part by which a fit must lower the held-out error to be named."""
_SMOOTH = (0.04, 0.08, 0.16)
"""Widths of the polynomial filter that differentiates positions, s."""
_NAMES = ("coulomb_friction", "viscous_damping", "armature", "torque_bias")


def fitted(folder: Path, tool: str, seconds: float) -> int:
    """Prints one JSON line: what is named, and the held-out error before and after."""
    from_source.register("mujoco")
    try:
        report = _sysid(folder, seconds) if tool == "sysid" else _recipe(folder)
        print(json.dumps({"report": report, "failure": None}))
    except Exception as error:
        print(json.dumps({"report": None, "failure": f"{error!r}"[:2000]}))
    return 0


def _sysid(folder: Path, seconds: float) -> dict[str, Any]:
    from blind.peer import fit

    return fit(
        scene_of(folder),
        recordings_of(folder, "fit"),
        recordings_of(folder, "held"),
        seconds,
        declared_start=True,
    )


def _recipe(folder: Path) -> dict[str, Any]:
    from orbisim import Recording, load_scene, replay

    scene = load_scene(scene_of(folder), trusted=True)
    held = [Recording.load(path) for path in recordings_of(folder, "held")]
    before = replay(scene, held, window=WINDOW).rms
    fitted, found = plain_recipe(scene, [Recording.load(p) for p in recordings_of(folder, "fit")])
    if not found:
        return _report([], before, before, "no joint to fit")
    after = replay(fitted, held, window=WINDOW).rms
    helps = bool(np.isfinite(after)) and after < (1 - GATE) * before
    return _report(found if helps else [], before, after if helps else before, "fitted")


def _report(
    found: Sequence[dict[str, Any]], before: float, after: float, verdict: str
) -> dict[str, Any]:
    named = [one for one in found if not one["ci95"][0] <= 0 <= one["ci95"][1]]
    named.sort(key=lambda one: -one["share"])
    effects = [
        {"effect": one["effect"], "target": one["joint"],
         "parameters": {"value": {"value": one["value"], "ci95": one["ci95"]}}}
        for one in named
    ]  # fmt: skip
    error = {"held_out": {"before": before, "after": after}, "window_s": WINDOW}
    return {"verdict": verdict, "effects": effects, "error": error}


def plain_recipe(scene: Any, recordings: Sequence[Any]) -> tuple[Any, list[dict[str, Any]]]:
    """The scene with what least squares gives, and these numbers (`least_squares`); the declared
    scene and none where no joint can be fitted."""
    from orbisim import replay

    best, least = (scene, []), np.inf
    for width in _SMOOTH:
        found = least_squares(scene, recordings, width)
        fitted = with_numbers(scene, found) if found else scene
        error = replay(fitted, list(recordings), window=WINDOW).rms if found else np.inf
        if error < least:
            best, least = (fitted, found), error
    return best


def least_squares(scene: Any, recordings: Sequence[Any], smooth_s: float) -> list[dict[str, Any]]:
    """Four numbers at each hinge and slide: value, interval and typical force.

    Args:
      smooth_s: width of the polynomial filter, s.
    """
    from orbisim.recording.joints import joints

    motions = [_motion(scene, one, smooth_s) for one in recordings]
    speed, pull, missing = (np.concatenate(column) for column in zip(*motions, strict=True))
    found: list[dict[str, Any]] = []
    for joint in joints(scene.model):
        if not joint.scalar:
            continue
        dof = joint.v.start
        typical = float(np.sqrt(np.mean(speed[:, dof] ** 2)))
        if typical < 1e-3:  # it stands still: nothing can be fitted
            continue
        v, a = speed[:, dof], pull[:, dof]
        columns = np.stack([np.tanh(v / (0.05 * typical)), v, a, -np.ones_like(v)], axis=1)
        if np.linalg.matrix_rank(columns) < len(_NAMES):
            continue
        # together with what is declared, none but the offset is less than nothing
        model = scene.model
        least = [model.dof_frictionloss[dof], np.ravel(model.dof_damping[dof])[0],
                 model.dof_armature[dof], np.inf]  # fmt: skip
        bounds = (-np.array(least, float) - 1e-12, np.inf)
        values = lsq_linear(columns, missing[:, dof], bounds).x
        rest = missing[:, dof] - columns @ values
        free = max(len(v) // 10, 8)  # samples of a smoothed motion are not independent
        spread = np.linalg.inv(columns.T @ columns / len(v)) * float(np.mean(rest**2)) / free
        for name, value, width, column in zip(
            _NAMES, values, 1.96 * np.sqrt(np.diag(spread)), columns.T, strict=True
        ):
            share = abs(value) * float(np.sqrt(np.mean(column**2)))
            ci95 = [float(value - width), float(value + width)]
            found.append({"effect": name, "joint": joint.label, "value": float(value),
                          "ci95": ci95, "share": float(share)})  # fmt: skip
    return found


def _motion(scene: Any, recording: Any, smooth_s: float) -> tuple[Floats, Floats, Floats]:
    """Velocity, acceleration and missing generalized force [T, nv], ends left out."""
    from orbisim.recording import bind

    bound, model = bind(recording, scene), scene.model
    grid = np.arange(bound.time[0], bound.time[-1], float(np.median(np.diff(bound.time))))
    rows = np.clip(np.searchsorted(bound.time, grid + 1e-9, side="right") - 1, 0, None)
    step = float(grid[1] - grid[0])
    width = max(5, int(smooth_s / step) | 1)
    scalar = model.nq == model.nv
    raw = np.stack([np.interp(grid, bound.time, column) for column in bound.qpos.T], axis=1)
    if not scalar:
        return tuple(np.empty((0, model.nv)) for _ in range(3))  # type: ignore[return-value]
    smooth = [savgol_filter(raw, width, 3, deriv=order, delta=step, axis=0) for order in (0, 1, 2)]
    data, missing = mujoco.MjData(model), np.empty_like(smooth[0])
    applied = np.where(bound.applied, np.nan_to_num(bound.torque), 0.0)
    for k, row in enumerate(rows):
        data.qpos[:], data.qvel[:], data.qacc[:] = (part[k] for part in smooth)
        data.ctrl[:] = bound.ctrl[row]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fwdActuation(model, data)
        driven = data.qfrc_actuator.copy()
        data.qacc[:] = smooth[2][k]
        mujoco.mj_inverse(model, data)
        missing[k] = driven + applied[row] - data.qfrc_inverse
    inner = slice(width, -width)
    return smooth[1][inner], smooth[2][inner], missing[inner]


_SOFT = 1e-6
"""Stiffness of a spring that stands for an offset: it hardly changes with position."""


def with_numbers(scene: Any, found: Sequence[dict[str, Any]]) -> Any:
    """The scene with the fitted numbers where a machine can have them."""
    from orbisim import Scene
    from orbisim.effects.base import spec_element

    spec = scene.spec
    for one in found:
        joint = spec_element(spec, "joint", one["joint"])
        value = one["value"]
        if one["effect"] == "coulomb_friction":
            joint.frictionloss = max(0.0, joint.frictionloss + value)
        elif one["effect"] == "viscous_damping":
            joint.damping[0] = max(0.0, joint.damping[0] + value)
        elif one["effect"] == "armature":
            joint.armature = max(0.0, joint.armature + value)
        elif not joint.stiffness[0]:
            joint.stiffness[0] = _SOFT
            angle = spec.compiler.degree and joint.type != mujoco.mjtJoint.mjJNT_SLIDE
            joint.springref = np.degrees(value / _SOFT) if angle else value / _SOFT
    return Scene.from_spec(spec, source=scene.source)
