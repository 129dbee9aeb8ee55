"""Reads the parts of mechanisms of a MuJoCo model, and their descriptors (`parts.COLUMNS`)."""

from __future__ import annotations

import functools
import hashlib
from pathlib import Path

import mujoco
import numpy as np
import numpy.typing as npt
import torch
import trimesh

from orbisim.errors import UnsupportedSceneError
from orbisim.scene import matrices
from orbisim_world_model.frames import transform
from orbisim_world_model.geometry import GeometryTokens, load_encoder
from orbisim_world_model.layout import Layout
from orbisim_world_model.pack import no_parts
from orbisim_world_model.parts import BODY, COLUMNS, JOINT, PLACE

Floats = npt.NDArray[np.float64]
ENCODER = Path(__file__).parent / "shapes" / "encoder.safetensors"
"""The encoder of shapes that comes with the package (`tools/train_geometry.py`)."""
_HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)


def part_joints(model: mujoco.MjModel, hand: str, scalar: list[int]) -> tuple[int, ...]:
    """Scalar joints (indices into `scalar`) that are parts': apart from the hand, without a motor.

    They are those of bodies whose tree is not the hand's and in which nothing acts on a joint.
    """
    if not hand:
        return ()
    robot = int(model.body_rootid[model.site_bodyid[model.site(hand).id]])
    root = {joint: int(model.body_rootid[model.jnt_bodyid[joint]]) for joint in scalar}
    on_joint = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    driven = {
        root.get(int(model.actuator_trnid[u, 0]))
        for u in range(model.nactuator)
        if mujoco.mjtTrn(model.actuator_trntype[u]) in on_joint
    }
    free = {int(model.body_rootid[b]) for b in model.jnt_bodyid[model.jnt_type < 2]}
    return tuple(
        place
        for place, joint in enumerate(scalar)
        if root[joint] != robot and root[joint] not in driven | free
    )


def read_parts(model: mujoco.MjModel, layout: Layout, source: str = "") -> Floats:
    """[P, D]: the columns `layout.part_columns` of each part.

    Raises:
      UnsupportedSceneError: a part has no shape, or two joints.
    """
    joints = [int(model.joint(layout.joints[j]).id) for j in layout.parts]
    bodies = [int(model.jnt_bodyid[j]) for j in joints]
    if len(set(bodies)) != len(bodies):
        raise UnsupportedSceneError(source, "learned dynamics know no part with two joints")
    rows = [_row(model, joint, bodies, source) for joint in joints]
    return np.array(rows).reshape(len(rows), len(COLUMNS))


def repeated(model: mujoco.MjModel, layout: Layout, episodes: int) -> dict[str, torch.Tensor]:
    """`Pack.parts` and `Pack.part_mask` of episodes of one scene."""
    if not layout.parts:
        return no_parts(episodes)
    rows = torch.as_tensor(read_parts(model, layout), dtype=torch.float32)
    mask = torch.ones(episodes, len(rows))
    return {"parts": rows.expand(episodes, *rows.shape).clone(), "part_mask": mask}


def _row(model: mujoco.MjModel, joint: int, bodies: list[int], source: str) -> Floats:
    body = int(model.jnt_bodyid[joint])
    address, dof = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
    parent, place = _attachment(model, body, bodies)
    mesh = body_mesh(model, body)
    if mesh is None:
        name = model.body(body).name
        raise UnsupportedSceneError(source, f"part {name!r} has no shape to be known by")
    box = mesh.bounds
    limited = bool(model.jnt_limited[joint])
    values = dict(
        zip(
            JOINT,
            (
                *(parent, float(model.jnt_type[joint] == _HINGE)),
                *(model.jnt_range[joint] if limited else (-np.pi, np.pi)),
                *(model.qpos0[address], *model.jnt_axis[joint], *model.jnt_pos[joint]),
                *(model.jnt_stiffness[joint], model.qpos_spring[address]),
                *(model.dof_damping[dof], model.dof_frictionloss[dof], model.dof_armature[dof]),
            ),
            strict=True,
        )
    )
    geom = matrices.main_geom(model, body)
    friction = 0.0 if geom is None else model.geom_friction[geom, 0]
    own = (*(box[1] - box[0]) / 2, model.body_mass[body], *model.body_inertia[body])
    values |= dict(zip(BODY, (*own, *box.mean(axis=0), friction), strict=True))
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, place[:3, :3].ravel())
    values |= dict(zip(PLACE, (*place[:3, 3], *quat), strict=True))
    known = [float(values[name]) for name in (*JOINT, *BODY, *PLACE)]
    return np.array([*known, *shape_tokens()(mesh)])


def _attachment(model: mujoco.MjModel, body: int, bodies: list[int]) -> tuple[int, Floats]:
    """Number of the part that carries a body (-1: none), and the body's pose in its frame."""
    pose = np.eye(4)
    while body:
        pose = transform(model.body_pos[body], model.body_quat[body]) @ pose
        body = int(model.body_parentid[body])
        if body in bodies:
            return bodies.index(body), pose
    return -1, pose


def body_mesh(model: mujoco.MjModel, body: int) -> trimesh.Trimesh | None:
    """The surface of a body's geoms in its frame; of those that are only seen, if it has any."""
    first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
    geoms = range(first, first + count)
    seen = [g for g in geoms if not (model.geom_contype[g] or model.geom_conaffinity[g])]
    found = [mesh for g in (seen or geoms) if (mesh := _geom_mesh(model, g)) is not None]
    return trimesh.util.concatenate(found) if found else None


def _geom_mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh | None:
    kind, size = mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        number = int(model.geom_dataid[geom])
        v, f = int(model.mesh_vertadr[number]), int(model.mesh_faceadr[number])
        mesh = trimesh.Trimesh(
            np.array(model.mesh_vert[v : v + model.mesh_vertnum[number]], np.float64),
            np.array(model.mesh_face[f : f + model.mesh_facenum[number]]),
            process=False,
        )
    elif kind == mujoco.mjtGeom.mjGEOM_BOX:
        mesh = trimesh.creation.box(2 * size)
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        mesh = trimesh.creation.cylinder(size[0], 2 * size[1], sections=24)
    elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        mesh = trimesh.creation.capsule(2 * size[1], size[0], count=[8, 16])
    elif kind in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_ELLIPSOID):
        mesh = trimesh.creation.icosphere(2)
        mesh.apply_scale(size if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID else size[0])
    else:
        return None
    mesh.apply_transform(transform(model.geom_pos[geom], model.geom_quat[geom]))
    return mesh


@functools.cache
def shape_tokens() -> GeometryTokens:
    """The tokens of the encoder that comes with the package, each mesh's computed once."""
    return GeometryTokens(load_encoder(ENCODER))


@functools.cache
def encoder_digest() -> str:
    """SHA-256 of the encoder: tokens of another one mean something else."""
    return hashlib.sha256(ENCODER.read_bytes()).hexdigest()
