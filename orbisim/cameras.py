"""`Camera`: where a camera stands, where it looks and how, as a value."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.errors import InputError, UnknownNameError

Floats = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera.

    Attributes:
      pos: [3] its centre in the world frame, m.
      rot: [3, 3] its axes in the world frame as columns: right, up, backward (as in MuJoCo, it
        looks along its negative z axis).
      focal: focal lengths (horizontal, vertical) in image heights: pixels over the height.
      offset: of the principal point from the middle of the image, right and down, in image
        heights.
    """

    pos: Floats
    rot: Floats
    focal: tuple[float, float]
    offset: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if self.pos.shape != (3,) or self.rot.shape != (3, 3):
            raise InputError(
                f"a camera has a position [3] and a rotation [3, 3]; got {self.pos.shape} and "
                f"{self.rot.shape}"
            )
        if np.abs(self.rot @ self.rot.T - np.eye(3)).max() > 1e-3:
            raise InputError("a camera's rotation must be an orthonormal matrix")
        if not min(self.focal) > 0:
            raise InputError(f"a camera's focal lengths are above 0; got {self.focal}")

    @property
    def fovy(self) -> float:
        """Vertical field of view, degrees."""
        return math.degrees(2.0 * math.atan(0.5 / self.focal[1]))

    def intrinsics(self, height: int, width: int) -> Floats:
        """[3, 3] from camera coordinates (right, down, forward) to pixels.

        The centre of the upper left pixel is at (0.5, 0.5).
        """
        fx, fy = (height * f for f in self.focal)
        cx, cy = width / 2 + height * self.offset[0], height / 2 + height * self.offset[1]
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    @staticmethod
    def from_intrinsics(
        pos: Floats, rot: Floats, matrix: Floats, height: int, width: int
    ) -> Camera:
        """The camera with these intrinsics (see `intrinsics`) on images of this size."""
        focal = float(matrix[0, 0]) / height, float(matrix[1, 1]) / height
        offset = (
            float(matrix[0, 2] - width / 2) / height,
            float(matrix[1, 2] - height / 2) / height,
        )
        return Camera(np.asarray(pos, float), np.asarray(rot, float), focal, offset)


@dataclasses.dataclass(frozen=True)
class Orbit:
    """A camera on a sphere about a point, upright.

    Attributes:
      lookat: the point, m. distance: from it, m. azimuth, elevation: of the line of sight, degrees.
    """

    lookat: tuple[float, float, float]
    distance: float
    azimuth: float
    elevation: float

    def camera(self, fovy: float) -> Camera:
        """As a value, with a vertical field of view in degrees."""
        az, el = math.radians(self.azimuth), math.radians(self.elevation)
        forward = np.array([math.cos(el) * math.cos(az), math.cos(el) * math.sin(az), math.sin(el)])
        right = np.array([math.sin(az), -math.cos(az), 0.0])
        rot = np.stack([right, np.cross(right, forward), -forward], axis=1)
        pos = np.array(self.lookat) - self.distance * forward
        return Camera(pos, rot, (_focal(fovy), _focal(fovy)))

    def to_mujoco(self) -> mujoco.MjvCamera:
        """As MuJoCo's free camera."""
        camera = mujoco.MjvCamera()
        camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        camera.lookat[:] = self.lookat
        camera.distance, camera.azimuth, camera.elevation = (
            *(self.distance, self.azimuth, self.elevation),
        )
        return camera


def camera_number(model: mujoco.MjModel, camera: int | str, source: str = "") -> int:
    """Number of a camera of a model; -1 for the free one.

    Raises:
      InputError: there is none of this number. UnknownNameError: or of this name.
    """
    if isinstance(camera, str):
        names = [model.camera(i).name for i in range(model.ncam)]
        if camera not in names:
            raise UnknownNameError("camera", camera, filter(None, names))
        return names.index(camera)
    if not -1 <= camera < model.ncam:
        raise InputError(
            f"camera {camera} does not exist; scene {source!r} has {model.ncam}, and -1 is the "
            "free camera"
        )
    return camera


def free_orbit(model: mujoco.MjModel) -> Orbit:
    """MuJoCo's free camera as it stands before anyone moved it."""
    camera = mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(model, camera)
    x, y, z = (float(value) for value in camera.lookat)
    return Orbit((x, y, z), float(camera.distance), float(camera.azimuth), float(camera.elevation))


def read_focal(model: mujoco.MjModel, camera: int) -> tuple[float, float]:
    """Focal lengths of a camera of the model, in image heights (see `Camera`).

    Raises:
      InputError: it is orthographic, or its principal point is not in the middle.
    """
    if camera < 0:
        f = _focal(float(model.vis.global_.fovy))
        return f, f
    name = model.camera(camera).name or str(camera)
    if int(model.cam_projection[camera]) != int(mujoco.mjtProjection.mjPROJ_PERSPECTIVE):
        raise InputError(f"camera {name!r} is orthographic; only perspective ones are known here")
    size, inner = model.cam_sensorsize[camera], model.cam_intrinsic[camera]
    if not size[1]:
        f = _focal(float(model.cam_fovy[camera]))
        return f, f
    if np.any(inner[2:]):
        raise InputError(f"camera {name!r} has its principal point beside the middle")
    return float(inner[0] / size[1]), float(inner[1] / size[1])


def read_camera(model: mujoco.MjModel, data: mujoco.MjData, camera: int) -> Camera:
    """A camera of a model where it stands now.

    Args:
      model: the scene.
      data: its kinematics and camera positions are computed (`mj_kinematics`, `mj_comPos`,
        `mj_camlight`).
      camera: its number, -1 for the free camera.
    """
    focal = read_focal(model, camera)
    if camera < 0:
        return free_orbit(model).camera(float(model.vis.global_.fovy))
    rot = np.array(data.cam_xmat[camera]).reshape(3, 3)
    return Camera(np.array(data.cam_xpos[camera]), rot, focal)


def _focal(fovy: float) -> float:
    """In image heights, of a vertical field of view in degrees."""
    if not 0.0 < fovy < 180.0:
        raise InputError(f"a field of view is between 0 and 180 degrees; got {fovy:g}")
    return 0.5 / math.tan(math.radians(fovy) / 2.0)


def to_dict(camera: Camera) -> dict[str, Any]:
    """For JSON."""
    return {
        "pos": camera.pos.tolist(),
        "rot": camera.rot.tolist(),
        "focal": list(camera.focal),
        "offset": list(camera.offset),
    }
