"""Which links become which bodies."""

from __future__ import annotations

import dataclasses

import numpy as np

from orbisim.scene.urdf.model import WORLD, Array, Joint, Link, Robot


@dataclasses.dataclass(frozen=True, eq=False)
class Member:
    """A link and its frame in the body that it is part of."""

    link: Link
    pos: Array
    rotation: Array


@dataclasses.dataclass(frozen=True, eq=False)
class Body:
    """Rigidly connected links.

    Attributes:
      name: of the first link, or `world`.
      parent: name of the body that it hangs on; None for the world itself.
      joint: that connects it; None for the root.
      pos, rotation: frame in the parent body, all joints at zero.
      members: the links, the first with the body's own frame.
      moves: whether a joint between it and the world moves.
    """

    name: str
    parent: str | None
    joint: Joint | None
    pos: Array
    rotation: Array
    members: list[Member]
    moves: bool


def assemble(robot: Robot, *, lump: bool, floating: bool) -> list[Body]:
    """The bodies of a robot, parents before children, in the order of MuJoCo's import.

    Args:
      lump: make links on fixed joints part of their parents (and a root that does not float part
        of the world).
      floating: the root moves.
    """
    origin, upright = np.zeros(3), np.eye(3)
    world = Body(WORLD, None, None, origin, upright, [], False)
    bodies = {WORLD: world}
    children = robot.children()
    root = Member(robot.links[robot.root], origin, upright)
    if robot.root == WORLD or (lump and not floating):
        home = world
        world.members.append(root)
    else:
        home = Body(robot.root, WORLD, None, origin, upright, [root], floating)
    waiting = [(root, home)]
    while waiting:
        member, body = waiting.pop()
        bodies.setdefault(body.name, body)
        waiting += reversed(
            [_place(robot, joint, member, body, lump) for joint in children[member.link.name]]
        )
    return _depth_first(list(bodies.values()))


def _place(
    robot: Robot, joint: Joint, member: Member, body: Body, lump: bool
) -> tuple[Member, Body]:
    """The child of a joint, and the body that it is part of: its parent's or one of its own."""
    link = robot.links[joint.child]
    pos = member.pos + member.rotation @ joint.pos
    rotation = member.rotation @ joint.rotation
    if lump and joint.type == "fixed":
        child = Member(link, pos, rotation)
        body.members.append(child)
        return child, body
    child = Member(link, np.zeros(3), np.eye(3))
    moves = body.moves or joint.type != "fixed"
    return child, Body(link.name, body.name, joint, pos, rotation, [child], moves)


def _depth_first(bodies: list[Body]) -> list[Body]:
    below: dict[str, list[Body]] = {}
    for body in bodies[1:]:
        below.setdefault(body.parent or WORLD, []).append(body)
    ordered, waiting = [], [bodies[0]]
    while waiting:
        body = waiting.pop()
        ordered.append(body)
        waiting += reversed(below.get(body.name, []))
    return ordered
