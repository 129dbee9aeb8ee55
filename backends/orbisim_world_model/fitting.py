"""Whether a checkpoint fits a scene: what must agree, and what lies outside its training data."""

from __future__ import annotations

import dataclasses
from typing import Any

import mujoco
import numpy as np

from orbisim.errors import UnsupportedSceneError
from orbisim.scene import Scene
from orbisim_world_model.articulation import SEEN
from orbisim_world_model.layout import Layout
from orbisim_world_model.manifest import variants
from orbisim_world_model.parts import BODY, JOINT
from orbisim_world_model.reading import read_attributes, read_layout, read_settings
from orbisim_world_model.reading_articulation import (
    limb_concerns,
    limb_rows,
    natural_step,
    read_articulated,
)
from orbisim_world_model.reading_parts import encoder_digest, read_parts

_SLACK = 0.02
"""How far, relative to a range's width, a value may lie outside it."""


@dataclasses.dataclass(frozen=True)
class Fit:
    """How a checkpoint fits a scene.

    Attributes:
      layout: of the scene.
      concerns: what lies outside the training data, one line each.
      variant: which of the checkpoint's robots it is.
    """

    layout: Layout
    concerns: tuple[str, ...]
    variant: int = 0


def fit(manifest: dict[str, Any], scene: Scene) -> Fit:
    """Checks a scene against a checkpoint's manifest.

    Raises:
      UnsupportedSceneError: the checkpoint cannot step this scene.
    """
    if manifest["model"].get("articulated"):
        return _fit_limbs(manifest, scene)
    refusals: list[UnsupportedSceneError] = []
    for number, view in enumerate(variants(manifest)):
        try:
            return _fit(view, scene, number)
        except UnsupportedSceneError as error:
            refusals.append(error)
    raise next((e for e in refusals if not isinstance(e, _OtherKindError)), refusals[0])


class _OtherKindError(UnsupportedSceneError):
    """One has mechanisms and the other not: of a checkpoint of both, another robot says more."""


def _fit_limbs(manifest: dict[str, Any], scene: Scene) -> Fit:
    """Any robot of hinges and slides: what matters are the numbers of its limbs."""
    views = variants(manifest)
    trained = Layout.from_dict(manifest["layout"])
    layout = read_articulated(scene.model, natural_step(scene.model), source=scene.source)
    if (trained.settings, trained.part_columns) != (layout.settings, layout.part_columns):
        raise UnsupportedSceneError(
            scene.source,
            "the checkpoint was trained with other descriptors than this version reads",
        )
    concerns = limb_concerns(scene.model)
    known = [view["ranges"] for view in views]
    for column, value in zip(layout.settings, read_settings(scene.model, layout), strict=True):
        both = _union([ranges["settings"][column] for ranges in known])
        concerns += _outside(f"world setting {column}", value, both)
    rows = limb_rows(scene.model, scene.source)
    both = _union([ranges["parts"]["count"] for ranges in known])
    if not both[0] <= len(rows) <= both[1]:
        concerns.append(f"{len(rows)} limbs (trained on {both[0]:g} to {both[1]:g})")
    for joint, row in zip(layout.joints, rows, strict=True):
        for column in SEEN:
            both = _union([ranges["parts"][column] for ranges in known])
            value = row[layout.part_columns.index(column)]
            concerns += _outside(f"{column} of the limb on joint {joint!r}", value, both)
    return Fit(layout, tuple(concerns))


def _union(bounds: list[list[float]]) -> list[float]:
    return [min(low for low, _ in bounds), max(high for _, high in bounds)]


def _fit(manifest: dict[str, Any], scene: Scene, variant: int) -> Fit:
    trained = Layout.from_dict(manifest["layout"])
    model = scene.model
    layout = read_layout(
        model,
        trained.timestep,
        hand=trained.hand if _has_site(model, trained.hand) else "",
        surface=_surface(model, trained.surface),
        source=scene.source,
    )
    if bool(trained.parts) != bool(layout.parts):
        if trained.parts:
            theirs, ours = f"on mechanisms of up to {len(trained.parts)} parts", "none"
        else:
            theirs, ours = "without mechanisms", f"one of {len(layout.parts)} parts"
        raise _OtherKindError(
            scene.source, f"the checkpoint was trained {theirs}; the scene has {ours}"
        )
    problem = _mismatch(trained, layout, manifest, model)
    if problem:
        raise UnsupportedSceneError(scene.source, problem)
    return Fit(layout, tuple(_concerns(manifest, model, layout)), variant)


