"""Reads the `Layout` and the descriptors of a MuJoCo model."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.errors import UnsupportedSceneError
from orbisim.scene import matrices
from orbisim_world_model.frames import axis_frame, motion, nested, transform
from orbisim_world_model.layout import Layout, Limbs
from orbisim_world_model.parts import COLUMNS
from orbisim_world_model.reading_limbs import read_limbs
from orbisim_world_model.reading_pads import read_pads
from orbisim_world_model.reading_parts import part_joints

Floats = npt.NDArray[np.float64]

_UNUSED = ("red", "green", "blue", "inertia_q", "geom_")
ATTRIBUTES = tuple(c for c in matrices.OBJECT_COLUMNS if not c.startswith(_UNUSED))
"""Columns of object attributes that the model is conditioned on."""
SETTINGS = matrices.WORLD_COLUMNS
_SCALAR = (int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE))
_HANDS = ("tcp", "grip_site", "attachment_site", "end_effector", "ee_site")
_SURFACES = ("table", "board", "ground", "floor")


def read_layout(
    model: mujoco.MjModel,
    timestep: float,
    *,
    hand: str | None = None,
    surface: str | None = None,
    source: str = "",
) -> Layout:
    """The layout of a model.

    Args:
      model: the scene.
      timestep: the control step, s.
      hand: site at the robot's hand; found by its usual names if None.
      surface: geom of the supporting surface; found by its usual names if None.
      source: the scene's name, for errors.

    Raises:
      UnsupportedSceneError: the scene has ball joints, mocap bodies or flexes.
    """
    _refuse(model, source)
    scalar = [j for j in range(model.njnt) if int(model.jnt_type[j]) in _SCALAR]
    free = [j for j in range(model.njnt) if j not in scalar]
    bodies = [int(model.jnt_bodyid[j]) for j in free]
    hand = _first(model, mujoco.mjtObj.mjOBJ_SITE, _HANDS) if hand is None else hand
    surface = _first(model, mujoco.mjtObj.mjOBJ_GEOM, _SURFACES) if surface is None else surface
    parts = part_joints(model, hand, scalar)
    if not (free or parts):
        hand = ""  # there is nothing to be near to
    chain, members, tip = _chain(model, hand, scalar) if hand else ((), (), ())
    level = _level_ground(model)
    return Layout(
        nq=model.nq,
        nv=model.nv,
        na=model.na,
        nu=model.nu,
        timestep=timestep,
        joints=tuple(model.joint(j).name or f"joint{j}" for j in scalar),
        joint_q=tuple(int(model.jnt_qposadr[j]) for j in scalar),
        joint_v=tuple(int(model.jnt_dofadr[j]) for j in scalar),
        hinge=tuple(int(model.jnt_type[j]) == _SCALAR[1] for j in scalar),
        bounded=tuple(bool(model.jnt_limited[j]) for j in scalar),
        ignored=tuple(level and _slides_freely(model, j) for j in scalar),
        objects=tuple(model.body(b).name or f"body{b}" for b in bodies),
        object_q=tuple(int(model.jnt_qposadr[j]) for j in free),
        object_v=tuple(int(model.jnt_dofadr[j]) for j in free),
        attributes=ATTRIBUTES if free else (),
        settings=SETTINGS,
        hand=hand,
        surface=surface,
        chain=chain,
        chain_joints=members,
        tip=tip,
        servo=tuple(_servo(model, u, scalar) for u in range(model.nu)),
        ground=_ground(model, surface),
        invariant=level and not scalar,
        limbs=Limbs() if parts else read_limbs(model, scalar),
        pads=read_pads(model, hand, scalar, members) if hand and free else (),
        parts=parts,
        part_columns=COLUMNS if parts else (),
    )


def read_attributes(model: mujoco.MjModel, layout: Layout) -> Floats:
    """[N, D]: `layout.attributes` of each object."""
    columns = [matrices.OBJECT_COLUMNS.index(name) for name in layout.attributes]
    rows = [matrices.object_row(model, model.body(name).id)[columns] for name in layout.objects]
    return np.array(rows).reshape(len(rows), len(columns))


def read_settings(model: mujoco.MjModel, layout: Layout) -> Floats:
    """[W]: `layout.settings`."""
    surface = layout.surface if _has(model, mujoco.mjtObj.mjOBJ_GEOM, layout.surface) else None
    row = matrices.world_row(model, surface or None, layout.timestep)
    return row[[matrices.WORLD_COLUMNS.index(name) for name in layout.settings]]


def _refuse(model: mujoco.MjModel, source: str) -> None:
    if model.nflex:
        raise UnsupportedSceneError(
            source,
            "learned dynamics of robots and objects know no flexes",
            remedy="a cloth alone is learned by --config cloth",
        )
    problems = {
        "ball joints": (model.jnt_type == mujoco.mjtJoint.mjJNT_BALL).any(),
        "mocap bodies": model.nmocap > 0,
        "bodies attached to a free body": _free_parents(model),
    }
    for what, there in problems.items():
        if there:
            raise UnsupportedSceneError(source, f"learned dynamics know no {what}")


def _free_parents(model: mujoco.MjModel) -> bool:
    """Whether a joint hangs on a body with a free joint (a floating-base robot)."""
    for joint in range(model.njnt):
        root = int(model.body_rootid[model.jnt_bodyid[joint]])
        first = int(model.body_jntadr[root])
        if first >= 0 and model.jnt_type[first] == mujoco.mjtJoint.mjJNT_FREE and joint != first:
            return True
    return False


def _chain(model: mujoco.MjModel, hand: str, scalar: list[int]) -> tuple[tuple, tuple, tuple]:  # type: ignore[type-arg]
    """See `Layout.chain`: each joint's frame has its axis as z and stands at its anchor."""
    site = int(model.site(hand).id)
    path, body = [], int(model.site_bodyid[site])
    while body:
        path.append(body)
        body = int(model.body_parentid[body])
    fixed: Any = np.eye(4)
    bases: list[list[Floats]] = []
    members: list[int] = []
    for body in reversed(path):
        fixed = fixed @ transform(model.body_pos[body], model.body_quat[body])
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        for joint in range(first, first + count):
            frame = axis_frame(model.jnt_axis[joint], model.jnt_pos[joint])
            hinge = int(model.jnt_type[joint]) == _SCALAR[1]
            if not hinge:
                frame[:3, 3] = 0.0
            reference = float(model.qpos0[model.jnt_qposadr[joint]])
            bases.append([fixed @ frame @ term for term in motion(hinge, reference)])
            members.append(scalar.index(joint))
            fixed = np.linalg.inv(frame)
    tip = fixed @ transform(model.site_pos[site], model.site_quat[site])
    return nested(np.array(bases)), tuple(members), nested(tip)


