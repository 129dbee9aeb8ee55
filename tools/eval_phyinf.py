"""PhyInf: density and table friction from a window of 64 frames, through the frozen dynamics.

    python tools/eval_phyinf.py data/test_push.h5 --episodes 20 --out out/phyinf [--workers 8]
        [--source true] [--source video]

Each episode of `push` has a table and cubes of its own. Declared are the middles of their ranges;
`orbisim identify` fits the friction of the table and the density of each cube that moves, by
gradients through the learned model, to the 64 frames in which the cubes move most: to the true
states (`true`), or to what `orbisim infer` reads off the frames, controls from the joints' motion
included (`video`). Then the learned model runs free over these frames, from the first state of the
same source, with what was declared, what was found, and what is true, and is held against the true
states. A file for each episode and source, which are kept, and `summary.json`; of a video also what
was read off it (`video_NNN.npz`), which takes longer than the fit and is not read off twice.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from orbisim_diffusion.estimate import load_inference, read_frames
from orbisim_diffusion.refine import Refiner
from orbisim_diffusion.symmetry import angle, rotation_error
from orbisim_diffusion.tracking import follow, reading, recording_of
from orbisim_diffusion.zoo import FOLDER
from orbisim_world_model.watch import OutsideTrainingWarning, UncertainPredictionWarning
from scipy.spatial.transform import Rotation

from orbisim import make_backend
from orbisim.cli.common import quiet_engine
from orbisim.errors import DivergedError, RecordingError
from orbisim.identification import identify
from orbisim.identification.parameters import free_bodies, parameters, patched
from orbisim.identification.windows import grid
from orbisim.recording import Recording, bind
from orbisim.recording.servo import with_controls
from orbisim.replay import prepare
from orbisim.scene import Scene
from orbisim.state import State
from orbisim.tasks import pool
from orbisim.tasks.dataset import EpisodeFile
from orbisim.tasks.registry import make

Floats = npt.NDArray[np.float64]

FRAMES, STEP = 64, 0.05
"""Of a window (the paper's), and between them, s."""
_MOVES = 0.02
"""m, that a cube must move for its density, and the friction under it, to show."""
_FEWEST = 22
"""Frames that a window of the fit and what is smoothed about it need; a film with fewer from where
all is seen on counts as failed."""
_WINDOW = 1.0
"""Of the free runs that are fitted, s."""


def main() -> None:
    """Fits on several processes; prints the summary."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("data", type=Path, help="episodes of push with images of the camera `side`")
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--source", action="append", choices=("true", "video"))
    parser.add_argument("--checkpoint", type=Path, default=FOLDER / "push", help="with StaInf")
    parser.add_argument("--dynamics", default="learned", help="backend that is fitted")
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--seconds", type=float, default=1e9, help="no episode is begun after")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    end = time.time() + options.seconds
    jobs: list[tuple[Any, ...]] = [  # by turns, so that a run that is ended has both
        (options.data, i, source, options.checkpoint, options.dynamics, options.out, end)
        for i in range(options.episodes)
        for source in options.source or ("true", "video")
    ]
    with quiet_engine():
        for _ in pool.run(one, jobs, options.workers):  # a run may be ended from outside
            found = summary(options.out)
            (options.out / "summary.json").write_text(json.dumps(found, indent=1) + "\n")
    print(json.dumps(found))


def one(
    data: Path, number: int, source: str, checkpoint: Path, dynamics: str, out: Path, end: float
) -> None:
    """One episode, unless it is done or the time is over."""
    path = out / f"{source}_{number:03d}.json"
    if path.exists() or time.time() > end:
        return
    torch.set_num_threads(1)
    warnings.simplefilter("ignore")
    begun = time.time()
    line: dict[str, Any] = {"episode": number, "source": source}
    try:
        measure(data, line, checkpoint, dynamics, path.with_suffix(".npz"))
    except (RecordingError, DivergedError) as error:  # what is not shown cannot be fitted
        line["failed"] = str(error)
    line["seconds"] = round(time.time() - begun, 1)
    path.write_text(json.dumps(line) + "\n")


def measure(data: Path, line: dict[str, Any], checkpoint: Path, dynamics: str, kept: Path) -> None:
    """Fits and runs the episode and source that `line` names; adds what came out to it.

    Args:
      kept: where what is read off a video stays, or is from an earlier run.

    Raises:
      RecordingError: the source does not have what a fit needs.
    """
    number = line["episode"]
    with EpisodeFile(data) as file:
        task, known = make(file.task, **file.config), file.attributes(number)
        arrays = file.episode(number, ["qpos", "ctrl", "frames/side"])
    scene = task.scene(known["subtask"], known["seed"])
    bodies = free_bodies(scene.model)
    cubes = [int(scene.model.joint(name).qposadr[0]) for name in bodies]
    rows = busiest(arrays["qpos"], cubes)
    qpos, ctrl = arrays["qpos"][rows], arrays["ctrl"][rows.start : rows.stop - 1]
    way = [float(np.linalg.norm(np.diff(qpos[:, a : a + 2], axis=0), axis=1).sum()) for a in cubes]
    moving = [name for name, far in zip(bodies, way, strict=True) if far > _MOVES]
    line["moving"] = len(moving)
    if moving:
        names = ["friction:table", *(f"density:{name}" for name in moving)]
        truth = parameters(scene, names)
        middle = [
            float(
                np.mean(task.config.table_friction if p.name == "friction" else task.config.density)
            )
            for p in truth
        ]
        declared = patched(scene, dict(zip(truth, middle, strict=True)))
        if line["source"] == "true":
            time_ = np.arange(len(qpos)) * np.float64(STEP)
            held = np.concatenate([ctrl, ctrl[-1:]])
            recording = Recording(time_, {"qpos": qpos, "ctrl": held}, source=f"episode {number}")
        else:
            frames = arrays["frames/side"][rows]
            recording = read_once(kept, lambda: watched(declared, frames, checkpoint))
            recording, first = from_where_all_is_seen(recording)
            qpos = qpos[first:]
            line["frames"] = len(qpos)
            if len(qpos) < _FEWEST:
                raise RecordingError(
                    recording.source,
                    f"{len(qpos)} frames are left from the first one in which all objects are seen",
                    remedy=f"{_FEWEST} are needed",
                )
        found = identify(
            declared, [recording], names, backend=dynamics, window=_WINDOW, check=False
        )
        line["parameters"] = [
            {"name": p.name, "true": t.declared, "declared": m, "found": v, "ci95": [a, b]}
            for p, t, m, v, a, b in zip(
                found.parameters, truth, middle, found.values, found.low, found.high, strict=True
            )
        ]
        for name, some in (("declared", declared), ("found", found.augmented), ("true", scene)):
            line[f"rollout_{name}"] = rollout(some, recording, qpos, cubes, dynamics)


def from_where_all_is_seen(recording: Recording) -> tuple[Recording, int]:
    """The recording from the first frame on in which every object is seen, and that frame.

    Raises:
      RecordingError: there is none.
    """
    places = [v for n, v in recording.signals.items() if n.startswith("xpos/")]
    seen = np.asarray(np.isfinite(np.concatenate(places, axis=1)).all(axis=1)).reshape(-1)
    if not seen.any():
        raise RecordingError(
            recording.source,
            f"no frame of {len(seen)} shows all objects, so that no rollout can start",
            remedy="film them from where none hides another one",
        )
    first = int(np.argmax(seen))
    rest = {name: values[first:] for name, values in recording.signals.items()}
    return dataclasses.replace(recording, time=recording.time[first:], signals=rest), first


def busiest(qpos: Floats, cubes: list[int]) -> slice:
    """The 64 frames in which cubes move most."""
    steps = sum(np.linalg.norm(np.diff(qpos[:, a : a + 2], axis=0), axis=1) for a in cubes)
    total = np.concatenate([[0.0], np.cumsum(steps)])
    count = min(FRAMES, len(qpos))
    start = int(np.argmax(total[count - 1 :] - total[: len(total) - count + 1]))
    return slice(start, start + count)


def read_once(kept: Path, read: Callable[[], Recording]) -> Recording:
    """What `read` returns, or what it returned in an earlier run and the file has."""
    if not kept.exists():
        part = kept.with_name(f"part_{kept.name}")  # a run that is ended leaves no half of a file
        read().save(part)
        part.replace(kept)
    return Recording.load(kept)


def watched(scene: Scene, frames: npt.NDArray[np.uint8], checkpoint: Path) -> Recording:
    """As `orbisim infer` does."""
    point, model = load_inference(checkpoint)
    refiner = Refiner(scene, scene.model.camera("side").id, frames.shape[1])
    read = reading(read_frames(frames, point, model), len(refiner.scalar.qpos))
    times = np.arange(len(frames)) * np.float64(STEP)
    found = recording_of(scene, refiner, times, follow(refiner, frames, read))
    return with_controls(found, scene.model)


def rollout(
    scene: Scene, recording: Recording, true: Floats, cubes: list[int], dynamics: str
) -> dict[str, Any]:
    """Errors over the window of a free run from its first state, against the true states.

    `none` alone, with the reason, where the model's state diverged on the way. `outside` says what
    left the model's training data.
    """
    prepared = prepare(bind(recording, scene), 0.0)
    backend: Any = make_backend(dynamics, scene, device="cpu", compiled=False)
    windows = grid([prepared], backend.timestep)
    rows = prepared.windows[0]  # it begins where all is seen
    state = State(np.zeros(1), windows.qpos[:1], windows.qvel[:1], windows.act[:1])
    with torch.no_grad(), warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", OutsideTrainingWarning)
        try:
            path = backend.rollout(state, windows.ctrl[:1], raise_on_divergence=True)
        except DivergedError as error:
            return {"none": f"of {windows.ctrl.shape[1]} steps: {error}", "outside": _said(said)}
    path = np.asarray(path.qpos)[0]
    truth = true[rows.start + 1 : rows.start + 1 + windows.ctrl.shape[1]]
    found = path[-windows.ctrl.shape[1] :][: len(truth)]
    places = [np.linalg.norm(found[:, a : a + 3] - truth[:, a : a + 3], axis=1) for a in cubes]
    turns = [
        _turned(scene, i, found[:, a : a + 7], truth[:, a : a + 7]) for i, a in enumerate(cubes)
    ]
    return {
        "mm": round(1e3 * float(np.mean(places)), 3),
        "mm_last": round(1e3 * float(np.mean([p[-1] for p in places])), 3),
        "degrees": round(float(np.mean(turns)), 3),
        "outside": _said(said),
    }


def _said(caught: list[warnings.WarningMessage]) -> list[str]:
    """Of states outside the training data; that a prediction is unsure is another matter."""
    kinds = OutsideTrainingWarning, UncertainPredictionWarning
    return [
        str(one.message)
        for one in caught
        if issubclass(one.category, kinds[0]) and not issubclass(one.category, kinds[1])
    ]


def _turned(scene: Scene, number: int, found: Floats, true: Floats) -> Floats:
    """Degrees [T] between orientations, up to the box's symmetries."""
    body = int(scene.model.body(free_bodies(scene.model)[number]).id)
    half = torch.as_tensor(scene.model.geom_size[int(scene.model.body_geomadr[body])].copy())
    one, other = (
        torch.as_tensor(Rotation.from_quat(np.roll(x[:, 3:], -1, axis=1)).as_matrix())
        for x in (found, true)
    )
    turned: Floats = angle(rotation_error(one, other, half.expand(len(one), 3))).rad2deg().numpy()
    return turned


def summary(out: Path) -> dict[str, Any]:
    """Over all episodes in which a cube moves, and which could not be fitted, with the reason."""
    found: dict[str, Any] = {}
    for source in ("true", "video"):
        lines = [json.loads(p.read_text()) for p in sorted(out.glob(f"{source}_*.json"))]
        moving = [line for line in lines if line["moving"]]
        lines = [line for line in moving if "failed" not in line]
        failed = {line["episode"]: line["failed"] for line in moving if "failed" in line}
        part: dict[str, Any] = {"episodes": len(moving), "fitted": len(lines), "failed": failed}
        for name in ("friction", "density"):
            some = [p for line in lines for p in line["parameters"] if p["name"] == name]
            for which in ("declared", "found"):
                off = [100 * abs(p[which] / p["true"] - 1.0) for p in some]
                part[f"{name}_percent_{which}"] = _statistics(off)
            part[f"{name}_covered"] = (
                round(float(np.mean([p["ci95"][0] <= p["true"] <= p["ci95"][1] for p in some])), 3)
                if some
                else None
            )
        for which in ("declared", "found", "true"):
            every = {line["episode"]: line[f"rollout_{which}"] for line in lines}
            runs = [run for run in every.values() if "none" not in run]
            none = {episode: run["none"] for episode, run in every.items() if "none" in run}
            part[f"rollouts_{which}"] = {"runs": len(runs), "none": none} | {
                unit: _statistics([run[unit] for run in runs]) for unit in ("mm", "degrees")
            }
        found[source] = part
    return found


def _statistics(values: list[float]) -> dict[str, float]:
    if not values:
        return {}
    v = np.array(values)
    rows = {"mean": v.mean(), "median": np.median(v), "p90": np.quantile(v, 0.9), "worst": v.max()}
    return {name: round(float(value), 3) for name, value in rows.items()}


if __name__ == "__main__":
    main()
