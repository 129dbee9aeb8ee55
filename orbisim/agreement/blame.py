"""Names what pushes on a joint: for messages about steps that went wrong."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.scene.descriptor import name_of
from orbisim.state import MEMORY, State

_DEEP = 0.1
"""Of the smaller geom's size: contacts deeper than this were not made by motion."""


@dataclasses.dataclass(frozen=True)
class Blame:
    """Who is to be named.

    Attributes:
      joint: kind and name of the joint that a degree of freedom belongs to.
      unit: of its velocity.
      text: the contact that pushes on it most, in words; empty if none does.
      deep: whether that contact is deeper than motion makes one.
    """

    joint: str
    unit: str
    text: str
    deep: bool


def blame(model: mujoco.MjModel, state: State, control: npt.NDArray[np.float64], dof: int) -> Blame:
    """Names a degree of freedom and the contact that pushes on its kinematic tree most.

    Args:
      state: one world. control: [1, nu].
    """
    data = mujoco.MjData(model)
    host = state.numpy()
    for name in ("qpos", "qvel", "act"):
        getattr(data, name)[:] = getattr(host, name)[0]
    for name in host.memory.keys() & set(MEMORY):
        getattr(data, name)[:] = host.memory[name][0]
    data.ctrl[:] = control[0]
    mujoco.mj_forward(model, data)
    joint = int(model.dof_jntid[dof])
    name = name_of(model, mujoco.mjtObj.mjOBJ_JOINT, joint, "joint")
    return Blame(f"joint {name!r}", _unit(model, dof), *_contact(model, data, dof))


def _unit(model: mujoco.MjModel, dof: int) -> str:
    joint = int(model.dof_jntid[dof])
    kind = model.jnt_type[joint]
    along = kind == mujoco.mjtJoint.mjJNT_SLIDE or (
        kind == mujoco.mjtJoint.mjJNT_FREE and dof - model.jnt_dofadr[joint] < 3
    )
    return "m/s" if along else "rad/s"


def _contact(model: mujoco.MjModel, data: mujoco.MjData, dof: int) -> tuple[str, bool]:
    """The contact with the largest force on the tree of a degree of freedom, in words."""
    tree = model.dof_treeid[dof]
    best, largest = -1, -1.0
    for index in range(data.ncon):
        geoms = data.contact[index].geom
        bodies = [int(model.geom_bodyid[g]) for g in geoms if g >= 0]
        force = np.zeros(6)
        mujoco.mj_contactForce(model, data, index, force)
        if any(model.body_treeid[b] == tree for b in bodies) and force[0] > largest:
            best, largest = index, float(force[0])
    if best < 0:
        return "", False
    contact = data.contact[best]
    pair = [
        name_of(model, mujoco.mjtObj.mjOBJ_GEOM, int(g), "geom") if g >= 0 else "a flex"
        for g in contact.geom
    ]
    depth = -float(contact.dist)
    sizes = [float(model.geom_rbound[g]) for g in contact.geom if g >= 0]
    small = min([size for size in sizes if size > 0], default=np.inf)  # planes have none
    how = f"overlap by {depth * 1e3:.3g} mm" if depth > 0 else "touch"
    text = f"geoms {pair[0]!r} and {pair[1]!r} {how} and push with {largest:.3g} N"
    return text, depth > _DEEP * small
