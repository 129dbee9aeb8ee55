"""Single steps of an engine beside C MuJoCo's: does it move, does it feel contacts?

Every step is repeated by C MuJoCo from the state that the engine itself was in, so that chaos does
not add up. Beside it C MuJoCo takes the same step from states moved by what single precision
rounds off, which shows how far two right engines may come apart in that step: much, where a
contact is just about to begin. An engine is at fault in a step if some kinematic tree's change of
velocity misses C MuJoCo's by a good part of the change itself, and by many times that band.

One step says little (a solver that stops early, a contact that is found or not); `PERSISTS` steps
after one another do: along episodes of the 51 tasks of dm_control's suite (tools/corpus_suite.py)
MuJoCo-Warp is at fault in single steps of the stacker's heaps only, two in a row at most.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.agreement.blame import Blame
from orbisim.backend import Backend, Capability
from orbisim.registry import backend_class, make_backend
from orbisim.scene import Scene
from orbisim.state import State
from orbisim.tangent import perturbed, tangent_difference

Floats = npt.NDArray[np.float64]

PERSISTS = 5
"""Steps after one another in which an engine must be at fault."""

_DRAWS = 4
"""Moved copies in which C MuJoCo takes each step: each costs as much as the step itself."""
_ROUNDING = 1e-6
"""Of positions (m, rad) and relative of velocities: ten roundings of float32 on the way to a
contact's distance."""
_PART = 0.3
"""Of the largest change of velocity in a tree that may be missed: solvers that stop early do."""
_BANDS = 30.0
"""Times C MuJoCo's own band, known from `_DRAWS` copies only, that an engine may miss."""
_STILL = 1e-3
"""Of C MuJoCo's change of velocity, up to which an engine is said to stand still."""
_SMALLEST = 1e-6
"""Changes of velocity (rad/s, m/s) below this are not compared."""


@dataclasses.dataclass(frozen=True)
class Fault:
    """What an engine did wrong in one step of one world.

    Attributes:
      kind: `still` (nothing accelerates although C MuJoCo's does), `apart` (something moves
        otherwise) or `lost` (C MuJoCo diverges in this step, the engine goes on).
      world: index of the world.
      dof: the degree of freedom that misses most.
      ours, theirs: its change of velocity in the engine and in C MuJoCo.
      step: of a rollout.
    """

    kind: str
    world: int
    dof: int
    ours: float
    theirs: float
    step: int = 0


def checkable(backend: Backend) -> bool:
    """Whether a backend claims to integrate what C MuJoCo integrates, and is not C MuJoCo."""
    return Capability.CLASSICAL in backend.capabilities and not isinstance(
        backend, backend_class("mujoco")
    )


class StepJudge:
    """Finds the faults of single steps.

    Args:
      scene: the scene that the engine has loaded.
      seed: of the draws that make the band.
    """

    def __init__(self, scene: Scene, seed: int = 0) -> None:
        self._reference = make_backend("mujoco", scene, nworld=1 + _DRAWS, nthread=1)
        self._model = scene.model
        self._rng = np.random.default_rng(seed)

    def faults(
        self, before: State, control: Any, nstep: int, after: State, *, step: int = 0
    ) -> dict[int, Fault]:
        """The faults of a step, by world.

        Args:
          before, after: the engine's states [nworld]. control: [nworld, nu]. nstep: timesteps of
            the model. step: number of the step in a rollout.
        """
        model, nworld = self._model, before.nworld
        if not model.nv:
            return {}
        count = 1 + _DRAWS
        start = self._spread(before, count)
        held = np.repeat(np.broadcast_to(control, (nworld, model.nu)), count, axis=0)
        run = self._reference.rollout(start, held[:, None], nstep=nstep, sensors=False)
        theirs = run.final.replace(qpos=run.qpos[:, -1], qvel=run.qvel[:, -1], act=run.act[:, -1])
        change = _speeds(model, start, theirs).reshape(nworld, count, -1)
        ours = _speeds(model, before, after)
        lost = run.diverged_at.reshape(nworld, count) >= 0
        found = {
            world: _fault(model, world, ours[world], change[world], lost[world])
            for world in range(nworld)
            if np.isfinite(ours[world]).all()  # the engine has said itself that it diverged
        }
        return {
            world: dataclasses.replace(fault, step=step) for world, fault in found.items() if fault
        }

    def memory_after(self, before: State, control: Any, nstep: int) -> Mapping[str, Any]:
        """What C MuJoCo remembers after a step (warm starts, delayed signals)."""
        held = np.broadcast_to(control, (before.nworld, self._model.nu))[:, None]
        return self._reference.rollout(before, held, nstep=nstep, sensors=False).final.memory

    def _spread(self, state: State, count: int) -> State:
        """Each world, and copies of it moved by rounding."""
        tiled, nv = state.numpy().tile(count), self._model.nv
        moves = self._rng.choice([-_ROUNDING, _ROUNDING], (tiled.nworld, 2 * nv + self._model.na))
        fastest = np.maximum(1.0, np.abs(tiled.qvel).max(axis=1, keepdims=True))
        moves[:, nv : 2 * nv] *= fastest
        moves[:, 2 * nv :] = 0.0
        moves[::count] = 0.0
        return perturbed(self._model, tiled, moves)


