"""MuJoCo-Warp as an OrbiSim backend."""

from orbisim_warp.backend import WarpBackend

__all__ = ["WarpBackend"]
