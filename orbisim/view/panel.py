"""What a live page can change: its controls, as the page is told, and its requests, as they come.

A request is a word (`pause`, `restart`, `step`) or JSON: `{"do": "joint", "index": 2, "value": 1}`.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Sequence

import mujoco
import numpy as np

from orbisim.scene import Scene
from orbisim.view.drawing import Drawing
from orbisim.view.kinematics import pose_matrix
from orbisim.view.three import Json, column_major

WORDS = ("pause", "restart", "step")
TOGGLES = ("contacts", "sites", "collisions")
SPEEDS = (0.05, 5.0)
"""Slowest and fastest, times real time."""
_REACH = {int(mujoco.mjtJoint.mjJNT_HINGE): math.pi, int(mujoco.mjtJoint.mjJNT_SLIDE): 1.0}
"""How far sliders of joints without limits go, rad and m."""
_MOST = 200
"""Of sliders of a kind."""


@dataclasses.dataclass(frozen=True)
class Request:
    """What a page asks for.

    Attributes:
      do: `pause`, `restart`, `step`, `speed`, `joint`, `control`, `manual`, `show` or `backend`.
      name: of a backend, or of what is shown. index: of a joint or actuator. value: a number.
    """

    do: str
    name: str = ""
    index: int = 0
    value: float = 0.0


def request_of(text: str) -> Request | None:
    """The request in a page's message; None for one that is none."""
    if text in WORDS:
        return Request(text)
    try:
        found = json.loads(text)
        asked = Request(
            str(found["do"]),
            str(found.get("name", "")),
            int(found.get("index", 0)),
            float(found.get("value", 0.0)),
        )
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError):
        return None
    return asked if math.isfinite(asked.value) else None


def scalar_joints(model: mujoco.MjModel) -> list[int]:
    """Hinges and slides, which have sliders."""
    return [joint for joint in range(model.njnt) if int(model.jnt_type[joint]) in _REACH][:_MOST]


def panel(scene: Scene, drawing: Drawing, backend: str, backends: Sequence[str]) -> Json:
    """What the page offers: sliders with their ranges, cameras, bodies to follow, backends."""
    model = scene.model
    return {
        "backend": backend,
        "backends": list(dict.fromkeys([backend, *backends])),
        "joints": [_joint(model, joint) for joint in scalar_joints(model)],
        "actuators": [_actuator(model, index) for index in range(min(model.nu, _MOST))],
        "bodies": {model.body(body).name or f"body {body}": path
                   for body, path in drawing.bodies.items() if body in drawing.moving},
        "cameras": _cameras(model, drawing),
        "toggles": {
            "contacts": drawing.options.contacts,
            "sites": drawing.options.sites,
            "collisions": 3 in drawing.options.groups,
        },
    }  # fmt: skip


def _joint(model: mujoco.MjModel, joint: int) -> Json:
    start = float(model.qpos0[model.jnt_qposadr[joint]])
    reach = _REACH[int(model.jnt_type[joint])]
    limited = bool(model.jnt_limited[joint])
    low, high = model.jnt_range[joint] if limited else (start - reach, start + reach)
    name = model.joint(joint).name or f"joint {joint}"
    return {"name": name, "low": float(low), "high": float(high), "value": start}


def _actuator(model: mujoco.MjModel, index: int) -> Json:
    limited = bool(model.actuator_ctrllimited[index])
    low, high = model.actuator_ctrlrange[index] if limited else (-1.0, 1.0)
    name = model.actuator(index).name or f"actuator {index}"
    return {"name": name, "low": float(low), "high": float(high), "value": 0.0}


def _cameras(model: mujoco.MjModel, drawing: Drawing) -> list[Json]:
    """The scene's cameras, each in the frame of its body as both are now."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    found = []
    for camera in range(model.ncam):
        body = int(model.cam_bodyid[camera])
        path = drawing.bodies.get(body) if body in drawing.moving else None
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = data.cam_xmat[camera].reshape(3, 3), data.cam_xpos[camera]
        if path is not None:
            pose = np.linalg.inv(pose_matrix(data.xpos[body], data.xquat[body])) @ pose
        name = model.camera(camera).name or f"camera {camera}"
        fov = float(model.cam_fovy[camera])
        found.append({"name": name, "path": path, "matrix": column_major(pose), "fov": fov})
    return found
