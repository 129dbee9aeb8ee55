"""PhyInf: density and table friction from a window of 64 frames, by the network and by the fit.

    python tools/eval_phyinf.py data/test_push.h5 --episodes 20 --out out/phyinf [--workers 8]
        [--source true] [--source video] [--network CHECKPOINT ...] [--device cuda] [--read]

Each episode of `push` has a table and cubes of its own. Declared are the middles of their ranges;
sought are the friction of the table and the density of each cube that moves, in the 64 frames in
which the cubes move most: from the true states (`true`), or from what `orbisim infer` reads off the
frames, controls from the joints' motion included (`video`). They are found

- `fit`: by what `orbisim identify` does, by gradients through the learned model;
- `network`: by the PhyInf of a vision checkpoint (each `--network`, named by its folder);
- `both`: by the fit that begins at the network's answer and is weighed against it.

Then the learned model runs free over these frames, from the first state of the same source, with
what was declared, what was found, and what is true, and is held against the true states. Episodes
are prepared on several processes, a file each, which are kept (with `--read` no more is done; what
was read off a video takes longest and is not read off twice); then all are fitted as one batch on
`--device`. `episodes.jsonl` has a line for each, `summary.json` statistics.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import os
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from orbisim_diffusion.estimate import load_inference, read_frames
from orbisim_diffusion.estimate_physics import Said, in_words, load_physics, windows_of
from orbisim_diffusion.physics import Window
from orbisim_diffusion.refine import Refiner
from orbisim_diffusion.symmetry import angle, rotation_error
from orbisim_diffusion.tracking import follow, reading, recording_of
from orbisim_diffusion.zoo import FOLDER
from orbisim_world_model.reading import read_attributes, read_settings
from orbisim_world_model.rotation import to_matrix
from torch import Tensor

from orbisim import make_backend
from orbisim.cli.common import quiet_engine
from orbisim.errors import DivergedError, RecordingError
from orbisim.identification.estimate import PRIOR, estimate
from orbisim.identification.parameters import free_bodies, parameters
from orbisim.identification.residual import errors
from orbisim.identification.windows import Grid, grid
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
_WINDOW, _STEPS = 1.0, 12
"""Of the free runs that are fitted, s, and of the search: those of `orbisim identify`."""
_HAND, _TABLE = "tcp", "table"
"""Site and geom of `push`."""
_UNITS = ("mm", "degrees", "mm_per_s", "hand_mm", "hand_degrees", "hand_mm_per_s")
"""Of errors of rollouts: objects' positions, rotations, velocities, and the hand's; the paper's."""


