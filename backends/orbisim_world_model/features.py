"""What the network sees of a state: numbers for each token and for each pair of tokens.

All of it is computed in float32 from raw SI values; `normalization.py` brings it to unit scale.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from orbisim_world_model.articulation import Articulation
from orbisim_world_model.config import ModelConfig
from orbisim_world_model.entities import Context, Entities
from orbisim_world_model.layout import Layout
from orbisim_world_model.normalization import fine
from orbisim_world_model.parts import RELATIONS, Parts
from orbisim_world_model.rotation import product, rotate_back, to_matrix
from orbisim_world_model.touch import Touch

_LINEAR, _ANGULAR, _HEIGHT, _NEAR = 0.02, 0.2, 0.005, 0.05
"""Scales below which velocities (m/s, rad/s), heights and distances (m) are seen finely."""
_CORNERS = [[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]
EDGE_FEATURES = 18
"""Numbers that `edges` gives for two objects."""


class Features(nn.Module):
    """Raw features of states of one layout.

    Indices are buffers, so that nothing is copied from the host while a CUDA graph is recorded.
    """

    def __init__(self, layout: Layout, config: ModelConfig) -> None:
        super().__init__()
        self.layout, self.config = layout, config
        seen = [j for j in layout.robot_joints if not layout.ignored[j]]
        plain = [j for j in seen if layout.bounded[j] or not layout.hinge[j]]
        sizes = [f"half_{axis}" for axis in "xyz"]
        self.boxes = config.contact and set(sizes) <= set(layout.attributes)
        servos = servo_controls(layout, config)
        self._index("plain", plain)
        self._index("turning", [j for j in seen if layout.hinge[j]])
        self._index("sizes", [layout.attributes.index(s) for s in sizes] if self.boxes else [])
        self._index("servos", servos)
        self._index("served", [layout.servo[u] for u in servos])
        self.touch = Touch(layout) if config.touch and layout.limbs.joints else None
        self.limbs = Articulation(layout, config) if layout.articulated else None
        self.parts = Parts(layout, config) if layout.parts and not self.limbs else None
        self.register_buffer("corners", torch.tensor(_CORNERS).T.contiguous(), persistent=False)

    def robot(self, x: Entities) -> Tensor:
        """[B, F]: joint coordinates and the hand; the paper's state has the hand alone.

        Nothing of robots made of limbs.
        """
        if self.limbs is not None:
            return x.q[:, :0]
        if not self.config.extended:
            return x.hand[:, :15]  # position, rotation matrix, linear velocity
        angles = x.q.index_select(1, self.turning)
        v = x.v if self.parts is None else x.v.index_select(1, self.parts.own)
        parts = [x.q.index_select(1, self.plain), angles.sin(), angles.cos(), v, x.act, x.hand]
        if self.touch is not None:
            parts.append(self.touch(x.q, x.v))
        return torch.cat(parts, dim=-1)

    def objects(self, x: Entities, context: Context) -> Tensor:
        """[B, N, F]: poses and velocities; in the object's own frame if `config.relative`."""
        if not self.config.extended:
            return torch.cat([x.pos, x.quat, x.vel], dim=-1)
        if not self.config.relative:
            return torch.cat([x.pos, x.quat, x.vel, x.ang], dim=-1)
        rot = to_matrix(x.quat)  # [B, N, 3, 3]
        vel, ang = rotate_back(rot, x.vel), rotate_back(rot, x.ang)
        up = rot[..., 2, :]  # the world's vertical in the object's frame
        pose = [x.pos[..., 2:], up] if self.layout.invariant else [x.pos, up, rot[..., 0, :]]
        parts = [*pose, vel, ang, fine(vel, _LINEAR), fine(ang, _ANGULAR)]
        if self.boxes:
            parts.append(self.corner_heights(x, up, context))
        return torch.cat(parts, dim=-1)

    def corner_heights(self, x: Entities, up: Tensor, context: Context) -> Tensor:
        """[B, N, 16]: heights of a box's corners over the ground, as they are and finely."""
        half = context.attributes.index_select(2, self.sizes)
        # [B, N, 8]
        height = (
            x.pos[..., 2:] - self.layout.ground + ((up * half)[..., None] * self.corners).sum(-2)
        )
        return torch.cat([height, fine(height, _HEIGHT)], dim=-1)

    @property
    def pairs(self) -> int:
        """How many numbers `edges` gives."""
        return EDGE_FEATURES + (RELATIONS if self._related else 0)

    @property
    def _related(self) -> bool:
        """Whether edges also say which part carries which; objects of a mixed model carry none."""
        return self.config.joints and (self.parts is not None or self.config.mixed)

    def edges(self, x: Entities, context: Context | None = None) -> Tensor:
        """[B, K, K, E]: entity j as entity i sees it from its own frame.

        Relative position (plain and finely), orientation (two columns), linear and angular
        velocity; of parts also which carries which. Parts need the context.
        """
        pos, rot, vel, ang = self.frames(x, context)
        seen = rot[:, :, None]  # [B, K, 1, 3, 3]

        def from_i(vector: Tensor) -> Tensor:
            return rotate_back(seen, vector[:, None, :] - vector[:, :, None])

        offset = from_i(pos)
        turn = product(seen.transpose(-1, -2), rot[:, None])  # [B, K, K, 3, 3]
        parts = [offset, fine(offset, _NEAR), turn[..., :2].flatten(-2), from_i(vel), from_i(ang)]
        if self._related and self.parts is None:
            parts.append(offset.new_zeros((*offset.shape[:-1], RELATIONS)))
        elif self._related and self.parts is not None and context is not None:
            parts.append(self.parts.relations(context, 1 + len(self.layout.objects)))
        return torch.cat(parts, dim=-1)

    def frames(
        self, x: Entities, context: Context | None = None
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Position, rotation matrix, linear and angular velocity of each token [B, K, ...].

        A robot without a hand is at the origin. Parts need the context.
        """
        if self.parts is not None:
            assert context is not None
            now = self.parts.placed(x, context)
            return self._with_hand(
                torch.cat([x.pos, now.pos], dim=1),
                torch.cat([to_matrix(x.quat), now.rot], dim=1),
                torch.cat([x.vel, now.vel], dim=1),
                torch.cat([x.ang, now.ang], dim=1),
                x,
            )
        rot = to_matrix(x.quat)
        if not self.layout.has_robot:
            return x.pos, rot, x.vel, x.ang
        return self._with_hand(x.pos, rot, x.vel, x.ang, x)

    def _with_hand(
        self, pos: Tensor, rot: Tensor, vel: Tensor, ang: Tensor, x: Entities
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        if self.layout.hand:
            hand = (x.hand_pos, x.hand_rot, x.hand_vel, x.hand_ang)
        else:
            zero = pos.new_zeros((len(pos), 3))
            eye = torch.eye(3, device=zero.device, dtype=zero.dtype)
            hand = (zero, eye.expand(len(zero), 3, 3), zero, zero)
        fields = zip(hand, (pos, rot, vel, ang), strict=True)
        pos, turn, vel, ang = (torch.cat([h[:, None], o], dim=1) for h, o in fields)
        return pos, turn, vel, ang

    def control(self, x: Entities, control: Tensor) -> Tensor:
        """[B, U + servos]: the control, and how far the joints are from where it wants them.

        Limbs know their motors' forces instead.
        """
        if self.limbs is not None:
            return control[:, :0]
        if not len(self.servos):
            return control
        distance = control.index_select(1, self.servos) - x.q.index_select(1, self.served)
        return torch.cat([control, distance], dim=1)

    def _index(self, name: str, values: Sequence[int]) -> None:
        self.register_buffer(name, torch.tensor(values, dtype=torch.long), persistent=False)


def servo_controls(layout: Layout, config: ModelConfig) -> list[int]:
    """Controls that command the position of a joint, where the model may see the distance."""
    if not (config.relative and config.extended and config.control == "ctrl"):
        return []
    return [u for u, joint in enumerate(layout.servo) if joint >= 0]
