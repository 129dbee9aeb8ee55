"""The machines of the trials: scenes of other packages, and a few written by hand beside this file.

None of them is in `mjcf_assets`. A scene is declared exactly as its package has it, time step
included: what a coarse step does to a prediction is part of what a user has.
"""

from __future__ import annotations

import dataclasses
import importlib.util
from pathlib import Path

import mujoco

HERE = Path(__file__).resolve().parent / "scenes"

Place = tuple[str, str]
"""An effect and its target."""
Same = tuple[Place, Place]
"""The truth, and what is the same physics in that scene."""


class Missing(Exception):
    """A package that has the scene is not installed."""


@dataclasses.dataclass(frozen=True)
class Machine:
    """A scene and how it is moved and recorded.

    Attributes:
      name: in tables. source: `hand:FILE`, `suite:FILE` of dm_control or `gym:FILE` of gymnasium.
      drive: `motor` and `servo` move all actuated joints along smooth random references, by torques
        and by position commands; `applied` does so by joint torques where no actuator is declared;
        `thrown` bodies start with a random velocity.
      fit, held: number of recordings. duration: of each, s. rate: Hz.
      start: reference configuration around which motions begin; the model's own if empty.
      contact: names of the geoms whose contact may lack an effect.
      left_out: joints that no effect is put at (goals that nothing moves).
      same: other names that stand for exactly the same physics in this scene.
    """

    name: str
    source: str
    drive: str = "motor"
    fit: int = 4
    held: int = 2
    duration: float = 6.0
    rate: float = 100.0
    start: tuple[float, ...] = ()
    contact: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    same: tuple[Same, ...] = ()

    @property
    def suffix(self) -> str:
        """Of the file of the scene."""
        return Path(self.source).suffix

    def text(self) -> str:
        """The scene's document, complete in itself.

        Raises:
          Missing: the package is not installed.
        """
        where, _, name = self.source.partition(":")
        if where == "hand":
            return (HERE / name).read_text()
        if where == "gym":
            return (_folder("gymnasium") / "envs" / "mujoco" / "assets" / name).read_text()
        folder = _folder("dm_control") / "suite"
        assets = {f"./common/{p.name}": p.read_bytes() for p in (folder / "common").glob("*.xml")}
        spec = mujoco.MjSpec.from_string((folder / name).read_text(), assets)
        spec.compile()
        return str(spec.to_xml())


def _folder(package: str) -> Path:
    found = importlib.util.find_spec(package)
    if found is None or found.origin is None:
        raise Missing(f"the package {package} is not installed")
    return Path(found.origin).parent


def _of_contact(moving: str, ground: str) -> tuple[Same, ...]:
    """A coefficient of a pair of geoms may be put at either; a slope pulls a single body like a
    constant force."""
    pairs = tuple(
        ((effect, moving), (effect, ground))
        for effect in ("sliding_friction", "restitution", "contact_compliance")
    )
    return (*pairs, (("gravity_tilt", "world"), ("constant_force", moving)))


def _both(one: Place, other: Place) -> tuple[Same, ...]:
    return ((one, other), (other, one))


def _turning(body: str, joint: str) -> tuple[Same, ...]:
    """A body that turns about its first axis only, gravity along it: all its mass does is inertia
    about that axis."""
    inertia: Place = ("armature", joint)
    return (
        *_both(inertia, ("payload", body)),
        (("com_offset", body), inertia),
        (("com_offset", body), ("payload", body)),
    )


def _upright(joint: str) -> tuple[Same, ...]:
    """Nothing but gravity depends on the first angle of a planar machine: an encoder that is off
    by an angle is a slope by that angle."""
    return _both(("sensor_bias", joint), ("gravity_tilt", "world"))


def _last(joint: str, body: str) -> tuple[Same, ...]:
    """Of the last link of a planar machine, forces know only where its centre of mass is: an
    encoder that is off by an angle is a centre of mass that has turned about the joint by it."""
    return ((("sensor_bias", joint), ("com_offset", body)),)


MACHINES: dict[str, Machine] = {
    one.name: one
    for one in (
        Machine(
            "suite_pendulum",
            "suite:pendulum.xml",
            # with one sensor and one drive, only the sum of their delays is seen
            same=(
                *_upright("hinge"),
                *_both(("sensor_delay", "hinge"), ("actuator_delay", "torque")),
            ),
        ),
        Machine(
            "suite_cartpole",
            "suite:cartpole.xml",
            start=(0.0, 3.14159),
            # mass of the cart acts along its rail only, like inertia of the drive
            same=(
                *_both(("armature", "slider"), ("payload", "cart")),
                *_both(("torque_bias", "slide"), ("constant_force", "cart")),
                *_last("hinge_1", "pole_1"),
            ),
        ),
        Machine("suite_reacher", "suite:reacher.xml", same=_turning("arm", "shoulder")),
        Machine(
            "suite_acrobot",
            "suite:acrobot.xml",
            start=(3.14159, 0.0),
            same=(*_upright("shoulder"), *_last("elbow", "lower_arm")),
        ),
        Machine("suite_finger", "suite:finger.xml"),
        Machine(
            "gym_reacher",
            "gym:reacher.xml",
            left_out=("target_x", "target_y"),
            same=_turning("body0", "joint0"),
        ),
        Machine(
            "gym_pusher",
            "gym:pusher_v5.xml",
            fit=3,
            left_out=("goal_slidey", "goal_slidex", "obj_slidey", "obj_slidex"),
        ),
        Machine(
            "urdf_arm2",
            "hand:arm2.urdf",
            drive="applied",
            same=(*_upright("hip"), *_last("knee", "distal")),
        ),
        Machine("urdf_arm6", "hand:arm6.urdf", drive="applied", same=_turning("shoulder", "a1")),
        Machine(
            "servo_arm",
            "hand:servo_arm.xml",
            drive="servo",
            same=(
                *_turning("turret", "yaw"),
                *_both(("torque_bias", "yaw_servo"), ("sensor_bias", "yaw")),
            ),
        ),
        Machine(
            "tossed_box",
            "hand:tossed_box.xml",
            "thrown",
            10,
            4,
            1.6,
            contact=("box",),
            same=_of_contact("box", "floor"),
        ),
        Machine(
            "sliding_puck",
            "hand:sliding_puck.xml",
            "thrown",
            8,
            3,
            1.6,
            contact=("puck",),
            same=_of_contact("puck", "table"),
        ),
        Machine(
            "served_ball",
            "hand:served_ball.xml",
            "thrown",
            8,
            3,
            1.0,
            same=(
                (("buoyancy", "ball"), ("constant_force", "ball")),
                (("gravity_tilt", "world"), ("constant_force", "ball")),
            ),
        ),
    )
}
"""By name."""
