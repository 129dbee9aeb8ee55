"""`orbisim infer`, `orbisim identify`: densities and friction of a recording, by PhyInf."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
import torch
from orbisim_world_model.pack import Pack
from orbisim_world_model.plain import checked

from orbisim.errors import InputError, RecordingError, UnsupportedSceneError
from orbisim.identification.windows import between
from orbisim.recording import Recording, bind
from orbisim.scene import Scene, matrices
from orbisim_diffusion.checkpoint import MANIFEST, PHYSICS, load_part, read_manifest
from orbisim_diffusion.physics import (
    FEWEST,
    FRAMES,
    NORMAL,
    PhysicsInference,
    Posterior,
    Window,
)

Floats = npt.NDArray[np.float64]
_SCALAR = (int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE))
_FREE, _BOX = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtGeom.mjGEOM_BOX)
_APART = 8
"""Frames from the begin of a window to the next one's."""
_LARGEST = 20.0
"""Of a logarithm of a friction or density: a factor of 5e8."""
_BEYOND = 0.1
"""Share by which a half size may lie outside of what was trained on."""


@dataclasses.dataclass(frozen=True)
class Reach:
    """What a PhyInf was trained on.

    Attributes:
      joints: of the robot. hand: its site. surface: the geom that objects lie on.
      timestep: between frames, s. half: least and largest half size of a box, m.
      dynamics: name of the checkpoint of the dynamics that it was trained through, and its digest.
    """

    joints: tuple[str, ...]
    hand: str
    surface: str
    timestep: float
    half: tuple[float, float]
    dynamics: str
    sha256: str

    @staticmethod
    def of(pack: Pack, dynamics: str, sha256: str) -> Reach:
        """Of training data."""
        layout = pack.layout
        columns = [layout.attributes.index(f"half_{axis}") for axis in "xyz"]
        half = pack.attributes[pack.mask > 0][:, columns]
        return Reach(
            layout.joints,
            layout.hand,
            layout.surface,
            float(layout.timestep),
            (float(half.min()), float(half.max())),
            dynamics,
            sha256,
        )

    def problem(self, scene: Scene) -> str:
        """Why a scene is none of those; empty if it is one."""
        model = scene.model
        joints = tuple(model.joint(j).name for j, k in enumerate(model.jnt_type) if k in _SCALAR)
        if joints != self.joints:
            return f"its joints are {joints}, not {self.joints}"
        for kind, name in (("site", self.hand), ("geom", self.surface)):
            if mujoco.mj_name2id(model, getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), name) < 0:
                return f"it has no {kind} {name!r}"
        if not bodies_of(model):
            return "it has no free bodies"
        for name in bodies_of(model):
            geom = matrices.main_geom(model, model.body(name).id)
            if geom is None or int(model.geom_type[geom]) != _BOX:
                return f"{name!r} is no box"
            half = model.geom_size[geom]
            low, high = (1 - _BEYOND) * self.half[0], (1 + _BEYOND) * self.half[1]
            if not (low <= half.min() and half.max() <= high):
                sizes = " ".join(f"{v:.3g}" for v in half)
                return f"half sizes of {name!r}, {sizes} m, are not {low:.3g} to {high:.3g}"
        return ""


@dataclasses.dataclass(frozen=True)
class Said:
    """What is said of one number of a scene.

    Attributes:
      value, low, high: the median, and a 95 % interval within what tasks draw. unit: of them.
      spread: standard deviation of the logarithm. prior: that of what tasks draw: where both are
        the same, nothing was learned from the recording.
    """

    value: float
    low: float
    high: float
    unit: str
    spread: float
    prior: float

    def to_json(self) -> dict[str, Any]:
        """As recordings and reports hold it."""
        return {
            "value": self.value,
            "ci95": [self.low, self.high],
            "unit": self.unit,
            "spread": self.spread,
            "prior_spread": self.prior,
        }


