"""States from single frames, as StaInf reads them and after they were fitted to the image.

    python tools/collect_vision.py --out data --only test_push --scale 0.05 --no-buffers
    python tools/eval_inference.py data/test_push.h5 --frames 5 [--out FILE]

A line of JSON for each frame, with objects' errors before and after, and a summary at the end. The
scene of each episode is drawn again: sizes and colours are declared, poses are not. With `--open`
sizes and colours are not known either: the fit starts from the network's, and which found object is
which is decided by where they are. `--network` measures the network alone, on frames spread over
all episodes, and its loss: on data that it was trained on and on others, this tells what it has
learned by heart.
"""

from __future__ import annotations

import argparse
import json
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
import torch
from orbisim_diffusion.estimate import load_inference, read_frames
from orbisim_diffusion.inference import inference_loss, robots, truth
from orbisim_diffusion.looks import LookFitter
from orbisim_diffusion.refine import Refiner
from orbisim_diffusion.store import load
from orbisim_diffusion.symmetry import angle, rotation_error
from orbisim_diffusion.tracking import Reading, places_of, reading
from orbisim_diffusion.train_inference import inference_errors
from orbisim_diffusion.training import encoded
from orbisim_diffusion.zoo import FOLDER
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

from orbisim.scene import Scene
from orbisim.tasks.dataset import EpisodeFile
from orbisim.tasks.registry import make

Floats = npt.NDArray[np.float64]

_FRAMES = 1024
"""That the network alone is measured on, at most."""


