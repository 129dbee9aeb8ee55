"""`orbisim infer`: from the frames of a video to a recording, by StaInf."""

from __future__ import annotations

from pathlib import Path

import imageio.v3 as iio
import mujoco
import numpy as np
import numpy.typing as npt
import torch
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation
from torch import nn

from orbisim.errors import InputError, UnsupportedSceneError
from orbisim.recording import Recording
from orbisim.scene import Scene, matrices
from orbisim_diffusion.autoencoder import to_float
from orbisim_diffusion.checkpoint import INFERENCE, Checkpoint, load_checkpoint, load_part
from orbisim_diffusion.inference import JOINTS, OBJECTS, Inferred, StateInference
from orbisim_diffusion.likeness import continuous, like_turns, unlikeness
from orbisim_diffusion.own import bounded, squares

_SCALAR = (int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE))
_FREE = int(mujoco.mjtJoint.mjJNT_FREE)
SURE = 3.0
"""Logit from which on more certainty that there is an object counts no more."""
_BATCH = 64  # images at once, so that memory does not grow with a video's length

Floats = npt.NDArray[np.float64]


def load_inference(folder: str | Path) -> tuple[Checkpoint, StateInference]:
    """A checkpoint with its StaInf.

    Raises:
      InputError: it has none.
    """
    point, model = load_with_inference(folder)
    if model is None:
        raise InputError(
            f"{folder}: has no state inference (StaInf); train it with `orbisim train inference`"
        )
    return point, model


def load_with_inference(folder: str | Path) -> tuple[Checkpoint, StateInference | None]:
    """A checkpoint and its StaInf, if it has one."""
    point = load_checkpoint(folder)
    entry = point.manifest["files"].get(INFERENCE)
    if entry is None:
        return point, None
    channels, size = point.config.autoencoder.channels, point.config.size
    model = load_part(point.path, INFERENCE, entry, lambda: StateInference(channels, size))
    assert isinstance(model, StateInference)
    return point, model


def read_video(path: Path, size: int) -> tuple[npt.NDArray[np.uint8], Floats]:
    """Frames [T, size, size, 3], the middle squares of a video's, and their times [T], s.

    Raises:
      InputError: it cannot be read.
    """
    try:
        fps = float(iio.immeta(path, plugin="FFMPEG")["fps"])
        frames = np.stack(list(bounded(iio.imiter(path, plugin="FFMPEG"), path)))
    except (OSError, ValueError, LookupError) as error:
        raise InputError(f"{path}: is not a video that ffmpeg reads ({error})") from None
    return squares(frames, size), np.arange(len(frames)) / fps


def infer(
    scene: Scene,
    frames: npt.NDArray[np.uint8],
    times: Floats,
    checkpoint: Checkpoint,
    model: nn.Module,
) -> Recording:
    """The recording that frames show: joints of the robot, poses of the objects.

    Which of the found objects is which body is decided by colour, size and the way they move;
    which of a box's like orientations it has, by the frame before (in the first: the smallest
    turn). As many are taken as the scene declares, whether they are seen or not: see
    `orbisim_diffusion.tracking` for what tells them apart.

    Args:
      scene: with the bodies and their colours. frames: [T, H, W, 3] of the checkpoint's size.
      times: [T], s. checkpoint, model: as `load_inference` gives them.

    Raises:
      UnsupportedSceneError: the scene has more joints or objects than StaInf knows.
    """
    joints, bodies = _parts(scene)
    found = read_frames(frames, checkpoint, model)
    signals: dict[str, Floats] = {
        f"qpos/{name}": found.joints[:, i].double().numpy() for i, name in enumerate(joints)
    }
    rows = np.array([matrices.object_row(scene.model, scene.model.body(b).id) for b in bodies])
    if bodies:
        places, turns = _tracks(found, rows.reshape(len(bodies), -1))
        for i, name in enumerate(bodies):
            signals[f"xpos/{name}"], signals[f"xquat/{name}"] = places[:, i], turns[:, i]
    known = checkpoint.manifest.get("metrics", {}).get(INFERENCE, {})
    return Recording(
        times,
        signals,
        metadata={"noise": known, "checkpoint": str(checkpoint.path.name)},
        source=f"{scene.name} seen",
    )


def _parts(scene: Scene) -> tuple[list[str], list[str]]:
    """Names of the scalar joints and of the free bodies."""
    model = scene.model
    kinds = [int(kind) for kind in model.jnt_type]
    joints = [model.joint(j).name for j, kind in enumerate(kinds) if kind in _SCALAR]
    free = [j for j, kind in enumerate(kinds) if kind == _FREE]
    bodies = [model.body(int(model.jnt_bodyid[j])).name for j in free]
    if len(joints) > JOINTS or len(bodies) > OBJECTS:
        raise UnsupportedSceneError(
            scene.source,
            f"StaInf knows up to {JOINTS} joints and {OBJECTS} objects; it has {len(joints)} and "
            f"{len(bodies)}",
        )
    return joints, bodies


@torch.no_grad()  # type: ignore[untyped-decorator]
def read_frames(frames: npt.NDArray[np.uint8], point: Checkpoint, model: nn.Module) -> Inferred:
    """What StaInf reads off frames [T, H, W, 3] of the checkpoint's size, on the CPU.

    Computed where the model is, on whose device the checkpoint's autoencoder must be, too.
    """
    parts, device = [], next(model.parameters()).device
    for first in range(0, len(frames), _BATCH):
        images = to_float(torch.as_tensor(frames[first : first + _BATCH]).to(device))
        parts.append(model(point.autoencoder.encode(images)))
    return Inferred(*(torch.cat(field).cpu() for field in zip(*parts, strict=True)))


def _tracks(found: Inferred, rows: Floats) -> tuple[Floats, Floats]:
    """Positions [T, M, 3] and quaternions [T, M, 4] of bodies with descriptor rows [M, D]."""
    column = matrices.OBJECT_COLUMNS.index
    sizes, colours = rows[:, :3], rows[:, column("red") : column("blue") + 1]
    pos, size, colour = (v.double().numpy() for v in (found.pos, found.size, found.colour))
    rot, present = found.rot.double().numpy(), found.present.double().numpy()
    count, bodies = len(pos), len(rows)
    places, turns = np.full((count, bodies, 3), np.nan), np.full((count, bodies, 4), np.nan)
    last, turned = np.full((bodies, 3), np.nan), np.tile(np.eye(3), (bodies, 1, 1))
    groups = [like_turns(one) for one in sizes]
    for t in range(count):
        cost = unlikeness(pos[t], size[t], colour[t], last, sizes, colours)
        cost -= np.minimum(present[t], SURE)
        for body, slot in zip(*linear_sum_assignment(cost), strict=True):
            places[t, body] = last[body] = pos[t, slot]
            choices = rot[t, slot] @ groups[body]
            nearest = int(np.argmax(np.einsum("kij,ij->k", choices, turned[body])))
            turned[body] = choices[nearest]
            x, y, z, w = Rotation.from_matrix(turned[body]).as_quat()
            turns[t, body] = continuous(np.array([w, x, y, z]), turns[t - 1, body] if t else None)
    return places, turns
