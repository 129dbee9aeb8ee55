"""Scenes with an arm, a table and cubes, drawn from ranges."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.scene import Scene
from orbisim.tasks import assets
from orbisim.tasks.sampling import Range

Floats = npt.NDArray[np.float64]

TABLE_LOW, TABLE_HIGH = np.array([0.15, -0.4]), np.array([0.95, 0.4])
"""Corners of the table top at z = 0, m; the arm's base is at the origin."""


SETTLED = 1.08e-4
"""How far a cube sinks into the table's soft contact, whatever its mass, m."""


@dataclasses.dataclass(frozen=True)
class TabletopConfig:
    """What a table-top scene is drawn from.

    Attributes:
      cube_half: half side of a cube, m. density: kg/m^3.
      cube_friction: of a cube with another one and, where it is the larger, with the fingers.
      table_friction: between the table and whatever lies on it.
      aspect: width over length of a box that has a cube's place; 1 is a cube.
      x, y: where cubes stand, m.
    """

    cube_half: Range = (0.02, 0.032)
    density: Range = (150.0, 900.0)
    cube_friction: Range = (0.2, 0.6)
    table_friction: Range = (0.2, 0.6)
    aspect: Range = (1.0, 1.0)
    x: Range = (0.38, 0.64)
    y: Range = (-0.2, 0.2)


@dataclasses.dataclass(frozen=True)
class Cube:
    """One cube.

    Attributes:
      half: half side, m. density: kg/m^3. friction: sliding coefficient. colour: red, green, blue.
      aspect: width over length.
    """

    half: float
    density: float
    friction: float
    colour: tuple[float, float, float]
    aspect: float = 1.0


@dataclasses.dataclass(frozen=True)
class Setting:
    """The physical side of a scene: what its descriptors say.

    Attributes:
      cubes: in order. table_friction: sliding coefficient.
    """

    cubes: tuple[Cube, ...]
    table_friction: float


def draw_setting(config: TabletopConfig, count: int, rng: np.random.Generator) -> Setting:
    """Draws the parameters of a scene with `count` cubes."""
    table = rng.uniform(*config.table_friction)
    return Setting(tuple(_draw_cube(config, rng) for _ in range(count)), table)


def _draw_cube(config: TabletopConfig, rng: np.random.Generator) -> Cube:
    half = rng.uniform(*config.cube_half)
    density = rng.uniform(*config.density)
    friction = rng.uniform(*config.cube_friction)
    red, green, blue = (float(value) for value in rng.uniform(0.1, 0.9, 3))
    low, high = config.aspect
    aspect = low if low == high else rng.uniform(low, high)  # cubes draw the same numbers as ever
    return Cube(half, density, friction, (red, green, blue), float(aspect))


def build(asset: str, setting: Setting, label: str, qpos: Floats, ctrl: Floats) -> Scene:
    """The scene of a setting, with its cubes named cube1, cube2 ..., and a keyframe `start`."""
    spec = assets.spec(asset)
    spec.geom("table").friction = [setting.table_friction, 0.005, 0.0001]
    present = [body for body in spec.bodies if body.name.startswith("cube")]
    for body in present[len(setting.cubes) :]:
        spec.delete(body)
    for key in list(spec.keys):
        spec.delete(key)
    for number, cube in enumerate(setting.cubes, 1):
        _write_cube(spec, f"cube{number}", cube)
    spec.add_key(name="start", qpos=qpos, ctrl=ctrl)
    return assets.scene(spec, label)


def _write_cube(spec: mujoco.MjSpec, name: str, cube: Cube) -> None:
    body = spec.body(name)
    if body is None:
        body = spec.worldbody.add_body(name=name, pos=[0.3, 0.3, 0.1])
        body.add_freejoint(name=name)
        body.add_geom(spec.find_default("cube"), name=name)
    geom = body.geoms[0]
    geom.size = [cube.half, cube.half * cube.aspect, cube.half]
    geom.density = cube.density
    geom.friction = [cube.friction, 0.005, 0.0001]
    geom.rgba = [*cube.colour, 1.0]


@dataclasses.dataclass(frozen=True)
class Pose:
    """Where a cube stands: centre [3], m, and turn about the vertical, rad."""

    pos: tuple[float, float, float]
    yaw: float

    @property
    def qpos(self) -> Floats:
        """Coordinates of its free joint [7]."""
        return np.array([*self.pos, np.cos(self.yaw / 2), 0.0, 0.0, np.sin(self.yaw / 2)])


def scatter(
    setting: Setting, config: TabletopConfig, rng: np.random.Generator, gap: float = 0.03
) -> list[Pose]:
    """Poses of all cubes on the table, at least `gap` metres apart."""
    poses: list[Pose] = []
    while len(poses) < len(setting.cubes):
        half = setting.cubes[len(poses)].half
        spot = np.array([rng.uniform(*config.x), rng.uniform(*config.y)])
        yaw = rng.uniform(-np.pi, np.pi)
        if all(_apart(spot, half, p, setting.cubes[i].half, gap) for i, p in enumerate(poses)):
            poses.append(Pose((float(spot[0]), float(spot[1]), half - SETTLED), yaw))
    return poses


def tower(
    setting: Setting, config: TabletopConfig, rng: np.random.Generator, height: int
) -> list[Pose]:
    """The first `height` cubes on top of one another, not quite straight; the others beside."""
    poses = scatter(setting, config, rng, gap=0.06)
    x, y, top = poses[0].pos[0], poses[0].pos[1], -SETTLED
    for i, cube in enumerate(setting.cubes[:height]):
        dx, dy = rng.uniform(-0.15, 0.15, 2) * cube.half if i else (0.0, 0.0)
        yaw = poses[0].yaw + rng.uniform(-0.3, 0.3)
        poses[i] = Pose((float(x + dx), float(y + dy), top + cube.half), yaw)
        top += 2 * cube.half - SETTLED
    return poses


def _apart(spot: Floats, half: float, other: Pose, other_half: float, gap: float) -> bool:
    reach = np.sqrt(2) * (half + other_half)
    return bool(np.linalg.norm(spot - np.array(other.pos[:2])) > reach + gap)


def on_table(pos: Floats) -> npt.NDArray[np.bool_]:
    """Whether cubes [..., 3] are above the table top."""
    inside = (pos[..., :2] > TABLE_LOW) & (pos[..., :2] < TABLE_HIGH)
    return np.asarray(inside.all(axis=-1) & (pos[..., 2] > 0))
