"""Where things are: forward kinematics on MjData of the viewer's own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

_CARRIED = ("mocap_pos", "mocap_quat")


class Kinematics:
    """Positions of everything that is drawn, from generalized positions.

    Args:
      model: the scene's model.
      contacts: whether to run collision detection too.

    Attributes:
      data: MjData with the position stage computed for what was placed last.
    """

    def __init__(self, model: mujoco.MjModel, contacts: bool = False) -> None:
        self.model, self.data = model, mujoco.MjData(model)
        self._contacts = contacts
        self.place(self.data.qpos)

    def place(
        self, qpos: npt.NDArray[np.floating[Any]], memory: Mapping[str, Any] | None = None
    ) -> None:
        """Computes positions.

        Args:
          qpos: [nq].
          memory: `mocap_pos` [nmocap, 3] and `mocap_quat` [nmocap, 4], where known; other entries
            are ignored.
        """
        self.data.qpos[:] = qpos
        for name in _CARRIED:
            if memory and name in memory and getattr(self.data, name).size:
                getattr(self.data, name)[:] = memory[name]
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        if self.model.nflex:
            mujoco.mj_flex(self.model, self.data)
        if self.model.ntendon:
            mujoco.mj_tendon(self.model, self.data)
        if self._contacts:
            mujoco.mj_collision(self.model, self.data)

    def body_matrix(self, body: int) -> npt.NDArray[np.float64]:
        """[4, 4]: pose of a body in the world."""
        return pose_matrix(self.data.xpos[body], self.data.xquat[body])


def pose_matrix(
    position: npt.NDArray[np.float64], quaternion: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """[4, 4] of a position and a unit quaternion (w, x, y, z)."""
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, np.ascontiguousarray(quaternion, np.float64))
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation.reshape(3, 3), position
    return matrix


def is_static(model: mujoco.MjModel, body: int) -> bool:
    """Whether a body never moves: fixed to the world and not moved as a mocap body."""
    return bool(model.body_weldid[body] == 0 and model.body_mocapid[model.body_rootid[body]] < 0)
