"""The colours of what rays see under a scene's lights, as OpenGL's classic lighting has them."""

from __future__ import annotations

import math
from collections.abc import Mapping

import mujoco
import numpy as np
import torch
from torch import Tensor

from orbisim.scene import visible
from orbisim_diffusion.raycast import Surfaces, in_the_way, unblocked
from orbisim_diffusion.solids import Lamps, Solids, View

_SPECULAR, _SHININESS = 0.5, 0.5
"""Of a geom without a material; MuJoCo's defaults (mjv_defaultGeom)."""
_SHINE = 128.0
"""OpenGL's exponent of a highlight where MuJoCo's `shininess` is 1."""


class Lighting:
    """Lights and materials of a model.

    Ambient, diffuse and Blinn-Phong specular light of the headlight and of each lamp, with
    attenuation, the fall of a spot and shadows: what MuJoCo's renderer computes at vertices
    (OpenGL 1.5 specification, section 2.14.1) is computed at every ray. Textures, fog and mirrors
    are not known.

    Args:
      model: its lights are read once, where they stand at `qpos0`.
      device: where to compute.
    """

    def __init__(self, model: mujoco.MjModel, device: torch.device) -> None:
        def tensor(values: object) -> Tensor:
            return torch.as_tensor(np.array(values, np.float32), device=device)

        on = np.flatnonzero(model.light_active)
        self.lamps = Lamps(tensor(visible.lights(model))[None])
        self._ambient, self._diffuse = (
            tensor(model.light_ambient[on]),
            tensor(model.light_diffuse[on]),
        )
        self._specular = tensor(model.light_specular[on])
        self._fade = tensor(model.light_attenuation[on])
        self._exponent, self._cutoff = model.light_exponent[on], model.light_cutoff[on]
        head = model.vis.headlight
        share = 1.0 if head.active else 0.0
        self._head = tensor([head.ambient, head.diffuse, head.specular]) * share
        shown = visible.seen(model)
        materials = [int(model.geom_matid[g]) for g in shown]

        def of(field: object, default: float) -> Tensor:
            values = np.asarray(field)
            return tensor([default if m < 0 else values[m] for m in materials])

        self._shine = of(model.mat_specular, _SPECULAR)
        self._sharp = _SHINE * of(model.mat_shininess, _SHININESS)
        self._glow = of(model.mat_emission, 0.0)

    def colours(
        self,
        seen: Surfaces,
        solids: Solids,
        view: View,
        height: int,
        geoms: Tensor,
        meshes: Mapping[int, Tensor] | None = None,
    ) -> Tensor:
        """Pixels [B, P, 3], 0 to 1, of what rays see in an image of `height` pixels.

        Args:
          seen: of `solids`, those geoms [G] of the model that may be seen or throw shadows.
          view: the cameras. meshes: by the place in `solids`.
        """
        normal = seen.normal @ view.rot.transpose(-1, -2)
        normal = normal / normal.norm(dim=-1, keepdim=True).clamp_min(1e-6)
        there = seen.weight.sum(1)[..., None].clamp_min(1e-3)
        point = seen.point / there
        size = seen.depth / there[..., 0] / (height * view.focal[:, 1:])
        shine, sharp, glow = (
            torch.einsum("bgp,g->bp", seen.weight, field[geoms])[..., None]
            for field in (self._shine, self._sharp, self._glow)
        )
        sharp = sharp / there
        eye = view.rot[:, None, :, 2].expand_as(normal)  # OpenGL's eye is infinitely far
        facing = (normal * eye).sum(-1, keepdim=True).clamp_min(0.0)
        ambient, diffuse, specular = self._head
        tint = glow + ambient + self._ambient.sum(0) + diffuse * facing
        gloss = specular * facing.clamp_min(1e-6) ** sharp
        lamps = Lamps(self.lamps.rows.expand(len(point), -1, -1))
        free, ways = unblocked(point, normal, size, solids, lamps, meshes)
        for number in range(len(self._diffuse)):
            open_, way = free[:, number], ways[:, number]
            light = (open_ * self._reach(number, way))[..., None]
            way = way / way.norm(dim=-1, keepdim=True)
            cosine = (normal * way).sum(-1, keepdim=True)
            half = way + eye
            half = half / half.norm(dim=-1, keepdim=True).clamp_min(1e-6)
            bright = (normal * half).sum(-1, keepdim=True).clamp_min(1e-6) ** sharp
            tint = tint + light * self._diffuse[number] * cosine.clamp_min(0.0)
            gloss = gloss + light * self._specular[number] * bright * (cosine > 0)
        return (seen.colour * tint + shine * gloss).clamp(0.0, 1.0)

    def shaded(self, seen: Surfaces, solids: Solids, view: View, height: int) -> Tensor:
        """[G]: which geoms come near the way from what rays see to a lamp; see `colours`."""
        there = seen.weight.sum(1)[..., None].clamp_min(1e-3)
        normal = seen.normal @ view.rot.transpose(-1, -2)
        normal = normal / normal.norm(dim=-1, keepdim=True).clamp_min(1e-6)
        size = seen.depth / there[..., 0] / (height * view.focal[:, 1:])
        lamps = Lamps(self.lamps.rows[:, self.lamps.shadow[0] > 0].expand(len(size), -1, -1))
        if not lamps.rows.shape[1]:
            return torch.zeros_like(solids.kind[0], dtype=torch.bool)
        near = in_the_way(seen.point / there, normal, size, solids, lamps)
        return near.any(-1).any(0)

    def _reach(self, number: int, way: Tensor) -> Tensor:
        """[B, P] of a lamp's light that its distance and its cone leave."""
        lamp = self.lamps.rows[0, number]
        if lamp[6] > 0:
            return torch.ones_like(way[..., 0])
        distance = way.norm(dim=-1)
        constant, linear, square = self._fade[number]
        left = 1.0 / (constant + linear * distance + square * distance**2).clamp_min(1e-6)
        if self._cutoff[number] >= 180:
            return left
        axis = lamp[3:6] / lamp[3:6].norm().clamp_min(1e-9)
        cosine = -(way @ axis) / distance.clamp_min(1e-6)
        inside = cosine > math.cos(math.radians(float(self._cutoff[number])))
        spot = cosine.clamp_min(1e-6) ** float(self._exponent[number])
        return torch.where(inside, left * spot, 0.0)
