"""C MuJoCo as an OrbiSim backend and renderer."""

from orbisim_mujoco.backend import MujocoBackend
from orbisim_mujoco.renderer import MujocoRenderer

__all__ = ["MujocoBackend", "MujocoRenderer"]