def main() -> None:
    """Prepares on several processes, fits; prints the summary."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("data", type=Path, help="episodes of push with images of the camera `side`")
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--source", action="append", choices=("true", "video"))
    parser.add_argument("--checkpoint", type=Path, default=FOLDER / "push", help="with StaInf")
    parser.add_argument("--network", type=Path, action="append", default=[], help="with PhyInf")
    parser.add_argument("--no-fit", action="store_true", help="networks alone")
    parser.add_argument("--dynamics", default="learned", help="backend that is fitted")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--seconds", type=float, default=1e9, help="no episode is begun after")
    parser.add_argument("--read", action="store_true", help="prepare episodes, and end")
    parser.add_argument("--backwards", action="store_true", help="begin with the last one")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    end = time.time() + options.seconds
    sources = options.source or ["true", "video"]
    jobs: list[tuple[Any, ...]] = [  # by turns, so that a run that is ended has both
        (options.data, i, source, options.checkpoint, options.out, end)
        for i in range(options.episodes)
        for source in sources
    ]
    if options.backwards:
        jobs.reverse()
    with quiet_engine():
        for _ in pool.run(one, jobs, options.workers):
            pass
        if options.read:
            return
        lines: list[dict[str, Any]] = []
        for source in sources:
            cases = read_cases(options.out, source)
            how = options.dynamics, options.device, not options.no_fit
            lines += measured(cases, options.network, *how)
    (options.out / "episodes.jsonl").write_text("".join(json.dumps(one) + "\n" for one in lines))
    found = summary(lines)
    (options.out / "summary.json").write_text(json.dumps(found, indent=1) + "\n")
    print(json.dumps(found))


# -- what is seen --------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, eq=False)
class Case:
    """One episode as one source shows it; N cubes, C windows of the fit with T steps.

    Attributes:
      moving: [N] whether a cube does. truth: [1 + N] the table's friction and the cubes' densities.
      middle: [2] what is declared of both. attributes, settings: of the scene, as the learned model
        takes them, with the true values.
      fit: the fit's windows. whole: all frames. shown: what the network sees (`Window`).
      qpos, qvel: [T + 1, ...] the true states from the first of `whole` on.
    """

    moving: npt.NDArray[np.bool_]
    truth: Floats
    middle: Floats
    attributes: Floats
    settings: Floats
    fit: Grid
    whole: Grid
    shown: Window
    qpos: Floats
    qvel: Floats

    def save(self, path: Path) -> None:
        """Writes a file that `load` reads."""
        arrays: dict[str, Any] = {}
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, Grid):
                arrays |= {f"{field.name}.{n}": v for n, v in vars(value).items()}
            elif isinstance(value, Window):
                arrays |= {f"{field.name}.{n}": v.numpy() for n, v in value._asdict().items()}
            else:
                arrays[field.name] = value
        part = path.with_name(f"part_{os.getpid()}_{path.name}")
        np.savez(part, **arrays)
        part.replace(path)

    @staticmethod
    def load(path: Path) -> Case:
        """Reads what `save` wrote."""
        with np.load(path) as file:
            arrays = dict(file)

        def part(name: str) -> dict[str, Any]:
            begin = f"{name}."
            return {n.removeprefix(begin): v for n, v in arrays.items() if n.startswith(begin)}

        plain = {n: v for n, v in arrays.items() if "." not in n}
        shown = Window(**{n: torch.as_tensor(v) for n, v in part("shown").items()})
        return Case(**plain, fit=Grid(**part("fit")), whole=Grid(**part("whole")), shown=shown)


def one(data: Path, number: int, source: str, checkpoint: Path, out: Path, end: float) -> None:
    """Prepares one episode, unless that is done or the time is over."""
    path = out / f"{source}_{number:03d}.json"
    if path.exists() or time.time() > end:
        return
    torch.set_num_threads(1)
    warnings.simplefilter("ignore")
    begun = time.time()
    line: dict[str, Any] = {"episode": number, "source": source}
    try:
        prepared(data, line, checkpoint, out / f"case_{source}_{number:03d}.npz")
    except (RecordingError, DivergedError) as error:  # what is not shown cannot be fitted
        line["failed"] = str(error)
    line["seconds"] = round(time.time() - begun, 1)
    path.write_text(json.dumps(line) + "\n")


def prepared(data: Path, line: dict[str, Any], checkpoint: Path, path: Path) -> None:
    """Writes the case that `line` names, if a cube moves; adds to the line what came out.

    Raises:
      RecordingError: the source does not have what a fit needs.
    """
    number = line["episode"]
    with EpisodeFile(data) as file:
        task, known = make(file.task, **file.config), file.attributes(number)
        names = ["qpos", "qvel", "ctrl"] + (["frames/side"] if line["source"] == "video" else [])
        arrays = file.episode(number, names)
    scene = task.scene(known["subtask"], known["seed"])
    bodies = free_bodies(scene.model)
    cubes = [int(scene.model.joint(name).qposadr[0]) for name in bodies]
    rows = busiest(arrays["qpos"], cubes)
    qpos, qvel = arrays["qpos"][rows], arrays["qvel"][rows]
    ctrl = arrays["ctrl"][rows.start : rows.stop - 1]
    way = [float(np.linalg.norm(np.diff(qpos[:, a : a + 2], axis=0), axis=1).sum()) for a in cubes]
    moving = np.array(way) > _MOVES
    line["moving"] = int(moving.sum())
    if not moving.any():
        return
    wanted = parameters(scene, [f"friction:{_TABLE}", *(f"density:{name}" for name in bodies)])
    if line["source"] == "true":
        time_ = np.arange(len(qpos)) * np.float64(STEP)
        held = np.concatenate([ctrl, ctrl[-1:]])
        recording = Recording(time_, {"qpos": qpos, "ctrl": held}, source=f"episode {number}")
    else:
        frames = arrays["frames/side"][rows]
        kept = path.with_name(path.name.replace("case_", ""))
        recording = read_once(kept, lambda: watched(scene, frames, checkpoint))
        recording, first = from_where_all_is_seen(recording)
        qpos, qvel = qpos[first:], qvel[first:]
        line["frames"] = len(qpos)
        if len(qpos) < _FEWEST:
            raise RecordingError(
                recording.source,
                f"{len(qpos)} frames are left from the first one in which all objects are seen",
                remedy=f"{_FEWEST} are needed",
            )
    bound = bind(recording, scene)
    pieces, whole = prepare(bound, _WINDOW), prepare(bound, 0.0)
    shown = windows_of(scene, bound.time, bound.qpos, _HAND, STEP)
    if shown is None:
        raise RecordingError(recording.source, "no object is seen often enough")
    start = whole.windows[0].start
    backend: Any = make_backend("learned", scene, device="cpu", compiled=False)
    layout = backend.engine.layout
    config = task.config
    Case(
        moving=moving,
        truth=np.array([p.declared for p in wanted]),
        middle=np.array([np.mean(config.table_friction), np.mean(config.density)]),
        attributes=read_attributes(scene.model, layout),
        settings=read_settings(scene.model, layout),
        fit=grid([pieces], STEP),
        whole=grid([whole], STEP),
        shown=shown,
        qpos=qpos[start:],
        qvel=qvel[start:],
    ).save(path)


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
        part = kept.with_name(f"part_{os.getpid()}_{kept.name}")
        read().save(part)  # a run that is ended leaves no half of a file
        part.replace(kept)
    return Recording.load(kept)


def watched(scene: Scene, frames: npt.NDArray[np.uint8], checkpoint: Path) -> Recording:
    """As `orbisim infer` does; of the scene it takes neither friction nor densities."""
    point, model = load_inference(checkpoint)
    refiner = Refiner(scene, scene.model.camera("side").id, frames.shape[1])
    read = reading(read_frames(frames, point, model), len(refiner.scalar.qpos))
    times = np.arange(len(frames)) * np.float64(STEP)
    found = recording_of(scene, refiner, times, follow(refiner, frames, read))
    return with_controls(found, scene.model)


# -- what is found -------------------------------------------------------------------------------


def read_cases(out: Path, source: str) -> list[tuple[dict[str, Any], Case | None]]:
    """Lines of the episodes in which a cube moves, with what there is to fit."""
    found = []
    for path in sorted(out.glob(f"{source}_[0-9]*.json")):
        line = json.loads(path.read_text())
        if line["moving"]:
            case = out / f"case_{path.stem}.npz"
            found.append((line, None if "failed" in line else Case.load(case)))
    return found


def measured(
    cases: Sequence[tuple[dict[str, Any], Case | None]],
    networks: Sequence[Path],
    dynamics: str,
    device: str,
    fits: bool = True,
) -> list[dict[str, Any]]:
    """The lines with what was found (`fits`: by fits, too), and errors of rollouts with it."""
    lines, known = [line for line, _ in cases], [case for _, case in cases if case is not None]
    fitted = [line for line, case in cases if case is not None]
    if not known:
        return lines
    batch = Batch(known, dynamics, device)
    found = {"fit": batch.fit(None)} if fits else {}
    for path in networks:
        said = batch.network(path)
        found[f"network {path.name}"] = said
        if fits:
            found[f"both {path.name}"] = batch.fit(said)
    truth, middle = batch.truth, batch.middle
    runs = {"declared": batch.rollout(middle), "true": batch.rollout(truth)}
    runs |= {name: batch.rollout(some.value) for name, some in found.items()}
    for number, (line, case) in enumerate(zip(fitted, known, strict=True)):
        names = [f"friction:{_TABLE}", *(f"density:cube{i + 1}" for i in range(len(case.moving)))]
        line["parameters"] = [
            {"name": name, "true": float(truth[number, i]), "declared": float(middle[number, i])}
            | {
                which: [float(v[number, i]) for v in (some.value, some.low, some.high)]
                for which, some in found.items()
            }
            for i, name in enumerate(names)
            if i == 0 or case.moving[i - 1]
        ]
        line["rollouts"] = {name: rows[number] for name, rows in runs.items()}
    return lines


@dataclasses.dataclass(frozen=True)
class Found:
    """value, low, high: [G, 1 + N], and 95 % intervals. spread: of the logarithms, or None."""

    value: Tensor
    low: Tensor
    high: Tensor
    spread: Tensor | None = None


class Batch:
    """All episodes of a source as one batch on a device."""

    def __init__(self, cases: Sequence[Case], dynamics: str, device: str) -> None:
        self.cases, self.device = cases, torch.device(device)
        scene = make("push").scene()
        self.scene, self.bodies = scene, free_bodies(scene.model)
        self.cubes = [int(scene.model.joint(name).qposadr[0]) for name in self.bodies]
        how: Any = {"compiled": False, "half": False}  # as precise as gradients are, on a GPU, too
        self.backend: Any = make_backend(dynamics, scene, device=device, **how)
        self.truth = torch.as_tensor(np.stack([c.truth for c in cases])).to(self.device)
        middle = np.stack([[c.middle[0], *([c.middle[1]] * len(c.moving))] for c in cases])
        self.middle = torch.as_tensor(middle).to(self.device)
        self._moving = self._all([np.concatenate([[True], c.moving]) for c in cases])
        self._described = [self._all([getattr(c, n) for c in cases], torch.float32)
                           for n in ("attributes", "settings")]  # fmt: skip

    def _all(self, arrays: Sequence[Any], dtype: Any = None) -> Tensor:
        return torch.as_tensor(np.stack(arrays)).to(self.device, dtype)

    def network(self, path: Path) -> Found:
        """What a checkpoint's PhyInf says."""
        model, _ = load_physics(path)
        with torch.no_grad():
            said = [in_words(model, model.said(c.shown), _TABLE, self.bodies) for c in self.cases]
        return Found(*(self._said(said, name) for name in ("value", "low", "high", "spread")))

    def _said(self, said: Sequence[dict[str, Said]], name: str) -> Tensor:
        return self._all([[getattr(one, name) for one in some.values()] for some in said])

    def fit(self, guess: Found | None) -> Found:
        """As `orbisim identify` does, from what is declared or from what a network says."""
        windows = [c.fit for c in self.cases]
        group = np.repeat(np.arange(len(windows)), [len(w.qpos) for w in windows])
        belongs = torch.as_tensor(group).to(self.device)
        fields = [f.name for f in dataclasses.fields(Grid)]
        stacked = {n: np.concatenate([getattr(w, n) for w in windows]) for n in fields}
        target = torch.as_tensor(stacked["target"]).to(self.device)

        def residuals(values: Tensor) -> Tensor:
            copies = len(values) // len(target)
            path = self._run(stacked, belongs, values)
            wanted = torch.cat([target] * copies)
            return errors(path.qpos.to(wanted.dtype), wanted, [], self.cubes)

        start = self.middle if guess is None else guess.value
        spread = torch.full_like(start, math.log(PRIOR)) if guess is None else guess.spread
        limits, count = self._bounds(), target.shape[1]
        found = estimate(residuals, start, limits, belongs, _STEPS, count, spread=spread)
        return Found(found.values, found.low, found.high)

    def _bounds(self) -> tuple[Tensor, Tensor]:
        """[G, 1 + N]: what the model was trained on, as in `identification.learned`."""
        backend, columns = self.backend, self.backend.engine.layout.attributes
        low, high = self.truth.clone(), self.truth.clone()
        friction = backend.trained(_TABLE, "friction_slide")
        low[:, 0], high[:, 0] = friction
        half = [columns.index(f"half_{axis}") for axis in "xyz"]
        volume = 8.0 * self._described[0][..., half].double().prod(-1)
        least, most = backend.trained(self.bodies[0], "mass")
        low[:, 1:], high[:, 1:] = least / volume, most / volume
        return low, high

    def _run(self, arrays: dict[str, Any], belongs: Tensor, values: Tensor) -> Any:
        """Rollouts of windows, in copies, under values; of cubes that rest densities are true."""
        copies = len(values) // len(belongs)
        which = torch.cat([belongs] * copies)
        values = torch.where(self._moving[which], values, self.truth[which])
        start = [torch.as_tensor(arrays[n]).to(self.device) for n in ("qpos", "qvel", "act")]
        controls = torch.as_tensor(arrays["ctrl"]).to(self.device)
        *start, controls = (torch.cat([a] * copies) for a in (*start, controls))
        time_ = torch.zeros(len(values), dtype=start[0].dtype, device=self.device)
        attributes, settings = (a[which] for a in self._described)
        objects = {n: {"density": values[:, i + 1]} for i, n in enumerate(self.bodies)}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of values far from the data, on the way
            state = self.backend.with_descriptors(
                State(time_, *start), attributes=attributes, settings=settings
            )
            world = {"friction_slide": values[:, 0]}
            state = self.backend.with_properties(state, objects, world)
            return self.backend.rollout(state, controls)

    def rollout(self, values: Tensor) -> list[dict[str, Any]]:
        """Errors over all frames of free runs, against the true states, for each episode.

        `none` alone, with the step, where the model's state diverged on the way.
        """
        longest = max(c.whole.ctrl.shape[1] for c in self.cases)

        def padded(controls: Floats) -> Floats:
            return np.pad(controls, ((0, 0), (0, longest - controls.shape[1]), (0, 0)), "edge")

        arrays = {n: np.concatenate([getattr(c.whole, n)[:1] for c in self.cases])
                  for n in ("qpos", "qvel", "act")}  # fmt: skip
        arrays["ctrl"] = np.concatenate([padded(c.whole.ctrl[:1]) for c in self.cases])
        with torch.no_grad():
            path = self._run(arrays, torch.arange(len(self.cases), device=self.device), values)
        qpos, qvel = (torch.as_tensor(a).double().cpu() for a in (path.qpos, path.qvel))
        diverged = np.asarray(torch.as_tensor(path.diverged_at).cpu())
        found = []
        for number, case in enumerate(self.cases):
            steps = min(case.whole.ctrl.shape[1], len(case.qpos) - 1)
            if 0 <= diverged[number] < steps:
                found.append({"none": f"diverged at step {diverged[number]} of {steps}"})
                continue
            truth = [torch.as_tensor(a[1 : steps + 1]).double() for a in (case.qpos, case.qvel)]
            found.append(self._errors((qpos[number, :steps], qvel[number, :steps]), truth, case))
        return found

    def _errors(self, found: Any, true: Any, case: Case) -> dict[str, Any]:
        """Means over frames (and cubes) in the units `_UNITS`, and of the last frame."""
        (q, v), (tq, tv) = found, true
        layout = self.backend.engine.layout
        places = torch.stack([(q - tq)[:, a : a + 3].norm(dim=-1) for a in self.cubes])
        speeds = torch.stack([(v - tv)[:, a : a + 3].norm(dim=-1) for a in layout.object_v])
        half = torch.as_tensor(case.attributes[:, :3]).double()
        turns = [turned(q[:, a : a + 7], tq[:, a : a + 7], half[i])
                 for i, a in enumerate(self.cubes)]  # fmt: skip
        hand, true_hand = (self._hand(*pair) for pair in ((q, v), (tq, tv)))
        rotations = [x[:, 3:12].unflatten(-1, (3, 3)) for x in (hand, true_hand)]
        away = angle((rotations[0] - rotations[1]).square().sum((-1, -2))).rad2deg()
        values = (
            1e3 * places.mean(),
            torch.stack(turns).mean(),
            1e3 * speeds.mean(),
            1e3 * (hand - true_hand)[:, :3].norm(dim=-1).mean(),
            away.mean(),
            1e3 * (hand - true_hand)[:, 12:15].norm(dim=-1).mean(),
        )
        found = {n: round(float(v), 3) for n, v in zip(_UNITS, values, strict=True)}
        return found | {"mm_last": round(1e3 * float(places[:, -1].mean()), 3)}

    def _hand(self, qpos: Tensor, qvel: Tensor) -> Tensor:
        layout, model = self.backend.engine.layout, self.backend.engine.stepper.model
        q, v = qpos[:, list(layout.joint_q)], qvel[:, list(layout.joint_v)]
        x: Tensor = model.kinematics(q.float().to(self.device), v.float().to(self.device))
        return x.double().cpu()


