"""From end-effector actions to joint targets.

An action is 7 numbers for one control step: a translation of the commanded end effector (m, world
frame), a rotation vector (rad, world frame), and the gripper from -1 (open) to 1 (closed). The
joint targets follow by damped least squares from the *commanded* pose, not the measured one: the
targets are a function of the initial ones and the actions alone, and can be replayed.
"""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from orbisim.tasks import assets

Floats = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class ArmConfig:
    """An arm and its controller.

    Attributes:
      asset: folder in `mjcf_assets` with the arm alone.
      site: of the end effector.
      joints: number of joints of the arm; the first ones of its model and of its controls.
      opening: of the open gripper, m.
      damping: of the least squares, m.
      iterations: for each control step.
      reach: largest translation in one control step, m. turn: largest rotation, rad.
      stride: largest change of a joint target in one control step, rad.
      posture: share of its way home that each joint goes in each iteration, as far as the end
        effector stays where it is; without it the elbow of a seven-joint arm drifts.
    """

    asset: str
    joints: int
    opening: float
    site: str = "tcp"
    damping: float = 0.02
    iterations: int = 3
    reach: float = 0.05
    turn: float = 0.2
    stride: float = 0.25
    posture: tuple[float, ...] = ()


UR5E = ArmConfig("ur5e", joints=6, opening=0.085)
PANDA = ArmConfig("panda", joints=7, opening=0.08)


class ArmController:
    """Keeps the commanded joint positions of an arm and moves them by actions.

    Attributes:
      target: [joints] commanded joint positions, rad.
      pos, rot: commanded end-effector position [3], m, and rotation matrix [3, 3].
    """

    def __init__(self, config: ArmConfig) -> None:
        self.config = config
        self._model = assets.spec(config.asset).compile()
        self._data = mujoco.MjData(self._model)
        self._site = int(self._model.site(config.site).id)
        self._home = self._model.key_qpos[0].copy()
        self._range = self._model.jnt_range[: config.joints]
        self._jacobian = np.empty((6, self._model.nv))
        self.reset(self._home[: config.joints])

    def reset(self, target: Floats) -> None:
        """Takes joint positions [joints] as the commanded ones."""
        self._data.qpos[:] = self._home
        self._place(np.array(target, np.float64))

    def solve(self, pos: npt.ArrayLike, yaw: float, iterations: int = 200) -> Floats:
        """Joint positions from home that point the gripper down at a position; [joints]."""
        self.reset(self._home[: self.config.joints])
        rotation = pointing_down(yaw)
        for _ in range(iterations):
            if self._descend(np.asarray(pos, np.float64), rotation) < 1e-7:
                break
        return self.target.copy()

    def step(self, action: Floats) -> Floats:
        """Moves the commanded pose by an action [7]; returns the controls [joints + 1]."""
        translation, rotation = self.clip(action[:3], action[3:6])
        pos = self.pos + translation
        rot = rotation_matrix(rotation) @ self.rot
        before = self.target
        for _ in range(self.config.iterations):
            self._descend(pos, rot)
        change = np.clip(self.target - before, -self.config.stride, self.config.stride)
        self._place(before + change)
        return np.append(self.target, self.gripper(float(action[6])))

    def clip(self, translation: Floats, rotation: Floats) -> tuple[Floats, Floats]:
        """Translation [3] and rotation vector [3] within the largest step."""
        return _shorten(translation, self.config.reach), _shorten(rotation, self.config.turn)

    def gripper(self, command: float) -> float:
        """Opening in m for a command from -1 (open) to 1 (closed)."""
        return self.config.opening * (1.0 - min(max(command, -1.0), 1.0)) / 2

    def action_to(self, pos: Floats, rot: Floats, gripper: float) -> Floats:
        """The action [7] that brings the commanded pose to another, as far as one step goes."""
        turn = rotation_vector(rot @ self.rot.T)
        return np.array([*np.concatenate(self.clip(pos - self.pos, turn)), gripper])

    def _place(self, target: Floats) -> None:
        low, high = self._range.T
        self.target = np.clip(target, low, high)
        self._data.qpos[: self.config.joints] = self.target
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        self.pos: Floats = self._data.site_xpos[self._site].copy()
        self.rot: Floats = self._data.site_xmat[self._site].reshape(3, 3).copy()

    def _descend(self, pos: Floats, rot: Floats) -> float:
        """One step of damped least squares towards a pose; returns the error before it."""
        mujoco.mj_jacSite(
            self._model, self._data, self._jacobian[:3], self._jacobian[3:], self._site
        )
        jacobian = self._jacobian[:, : self.config.joints]
        error = np.concatenate([pos - self.pos, rotation_vector(rot @ self.rot.T)])
        normal = jacobian @ jacobian.T + self.config.damping**2 * np.eye(6)
        change = jacobian.T @ np.linalg.solve(normal, error)
        if self.config.posture:
            away = self._home[: self.config.joints] - self.target
            homeward = np.array(self.config.posture) * away
            change += homeward - jacobian.T @ np.linalg.solve(normal, jacobian @ homeward)
        self._place(self.target + change)
        return float(np.abs(error).max())


def pointing_down(yaw: float) -> Floats:
    """Rotation of a tool whose z axis points down and whose x axis points along `yaw`."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]])


def rotation_matrix(vector: Floats) -> Floats:
    """Of a rotation vector [3]."""
    return np.asarray(Rotation.from_rotvec(vector).as_matrix())


def rotation_vector(matrix: Floats) -> Floats:
    """Of a rotation matrix [3, 3]."""
    return np.asarray(Rotation.from_matrix(matrix).as_rotvec())


def _shorten(vector: Floats, longest: float) -> Floats:
    length = float(np.linalg.norm(vector))
    return np.asarray(vector if length <= longest else vector * (longest / length))
