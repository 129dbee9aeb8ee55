"""The declared parameters, each within a few percent: a rival to every effect.

A scene's masses, dampings and gains are never exact. Each is given a factor with a narrow prior
about 1, so that it moves only where the data insist, and never far: what needs more is an effect.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Literal

import mujoco
import numpy as np

from orbisim.effects.base import index_of, names_of_kind, spec_element
from orbisim.effects.bodies import write_inertial
from orbisim.scene import Scene

Kind = Literal["mass", "damping", "stiffness", "frictionloss", "armature", "gain", "friction"]

SPREAD = 0.03
"""Standard deviation of the prior of a factor."""
REACH = 0.10
"""A factor stays within 1 - REACH and 1 + REACH."""


@dataclasses.dataclass(frozen=True, order=True)
class Tunable:
    """A declared parameter.

    Attributes:
      kind: which parameter. target: name of the body, joint, actuator or geom that has it.
    """

    kind: Kind
    target: str

    def __str__(self) -> str:
        return f"{self.kind} of {self.target}"


def tunables(model: mujoco.MjModel) -> tuple[Tunable, ...]:
    """The declared parameters of a model that are not zero."""
    found = [
        Tunable("mass", name)
        for body, name in enumerate(names_of_kind(model, "body"))
        if model.body_weldid[body] != 0 and model.body_mass[body] > 0
    ]
    for joint, name in enumerate(names_of_kind(model, "joint")):
        dof = int(model.jnt_dofadr[joint])
        values: dict[Kind, float] = {
            "damping": model.dof_damping[dof],
            "frictionloss": model.dof_frictionloss[dof],
            "armature": model.dof_armature[dof],
            "stiffness": model.jnt_stiffness[joint],
        }
        found += [Tunable(kind, name) for kind, value in values.items() if value]
    found += [Tunable("gain", name) for name in names_of_kind(model, "actuator")]
    return tuple(found)


def retuned(scene: Scene, factors: Mapping[Tunable, float]) -> Scene:
    """The scene with declared parameters times their factors."""
    changed = {one: factor for one, factor in factors.items() if factor != 1.0}
    if not changed:
        return scene
    spec = scene.spec
    for one, factor in changed.items():
        _scale(spec, scene.model, one, factor)
    return Scene.from_spec(spec, source=scene.source, unsupported=scene.unsupported)


def _scale(spec: mujoco.MjSpec, model: mujoco.MjModel, one: Tunable, factor: float) -> None:
    if one.kind == "mass":
        body = index_of(model, "body", one.target)
        write_inertial(
            spec_element(spec, "body", one.target),
            float(model.body_mass[body]) * factor,
            model.body_ipos[body].copy(),
            model.body_iquat[body].copy(),
            model.body_inertia[body] * factor,
        )
    elif one.kind == "gain":
        actuator = spec_element(spec, "actuator", one.target)
        actuator.gainprm[:3] = np.asarray(actuator.gainprm[:3]) * factor
        actuator.biasprm[:3] = np.asarray(actuator.biasprm[:3]) * factor
    elif one.kind == "friction":
        geom = spec_element(spec, "geom", one.target)
        geom.friction[0] *= factor
    else:
        joint = spec_element(spec, "joint", one.target)
        value = np.asarray(getattr(joint, one.kind)) * factor
        if value.ndim:
            getattr(joint, one.kind)[:] = value
        else:
            setattr(joint, one.kind, float(value))
