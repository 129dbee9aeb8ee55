"""Poses of all bodies as a differentiable function of coordinates, in few large products.

A GPU takes longer to start a small product than to compute it, so that a tree is not gone through
body by body: all joints move at once, and poses in the world come by doubling (each body's pose in
its parent, then in its parent's parent, in that one's, and so on).
"""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbisim_diffusion.solids import matrices

_FREE, _BALL, _SLIDE, _HINGE = (
    int(kind)
    for kind in (
        mujoco.mjtJoint.mjJNT_FREE,
        mujoco.mjtJoint.mjJNT_BALL,
        mujoco.mjtJoint.mjJNT_SLIDE,
        mujoco.mjtJoint.mjJNT_HINGE,
    )
)
_KINDS = (_HINGE, _SLIDE, _BALL, _FREE)


@dataclasses.dataclass(frozen=True)
class _Numbers:
    """What a model says once, in one precision; N bodies, J joints of each kind.

    Attributes:
      still: [N, 4, 4] poses in the parents with all joints at their reference.
      address: by kind, [J] first coordinates. reference: by kind, [J] of the first coordinate.
      axis, anchor: by kind, [J, 3] in the bodies' frames. last: [4] last row of a pose.
    """

    still: Tensor
    last: Tensor
    address: dict[int, Tensor]
    reference: dict[int, Tensor]
    axis: dict[int, Tensor]
    anchor: dict[int, Tensor]


class Chain:
    """The bodies of a model.

    Args:
      model: read once. device: where to compute.
    """

    def __init__(self, model: mujoco.MjModel, device: torch.device) -> None:
        self._model, self._device = model, device
        self._known: dict[torch.dtype, _Numbers] = {}
        kinds = model.jnt_type.astype(int)
        self._joints = {kind: np.flatnonzero(kinds == kind) for kind in _KINDS}
        order = np.concatenate([self._joints[kind] for kind in _KINDS])
        # the moves are in this order; one more stands for no joint
        place = np.empty(model.njnt + 1, np.int64)
        place[order], place[-1] = np.arange(model.njnt), model.njnt
        counts = model.body_jntnum.astype(int)
        self._moves = []
        for k in range(int(counts.max(initial=0))):
            joint = np.where(counts > k, model.body_jntadr + k, model.njnt)
            self._moves.append(self._index(place[joint]))
        self._ancestors = [self._index(row) for row in _doubled(model.body_parentid)]

    def bodies(self, qpos: Tensor) -> tuple[Tensor, Tensor]:
        """Positions [B, nbody, 3] and rotations [B, nbody, 3, 3] at coordinates [B, nq]."""
        numbers = self._numbers(qpos.dtype)
        moves = self._moved(qpos, numbers)
        pose = numbers.still.expand(len(qpos), -1, -1, -1)
        for joint in self._moves:
            pose = pose @ moves[:, joint]
        for ancestor in self._ancestors:
            pose = pose[:, ancestor] @ pose
        return pose[..., :3, 3], pose[..., :3, :3]

    def _moved(self, qpos: Tensor, numbers: _Numbers) -> Tensor:
        """[B, njnt + 1, 4, 4]: what each joint does to its body; the last one does nothing."""
        parts = [
            _placed(*self._move(kind, qpos, numbers), numbers.last)
            for kind in _KINDS
            if len(self._joints[kind])
        ]
        nothing = torch.eye(4, dtype=qpos.dtype, device=qpos.device)
        return torch.cat([*parts, nothing.expand(len(qpos), 1, 4, 4)], dim=1)

    def _move(self, kind: int, qpos: Tensor, numbers: _Numbers) -> tuple[Tensor, Tensor]:
        """Rotations [B, J, 3, 3] and translations [B, J, 3] of all joints of a kind."""
        first, axis = numbers.address[kind], numbers.axis[kind]
        if kind == _FREE:
            quat = qpos[:, first[:, None] + torch.arange(3, 7, device=qpos.device)]
            return matrices(quat), qpos[:, first[:, None] + torch.arange(3, device=qpos.device)]
        if kind == _BALL:
            turn = matrices(qpos[:, first[:, None] + torch.arange(4, device=qpos.device)])
        else:
            change = (qpos[:, first] - numbers.reference[kind])[..., None]
            if kind == _SLIDE:
                straight = torch.eye(3, dtype=qpos.dtype, device=qpos.device)
                return straight.expand(*change.shape[:2], 3, 3), change * axis
            half = 0.5 * change
            turn = matrices(torch.cat([half.cos(), half.sin() * axis], dim=-1))
        anchor = numbers.anchor[kind]
        return turn, anchor - (turn @ anchor[..., None])[..., 0]

    def _numbers(self, dtype: torch.dtype) -> _Numbers:
        if dtype not in self._known:
            model, joints = self._model, self._joints
            turn = matrices(torch.as_tensor(np.array(model.body_quat)))
            last = torch.tensor([0.0, 0.0, 0.0, 1.0], dtype=turn.dtype)
            still = _placed(turn, torch.as_tensor(np.array(model.body_pos)), last)
            for body in model.jnt_bodyid[joints[_FREE]]:  # the joint says all of the pose
                still[body] = torch.eye(4, dtype=still.dtype)

            def each(values: npt.NDArray[np.float64]) -> dict[int, Tensor]:
                return {
                    k: torch.as_tensor(values[of]).to(self._device, dtype)
                    for k, of in joints.items()
                }

            self._known[dtype] = _Numbers(
                still.to(self._device, dtype),
                last.to(self._device, dtype),
                {k: self._index(model.jnt_qposadr[of]) for k, of in joints.items()},
                each(model.qpos0[model.jnt_qposadr]),
                each(model.jnt_axis),
                each(model.jnt_pos),
            )
        return self._known[dtype]

    def _index(self, values: npt.NDArray[np.integer]) -> Tensor:
        return torch.as_tensor(np.asarray(values, np.int64), device=self._device)


def _placed(turn: Tensor, place: Tensor, last: Tensor) -> Tensor:
    """Homogeneous matrices [..., 4, 4] of rotations [..., 3, 3] and translations [..., 3]."""
    top = torch.cat([turn, place[..., None]], dim=-1)
    return torch.cat([top, last.expand(*top.shape[:-2], 1, 4)], dim=-2)


def _doubled(parents: npt.NDArray[np.integer]) -> list[npt.NDArray[np.int64]]:
    """The first, second, fourth, ... ancestors, until all are the world, which is its own."""
    row, found = np.asarray(parents, np.int64), []
    while row.any():
        found.append(row)
        row = row[row]
    return found