def load_physics(folder: str | Path) -> tuple[PhysicsInference, Reach]:
    """The PhyInf of a vision checkpoint, and what it suits.

    Raises:
      InputError: it has none, or it is damaged.
    """
    manifest, where = read_manifest(folder), str(Path(folder) / MANIFEST)
    files = checked(dict[str, Any], manifest.get("files"), f"{where}: files")
    if PHYSICS not in files:
        raise InputError(
            f"{folder}: has no physics inference (PhyInf); train it with "
            "`orbisim train inference --physics`"
        )
    suited = checked(dict[str, Any], manifest.get("reach"), f"{where}: reach")
    reach = checked(Reach, suited.get(PHYSICS), f"{where}: reach/{PHYSICS}")
    model = load_part(Path(folder), PHYSICS, files[PHYSICS], PhysicsInference)
    assert isinstance(model, PhysicsInference)
    _check_draws(model, str(Path(folder) / f"{PHYSICS}.safetensors"))
    return model, reach


def _check_draws(model: PhysicsInference, where: str) -> None:
    """Raises InputError where what tasks drew (logarithms of frictions and densities) makes no
    sense: what is said lies within it."""
    low, high, middle, width, widen = (
        values.double()
        for values in (model.low, model.high, model.middle, model.width, model.widen)
    )
    within = (low >= -_LARGEST) & (low < high) & (high <= _LARGEST)
    inside = (low <= middle) & (middle <= high)
    sizes = (width > 0) & (width <= high - low) & (widen > 0)
    if not bool((within & inside & sizes).all()):  # so is NaN
        raise InputError(
            f"{where}: low, middle, high, width or widen of the draws that it was trained on make "
            "no sense: damaged, or no PhyInf"
        )


def has_physics(folder: str | Path) -> bool:
    """Whether a vision checkpoint has a PhyInf."""
    files = read_manifest(folder).get("files")
    return isinstance(files, dict) and PHYSICS in files


def bodies_of(model: mujoco.MjModel) -> list[str]:
    """Names of the free bodies."""
    return [model.body(int(model.jnt_bodyid[j])).name for j, k in enumerate(model.jnt_type)
            if int(k) == _FREE]  # fmt: skip


def infer_physics(
    scene: Scene, recordings: Sequence[Recording], network: PhysicsInference, reach: Reach
) -> dict[str, Said]:
    """Friction of the table and density of each free body, by `friction:table`, `density:cube1`.

    Of several windows the one that is surest of a number says it: windows share what they do not
    know, so that their answers are not averaged.

    Args:
      scene: with sizes and own friction of the bodies; its densities and table do not matter.
      recordings: positions over time; what is not known in a frame is NaN there.
      network, reach: as `load_physics` gives them.

    Raises:
      UnsupportedSceneError: the scene is none that the network was trained on.
      RecordingError: no recording shows enough.
      InputError: the network says what is no number.
    """
    if reason := reach.problem(scene):
        raise UnsupportedSceneError(
            scene.source,
            f"PhyInf was not trained on such a scene: {reason}",
            remedy="train one on it (orbisim train inference --physics)",
        )
    bound = [bind(one, scene) for one in recordings]
    how = reach.hand, reach.timestep
    parts = [w for one in bound if (w := windows_of(scene, one.time, one.qpos, *how)) is not None]
    if not parts:
        raise RecordingError(
            recordings[0].source if recordings else scene.source,
            f"in no {FRAMES * reach.timestep:.3g} s an object is seen in {FEWEST} frames",
            remedy="record longer, or let `orbisim identify` fit what there is",
        )
    window = Window(*(torch.cat(fields) for fields in zip(*parts, strict=True)))
    with torch.no_grad():
        found = network.said(window)
    if not bool(torch.isfinite(torch.stack([*found])).all()):
        raise InputError("PhyInf says what is no number: weights of its checkpoint are damaged")
    return in_words(network, found, reach.surface, bodies_of(scene.model))