def turned(found: Tensor, true: Tensor, half: Tensor) -> Tensor:
    """Degrees [T] between orientations of poses [T, 7], up to the box's symmetries."""
    one, other = (to_matrix(x[:, 3:] / x[:, 3:].norm(dim=-1, keepdim=True)) for x in (found, true))
    return angle(rotation_error(one, other, half.expand(len(one), 3))).rad2deg()


# -- statistics ----------------------------------------------------------------------------------


def summary(lines: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Statistics of both sources."""
    found: dict[str, Any] = {}
    for source in dict.fromkeys(line["source"] for line in lines):
        moving = [line for line in lines if line["source"] == source]
        some = [line for line in moving if "failed" not in line]
        failed = {line["episode"]: line["failed"] for line in moving if "failed" in line}
        part: dict[str, Any] = {"episodes": len(moving), "fitted": len(some), "failed": failed}
        ways = list(some[0]["rollouts"]) if some else []
        for name in ("friction", "density"):
            rows = [p for line in some for p in line["parameters"] if p["name"].startswith(name)]
            of: dict[str, Any] = {}
            for which in ways:
                if which == "true":
                    continue
                values = [p[which] if which == "declared" else p[which][0] for p in rows]
                off = [100 * abs(v / p["true"] - 1.0) for v, p in zip(values, rows, strict=True)]
                of[which] = _statistics(off)
                if which != "declared":
                    inside = [p[which][1] <= p["true"] <= p[which][2] for p in rows]
                    of[which]["covered"] = round(float(np.mean(inside)), 3)
                    wide = [(p[which][2] - p[which][1]) / p["true"] for p in rows]
                    of[which]["width_percent"] = round(100 * float(np.median(wide)), 1)
            part[f"{name}_percent"] = {"count": len(rows)} | of
        for which in ways:
            every = {line["episode"]: line["rollouts"][which] for line in some}
            runs = [run for run in every.values() if "none" not in run]
            none = {episode: run["none"] for episode, run in every.items() if "none" in run}
            part[f"rollouts {which}"] = {"runs": len(runs), "none": none} | {
                unit: _statistics([run[unit] for run in runs]) for unit in _UNITS
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
