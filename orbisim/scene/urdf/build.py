"""From a `Robot` to a `mujoco.MjSpec`."""

from __future__ import annotations

from pathlib import Path

import mujoco

from orbisim.errors import SceneError
from orbisim.scene.reading import ReadResult
from orbisim.scene.urdf.actuators import Actuators
from orbisim.scene.urdf.assembly import Body, assemble
from orbisim.scene.urdf.assets import Meshes
from orbisim.scene.urdf.extension import Extension, read_extension
from orbisim.scene.urdf.geometry import Geoms, quaternion
from orbisim.scene.urdf.inertials import Inferrer, of_body
from orbisim.scene.urdf.joints import Joints
from orbisim.scene.urdf.model import WORLD, Inertial, Robot
from orbisim.scene.urdf.options import UrdfOptions
from orbisim.scene.urdf.own_extension import apply_extension
from orbisim.scene.urdf.packages import FileFinder
from orbisim.scene.urdf.visuals import without_missing_visuals

MAX_DEPTH = 1000
"""MuJoCo's compiler gives up at 1024 bodies below each other."""


def build(robot: Robot, folder: Path | None, options: UrdfOptions, source: str) -> ReadResult:
    """Builds the scene of a robot.

    Args:
      folder: where the document is, for the files that it names.
    """
    extension = read_extension(robot.extension, robot.name, source)
    return _Builder(robot, extension, folder, options, source).build()


class _Builder:
    def __init__(
        self,
        robot: Robot,
        extension: Extension,
        folder: Path | None,
        options: UrdfOptions,
        source: str,
    ) -> None:
        self._extension, self._source = extension, source
        self._options, self._spec = options, extension.spec
        finder = FileFinder(
            folder, options, source, meshdir=extension.meshdir, strippath=extension.strippath
        )
        self._robot = without_missing_visuals(robot, finder)
        discard = bool(extension.discardvisual)
        self._meshes = Meshes(self._spec, finder, source)
        self._geoms = Geoms(
            self._meshes,
            source,
            visuals=not discard if options.visuals is None else options.visuals,
        )
        self._joints = Joints(self._spec)
        self._actuators = Actuators(self._spec, options)
        self._made: dict[str, mujoco.MjsBody] = {}

    def build(self) -> ReadResult:
        lump = self._options.lump_fixed
        lump = self._extension.fusestatic if lump is None else lump
        self._check_base()
        bodies = assemble(self._robot, lump=lump, floating=self._options.floating_base)
        _check_depth(bodies, self._robot, self._source)
        inferrer = self._inferrer()
        groups = assemble(self._robot, lump=True, floating=self._options.floating_base)
        inertials = inferrer.all(groups, skip_static=lump)
        for body in bodies:
            self._add(body, of_body(body, inertials))
        for joint in self._robot.joints.values():
            self._joints.mimic(joint, self._robot.joints)
        self._actuators.add(self._robot)
        self._joints.finish()
        self._meshes.finish()
        beyond = apply_extension(self._robot.own_extension, self._spec, self._source)
        return ReadResult(
            self._spec,
            (
                *self._robot.unsupported,
                *self._extension.unsupported,
                *beyond,
                *self._geoms.unsupported(),
                *self._joints.unsupported,
                *self._actuators.unsupported,
            ),
            (
                *self._robot.warnings,
                *inferrer.warnings,
                *self._joints.warnings,
                *self._geoms.warnings(),
                *self._actuators.warnings,
                *_lumped(bodies),
            ),
        )

    def _check_base(self) -> None:
        if self._options.floating_base and self._robot.root == WORLD:
            raise SceneError(
                self._source,
                "the root link is the world, which cannot float",
                element=self._robot.links[WORLD].label,
                remedy="remove the world link and its joint, or the option floating_base",
            )

    def _inferrer(self) -> Inferrer:
        compiler = self._spec.compiler
        return Inferrer(
            self._source,
            self._meshes.triangles,
            self._options.mesh_inertia,
            balanced=bool(compiler.balanceinertia),
            bounded=compiler.boundmass > 0 and compiler.boundinertia > 0,
        )

    def _add(self, body: Body, inertial: Inertial | None) -> None:
        if body.parent is None:
            target = self._spec.worldbody
        else:
            target = self._made[body.parent].add_body(
                name=body.name, pos=body.pos, quat=quaternion(body.rotation)
            )
            _weigh(target, inertial)
            self._joints.add(target, body)
            if body.joint is None and self._options.floating_base:
                target.add_freejoint(name=f"{body.name}_free_joint")
        self._made[body.name] = target
        for member in body.members:
            self._geoms.add(target, member)


def _check_depth(bodies: list[Body], robot: Robot, source: str) -> None:
    depth: dict[str, int] = {}
    for body in bodies:
        depth[body.name] = depth[body.parent] + 1 if body.parent else 0
        if depth[body.name] > MAX_DEPTH:
            raise SceneError(
                source,
                f"is more than {MAX_DEPTH} joints away from the world, which MuJoCo cannot compile",
                element=robot.links[body.name].label,
            )


def _weigh(target: mujoco.MjsBody, inertial: Inertial | None) -> None:
    """Mass, centre of mass and full tensor (xx, yy, zz, xy, xz, yz) of a body."""
    target.explicitinertial = True
    if inertial is None:
        target.mass, target.inertia = 0.0, (0.0, 0.0, 0.0)
        return
    tensor = inertial.tensor
    target.mass, target.ipos = inertial.mass, inertial.com
    target.fullinertia = (
        tensor[0, 0], tensor[1, 1], tensor[2, 2], tensor[0, 1], tensor[0, 2], tensor[1, 2]
    )  # fmt: skip


def _lumped(bodies: list[Body]) -> list[str]:
    names = [m.link.name for body in bodies for m in body.members[1 if body.parent else 0 :]]
    names = [name for name in names if name != WORLD]
    if not names:
        return []
    shown = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
    return [
        f"links on fixed joints are part of the bodies they are fixed to: {shown}; "
        "'x.urdf?lump_fixed=false' keeps them (in Python lump_fixed=False)"
    ]