def robot_parameters(model: mujoco.MjModel, layout: Layout) -> dict[str, list[float]]:
    """Numbers of all that is not an object: the learned model knows them by heart."""
    free = {int(model.body(name).id) for name in layout.objects}
    roots = {int(model.joint(layout.joints[j]).bodyid[0]) for j in layout.parts}
    roots = {int(model.body_rootid[body]) for body in roots}
    free |= {b for b in range(model.nbody) if int(model.body_rootid[b]) in roots}
    bodies = [b for b in range(1, model.nbody) if b not in free]
    geoms = [g for g in range(model.ngeom) if int(model.geom_bodyid[g]) not in free]
    geoms = [g for g in geoms if model.geom_contype[g] or model.geom_conaffinity[g]]
    dofs = [layout.joint_v[j] for j in layout.robot_joints]
    tables = {
        "mass": model.body_mass[bodies],
        "inertia": model.body_inertia[bodies],
        "damping": model.dof_damping[dofs],
        "armature": model.dof_armature[dofs],
        "frictionloss": model.dof_frictionloss[dofs],
        "gain": model.actuator_gainprm[:, 0],
        "bias": model.actuator_biasprm[:, :3],
        "gear": model.actuator_gear[:, 0],
        "geom size": model.geom_size[geoms],
        "geom position": model.geom_pos[geoms],
    }
    return {name: [float(f"{v:.6g}") for v in np.ravel(rows)] for name, rows in tables.items()}


def _mismatch(
    trained: Layout, layout: Layout, manifest: dict[str, Any], model: mujoco.MjModel
) -> str:
    """What makes it impossible, in words; empty if nothing does."""
    if layout.parts and manifest["data"].get("shapes") != encoder_digest():
        return "the checkpoint was trained with another encoder of shapes than this version has"
    pairs = {
        "joints": tuple(tuple(name for name, _ in x.robot) for x in (trained, layout)),
        "kinds of joints": tuple(tuple(turns for _, turns in x.robot) for x in (trained, layout)),
        "number of controls": (trained.nu, layout.nu),
        "number of activations": (trained.na, layout.na),
        "hand": (trained.hand, layout.hand),
    }
    for what, (theirs, ours) in pairs.items():
        if theirs != ours:
            return f"the checkpoint was trained with {what} {theirs}; the scene has {ours}"
    if bool(trained.objects) != bool(layout.objects) or (
        manifest["model"]["kind"] != "objects" and len(trained.objects) != len(layout.objects)
    ):
        return (
            f"the checkpoint was trained on {len(trained.objects)} objects; "
            f"the scene has {len(layout.objects)}"
        )
    descriptors = (layout.attributes, layout.settings, layout.part_columns)
    if (trained.attributes, trained.settings, trained.part_columns) != descriptors:
        return "the checkpoint was trained with other descriptors than this version reads"
    steps = trained.timestep / float(model.opt.timestep)
    if abs(steps - round(steps)) > 1e-6 * steps or round(steps) < 1:
        return (
            f"the checkpoint's control step is {trained.timestep:g} s, which is not a multiple of "
            f"the scene's timestep of {model.opt.timestep:g} s"
        )
    return ""


def _concerns(manifest: dict[str, Any], model: mujoco.MjModel, layout: Layout) -> list[str]:
    found = manifest["ranges"]
    concerns = []
    low, high = found["objects"]
    if not low <= len(layout.objects) <= high:
        concerns.append(f"{len(layout.objects)} objects (trained on {low} to {high})")
    for name, row in zip(layout.objects, read_attributes(model, layout), strict=True):
        for column, value in zip(layout.attributes, row, strict=True):
            concerns += _outside(f"{column} of object {name!r}", value, found["attributes"][column])
    for column, value in zip(layout.settings, read_settings(model, layout), strict=True):
        concerns += _outside(f"world setting {column}", value, found["settings"][column])
    if layout.parts:
        concerns += _part_concerns(found["parts"], model, layout)
    ours, theirs = robot_parameters(model, layout), manifest["data"].get("robot", {})
    for name, values in theirs.items():
        if name not in ours:
            concerns.append(f"the training scene had {name!r}, which this version does not read")
        elif len(values) != len(ours[name]) or not np.allclose(values, ours[name], 1e-3, 1e-6):
            concerns.append(f"the scene's {name} differs from the training scene's")
    return concerns


def _part_concerns(
    known: dict[str, list[float]], model: mujoco.MjModel, layout: Layout
) -> list[str]:
    """Of numbers that mean something one by one; not of tokens of shapes, nor of indices."""
    concerns = []
    rows = read_parts(model, layout)
    low, high = known["count"]
    if not low <= len(rows) <= high:
        concerns.append(f"{len(rows)} parts (trained on {low:g} to {high:g})")
    for joint, row in zip(layout.parts, rows, strict=True):
        for column in (*JOINT[3:4], *JOINT[11:], *BODY):
            value = row[layout.part_columns.index(column)]
            what = f"{column} of the part on joint {layout.joints[joint]!r}"
            concerns += _outside(what, value, known[column])
    return concerns


def _outside(what: str, value: float, bounds: list[float]) -> list[str]:
    low, high = bounds
    slack = _SLACK * (high - low) + 1e-5 * max(abs(low), abs(high)) + 1e-9
    if low - slack <= value <= high + slack:
        return []
    return [f"{what} is {value:.4g} (trained on {low:.4g} to {high:.4g})"]


def _has_site(model: mujoco.MjModel, name: str) -> bool:
    return bool(name) and mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name) >= 0


def _surface(model: mujoco.MjModel, name: str) -> str | None:
    has = bool(name) and mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, name) >= 0
    return name if has else None
