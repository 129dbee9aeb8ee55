"""Films of a task's script, and the states that are read off their frames (paper 3.5, the second
regime): what a training from pixels begins with.

The script acts, C MuJoCo steps, a camera films (`filming`). StaInf reads each frame, so that
episodes begin where the first frame seems to show them; PhyInf (`phyinf`) fits what no frame shows
to the film's motion. As a simulator films, the true states are known, too: how far readings were
off is kept, and nothing else is made of them.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
import torch
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from orbisim.errors import InputError
from orbisim.files.reading import parse_json, size_of
from orbisim.files.writing import output_errors, writing
from orbisim_policies.demonstrations import Demonstrations
from orbisim_policies.evaluate import as_float
from orbisim_policies.problem import Floats, Moment, Problem, Starts

SCHEMA = "orbisim.films/1"


@dataclasses.dataclass(frozen=True, eq=False)
class Films:
    """E episodes of T steps as they were, and as they were read off T frames, one before each.

    Attributes:
      seeds: [E]. success: [E] whether the script did what it was to do.
      true_qpos, true_qvel: [E, T, nq], [E, T, nv].
      qpos, qvel: the same as read; velocities by the last two frames, zero in the first.
      seen: [E, T, bodies] whether a fit said that it saw the free bodies.
      ctrl: [E, T, nu] from each frame on. command: [E, T, C] before it. action: [E, T, A].
      params: [E, P] of the scenes, nominal where no image shows them, or as
        inferred (see `phyinf`).
      notes: task, what was read and how, and how far off it was.
    """

    seeds: npt.NDArray[np.int64]
    success: npt.NDArray[np.bool_]
    true_qpos: Floats
    true_qvel: Floats
    qpos: Floats
    qvel: Floats
    seen: npt.NDArray[np.bool_]
    ctrl: Floats
    command: Floats
    action: Floats
    params: Floats
    notes: dict[str, Any]

    def __len__(self) -> int:
        return len(self.seeds)

    @property
    def arrays(self) -> dict[str, npt.NDArray[Any]]:
        """All but the notes."""
        names = (field.name for field in dataclasses.fields(self) if field.name != "notes")
        return {name: getattr(self, name) for name in names}

    @property
    def digest(self) -> str:
        """Of what was read."""
        return hashlib.sha256(self.qpos.tobytes()).hexdigest()[:16]

    @property
    def exact(self) -> Films:
        """The same as if read without errors."""
        return dataclasses.replace(self, qpos=self.true_qpos, qvel=self.true_qvel)

    def starts(self) -> Starts:
        """The second regime of section 3.5: where episodes begin as the first frames show it, at
        rest, in scenes as inferred."""
        return Starts(
            self.qpos[:, 0],
            np.zeros_like(self.qvel[:, 0]),
            self.ctrl[:, 0],
            self.command[:, 0],
            self.params,
        )

    def demonstrations(self, problem: Problem) -> Demonstrations:
        """The script's actions, and what a policy would have seen that sees the frames alone."""
        command, params = as_float(self.command), problem.unseen(as_float(self.params))
        qpos, qvel, ctrl = as_float(self.qpos), as_float(self.qvel), as_float(self.ctrl)
        episodes, steps = self.qpos.shape[:2]
        score, views = problem.begin(qpos[:, 0], qvel[:, 0], command[:, 0]), []
        for t in range(steps):
            if t:
                score = problem.count(score, qpos[:, t], qvel[:, t], ctrl[:, t - 1])
            time = torch.full((episodes,), t / steps)
            moment = Moment(qpos[:, t], qvel[:, t], command[:, t], params, score, time)
            views.append(problem.observe(moment))
        return Demonstrations(
            torch.stack(views, 1).flatten(0, 1),
            as_float(self.action).flatten(0, 1),
            float(self.success.mean()),
            episodes,
            episodes * steps,
        )

    def save(self, path: Path) -> None:
        """Writes the arrays and the notes to a file of safetensors."""
        header = {"schema": SCHEMA, "notes": json.dumps(self.notes)}
        arrays = {name: np.ascontiguousarray(values) for name, values in self.arrays.items()}
        with output_errors(path), writing(path, announce=False) as part:
            save_file(arrays, str(part), header)

    @staticmethod
    def load(path: Path, problem: Problem) -> Films:
        """Reads what `save` wrote.

        Raises:
          InputError: it is damaged, or of another task.
        """
        try:
            size_of(path)
            with safe_open(str(path), "numpy") as file:
                header = file.metadata() or {}
                if header.get("schema") != SCHEMA:
                    raise ValueError(f"not {SCHEMA}")
                found = Films(
                    **{name: file.get_tensor(name) for name in file.keys()},  # noqa: SIM118
                    notes=parse_json(header["notes"], str(path)),
                )
            found._check(problem)
        except (OSError, SafetensorError, ValueError, KeyError, TypeError) as error:
            reason = " ".join(str(error).split())[:200]
            raise InputError(f"{path}: are no films, or damaged ones ({reason})") from None
        known = found.notes.get("task"), found.qpos.shape[1]
        if known != (problem.name, problem.steps):
            raise InputError(
                f"{path}: films of {known[0]}, {known[1]} steps; got {problem.name}, "
                f"{problem.steps} steps"
            )
        return found

    def _check(self, problem: Problem) -> None:
        """Raises ValueError where shapes do not belong together, or a number is not finite."""
        model, (count, steps) = problem.scene.model, self.qpos.shape[:2]
        command, params = problem.draw([0]).command.shape[1], problem.draw([0]).params.shape[1]
        ends = {"qpos": model.nq, "qvel": model.nv, "ctrl": model.nu, "command": command}
        ends |= {"true_qpos": model.nq, "true_qvel": model.nv, "action": problem.actions}
        shapes: dict[str, tuple[int, ...]]
        shapes = {name: (count, steps, end) for name, end in ends.items()}
        shapes |= {"seeds": (count,), "success": (count,), "params": (count, params)}
        bodies = int((model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).sum())
        shapes["seen"] = (count, steps, bodies)
        if not count or not steps:
            raise ValueError("there is no frame")
        for name, shape in shapes.items():
            values = getattr(self, name)
            if values.shape != shape or not np.isfinite(values).all():
                raise ValueError(f"{name} has shape {values.shape} or is not finite")
