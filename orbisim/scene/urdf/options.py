"""What a user can choose about reading URDF."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from orbisim.errors import InputError, UnknownNameError

ActuatorKind = Literal["motor", "position", "velocity"]
PackagePaths = Mapping[str, str | os.PathLike[str]] | Sequence[str | os.PathLike[str]]

_CHOICES: Mapping[str, tuple[object, ...]] = {
    "lump_fixed": (None, True, False),
    "floating_base": (True, False),
    "visuals": (None, True, False),
    "actuators": (None, "motor", "position", "velocity"),
    "actuate": ("transmissions", "all"),
    "mesh_inertia": ("legacy", "exact", "convex"),
}


@dataclasses.dataclass(frozen=True)
class UrdfOptions:
    """Options of `read_urdf`.

    Attributes:
      package_paths: where `package://NAME/...` leads: a mapping from package name to folder, or
        folders that are packages or hold packages. Searched before `ROS_PACKAGE_PATH`,
        `AMENT_PREFIX_PATH` and the folders above the file.
      lump_fixed: whether links on fixed joints become part of their parents. None: what the
        file's `<mujoco><compiler fusestatic=.../>` says, and else True, as in MuJoCo's import.
      floating_base: whether the root link gets a free joint; else it is welded to the world.
      visuals: whether visual geometry is kept, as geoms that do not collide and weigh nothing
        (group 1; the collision geoms of a link that has visual ones are then in group 3, which
        viewers hide). None: what the file's `discardvisual` says, and else True. MuJoCo's import
        discards visual geometry.
      actuators: kind of actuators to make from transmissions and joint limits; None for none.
      actuate: which joints get one: those with a transmission, or all that move on one axis and
        mimic no other.
      position_gain: of position actuators, N*m/rad or N/m at the actuator; critically damped.
      velocity_gain: of velocity actuators, N*m*s/rad or N*s/m at the actuator.
      mesh_inertia: rule for the volume of a mesh whose link declares no inertia: `legacy` (what
        MuJoCo does by default; overestimates meshes that are not star-shaped), `exact` (signed
        volume; of an open mesh that of its convex hull) or `convex` (the convex hull).
    """

    package_paths: PackagePaths = ()
    lump_fixed: bool | None = None
    floating_base: bool = False
    visuals: bool | None = None
    actuators: ActuatorKind | None = None
    actuate: Literal["transmissions", "all"] = "transmissions"
    position_gain: float = 100.0
    velocity_gain: float = 10.0
    mesh_inertia: Literal["legacy", "exact", "convex"] = "legacy"

    def __post_init__(self) -> None:
        for name, allowed in _CHOICES.items():
            if getattr(self, name) not in allowed:
                shown = ", ".join(repr(value) for value in allowed)
                raise InputError(f"URDF option {name}={getattr(self, name)!r}: expected {shown}")
        for name in ("position_gain", "velocity_gain"):
            value = getattr(self, name)
            if not isinstance(value, int | float) or not 0 < value < float("inf"):
                raise InputError(f"URDF option {name}={value!r}: expected a positive number")
        if isinstance(self.package_paths, str | os.PathLike):
            object.__setattr__(self, "package_paths", (self.package_paths,))

    @property
    def named_packages(self) -> Mapping[str, Path]:
        """Folders given by package name."""
        if not isinstance(self.package_paths, Mapping):
            return {}
        return {name: Path(folder) for name, folder in self.package_paths.items()}

    @property
    def package_folders(self) -> tuple[Path, ...]:
        """Folders given without a name."""
        if isinstance(self.package_paths, Mapping):
            return ()
        return tuple(Path(folder) for folder in self.package_paths)


def urdf_options(options: Mapping[str, Any]) -> UrdfOptions:
    """Options from keyword arguments.

    Raises:
      UnknownNameError: there is no option of that name.
      InputError: a value is none of the allowed ones.
    """
    known = [field.name for field in dataclasses.fields(UrdfOptions)]
    for name in options:
        if name not in known:
            raise UnknownNameError("URDF option", name, known)
    return UrdfOptions(**options)
