"""From frames to a recording by analysis by synthesis: each frame starts from the one before."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from orbisim.host.progress import track
from orbisim.recording import Recording
from orbisim.scene import Scene
from orbisim_diffusion.inference import Inferred
from orbisim_diffusion.likeness import continuous, like_turns, unlikeness
from orbisim_diffusion.refine import Frame, Refiner
from orbisim_diffusion.resting import Body
from orbisim_diffusion.starting import shows_joints, start

Floats = npt.NDArray[np.float64]

_PEAKS = 2
"""Of what a network found, for how many each object is tried."""


class Reading(NamedTuple):
    """What a network reads off frames; T of them, N objects in no particular order.

    Attributes:
      joints: [T, J] scalar joints. places: [T, N, 7] positions and quaternions (w x y z).
      sizes: [T, N, 3] half sizes, m. colours: [T, N, 3]. present: [T, N] logits.
    """

    joints: Floats
    places: Floats
    sizes: Floats
    colours: Floats
    present: Floats


def reading(found: Inferred, joints: int) -> Reading:
    """StaInf's answer for a scene with so many scalar joints."""
    turns = Rotation.from_matrix(found.rot.double().numpy().reshape(-1, 3, 3)).as_quat()
    quats = np.roll(turns, 1, axis=-1).reshape(*found.pos.shape[:2], 4)
    return Reading(
        found.joints[:, :joints].double().numpy(),
        np.concatenate([found.pos.double().numpy(), quats], axis=-1),
        found.size.double().numpy(),
        found.colour.double().numpy(),
        found.present.double().numpy(),
    )


def follow(refiner: Refiner, frames: npt.NDArray[np.uint8], read: Reading | None) -> list[Frame]:
    """What each frame of a video shows.

    Args:
      refiner: of the scene and the camera. frames: [T, H, W, 3] of its size.
      read: what a network reads off the same frames. Without one, joints start from where the
        first frame is drawn best (`starting.start`), objects from where the image has their
        colours, and joints that the fit has lost stay lost.
    """
    found: list[Frame] = []
    for t, frame in enumerate(track(frames, "fitting frames", len(frames))):
        places = [places_of(read, t, body) for body in refiner.bodies]
        guess = None if read is None else read.joints[t]
        if not found:
            joints = refiner.turns.held(start(refiner, frame)) if guess is None else guess
            one = refiner.first(frame, joints, places, read=guess)
        else:
            joints = expected(found, refiner.scalar.qpos)
            ahead = [gone(found, i) for i in range(len(refiner.bodies))]
            one = refiner.following(frame, joints, places, found[-1], ahead=ahead, read=guess)
        if len(refiner.scalar.qpos):
            present = [i for i, pose in enumerate(one.objects) if pose.seen]
            one = one._replace(joints_seen=shows_joints(refiner, frame, one.qpos, present))
        found.append(one)
    return found


def recording_of(
    scene: Scene,
    refiner: Refiner,
    times: Floats,
    found: list[Frame],
    looks: Sequence[Any] | None = None,
) -> Recording:
    """What frames show, as signals; joints and objects have NaN where they are not seen.

    `metadata` has `noise`, the median standard deviation of each signal from frame to frame (of a
    body by axes: the world's for its position, its own for its orientation), `offset`, that of what
    all frames may be off together, and `not_seen`, the stretches in which
    the joints or an object are not seen. With `looks` (one of `orbisim_diffusion.looks.Look` for
    each free body) it has them, too, by the bodies' names; standard deviations of what was not seen
    are null.
    """
    model = scene.model
    qpos = np.stack([one.qpos for one in found])
    signals: dict[str, Floats] = {}
    noise: dict[str, float | list[float]] = {}
    offset: dict[str, float] = {}
    hidden: list[dict[str, Any]] = []
    stds = np.stack([one.joints_std for one in found])
    shown, names = np.array([one.joints_seen for one in found]), []
    for i, adr in enumerate(refiner.scalar.qpos):
        names.append(model.joint(int(np.flatnonzero(model.jnt_qposadr == adr)[0])).name)
        signals[f"qpos/{names[-1]}"] = np.where(shown, qpos[:, adr], np.nan)
        if shown.any():
            noise[f"qpos/{names[-1]}"] = float(np.median(stds[shown, i]))
    hidden += [{"joints": names, **stretch} for stretch in _stretches(times, ~shown)]
    for i, body in enumerate(refiner.bodies):
        joint = int(np.flatnonzero(model.jnt_qposadr == body.qpos)[0])
        name = model.body(int(model.jnt_bodyid[joint])).name
        poses = [one.objects[i] for one in found]
        seen = np.array([pose.seen for pose in poses])
        place = np.where(seen[:, None], qpos[:, body.qpos : body.qpos + 3], np.nan)
        group = like_turns(body.half) if body.box else np.eye(3)[None]
        turn = nearest_turns(qpos[:, body.qpos + 3 : body.qpos + 7], seen, group)
        signals[f"xpos/{name}"], signals[f"xquat/{name}"] = place, turn
        jitter = np.stack([pose.jitter for pose in poses])[seen]
        spread = np.stack([pose.std for pose in poses])[seen]
        if len(spread):
            common = np.sqrt(np.maximum(spread**2 - jitter**2, 0.0))
            jitter[:, 3:] = _about_own(turn[seen], jitter[:, 3:])
            for signal, axes in (("xpos", slice(0, 3)), ("xquat", slice(3, 6))):
                noise[f"{signal}/{name}"] = np.median(jitter[:, axes], axis=0).tolist()
                offset[f"{signal}/{name}"] = float(np.median(common[:, axes].max(1)))
        hidden += [{"body": name, **stretch} for stretch in _stretches(times, ~seen)]
    metadata: dict[str, Any] = {"noise": noise, "offset": offset, "not_seen": hidden}
    if looks is not None:
        names = [str(name).split("/")[1] for name in signals if name.startswith("xpos/")]
        metadata["looks"] = {n: _as_json(look) for n, look in zip(names, looks, strict=True)}
    return Recording(times, signals, metadata=metadata, source=f"{scene.name} seen")


