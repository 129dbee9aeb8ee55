"""Poses of a scene's geoms and cameras as differentiable functions of its coordinates."""

from __future__ import annotations

import mujoco
import numpy as np
import torch
from torch import Tensor

from orbisim import cameras
from orbisim.errors import InputError, UnsupportedSceneError
from orbisim.scene import Scene, visible
from orbisim_diffusion.chain import Chain
from orbisim_diffusion.shapes import MESH, PRIMITIVES
from orbisim_diffusion.solids import Lamps, Solids, View, constant, matrices

Poses = tuple[Tensor, Tensor]
"""What `Kinematics.bodies` gives."""
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
        turns = matrices(self._constant(self.model.cam_quat))
        self._cameras = self._constant(self.model.cam_pos), turns
        self._lights = torch.as_tensor(
            visible.lights(self.model), dtype=torch.float32, device=device
        )
        self._shown = visible.seen(self.model)
        self._chain = Chain(self.model, device)
        self._owner = torch.as_tensor(self.model.geom_bodyid[self._shown], device=device).long()
        self._place = self._constant(self.model.geom_pos[self._shown])
        self._turn = matrices(self._constant(self.model.geom_quat[self._shown]))
        self.meshes = {
            place: self._triangles(geom)
            for place, geom in enumerate(self._shown)
            if int(self.model.geom_type[geom]) == MESH
        }

    def solids(self, qpos: Tensor, poses: Poses | None = None) -> Solids:
        """The geoms at coordinates [B, nq]; `poses` are the bodies', if they are known."""
        pos, rot = self.bodies(qpos) if poses is None else poses
        place, turn = (v.to(qpos.dtype) for v in (self._place, self._turn))
        count, owner = len(qpos), self._owner
        at, axes = pos[:, owner], rot[:, owner]
        rows = self._rows.to(qpos.dtype).expand(count, -1, -1)
        return Solids(
            kind=rows[..., 0].long(),
            size=rows[..., 1:4],
            colour=rows[..., 4:7],
            entity=rows[..., 7].long(),
            pos=at + (axes @ place[..., None])[..., 0],
            rot=axes @ turn,
        )

    def lamps(self, count: int) -> Lamps:
        """The lights, for each of so many worlds."""
        return Lamps(self._lights.expand(count, -1, -1))

    def view(self, qpos: Tensor, camera: int, poses: Poses | None = None) -> View:
        """A camera of the scene at coordinates [B, nq]; -1 is MuJoCo's free camera.

        `poses` are the bodies', if they are known.

        Raises:
          InputError: the camera follows or looks at a body, or is orthographic.
        """
        model, count = self.model, len(qpos)
        focal = constant(tuple(map(float, cameras.read_focal(model, camera))), qpos)
        focal = focal.expand(count, 2)
        if camera < 0:
            free = cameras.free_orbit(model).camera(float(model.vis.global_.fovy))
            return self._still(free, qpos, focal)
        if int(model.cam_mode[camera]) != _FIXED:
            raise InputError(
                f"camera {model.camera(camera).name!r} tracks a body; only cameras that are fixed "
                "to one (mode='fixed') are known here"
            )
        pos, rot = self.bodies(qpos) if poses is None else poses
        body = int(model.cam_bodyid[camera])
        place, turn = (v[camera].to(qpos.dtype) for v in self._cameras)
        return View(
            pos[:, body] + rot[:, body] @ place, rot[:, body] @ turn, focal, torch.zeros_like(focal)
        )

    def bodies(self, qpos: Tensor) -> Poses:
        """Positions [B, nbody, 3] and rotations [B, nbody, 3, 3] of all bodies at [B, nq]."""
        return self._chain.bodies(qpos)

    def _still(self, camera: cameras.Camera, qpos: Tensor, focal: Tensor) -> View:
        pos, rot = (
            constant(tuple(np.ravel(v).tolist()), qpos).reshape(np.shape(v))
            for v in (camera.pos, camera.rot)
        )
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
