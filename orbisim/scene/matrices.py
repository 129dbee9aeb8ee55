"""Static descriptors of a scene as matrices with named columns: what episodes hold of it."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

GEOM_TYPES = ("plane", "sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh")
_GEOM_IDS = [int(getattr(mujoco.mjtGeom, f"mjGEOM_{name.upper()}")) for name in GEOM_TYPES]

OBJECT_COLUMNS = (
    *("half_x", "half_y", "half_z", "mass", "inertia_x", "inertia_y", "inertia_z"),
    *("friction_slide", "friction_torsion", "friction_roll", "solref_0", "solref_1"),
    *(f"type_{name}" for name in GEOM_TYPES),
    *("com_x", "com_y", "com_z", "inertia_qw", "inertia_qx", "inertia_qy", "inertia_qz"),
    *("geom_x", "geom_y", "geom_z", "geom_qw", "geom_qx", "geom_qy", "geom_qz"),
    *("red", "green", "blue"),
)
"""Half sizes of the geom's bounding box in m, mass in kg, inertia in kg m^2 about its principal
axes, contact parameters as in MuJoCo, the geom's type, centre of mass and principal axes, pose of
the geom in the body, colour."""

WORLD_COLUMNS = (
    *("gravity_x", "gravity_y", "gravity_z", "timestep", "control_timestep"),
    *("density", "viscosity", "impratio"),
    *("friction_slide", "friction_torsion", "friction_roll", "solref_0", "solref_1"),
)
"""World configuration; friction and solref are those of the supporting surface."""

JOINT_COLUMNS = (
    *("body", "qpos", "dof", "type_free", "type_ball", "type_slide", "type_hinge"),
    *("axis_x", "axis_y", "axis_z", "pos_x", "pos_y", "pos_z", "limited", "low", "high"),
    *("stiffness", "springref", "damping", "frictionloss", "armature"),
)
"""`body` is the position among the objects (-1 a part of the robot), `qpos` and `dof` where the
joint's coordinates begin."""

ACTUATOR_COLUMNS = (
    *("joint", "gear", "gain", "bias_0", "bias_1", "bias_2", "limited", "low", "high"),
)
"""`joint` is the number of the joint that it acts on, -1 for another transmission."""


def object_row(model: mujoco.MjModel, body: int) -> Floats:
    """The columns `OBJECT_COLUMNS` of one body; its largest colliding geom stands for its shape."""
    row = np.zeros(len(OBJECT_COLUMNS))
    row[3] = model.body_mass[body]
    row[4:7] = model.body_inertia[body]
    start = 12 + len(GEOM_TYPES)
    row[start : start + 3] = model.body_ipos[body]
    row[start + 3 : start + 7] = model.body_iquat[body]
    row[start + 10] = 1.0
    geom = main_geom(model, body)
    if geom is None:
        return row
    row[:3] = half_sizes(model, geom)
    row[7:10] = model.geom_friction[geom]
    row[10:12] = model.geom_solref[geom]
    kind = int(model.geom_type[geom])
    if kind in _GEOM_IDS:
        row[12 + _GEOM_IDS.index(kind)] = 1.0
    row[start + 7 : start + 10] = model.geom_pos[geom]
    row[start + 10 : start + 14] = model.geom_quat[geom]
    row[start + 14 : start + 17] = model.geom_rgba[geom, :3]
    return row


def main_geom(model: mujoco.MjModel, body: int) -> int | None:
    """The body's largest geom, a colliding one if it has any."""
    first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
    geoms = list(range(first, first + count))
    colliding = [g for g in geoms if model.geom_contype[g] or model.geom_conaffinity[g]]
    candidates = colliding or geoms
    if not candidates:
        return None
    return max(candidates, key=lambda g: (float(np.prod(half_sizes(model, g))), -g))


def half_sizes(model: mujoco.MjModel, geom: int) -> Floats:
    """Half sizes of the geom's bounding box in its own frame, m."""
    return np.asarray(model.geom_aabb[geom, 3:6], np.float64).copy()


def world_row(model: mujoco.MjModel, surface: str | None, control_timestep: float) -> Floats:
    """The columns `WORLD_COLUMNS`."""
    option = model.opt
    row = np.zeros(len(WORLD_COLUMNS))
    row[:3] = option.gravity
    row[3:8] = (
        *(option.timestep, control_timestep, option.density, option.viscosity, option.impratio),
    )
    geom = surface_geom(model, surface)
    if geom is not None:
        row[8:11] = model.geom_friction[geom]
        row[11:13] = model.geom_solref[geom]
    return row


def surface_geom(model: mujoco.MjModel, name: str | None) -> int | None:
    """The geom of that name, or the first plane of the world."""
    if name is not None:
        return int(model.geom(name).id)
    planes = (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE) & (model.geom_bodyid == 0)
    found = np.flatnonzero(planes)
    return int(found[0]) if found.size else None


def joint_rows(model: mujoco.MjModel, bodies: Sequence[int]) -> Floats:
    """[njnt, columns `JOINT_COLUMNS`]; `bodies` are the objects, in order."""
    place = {body: index for index, body in enumerate(bodies)}
    rows = np.zeros((model.njnt, len(JOINT_COLUMNS)))
    for joint in range(model.njnt):
        dof = int(model.jnt_dofadr[joint])
        adr = int(model.jnt_qposadr[joint])
        row = rows[joint]
        row[:3] = place.get(int(model.jnt_bodyid[joint]), -1), adr, dof
        row[3 + int(model.jnt_type[joint])] = 1.0
        row[7:10], row[10:13] = model.jnt_axis[joint], model.jnt_pos[joint]
        row[13] = model.jnt_limited[joint]
        row[14:16] = model.jnt_range[joint]
        row[16:18] = model.jnt_stiffness[joint], model.qpos_spring[adr]
        row[18] = model.dof_damping[dof]
        row[19:21] = model.dof_frictionloss[dof], model.dof_armature[dof]
    return rows


def actuator_rows(model: mujoco.MjModel) -> Floats:
    """[nu, columns `ACTUATOR_COLUMNS`]: of the actuator that reads each control."""
    rows = np.zeros((model.nu, len(ACTUATOR_COLUMNS)))
    kinds = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    for index in range(model.nactuator):
        first = int(model.actuator_ctrladr[index])
        for control in range(first, first + int(model.actuator_ctrlnum[index])):
            on_joint = mujoco.mjtTrn(model.actuator_trntype[index]) in kinds
            row = rows[control]
            row[0] = model.actuator_trnid[index, 0] if on_joint else -1
            row[1] = model.actuator_gear[model.actuator_outadr[index], 0]
            row[2] = model.actuator_gainprm[index, 0]
            row[3:6] = model.actuator_biasprm[index, :3]
            row[6] = model.actuator_ctrllimited[control]
            row[7:9] = model.actuator_ctrlrange[control]
    return rows
