"""Poses of a scene's geoms and cameras as differentiable functions of its coordinates."""

from __future__ import annotations

import mujoco
import numpy as np
import torch
from torch import Tensor

from orbisim import cameras
from orbisim.errors import InputError, UnsupportedSceneError
from orbisim.scene import Scene, visible
from orbisim_diffusion.shapes import MESH, PRIMITIVES
from orbisim_diffusion.solids import Lamps, Solids, View, matrices

_FREE, _BALL, _SLIDE = (
    int(kind)
    for kind in (
        mujoco.mjtJoint.mjJNT_FREE,
        mujoco.mjtJoint.mjJNT_BALL,
        mujoco.mjtJoint.mjJNT_SLIDE,
    )
)
_FIXED = int(mujoco.mjtCamLight.mjCAMLIGHT_FIXED)


class Kinematics:
    """The way from coordinates to what a camera sees.

    Args:
      scene: its model is read once.
      device: where to compute.

    Raises:
      UnsupportedSceneError: the scene shows what has no pose in its coordinates (flexes, mocap
        bodies), or geoms that rays are not cast at (height fields, signed distance fields).
    """

    def __init__(self, scene: Scene, device: torch.device) -> None:
        self.model, self.device, self.source = scene.model, device, scene.source
        self._refuse(scene)
        rows = visible.rows(self.model)
        self.rows = rows
        self._rows = torch.as_tensor(rows, dtype=torch.float32, device=device)
        self._lights = torch.as_tensor(
            visible.lights(self.model), dtype=torch.float32, device=device
        )
        self._shown = visible.seen(self.model)
        self.meshes = {
            place: self._triangles(geom)
            for place, geom in enumerate(self._shown)
            if int(self.model.geom_type[geom]) == MESH
        }

    def solids(self, qpos: Tensor) -> Solids:
        """The geoms at coordinates [B, nq]."""
        pos, rot = self.bodies(qpos)
        model, count = self.model, len(qpos)
        bodies = torch.as_tensor(model.geom_bodyid[self._shown], device=self.device).long()
        place = self._constant(model.geom_pos[self._shown]).to(qpos.dtype)
        turn = matrices(self._constant(model.geom_quat[self._shown])).to(qpos.dtype)
        rows = self._rows.to(qpos.dtype).expand(count, -1, -1)
        return Solids(
            kind=rows[..., 0].long(),
            size=rows[..., 1:4],
            colour=rows[..., 4:7],
            entity=rows[..., 7].long(),
            pos=pos[:, bodies] + (rot[:, bodies] @ place[..., None])[..., 0],
            rot=rot[:, bodies] @ turn,
        )

    def lamps(self, count: int) -> Lamps:
        """The lights, for each of so many worlds."""
        return Lamps(self._lights.expand(count, -1, -1))

    def view(self, qpos: Tensor, camera: int) -> View:
        """A camera of the scene at coordinates [B, nq]; -1 is MuJoCo's free camera.

        Raises:
          InputError: the camera follows or looks at a body, or is orthographic.
        """
        model, count = self.model, len(qpos)
        focal = torch.tensor(cameras.read_focal(model, camera), device=self.device)
        focal = focal.to(qpos.dtype).expand(count, 2)
        if camera < 0:
            free = cameras.free_orbit(model).camera(float(model.vis.global_.fovy))
            return self._still(free, qpos, focal)
        if int(model.cam_mode[camera]) != _FIXED:
            raise InputError(
                f"camera {model.camera(camera).name!r} tracks a body; only cameras that are fixed "
                "to one (mode='fixed') are known here"
            )
        pos, rot = self.bodies(qpos)
        body = int(model.cam_bodyid[camera])
        turn = matrices(self._constant(model.cam_quat[camera])).to(qpos.dtype)
        place = self._constant(model.cam_pos[camera]).to(qpos.dtype)
        return View(
            pos[:, body] + rot[:, body] @ place, rot[:, body] @ turn, focal, torch.zeros_like(focal)
        )

    def bodies(self, qpos: Tensor) -> tuple[Tensor, Tensor]:
        """Positions [B, nbody, 3] and rotations [B, nbody, 3, 3] of all bodies."""
        model, count = self.model, len(qpos)
        pos = [qpos.new_zeros(count, 3)]
        rot = [torch.eye(3, device=qpos.device, dtype=qpos.dtype).expand(count, 3, 3)]
        for body in range(1, model.nbody):
            parent = int(model.body_parentid[body])
            place = self._constant(model.body_pos[body]).to(qpos.dtype)
            turn = matrices(self._constant(model.body_quat[body])).to(qpos.dtype)
            p, r = pos[parent] + rot[parent] @ place, rot[parent] @ turn
            first = int(model.body_jntadr[body])
            for joint in range(first, first + int(model.body_jntnum[body])):
                p, r = self._moved(qpos, joint, p, r)
            pos.append(p)
            rot.append(r)
        return torch.stack(pos, 1), torch.stack(rot, 1)

    def _moved(self, qpos: Tensor, joint: int, pos: Tensor, rot: Tensor) -> tuple[Tensor, Tensor]:
        """The body's pose after one of its joints has moved it."""
        model, adr = self.model, int(self.model.jnt_qposadr[joint])
        kind = int(model.jnt_type[joint])
        if kind == _FREE:
            return qpos[:, adr : adr + 3], matrices(qpos[:, adr + 3 : adr + 7])
        axis = self._constant(model.jnt_axis[joint]).to(qpos.dtype)
        change = qpos[:, adr] - float(model.qpos0[adr])
        if kind == _SLIDE:
            return pos + change[:, None] * (rot @ axis), rot
        if kind == _BALL:
            turn = matrices(qpos[:, adr : adr + 4])
        else:
            half = 0.5 * change[:, None]
            turn = matrices(torch.cat([half.cos(), half.sin() * axis], dim=1))
        anchor = self._constant(model.jnt_pos[joint]).to(qpos.dtype)
        after = rot @ turn
        return pos + rot @ anchor - after @ anchor, after

    def _still(self, camera: cameras.Camera, qpos: Tensor, focal: Tensor) -> View:
        pos, rot = (self._constant(v).to(qpos.dtype) for v in (camera.pos, camera.rot))
        count = len(qpos)
        return View(pos.expand(count, 3), rot.expand(count, 3, 3), focal, torch.zeros_like(focal))

    def _constant(self, values: object) -> Tensor:
        return torch.as_tensor(np.array(values, np.float64), device=self.device)

    def _triangles(self, geom: int) -> Tensor:
        """Triangles [F, 3, 3] of a mesh geom in its own frame."""
        model, mesh = self.model, int(self.model.geom_dataid[geom])
        vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
        faces = model.mesh_face[model.mesh_faceadr[mesh] :][: model.mesh_facenum[mesh]]
        return torch.as_tensor(vertices[faces], dtype=torch.float32, device=self.device)

    def _refuse(self, scene: Scene) -> None:
        model = scene.model
        strange = {
            int(model.geom_type[g])
            for g in visible.seen(model)
            if int(model.geom_type[g]) not in (*PRIMITIVES, MESH)
        }
        problems = {
            "flexes": model.nflex > 0,
            "mocap bodies": model.nmocap > 0,
            "geoms that are neither primitives nor meshes": bool(strange),
        }
        for what, there in problems.items():
            if there:
                raise UnsupportedSceneError(
                    scene.source, f"the diffusion renderer knows no {what}", remedy="use 'mujoco'"
                )
