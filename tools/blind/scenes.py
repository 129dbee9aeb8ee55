"""The scenes of the trials: what is recorded of them, and what makes physical sense in them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import mjcf_assets
from orbisim import Scene, load_scene

ASSETS = Path(mjcf_assets.__file__).parent


@dataclasses.dataclass(frozen=True)
class Rig:
    """A scene and how it is recorded.

    Attributes:
      name: of its folder. fit, held: number of recordings. duration: of each, s. rate: Hz.
      brief: duration where a few short recordings must do, s.
      planar: whether nothing ever moves along y.
      bodies: bodies that forces act on and that have payloads.
      medium: bodies with drag from the air. spinning: with a Magnus force. floating: buoyant.
      geoms: by effect of the contact, geoms that it makes sense at.
    """

    name: str
    fit: int = 3
    held: int = 2
    duration: float = 8.0
    brief: float = 3.0
    rate: float = 100.0
    planar: bool = False
    bodies: tuple[str, ...] = ()
    medium: tuple[str, ...] = ()
    spinning: tuple[str, ...] = ()
    floating: tuple[str, ...] = ()
    geoms: tuple[tuple[str, tuple[str, ...]], ...] = ()

    @property
    def path(self) -> Path:
        """The scene's file."""
        return ASSETS / self.name / "scene.xml"

    def shorter(self) -> Rig:
        """With few and short recordings."""
        fit, held = max(2, self.fit // 2), max(1, self.held // 2)
        return dataclasses.replace(self, fit=fit, held=held, duration=self.brief)

    def scene(self) -> Scene:
        """The scene as it is declared when nothing is declared wrongly."""
        return load_scene(self.path, trusted=True)


RIGS: dict[str, Rig] = {
    rig.name: rig
    for rig in (
        Rig("arm2", planar=True, bodies=("upper_arm", "forearm"), medium=("forearm",)),
        Rig("arm6", bodies=("upper_arm", "forearm", "flange"), medium=("flange",)),
        # a payload of the cart is the same as armature of its rail, to the last digit
        Rig("cart_pole", brief=4.0, planar=True, bodies=("pole",), medium=("pole",)),
        Rig("servo_pendulum", planar=True, bodies=("rod",)),
        Rig(
            "puck",
            fit=8,
            held=4,
            duration=0.8,
            brief=0.8,
            bodies=("puck",),
            medium=("puck",),
            # adhesion of a puck on a level table is the same as more sliding friction
            geoms=(
                ("sliding_friction", ("puck",)),
                ("torsional_friction", ("puck",)),
                ("anisotropic_friction", ("puck",)),
                ("contact_compliance", ("puck",)),
            ),
        ),
        Rig(
            "bouncing_ball",
            fit=8,
            held=4,
            duration=1.5,
            brief=0.35,
            rate=200.0,
            bodies=("ball",),
            medium=("ball",),
            spinning=("ball",),
            floating=("ball",),
            geoms=(
                ("sliding_friction", ("ball",)),
                ("torsional_friction", ("ball",)),
                ("rolling_friction", ("ball",)),
                ("restitution", ("ball",)),
                ("contact_compliance", ("ball",)),
                ("adhesion", ("ball",)),
            ),
        ),
        Rig("drone", bodies=("drone",), medium=("drone",), floating=("drone",)),
        Rig(
            "gripper_push",
            bodies=("hand", "box"),
            geoms=(
                ("sliding_friction", ("box", "hand")),
                ("torsional_friction", ("box",)),
                ("anisotropic_friction", ("box",)),
                ("contact_compliance", ("box",)),
                ("adhesion", ("hand",)),
            ),
        ),
        Rig(
            "leg",
            planar=True,
            bodies=("hip", "thigh", "shank"),
            geoms=(
                ("sliding_friction", ("foot",)),
                ("contact_compliance", ("foot",)),
                ("restitution", ("foot",)),
                ("adhesion", ("foot",)),
            ),
        ),
    )
}
"""All scenes by name."""
