"""The arm's commands for many worlds at once, with gradients from joint targets to actions.

The same damped least squares as `orbisim.tasks.arm`, on tensors. Gradients do not run through the
iterations: where they have converged, forward(q) = pose, so that dq = J^+ dpose.
"""

from __future__ import annotations

import mujoco
import numpy as np
import torch
from orbisim_world_model.rotation import product, rotate
from torch import Tensor

from orbisim.tasks import assets
from orbisim.tasks.arm import ArmConfig


class ArmKinematics:
    """Pose and Jacobian of an arm's end effector, as a product of exponentials.

    Products are multiplications and sums, which a compiler joins with what is around them; each
    batched product of small matrices would be a kernel of its own.

    Args:
      config: of the arm.
      device: where to compute.

    Attributes:
      home: [joints] of the arm's keyframe, rad.
      low, high: [joints], rad.
    """

    def __init__(self, config: ArmConfig, device: torch.device) -> None:
        self.config = config
        model = assets.spec(config.asset).compile()
        data = mujoco.MjData(model)  # the reference configuration: all joints at zero
        mujoco.mj_kinematics(model, data)
        site, count = int(model.site(config.site).id), config.joints

        def put(values: object) -> Tensor:
            return torch.as_tensor(np.array(values), dtype=torch.float32, device=device)

        self._axis, self._anchor = put(data.xaxis[:count]), put(data.xanchor[:count])
        self._tip = put(data.site_xpos[site])
        self._rot = put(data.site_xmat[site].reshape(3, 3))
        self.home = put(model.key_qpos[0][:count])
        self.low, self.high = put(model.jnt_range[:count, 0]), put(model.jnt_range[:count, 1])
        self._eye = torch.eye(6, device=device) * config.damping**2
        self._skew = torch.stack([_skew(axis) for axis in self._axis])
        self._square, self._one = self._skew @ self._skew, torch.eye(3, device=device)

    def pose(self, q: Tensor) -> tuple[Tensor, Tensor]:
        """Position [B, 3], m, and rotation matrix [B, 3, 3] of the end effector."""
        pos, rot, _ = self._chain(q)
        return pos, rot

    def _chain(self, q: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Position, rotation, and the Jacobian [B, 6, joints] (translation, then rotation)."""
        s, c = q.sin()[..., None, None], q.cos()[..., None, None]
        turns = self._one + s * self._skew + (1 - c) * self._square
        rot = self._one.expand(len(q), 3, 3)
        origin = q.new_zeros((len(q), 3))
        axes, anchors = [], []
        for j in range(q.shape[1]):
            anchors.append(origin + rotate(rot, self._anchor[j]))
            axes.append(rotate(rot, self._axis[j]))
            rot = product(rot, turns[:, j])
            origin = anchors[-1] - rotate(rot, self._anchor[j])
        tip = origin + rotate(rot, self._tip)
        axis, anchor = torch.stack(axes, -1), torch.stack(anchors, -1)  # [B, 3, joints]
        arm = tip[..., None] - anchor
        linear = torch.linalg.cross(axis, arm, dim=1)
        return tip, product(rot, self._rot), torch.cat([linear, axis], dim=1)

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def descend(
        self, q: Tensor, pos: Tensor, yaw: Tensor, iterations: int
    ) -> tuple[Tensor, Tensor]:
        """Damped least squares towards a pose that points down.

        Args:
          q: [B, joints] to begin with. pos: [B, 3]. yaw: [B]. iterations: how many.

        Returns:
          Joints [B, joints] and the damped inverse of the last Jacobian [B, joints, 6].
        """
        goal, inverse = pointing_down(yaw), None
        for _ in range(iterations):
            tip, rot, jacobian = self._chain(q)
            turn = product(goal, rot.transpose(1, 2))
            skew = 0.5 * torch.stack(
                [
                    turn[:, 2, 1] - turn[:, 1, 2],
                    turn[:, 0, 2] - turn[:, 2, 0],
                    turn[:, 1, 0] - turn[:, 0, 1],
                ],
                -1,
            )
            size = skew.norm(dim=1, keepdim=True)
            cosine = (turn.diagonal(dim1=1, dim2=2).sum(1, keepdim=True) - 1) / 2
            angle = torch.atan2(size, cosine)
            error = torch.cat([pos - tip, skew * angle / size.clamp_min(1e-9)], 1)
            normal = product(jacobian, jacobian.transpose(1, 2)) + self._eye
            inverse = product(jacobian.transpose(1, 2), inverse_of_positive(normal))
            q = (q + rotate(inverse, error)).clamp(self.low, self.high)
        assert inverse is not None
        return q, inverse


def inverse_of_positive(matrix: Tensor) -> Tensor:
    """Inverse of symmetric positive definite matrices [B, n, n].

    Gauss-Jordan without pivoting, which they do not need: plain tensor operations, which can be
    compiled and recorded in a CUDA graph.
    """
    n = matrix.shape[-1]
    eye = torch.eye(n, device=matrix.device, dtype=matrix.dtype)
    rows = torch.cat([matrix, eye.expand_as(matrix)], dim=-1)
    for k in range(n):
        pivot = rows[:, k : k + 1] / rows[:, k : k + 1, k : k + 1]
        others = rows - rows[:, :, k : k + 1] * pivot
        rows = torch.where((eye[k] > 0)[:, None], pivot, others)
    return rows[..., n:]


def pointing_down(yaw: Tensor) -> Tensor:
    """[B, 3, 3]: a tool whose z axis points down and whose x axis points along `yaw` [B]."""
    c, s, zero, one = yaw.cos(), yaw.sin(), torch.zeros_like(yaw), torch.ones_like(yaw)
    rows = [c, s, zero, s, -c, zero, zero, zero, -one]
    return torch.stack(rows, -1).unflatten(-1, (3, 3))


def _skew(v: Tensor) -> Tensor:
    x, y, z = v.tolist()
    return torch.tensor([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]], device=v.device)
