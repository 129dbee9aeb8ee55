"""Which MuJoCo elements came from which prims."""

from __future__ import annotations

import dataclasses

import mujoco

from orbisim.scene.usd.names import NameBook


@dataclasses.dataclass
class Registry:
    """Names of the elements of one spec by prim path.

    Attributes:
      spec: the model that is being built.
      bodies: "" stands for the world.
      joints: names of the joints of a joint prim, outermost first.
      joint_types: MuJoCo's type by joint name.
      sites: names by path.
      tendons: names by path.
      geoms: names by path; several for a mesh that is split.
      actuator_names: hands out names of actuators.
      site_names: hands out names of sites.
    """

    spec: mujoco.MjSpec
    bodies: dict[str, str] = dataclasses.field(default_factory=lambda: {"": "world"})
    joints: dict[str, list[str]] = dataclasses.field(default_factory=dict)
    joint_types: dict[str, mujoco.mjtJoint] = dataclasses.field(default_factory=dict)
    sites: dict[str, str] = dataclasses.field(default_factory=dict)
    tendons: dict[str, str] = dataclasses.field(default_factory=dict)
    geoms: dict[str, list[str]] = dataclasses.field(default_factory=dict)
    actuator_names: NameBook = dataclasses.field(default_factory=NameBook)
    site_names: NameBook = dataclasses.field(default_factory=NameBook)
    tendon_names: NameBook = dataclasses.field(default_factory=NameBook)
    equality_names: NameBook = dataclasses.field(default_factory=NameBook)

    def body(self, path: str | None) -> mujoco.MjsBody:
        """A body of the spec; the world for None or ""."""
        return self.spec.worldbody if not path else self.spec.body(self.bodies[path])
