"""Kinematic trees rooted in the world."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence

from orbisim.scene.usd.bodies import Bodies, Body
from orbisim.scene.usd.chains import Element, elements, measure, reached
from orbisim.scene.usd.context import Context
from orbisim.scene.usd.flat import ancestors
from orbisim.scene.usd.graph import Edge, Graph, Node, span
from orbisim.scene.usd.joints import BALL, Joint
from orbisim.scene.usd.pose import Pose, angle_of

_OFFSET = 1e-4  # m by which an authored pose may violate its joint and still count as rounding
_TWIST = 1e-3  # rad


@dataclasses.dataclass(frozen=True)
class Link:
    """A body's place in a tree.

    Attributes:
      body: the body.
      parent: path of the parent body, or None for the world.
      pose: relative to the parent at the reference coordinates.
      chain: its joints, outermost first.
      joints: the joint prims that the chain is made of.
      floats: whether it is free.
      mocap: whether it is moved from outside.
    """

    body: Body
    parent: Node
    pose: Pose
    chain: tuple[Element, ...] = ()
    joints: tuple[Joint, ...] = ()
    floats: bool = False
    mocap: bool = False


@dataclasses.dataclass(frozen=True)
class Forest:
    """All bodies as trees.

    Attributes:
      links: parents before children, in the stage's order.
      loops: joints that are not part of a tree.
    """

    links: tuple[Link, ...]
    loops: tuple[Joint, ...]


def grow(context: Context, bodies: Bodies, joints: Sequence[Joint]) -> Forest:
    """Arranges the bodies in trees."""
    graph = span(context, bodies, joints)
    links = _walk(context, bodies, graph)
    _report_misfits(context)
    return Forest(tuple(links), graph.loops)


def _walk(context: Context, bodies: Bodies, graph: Graph) -> list[Link]:
    """The links, depth first, siblings in the stage's order."""
    order = {path: i for i, path in enumerate(bodies.all)}
    links: list[Link] = []
    stack: list[tuple[Node, str, Edge | None]] = []

    def push(parent: Node, children: Iterable[tuple[Node, Edge | None]]) -> None:
        named = [(child, edge) for child, edge in children if child is not None]
        named.sort(key=lambda child: -order[child[0]])
        stack.extend((parent, child, edge) for child, edge in named)

    push(None, [*graph.neighbours.get(None, ()), *((root, None) for root in graph.roots)])
    while stack:
        parent, child, edge = stack.pop()
        links.append(_link(context, bodies, parent, child, edge))
        push(child, [pair for pair in graph.neighbours.get(child, ()) if pair[0] != parent])
    return links


def _link(context: Context, bodies: Bodies, parent: Node, child: str, edge: Edge | None) -> Link:
    body = bodies.all[child]
    authored = bodies.pose_in(child, bodies.all[parent] if parent is not None else None)
    if edge is None:
        return Link(body, parent, authored, floats=not body.kinematic, mocap=body.kinematic)
    if len(edge.joints) > 1:
        chain = [
            element
            for joint in edge.joints
            for element in _stacked(context, joint, authored, child)
        ]
        return Link(body, parent, authored, tuple(chain), edge.joints)
    pose, chain = _attach(context, edge.joints[0], authored, child)
    return Link(body, parent, pose, tuple(chain), edge.joints)


def _stacked(context: Context, joint: Joint, authored: Pose, child: str) -> list[Element]:
    """A joint of several; all are at zero in the authored pose."""
    reverse = joint.body0 == child
    measured = measure(joint, authored.inverse() if reverse else authored)
    if measured.offset > _OFFSET or measured.twist > _TWIST or any(measured.coordinates):
        context.warn("taken to be at zero in the authored pose of its bodies", joint.path)
    rest = measure(joint, joint.frame0 @ joint.frame1.inverse())
    return elements(joint, rest, reverse=reverse)


def _attach(
    context: Context, joint: Joint, authored: Pose, child: str
) -> tuple[Pose, list[Element]]:
    """The child's pose relative to its parent, and its joints.

    The authored pose stands as long as the joint allows it.
    """
    reverse = joint.body0 == child
    measured = measure(joint, authored.inverse() if reverse else authored)
    limited_ball = any(dof.kind == BALL and dof.range for dof in joint.dofs)
    turned = limited_ball and angle_of(measured.turn) > _TWIST
    pose = authored
    if measured.offset > _OFFSET or measured.twist > _TWIST:
        context.misfits.append((joint.path, measured.offset, measured.twist))
        pose = _oriented(reached(joint, measured, with_ball=not turned), reverse)
    elif turned:
        pose = _oriented(reached(joint, measured, with_ball=False), reverse)
    chain = elements(joint, measured, reverse=reverse)
    if not turned:
        chain = [dataclasses.replace(element, start=None) for element in chain]
    return pose, chain


def _report_misfits(context: Context) -> None:
    if not context.misfits:
        return
    offset = max(offset for _, offset, _ in context.misfits)
    twist = max(twist for _, _, twist in context.misfits)
    for path, _, _ in context.misfits:
        context.warn(
            f"the authored poses of its bodies miss the joint (by up to {offset:.3g} m and "
            f"{twist:.3g} rad); the bodies are moved to fit",
            path,
        )


def _oriented(between: Pose, reverse: bool) -> Pose:
    return between.inverse() if reverse else between


def articulation_of(context: Context, path: str) -> str | None:
    """The prim that marks the articulation of a body: itself or the nearest above, or None."""
    for step in ancestors(path):
        if step in context.prims and context.prims[step].has("PhysicsArticulationRootAPI"):
            return step
    return None