def _servo(model: mujoco.MjModel, control: int, scalar: list[int]) -> int:
    """The scalar joint whose position a control commands, or -1."""
    joint = int(model.actuator_trnid[control, 0])
    on_joint = model.actuator_trntype[control] == mujoco.mjtTrn.mjTRN_JOINT
    gain, bias = model.actuator_gainprm[control, 0], model.actuator_biasprm[control, 1]
    return scalar.index(joint) if on_joint and gain and gain == -bias and joint in scalar else -1


def _level_ground(model: mujoco.MjModel) -> bool:
    """Whether all that can be hit of the surroundings are horizontal planes."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    up = -np.asarray(model.opt.gravity) / max(np.linalg.norm(model.opt.gravity), 1e-9)
    for geom in range(model.ngeom):
        fixed = model.body_weldid[model.geom_bodyid[geom]] == 0
        if fixed and (model.geom_contype[geom] or model.geom_conaffinity[geom]):
            normal = data.geom_xmat[geom].reshape(3, 3)[:, 2]
            plane = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE
            if not plane or normal @ up < 1.0 - 1e-9:
                return False
    return bool(up[2] > 1.0 - 1e-9)


def _slides_freely(model: mujoco.MjModel, joint: int) -> bool:
    """An unlimited horizontal slide of a root, without a spring."""
    root = model.body_parentid[model.jnt_bodyid[joint]] == 0
    slide = int(model.jnt_type[joint]) == _SCALAR[0] and not model.jnt_limited[joint]
    level = abs(float(model.jnt_axis[joint] @ model.opt.gravity)) < 1e-9
    return bool(root and slide and level and not model.jnt_stiffness[joint])


def _ground(model: mujoco.MjModel, surface: str) -> float:
    if not surface:
        return 0.0
    geom = int(model.geom(surface).id)
    thick = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX
    return float(model.geom_pos[geom, 2] + (model.geom_size[geom, 2] if thick else 0.0))


def _first(model: mujoco.MjModel, kind: mujoco.mjtObj, names: tuple[str, ...]) -> str:
    return next((name for name in names if _has(model, kind, name)), "")


def _has(model: mujoco.MjModel, kind: mujoco.mjtObj, name: str) -> bool:
    return bool(name) and mujoco.mj_name2id(model, kind, name) >= 0
