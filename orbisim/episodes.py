"""Initial states and controls for open-loop episodes."""

from __future__ import annotations

import dataclasses
import os
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim import plugins
from orbisim.errors import InputError
from orbisim.physics.mjdata import read_state
from orbisim.scene import Scene, load_scene
from orbisim.state import State

NAMES = "orbisim.episodes"
"""Entry point group of functions (task, count, seed) that make episodes, by a name's prefix."""

HORIZON = 2.0
"""Duration of an episode, s."""

Floats = npt.NDArray[np.float64]

CONTROL_CORRELATION = 0.1
"""Correlation time of random controls, s."""


@dataclasses.dataclass(frozen=True)
class Episodes:
    """What is needed to run episodes open-loop.

    Attributes:
      scene: the scene.
      initial: one world for each episode.
    """

    scene: Scene
    initial: State

    @property
    def horizon(self) -> float:
        """How long the episodes are if nobody says otherwise, s."""
        return HORIZON

    def controls(self, duration: float, step: float, seed: int) -> Floats:
        """Smooth random controls [nworld, T, nu], each held for `step` seconds."""
        steps = max(1, round(duration / step))
        return random_controls(self.scene.model, self.initial.nworld, steps, step, seed)


def episodes(name: str, count: int, seed: int, **options: Any) -> Episodes:
    """Makes episodes for a scene: a path, or a task name, whose own initial states are used.

    Args:
      name: what `orbisim.load_scene` takes.
      count: number of episodes.
      seed: of the random initial states.
      **options: passed to `load_scene`.
    """
    prefix, _, task = name.partition(":")
    if task and prefix in plugins.names(NAMES):
        made: Episodes = plugins.load(NAMES, prefix, "kind of task")(task, count, seed)
        return made
    scene = load_scene(name, **options)
    return Episodes(scene, random_initial_states(scene.model, count, seed))


def check_size(model: mujoco.MjModel, count: int, steps: float) -> None:
    """Checks that episodes can be kept in this machine's memory.

    Args:
      model: of the scene. count: of episodes. steps: of each.

    Raises:
      InputError: they cannot.
    """
    width = 1 + model.nq + model.nv + model.na + model.nsensordata + model.nu
    needed = 8.0 * width * count * steps
    there = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if not needed < there:
        raise InputError(
            f"{count} episodes of {steps:.3g} steps take {needed / 2**30:.3g} GiB, this machine "
            f"has {there / 2**30:.3g}; simulate a shorter time, or fewer at once"
        )


def random_initial_states(
    model: mujoco.MjModel, count: int, seed: int, spread: float = 0.1
) -> State:
    """The first keyframe, or the reference configuration, with its joints moved at random.

    Args:
      model: the model.
      count: number of worlds.
      seed: of the random numbers.
      spread: hinges move by up to this angle (rad), slides by a tenth of it (m), within their
        limits. Free and ball joints stay.

    Raises:
      InputError: so many worlds do not fit into this machine's memory.
    """
    check_size(model, count, 1)
    rng = np.random.default_rng(seed)
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    states: list[State] = []
    base = data.qpos.copy()
    for _ in range(count):
        data.qpos[:] = base
        for joint in range(model.njnt):
            _move(model, data.qpos, joint, rng.uniform(-spread, spread))
        states.append(read_state(data))
    return State.stack(states)


def _move(model: mujoco.MjModel, qpos: Floats, joint: int, angle: float) -> None:
    kind, adr = model.jnt_type[joint], model.jnt_qposadr[joint]
    if kind == mujoco.mjtJoint.mjJNT_SLIDE:
        angle *= 0.1
    elif kind != mujoco.mjtJoint.mjJNT_HINGE:
        return
    value = qpos[adr] + angle
    if model.jnt_limited[joint]:
        value = np.clip(value, *model.jnt_range[joint])
    qpos[adr] = value


def random_controls(
    model: mujoco.MjModel, count: int, steps: int, step: float, seed: int
) -> Floats:
    """Smooth random controls [count, steps, nu] over the actuators' ranges (-1 to 1 without).

    A first-order filter of white noise with the correlation time `CONTROL_CORRELATION`, scaled to
    half the range and clipped.
    """
    rng = np.random.default_rng([seed, 1])
    decay = float(np.exp(-step / CONTROL_CORRELATION))
    noise = rng.standard_normal((count, steps, model.nu))
    values = np.empty_like(noise)
    current = rng.standard_normal((count, model.nu))
    for t in range(steps):
        current = decay * current + np.sqrt(1 - decay**2) * noise[:, t]
        values[:, t] = current
    limited = np.asarray(model.actuator_ctrllimited, bool)
    low = np.where(limited, model.actuator_ctrlrange[:, 0], -1.0)
    high = np.where(limited, model.actuator_ctrlrange[:, 1], 1.0)
    scaled = (low + high) / 2 + values * (high - low) / 4
    return np.clip(scaled, low, high)
