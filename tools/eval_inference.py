"""States from single frames, as StaInf reads them and after they were fitted to the image.

    python tools/collect_vision.py --out data --only test_push --scale 0.05 --no-buffers
    python tools/eval_inference.py data/test_push.h5 --frames 5 [--out FILE]

A line of JSON for each frame, with objects' errors before and after, and a summary at the end. The
scene of each episode is drawn again: sizes and colours are declared, poses are not.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from orbisim_diffusion.estimate import load_inference, read_frames
from orbisim_diffusion.refine import Refiner
from orbisim_diffusion.symmetry import angle, rotation_error
from orbisim_diffusion.tracking import Reading, places_of, reading
from orbisim_diffusion.zoo import FOLDER
from scipy.spatial.transform import Rotation

from orbisim.tasks.dataset import EpisodeFile
from orbisim.tasks.registry import make

Floats = npt.NDArray[np.float64]


def main() -> None:
    """Prints the lines, then the summary."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("data", type=Path, help="episodes with images of the camera `side`")
    parser.add_argument("--checkpoint", type=Path, default=FOLDER / "push")
    parser.add_argument("--frames", type=int, default=5, help="of each episode, at random")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="a file for the lines, too")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    lines: list[dict[str, Any]] = []
    for line in trials(arguments):
        lines.append(line)
        _say(line, arguments.out)
    _say(summary(lines), arguments.out)


def trials(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Errors in some frames of each episode."""
    point, model = load_inference(arguments.checkpoint)
    rng = np.random.default_rng(arguments.seed)
    with EpisodeFile(arguments.data) as file:
        changes = {n: tuple(v) if isinstance(v, list) else v for n, v in file.config.items()}
        task = make(file.task, **changes)
        for episode in range(len(file)):
            known = file.attributes(episode)
            scene = task.scene(known["subtask"], known["seed"])
            arrays = file.episode(episode, ["qpos", "frames/side"])
            frames, qpos = arrays["frames/side"], arrays["qpos"]
            refiner = Refiner(scene, scene.model.camera("side").id, frames.shape[1])
            chosen = np.sort(rng.choice(len(qpos), arguments.frames, replace=False))
            read = reading(read_frames(frames[chosen], point, model), len(refiner.scalar.qpos))
            for i, t in enumerate(chosen):
                found = one(refiner, frames[t], qpos[t], read, i)
                yield {"episode": episode, "frame": int(t), **found}


def one(
    refiner: Refiner, frame: npt.NDArray[np.uint8], true: Floats, read: Reading, i: int
) -> dict[str, Any]:
    """Errors in one frame, of the network's answer and of the fit."""
    places = [places_of(read, i, body) for body in refiner.bodies]
    fitted = refiner.first(frame, read.joints[i], places)
    columns = refiner.scalar.qpos
    objects = []
    for body, place, pose in zip(refiner.bodies, places, fitted.objects, strict=True):
        truth = true[body.qpos : body.qpos + 7]
        objects.append(
            {
                "network": _errors(place[0], truth, body.half),
                "fit": _errors(pose.qpos, truth, body.half),
                "seen": bool(pose.seen),
                "explained": round(pose.explained, 3),
                "std_mm": round(1e3 * float(pose.std[:3].max()), 2),
            }
        )
    return {
        "objects": objects,
        "joints_network": _turned(read.joints[i], true[columns]),
        "joints_fit": _turned(fitted.qpos[columns], true[columns]),
    }


def summary(lines: list[dict[str, Any]]) -> dict[str, Any]:
    """Statistics over all objects, and over those that the fit says are seen."""
    every = [one for line in lines for one in line["objects"]]
    sets = {"all": every, "seen": [o for o in every if o["seen"]]}
    found: dict[str, Any] = {"frames": len(lines), "objects": len(every)}
    found["seen_share"] = round(len(sets["seen"]) / max(1, len(every)), 3)
    for name, chosen in sets.items():
        for source in ("network", "fit"):
            values = np.array([o[source] for o in chosen]).reshape(-1, 2)
            found[f"{name}_{source}"] = {
                "mm": statistics(values[:, 0]),
                "degrees": statistics(values[:, 1]),
            }
    for source in ("network", "fit"):
        found[f"joints_{source}"] = statistics(
            np.concatenate([line[f"joints_{source}"] for line in lines])
        )
    return found


def statistics(values: Floats) -> dict[str, float]:
    """Mean, median, 90 % and worst."""
    if not len(values):
        return {}
    found = {
        "mean": values.mean(),
        "median": np.median(values),
        "p90": np.quantile(values, 0.9),
        "worst": values.max(),
    }
    return {name: round(float(value), 4) for name, value in found.items()}


def _errors(pose: Floats, true: Floats, half: Floats) -> list[float]:
    """Of position, mm, and of orientation up to the box's symmetries, degrees."""
    turns = [
        torch.as_tensor(Rotation.from_quat(np.roll(one[3:], -1)).as_matrix())
        for one in (pose, true)
    ]
    turned = angle(rotation_error(turns[0], turns[1], torch.as_tensor(half)))
    return [
        round(1e3 * float(np.linalg.norm(pose[:3] - true[:3])), 3),
        round(float(turned.rad2deg()), 3),
    ]


def _turned(found: Floats, true: Floats) -> list[float]:
    """Differences of joints: a turn more or less looks the same."""
    return [round(float(abs((d + np.pi) % (2 * np.pi) - np.pi)), 4) for d in found - true]


def _say(line: dict[str, Any], out: Path | None) -> None:
    text = json.dumps(line)
    print(text, flush=True)
    if out:
        with out.open("a") as file:
            file.write(text + "\n")


if __name__ == "__main__":
    main()
