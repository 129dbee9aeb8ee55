"""A scene as one of its cameras sees it, for states that are to be found from images."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbisim.scene import Scene, visible
from orbisim_diffusion.kinematics import Kinematics
from orbisim_diffusion.lighting import Lighting
from orbisim_diffusion.raycast import look
from orbisim_diffusion.solids import Solids, View, rays

Floats = npt.NDArray[np.float64]
_CHUNK = 1_500_000
"""Pairs of rays and geoms at once, so that memory stays below some 500 MB."""

_SHOWS = 1e-2
"""Share of a pixel from which on a geom counts as seen in it."""
_SMALL = 1e-3
"""Of a coordinate, m or rad, for its speed in the image."""


FINE = 2
"""Rays along a pixel's side where it counts: with one, an edge that has no soft outline (between
faces, of a shadow) jumps from pixel to pixel, and a fit ends where it began to find no better."""


class Sight(NamedTuple):
    """What is drawn of states.

    Attributes:
      pixels: [B, P, 3], 0 to 1. weight: [B, G, P] share of each geom in a pixel.
    """

    pixels: Tensor
    weight: Tensor


class Eye:
    """Draws chosen pixels of a camera's image.

    Args:
      scene: what is seen. camera: its number. size: height and width of the image, pixels.
    """

    def __init__(self, scene: Scene, camera: int, size: int) -> None:
        device = torch.device("cpu")
        self.model, self.camera, self.size = scene.model, camera, size
        kinematics = Kinematics(scene, device)  # refuses what cannot be drawn
        self.rows, self.meshes = kinematics.rows, kinematics.meshes
        self.lighting = Lighting(scene.model, device)
        self.geoms = torch.arange(len(self.rows))
        self.entity = torch.as_tensor(self.rows[:, 7]).long()
        self._rows = torch.as_tensor(self.rows, dtype=torch.float32)
        self._shown, self._data = visible.seen(scene.model), mujoco.MjData(scene.model)
        self._carried = camera >= 0 and bool(
            scene.model.body_weldid[scene.model.cam_bodyid[camera]] != 0
        )
        self._still = kinematics.view(torch.as_tensor(scene.model.qpos0)[None].float(), camera)
        level = self._still._replace(rot=torch.eye(3)[None])
        self._rays = {fine: rays(level, fine * size, fine * size)[0] for fine in (1, FINE)}

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def draw(
        self, qpos: Floats, pixels: Tensor, geoms: Tensor | None = None, fine: int = 1
    ) -> Sight:
        """Pixels [P] (numbers, row by row) of states [B, nq], of some geoms or of all.

        A pixel is the mean of `fine` times `fine` rays (1 or `FINE`).
        """
        some, places = self.geoms if geoms is None else geoms, _parts(pixels, self.size, fine)
        step = max(1, _CHUNK // max(1, len(some) * len(places)))
        parts = [
            self._drawn(qpos[first : first + step], places, some, fine)
            for first in range(0, len(qpos), step)
        ]
        found = Sight(*(torch.cat(field) for field in zip(*parts, strict=True)))
        if fine == 1:
            return found
        shape = len(pixels), fine * fine
        return Sight(
            found.pixels.unflatten(1, shape).mean(2), found.weight.unflatten(2, shape).mean(3)
        )

    def _drawn(self, qpos: Floats, pixels: Tensor, some: Tensor, fine: int) -> Sight:
        if not len(some):  # MuJoCo's background is black
            shape = len(qpos), len(pixels)
            return Sight(torch.zeros(*shape, 3), torch.zeros(shape[0], 0, shape[1]))
        solids, view = self.placed(qpos)
        solids = Solids(*(field[:, some] for field in solids))
        meshes = {i: self.meshes[g] for i, g in enumerate(some.tolist()) if g in self.meshes}
        # the camera's own axes are turned with it
        ray = self._rays[fine][pixels] @ view.rot.transpose(-1, -2)
        seen = look(solids, view, ray, fine * self.size, meshes)
        shown = self.lighting.colours(seen, solids, view, fine * self.size, some, meshes)
        return Sight(shown, seen.weight)

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def met(self, qpos: Floats, pixels: Tensor, geoms: Tensor) -> Tensor:
        """Which of some geoms [G] may show or throw shadows in pixels [P] of states [B, nq]."""
        solids, view = self.placed(qpos)
        solids = Solids(*(field[:, geoms] for field in solids))
        meshes = {i: self.meshes[g] for i, g in enumerate(geoms.tolist()) if g in self.meshes}
        ray = self._rays[1][pixels] @ view.rot.transpose(-1, -2)
        seen = look(solids, view, ray, self.size, meshes)
        found = (seen.weight.amax(-1) > _SHOWS).any(0)
        return found | self.lighting.shaded(seen, solids, view, self.size)

    def placed(self, qpos: Floats) -> tuple[Solids, View]:
        """Geoms and camera of states [B, nq], by MuJoCo's kinematics: nothing has gradients."""
        count, shown, data = len(qpos), self._shown, self._data
        pos, rot = np.empty((count, len(shown), 3)), np.empty((count, len(shown), 9))
        eye, axes = np.empty((count, 3)), np.empty((count, 9))
        for i, row in enumerate(qpos):
            data.qpos[:] = row
            mujoco.mj_kinematics(self.model, data)
            pos[i], rot[i] = data.geom_xpos[shown], data.geom_xmat[shown]
            if self.camera >= 0 and (self._carried or not i):
                mujoco.mj_comPos(self.model, data)
                mujoco.mj_camlight(self.model, data)
                eye[i], axes[i] = data.cam_xpos[self.camera], data.cam_xmat[self.camera]
            elif i:
                eye[i], axes[i] = eye[0], axes[0]
        rows = self._rows.expand(count, -1, -1)
        solids = Solids(
            kind=rows[..., 0].long(),
            size=rows[..., 1:4],
            colour=rows[..., 4:7],
            entity=rows[..., 7].long(),
            pos=torch.as_tensor(pos).float(),
            rot=torch.as_tensor(rot).float().unflatten(-1, (3, 3)),
        )
        if self.camera < 0:
            return solids, View(*(field.expand(count, *field.shape[1:]) for field in self._still))
        view = View(
            torch.as_tensor(eye).float(),
            torch.as_tensor(axes).float().unflatten(-1, (3, 3)),
            self._still.focal.expand(count, 2),
            self._still.offset.expand(count, 2),
        )
        return solids, view

    def moved(self, qpos: Floats, change: Floats) -> Floats:
        """States [..., nq] after changes [..., nv] of their coordinates (`mj_integratePos`)."""
        after: Floats = np.array(np.broadcast_to(qpos, (*change.shape[:-1], qpos.shape[-1])))
        flat, moves = after.reshape(-1, qpos.shape[-1]), change.reshape(-1, change.shape[-1])
        for row, move in zip(flat, moves, strict=True):
            mujoco.mj_integratePos(self.model, row, move, 1.0)
        return after

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def speeds(self, qpos: Floats, directions: Floats) -> Floats:
        """[B, k] pixels by which the fastest geom moves for one unit of each direction.

        Args:
          qpos: [B, nq]. directions: [B, nv, k].
        """
        count, k = len(qpos), directions.shape[-1]
        change = _SMALL * directions.transpose(0, 2, 1)
        after = self.moved(qpos[:, None].repeat(k, 1), change).reshape(count * k, -1)
        solids, view = self.placed(np.concatenate([qpos, after]))
        found = self._shifts(solids, view, k) / _SMALL
        fastest: Floats = found.amax(1).clamp_min(1e-3).reshape(count, k).numpy()
        return fastest

    def apart(self, one: Floats, other: Floats, geoms: Tensor) -> float:
        """Pixels between two states [nq] of the geom that moves farthest, of some: mask [G]."""
        solids, view = self.placed(np.stack([one, other]))
        moved = self._shifts(solids, view, 1)[0, geoms]
        return float(moved.max()) if len(moved) else 0.0

    def _shifts(self, solids: Solids, view: View, k: int) -> Tensor:
        """[B * k, G] pixels that geoms move from each of B states to k others that come after."""
        count = len(solids.pos) // (k + 1)
        pos, rot = (field[:count].repeat_interleave(k, 0) for field in (solids.pos, solids.rot))
        gone = (solids.pos[count:] - pos).norm(dim=-1)
        turned = (solids.rot[count:] - rot).flatten(2).norm(dim=-1)
        reach = solids.size[count:].clamp(max=1.0).norm(dim=-1)
        depth = (view.pos[:count, None] - solids.pos[:count]).norm(dim=-1).clamp_min(0.05)
        scale = self.size * view.focal[:count, 1:] / depth  # pixels for a metre
        return (gone + turned * reach) * scale.repeat_interleave(k, 0)


def _parts(pixels: Tensor, size: int, fine: int) -> Tensor:
    """Of an image `fine` times as wide and high, the pixels [P * fine^2] that those [P] hold."""
    if fine == 1:
        return pixels
    row, column = pixels // size * fine, pixels % size * fine
    wide, inside = size * fine, torch.arange(fine)
    parts = (row[:, None, None] + inside[:, None]) * wide + column[:, None, None] + inside
    return parts.flatten()