def _about_own(quats: Floats, stds: Floats) -> Floats:
    """Standard deviations [T, 3] about the world's axes as they are about a body's."""
    turns = Rotation.from_quat(np.roll(quats, -1, axis=1)).as_matrix()
    found: Floats = np.sqrt(np.einsum("tij,ti->tj", turns**2, stds**2))
    return found


def _as_json(look: Any) -> dict[str, list[float | None]]:
    """A look as JSON has it: half sizes, m, colour, and their standard deviations."""
    fields = {
        "half_size": look.half,
        "half_size_std": look.half_std,
        "color": look.colour,
        "color_std": look.colour_std,
    }
    return {
        name: [round(float(v), 6) if np.isfinite(v) else None for v in values]
        for name, values in fields.items()
    }


def expected(found: list[Frame], columns: npt.NDArray[np.int64]) -> Floats:
    """Joints in the next frame at the speed of the last two."""
    last = found[-1].qpos[columns]
    if len(found) < 2:
        return last
    ahead: Floats = 2.0 * last - found[-2].qpos[columns]
    return ahead


def gone(found: list[Frame], number: int) -> Floats | None:
    """The pose [7] of an object in the next frame at the speed of the last two."""
    if len(found) < 2 or not (found[-1].objects[number].seen and found[-2].objects[number].seen):
        return None
    last, before = found[-1].objects[number].qpos, found[-2].objects[number].qpos
    turns = Rotation.from_quat(np.roll(np.stack([last, before])[:, 3:], -1, axis=1))
    turn = turns[0] * turns[1].inv() * turns[0]
    return np.concatenate([2.0 * last[:3] - before[:3], np.roll(turn.as_quat(), 1)])


def places_of(read: Reading | None, t: int, body: Body) -> list[Floats]:
    """Poses [7] of what a network sees in frame t that is most like a body."""
    if read is None:
        return []
    none = np.full((1, 3), np.nan)
    cost = unlikeness(
        read.places[t, :, :3],
        read.sizes[t],
        read.colours[t],
        none,
        body.half[None],
        body.colour[None],
    )[0]
    order = np.argsort(cost - np.minimum(read.present[t], 3.0))
    return [read.places[t, slot] for slot in order[:_PEAKS]]


def nearest_turns(
    quats: Floats, seen: npt.NDArray[np.bool_], group: Floats, before: Floats | None = None
) -> Floats:
    """[T, 4] the ones of like orientations that are nearest to those before.

    Args:
      quats: [T, 4] (w x y z). seen: [T] frames to take; NaN in the others.
      group: [K, 3, 3] turns after which the body looks the same, see `like_turns`.
      before: [4] the orientation before the first; none is no turn.
    """
    found = np.full((len(quats), 4), np.nan)
    last = np.eye(3) if before is None else Rotation.from_quat(np.roll(before, -1)).as_matrix()
    for t in np.flatnonzero(seen):
        choices = Rotation.from_quat(np.roll(quats[t], -1)).as_matrix() @ group
        last = choices[int(np.argmax(np.einsum("kij,ij->k", choices, last)))]
        found[t] = continuous(np.roll(Rotation.from_matrix(last).as_quat(), 1), before)
        before = found[t]
    return found


def _stretches(times: Floats, hidden: npt.NDArray[np.bool_]) -> list[dict[str, float]]:
    """From and to, s, of each stretch of frames."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], hidden, [False]]).astype(int)))
    return [
        {"from": float(times[a]), "to": float(times[b - 1])}
        for a, b in zip(edges[::2], edges[1::2], strict=True)
    ]