def _speeds(model: mujoco.MjModel, start: State, end: State) -> Floats:
    """[nworld, nv] changes of velocity."""
    nv = model.nv
    return tangent_difference(model, start, end.numpy())[:, nv : 2 * nv]


def _fault(
    model: mujoco.MjModel, world: int, ours: Floats, change: Floats, lost: npt.NDArray[np.bool_]
) -> Fault | None:
    """The fault of one world: `change` [1 + draws, nv] is C MuJoCo's, the first without draw."""
    if lost[0]:
        return Fault("lost", world, 0, float(ours[0]), float("nan"))
    if lost[1:].any():
        return None  # so near to divergence anything is right
    theirs, miss = change[0], np.abs(ours - change[0])
    band = np.abs(change[1:] - theirs).max(axis=0)
    tree = np.maximum(model.dof_treeid, 0)  # dofs of bodies that sleep have none
    excess = np.array(
        [
            miss[mine].max()
            / max(
                _PART * max(np.abs(theirs[mine]).max(), np.abs(ours[mine]).max()),
                _BANDS * band[mine].max(),
                _SMALLEST,
            )
            for mine in (tree == t for t in range(tree.max() + 1))
            if mine.any()
        ]
    )
    if excess.max() <= 1.0:
        return None
    if np.abs(ours).max() <= _STILL * np.abs(theirs).max():
        dof, kind = int(np.abs(theirs).argmax()), "still"
    else:
        dof, kind = int(np.where(tree == int(excess.argmax()), miss, -1.0).argmax()), "apart"
    return Fault(kind, world, dof, float(ours[dof]), float(theirs[dof]))


def describe(backend: Backend, fault: Fault, found: Blame, nstep: int) -> str:
    """One line: what the engine does, what C MuJoCo does, where, and what to do."""
    where = f"backend {backend.name!r}, scene {backend.scene.name!r}"
    seconds = nstep * float(backend.model.opt.timestep)
    joint = f"{found.joint} gains {fault.theirs:.3g} {found.unit} in {seconds:g} s"
    if fault.kind == "lost":
        what = "C MuJoCo diverges in this step, so that the engine's numbers mean nothing"
    elif fault.kind == "still":
        what = f"nothing accelerates, while in C MuJoCo {joint}"
    else:
        what = f"{joint} in C MuJoCo and {fault.ours:.3g} here, step after step"
    return f"{where}: {what}; {found.text or 'no contact acts on it'}; {_remedy(fault, found)}"


def _remedy(fault: Fault, found: Blame) -> str:
    if fault.kind == "lost":
        return "reduce the timestep, the gains or the controls"
    if found.deep:
        return "move the two apart, exclude the pair (<contact><exclude>), or use 'mujoco'"
    return "use 'mujoco', or compare the two (orbisim compare)"
