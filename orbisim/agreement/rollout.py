"""The first steps of a rollout beside C MuJoCo's."""

from __future__ import annotations

from typing import Any

import numpy as np

from orbisim.agreement.blame import blame
from orbisim.agreement.judge import PERSISTS, Fault, StepJudge, checkable, describe
from orbisim.backend import Backend
from orbisim.errors import OrbiSimError
from orbisim.state import State
from orbisim.trajectory import Trajectory


def faults_of_rollout(
    backend: Backend, trajectory: Trajectory, nstep: int, *, most: int = 3
) -> tuple[str, ...]:
    """What is wrong with a backend in the first steps of a rollout, in words.

    Args:
      backend: that made it. trajectory: at least `PERSISTS` steps of it, from the beginning.
      nstep: timesteps of the model for each step.
      most: texts at most, one for each kind of fault and degree of freedom.
    """
    if not checkable(backend) or trajectory.nstep < PERSISTS:
        return ()
    try:
        steps, states = _persistent(StepJudge(backend.scene), trajectory, nstep)
    except OrbiSimError:  # C MuJoCo cannot say (its memory is full)
        return ()
    worlds: dict[tuple[str, int], list[int]] = {}
    for world, fault in steps.items():
        worlds.setdefault((fault.kind, fault.dof), []).append(world)
    texts = []
    for found in sorted(worlds.values(), key=len, reverse=True)[:most]:
        fault = steps[found[0]]
        control = _host(trajectory.control[found[:1], fault.step])
        named = blame(backend.model, states[fault.step][found[0]], control, fault.dof)
        share = f"in {len(found)} of {trajectory.nworld} episodes from the first step on"
        texts.append(f"{share}: {describe(backend, fault, named, nstep)}")
    return tuple(texts)


def _persistent(
    judge: StepJudge, trajectory: Trajectory, nstep: int
) -> tuple[dict[int, Fault], list[State]]:
    """Faults that are there in each of the first steps, by world, and the steps' states."""
    state, kept = trajectory.initial.numpy(), None
    states: list[State] = []
    for step in range(PERSISTS):
        control, after = _host(trajectory.control[:, step]), trajectory.state_at(step).numpy()
        found = judge.faults(state, control, nstep, after, step=step)
        lost = np.flatnonzero(np.asarray(trajectory.diverged_at) == step)
        kept = {
            world: fault
            for world, fault in found.items()
            if world not in lost and (kept is None or world in kept)
        }
        states.append(state)
        state = after.replace(memory=judge.memory_after(state, control, nstep))
    return kept or {}, states


def _host(array: Any) -> Any:
    return array.detach().cpu().numpy() if hasattr(array, "detach") else np.asarray(array)