def main() -> None:
    """Prints the lines, then the summary."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("data", type=Path, help="episodes with images of the camera `side`")
    parser.add_argument("--checkpoint", type=Path, default=FOLDER / "push")
    parser.add_argument("--frames", type=int, default=5, help="of each episode, at random")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--open", action="store_true", help="sizes and colours are fitted, too")
    parser.add_argument("--out", type=Path, help="a file for the lines, too")
    parser.add_argument("--network", action="store_true", help="the network alone")
    parser.add_argument("--episodes", type=int, help="at most so many")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    if arguments.network:
        _say(alone(arguments), arguments.out)
        return
    with EpisodeFile(arguments.data) as file:
        count = min(len(file), arguments.episodes or len(file))
    lines: list[dict[str, Any]] = []
    with ProcessPoolExecutor(arguments.workers, get_context("spawn")) as pool:
        for some in pool.map(trials, [arguments] * count, range(count)):
            for line in some:
                lines.append(line)
                _say(line, arguments.out)
    _say(summary(lines), arguments.out)


def alone(arguments: argparse.Namespace) -> dict[str, Any]:
    """Errors and loss of the network on frames spread over the episodes."""
    point, model = load_inference(arguments.checkpoint)
    store = load([arguments.data], torch.device("cpu"), limit=arguments.episodes)
    store = encoded(point.autoencoder, store)
    assert store.latents is not None
    found: dict[str, Any] = {"frames": len(store), **inference_errors(model, store, _FRAMES)}
    index = torch.arange(0, len(store), max(1, len(store) // _FRAMES))
    with torch.no_grad():
        answer = model.dense(store.latents[index].float())
        true = truth(store, robots(store), index)
        found["loss"] = round(float(inference_loss(model, answer, true, store.view(index))), 4)
    return found


def trials(arguments: argparse.Namespace, episode: int) -> list[dict[str, Any]]:
    """Errors in some frames of an episode."""
    torch.set_num_threads(1)
    point, model = load_inference(arguments.checkpoint)
    rng = np.random.default_rng([arguments.seed, episode])
    with EpisodeFile(arguments.data) as file:
        task = make(file.task, **file.config)
        known = file.attributes(episode)
        arrays = file.episode(episode, ["qpos", "frames/side"])
    scene = task.scene(known["subtask"], known["seed"])
    frames, qpos = arrays["frames/side"], arrays["qpos"]
    refiner = Refiner(scene, scene.model.camera("side").id, frames.shape[1])
    chosen = np.sort(rng.choice(len(qpos), arguments.frames, replace=False))
    network = read_frames(frames[chosen], point, model)
    read, hands = reading(network, len(refiner.scalar.qpos)), Hands(task, scene)
    lines = []
    for i, t in enumerate(chosen):
        if arguments.open:
            found = opened(scene, frames[t], qpos[t], read, i)
        else:
            found = one(refiner, frames[t], qpos[t], read, i)
        fitted = found.pop("qpos")
        told = qpos[t].copy()
        told[refiner.scalar.qpos] = read.joints[i]
        found["hand_network"] = hands.apart(
            network.hand_pos[i].double().numpy(), network.hand_rot[i].double().numpy(), qpos[t]
        )
        found["hand_of_network_joints"] = hands.apart(*hands.at(told), qpos[t])
        found["hand_fit"] = hands.apart(*hands.at(fitted), qpos[t])
        lines.append({"episode": episode, "frame": int(t), **found})
    return lines


class Hands:
    """Where the hand is: the site of the end effector that episodes hold as `robot/pos`."""

    def __init__(self, task: Any, scene: Scene) -> None:
        self.model, self.data = scene.model, mujoco.MjData(scene.model)
        self.site = int(scene.model.site(task.arm.site).id)

    def at(self, qpos: Floats) -> tuple[Floats, Floats]:
        """Position [3], m, and rotation [3, 3] at coordinates [nq]."""
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self.data)
        rot = self.data.site_xmat[self.site].reshape(3, 3).copy()
        return self.data.site_xpos[self.site].copy(), rot

    def apart(self, pos: Floats, rot: Floats, true: Floats) -> list[float]:
        """Errors, mm and degrees, against the hand at true coordinates."""
        place, turn = self.at(true)
        angle = Rotation.from_matrix(rot @ turn.T).magnitude()
        return [
            round(1e3 * float(np.linalg.norm(pos - place)), 3),
            round(float(np.degrees(angle)), 3),
        ]


def opened(
    scene: Scene, frame: npt.NDArray[np.uint8], true: Floats, read: Reading, i: int
) -> dict[str, Any]:
    """Errors in one frame of which sizes and colours are not known."""
    refiner = Refiner(scene, scene.model.camera("side").id, frame.shape[0])
    declared = refiner.bodies
    fitter = LookFitter(refiner, sizes=True, colours=True)
    fitted, looks = fitter.first(frame, read, i)
    places = np.stack([pose.qpos[:3] for pose in fitted.objects])
    truths = np.stack([true[body.qpos : body.qpos + 7] for body in declared])
    far = np.linalg.norm(places[:, None] - truths[None, :, :3], axis=-1)
    far[[not pose.seen for pose in fitted.objects]] += 10.0  # they get what is left
    order = fitter.slots(read, i)
    objects = []
    for k, j in zip(*linear_sum_assignment(far), strict=True):
        pose, look, body, slot = fitted.objects[k], looks[k], declared[j], order[k]
        objects.append(
            {
                "network": _errors(read.places[i, slot], truths[j], body.half),
                "fit": _errors(pose.qpos, truths[j], body.half),
                "seen": bool(pose.seen),
                "explained": round(pose.explained, 3),
                "std_mm": round(1e3 * float(pose.std[:3].max()), 2),
                "size_network": _off(read.sizes[i, slot] / body.half - 1.0, 100.0),
                "size_fit": _off(look.half / body.half - 1.0, 100.0),
                "size_fit_larger": round(100 * float((look.half / body.half - 1.0).mean()), 3),
                "size_std": round(100 * float((look.half_std / look.half).mean()), 3),
                "colour_network": _off(read.colours[i, slot] - body.colour),
                "colour_fit": _off(look.colour - body.colour),
                "colour_std": round(float(look.colour_std.mean()), 4),
            }
        )
    columns = refiner.scalar.qpos
    return {
        "qpos": fitted.qpos,
        "objects": objects,
        "joints_network": _turned(read.joints[i], true[columns]),
        "joints_fit": _turned(fitted.qpos[columns], true[columns]),
    }


def _off(difference: Floats, unit: float = 1.0) -> float:
    """Mean absolute difference."""
    return round(unit * float(np.abs(difference).mean()), 4)


def one(
    refiner: Refiner, frame: npt.NDArray[np.uint8], true: Floats, read: Reading, i: int
) -> dict[str, Any]:
    """Errors in one frame, of the network's answer and of the fit."""
    places = [places_of(read, i, body) for body in refiner.bodies]
    fitted = refiner.first(frame, read.joints[i], places, read.joints[i])
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
        "qpos": fitted.qpos,
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
            for what in ("size", "colour"):
                kept = [o[f"{what}_{source}"] for o in chosen if f"{what}_{source}" in o]
                if kept:
                    found[f"{name}_{source}"][what] = statistics(np.array(kept))
    for source in ("network", "of_network_joints", "fit"):
        hands = np.array([line[f"hand_{source}"] for line in lines]).reshape(-1, 2)
        found[f"hand_{source}"] = {
            "mm": statistics(hands[:, 0]),
            "degrees": statistics(hands[:, 1]),
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
