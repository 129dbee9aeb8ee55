"""Newton's `diffsim_ball` in NumPy: a particle, a wall and a floor that are damped springs.

Constants and equations are those of newton/examples/diffsim/example_diffsim_ball.py and of its
semi-implicit solver: penalty forces at two contact planes found once, at the start; damping on
approach only; no friction (its coefficient kf is 0); semi-implicit Euler.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class BallConfig:
    """Constants of the example.

    Attributes:
      start: m. velocity: m/s. target: m.
      stiffness: ke, N/m. damping: kd, N s/m. radius: m. mass: kg. gravity: m/s^2.
      planes: (normal, offset) of wall and floor; outside is normal @ x > offset.
      frames: of 1/60 s each. substeps: of each frame.
    """

    start: tuple[float, float, float] = (0.0, -0.5, 1.0)
    velocity: tuple[float, float, float] = (0.0, 5.0, -5.0)
    target: tuple[float, float, float] = (0.0, -2.0, 1.5)
    stiffness: float = 1e4
    damping: float = 10.0
    radius: float = 0.1
    mass: float = 1.0
    gravity: float = 9.81
    planes: tuple[tuple[tuple[float, float, float], float], ...] = (
        ((0.0, -1.0, 0.0), -1.75),
        ((0.0, 0.0, 1.0), 0.0),
    )
    frames: int = 36
    frame_time: float = 1 / 60
    substeps: int = 8


def acceleration(config: BallConfig, position: Floats, velocity: Floats) -> Floats:
    """Acceleration [..., 3] under gravity and the two springs, m/s^2."""
    force = np.zeros_like(position)
    for axis, offset in config.planes:
        normal = np.array(axis)
        depth = position @ normal - offset - config.radius
        speed = np.minimum(velocity @ normal, 0.0)
        push = np.where(depth <= 0, -config.stiffness * depth - config.damping * speed, 0.0)
        force += push[..., None] * normal
    return force / config.mass - np.array([0.0, 0.0, config.gravity])


def simulate(
    velocity: npt.ArrayLike,
    position: npt.ArrayLike | None = None,
    config: BallConfig | None = None,
    frames: int | None = None,
) -> tuple[Floats, Floats]:
    """Positions and velocities [frames+1, ..., 3] at the frames.

    Args:
      velocity: [..., 3] initial velocities, m/s.
      position: [..., 3] initial positions, m; `config.start` if None.
      config: constants.
      frames: how many; `config.frames` if None.
    """
    config = config or BallConfig()
    v = np.array(velocity, np.float64)
    p = np.broadcast_to(config.start if position is None else position, v.shape).astype(np.float64)
    step = config.frame_time / config.substeps
    positions, velocities = [p], [v]
    for _ in range(config.frames if frames is None else frames):
        for _ in range(config.substeps):
            v = v + acceleration(config, p, v) * step
            p = p + v * step
        positions.append(p)
        velocities.append(v)
    return np.stack(positions), np.stack(velocities)


def loss(position: Floats, config: BallConfig | None = None) -> Floats:
    """Squared distance to the target, m^2: what the example minimises."""
    config = config or BallConfig()
    return np.asarray(np.sum((position - np.array(config.target)) ** 2, axis=-1))