def in_words(
    network: PhysicsInference, found: Posterior, surface: str, bodies: Sequence[str]
) -> dict[str, Said]:
    """Of windows of one scene, what the one says that is surest of a number (see `Said`)."""
    best = found.spread.argmin(0)
    names = [f"friction:{surface}", *(f"density:{body}" for body in bodies)]
    kinds = network.kinds(len(bodies)).tolist()
    said: dict[str, Said] = {}
    for number, (name, kind) in enumerate(zip(names, kinds, strict=True)):
        mean = float(found.mean[best[number], number])
        spread = float(found.spread[best[number], number])
        low, high = float(network.low[kind]), float(network.high[kind])
        said[name] = Said(
            math.exp(mean),
            math.exp(max(low, mean - NORMAL * spread)),
            math.exp(min(high, mean + NORMAL * spread)),
            "kg/m^3" if kind else "1",
            spread,
            float(network.width[kind]),
        )
    return said


def guesses(said: Mapping[str, Said]) -> dict[str, tuple[float, float]]:
    """As `orbisim.identify` takes them: value and standard deviation of its logarithm."""
    return {name: (one.value, one.spread) for name, one in said.items()}


def windows_of(scene: Scene, time: Floats, qpos: Floats, hand: str, step: float) -> Window | None:
    """Windows of positions [T, nq] at times [T], s; None if no object is seen often enough.

    Positions between samples are linear. A recording that is shorter than a window is shown as the
    begin of one.

    Args:
      scene: with the bodies. time, qpos: of the recording; NaN where a frame does not show it.
      hand: site of the hand. step: between frames, s.
    """
    model = scene.model
    count = int(np.floor((time[-1] - time[0]) / step + 1e-6)) + 1
    when = time[0] + step * np.arange(count)
    rows = between(time, qpos, when, float(time[-1])) if len(time) > 1 else qpos[:1]
    rows = np.concatenate([rows, np.full((max(0, FRAMES - count), model.nq), np.nan)])
    names = bodies_of(model)
    firsts = [int(model.joint(int(model.body(n).jntadr[0])).qposadr[0]) for n in names]
    poses = np.stack([rows[:, a : a + 7] for a in firsts], axis=1)
    known = np.asarray(np.isfinite(poses).all(-1))
    begins = np.arange(0, len(rows) - FRAMES + 1, _APART)
    if len(rows) - FRAMES not in begins:  # the last one ends with the recording
        begins = np.append(begins, len(rows) - FRAMES)
    hand_pos, hand_rot, hand_known = _hands(scene, rows, hand)
    quat = np.where(known[..., None], poses[..., 3:], np.array([1.0, 0.0, 0.0, 0.0]))
    quat = quat / np.linalg.norm(quat, axis=-1, keepdims=True)
    pos = np.where(known[..., None], poses[..., :3], 0.0)
    of = [matrices.object_row(model, model.body(n).id) for n in names]
    friction = [row[matrices.OBJECT_COLUMNS.index("friction_slide")] for row in of]
    index = begins[:, None] + np.arange(FRAMES)
    each = (hand_pos, hand_rot, pos, quat, hand_known.astype(float), known.astype(float))
    still = (np.array(of)[:, :3], np.array(friction), np.ones(len(names)))
    fields = [a[index] for a in each]
    fields += [np.broadcast_to(a, (len(begins), *a.shape)) for a in still]
    kept = known[index].sum(1).max(-1) >= FEWEST
    if not kept.any():
        return None
    return Window(*(torch.as_tensor(a[kept], dtype=torch.float32) for a in fields))


def _hands(scene: Scene, rows: Floats, site: str) -> tuple[Floats, Floats, npt.NDArray[np.bool_]]:
    """Positions [T, 3] and rotations [T, 3, 3] of the hand, and whether its joints are known."""
    model, data = scene.model, mujoco.MjData(scene.model)
    scalar = [int(model.jnt_qposadr[j]) for j, k in enumerate(model.jnt_type) if k in _SCALAR]
    known = np.asarray(np.isfinite(rows[:, scalar]).all(axis=1))
    pos, rot = np.zeros((len(rows), 3)), np.tile(np.eye(3), (len(rows), 1, 1))
    for t in np.flatnonzero(known):
        data.qpos[:] = model.qpos0
        data.qpos[scalar] = rows[t, scalar]
        mujoco.mj_kinematics(model, data)
        pos[t] = data.site(site).xpos
        rot[t] = data.site(site).xmat.reshape(3, 3)
    return pos, rot, known
