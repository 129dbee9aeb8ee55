"""The graph of bodies and joints, and a spanning forest of it.

The forest is chosen so that the joints which only a tree can carry (those with limits, drives,
or freedom that no equality constraint expresses) are in it. The other joints close loops.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence

from orbisim.scene.usd.bodies import Bodies, Body
from orbisim.scene.usd.context import Context
from orbisim.scene.usd.joints import BALL, HINGE, Joint

Node = str | None
"""Path of a body, or None for the world."""


@dataclasses.dataclass(frozen=True)
class Edge:
    """One joint, or several that are stacked, between two nodes."""

    ends: tuple[Node, Node]
    joints: tuple[Joint, ...]

    @property
    def rank(self) -> int:
        """Smaller ranks are kept in trees before larger ones."""
        if not all(joint.in_tree for joint in self.joints):
            return 10
        dofs = [dof for joint in self.joints for dof in joint.dofs]
        if any(joint.is_driven for joint in self.joints) or len(dofs) > 1:
            return 0
        if not dofs:
            return 1
        return {HINGE: 2, BALL: 3}.get(dofs[0].kind, 0)


@dataclasses.dataclass(frozen=True)
class Graph:
    """A spanning forest.

    Attributes:
      neighbours: for each node the nodes that an edge of the forest leads to.
      roots: bodies that no joint ties to the world: those moved from outside, and one for each
        tree that floats.
      loops: joints that are not in the forest.
    """

    neighbours: Mapping[Node, Sequence[tuple[Node, Edge]]]
    roots: tuple[str, ...]
    loops: tuple[Joint, ...]


def span(context: Context, bodies: Bodies, joints: Sequence[Joint]) -> Graph:
    """Finds a spanning forest."""
    for prim in context.with_schema("PhysicsArticulationRootAPI"):
        prim.use("newton:jointsAddMobility")
    held = [joint for joint in joints if not joint.free and joint.distance is None]
    edges = _without_idle(context, bodies, _edges(context, held))
    moved = _moved_from_outside(bodies, edges)
    kept, cut = _kruskal(bodies, moved, edges)
    neighbours = _neighbours(kept)
    roots = (*moved, *_floating(context, bodies, moved, kept, neighbours))
    return Graph(neighbours, roots, tuple(joint for edge in cut for joint in edge.joints))


def _edges(context: Context, joints: Iterable[Joint]) -> list[Edge]:
    """One edge a joint; joints that are stacked on one another share an edge."""
    edges: list[Edge] = []
    stacked: dict[tuple[Node, Node], int] = {}
    for joint in joints:
        ends = (joint.body0, joint.body1)
        if ends in stacked and _adds_mobility(context, joint):
            index = stacked[ends]
            edges[index] = Edge(ends, (*edges[index].joints, joint))
            continue
        stacked.setdefault(ends, len(edges))
        edges.append(Edge(ends, (joint,)))
    return edges


def _adds_mobility(context: Context, joint: Joint) -> bool:
    """Whether a further joint between two bodies frees them, as in MuJoCo, or holds them."""
    if joint.prim.has("MjcJointAPI"):
        return True
    body = joint.body1 or joint.body0 or joint.path
    return any(prim.flag("newton:jointsAddMobility", False) for prim in context.lineage(body))


def _without_idle(context: Context, bodies: Bodies, edges: Sequence[Edge]) -> list[Edge]:
    """Drops joints that cannot do anything because both ends are moved from outside."""
    used = []
    for edge in edges:
        ends = [end for end in edge.ends if end is not None]
        passive = all(bodies.all[end].kinematic for end in ends)
        if not passive or _carries(context, edge):
            used.append(edge)
        elif len(ends) == 2 or edge.joints[0].dofs:
            for joint in edge.joints:
                context.omit(joint.path, f"{joint.type_name} between kinematic bodies", "left out")
    return used


def _carries(context: Context, edge: Edge) -> bool:
    """Whether an edge between kinematic bodies places one of them relative to the other."""
    if edge.ends[0] is None or edge.ends[1] is None:
        return False
    return not edge.joints[0].dofs or context.for_mujoco


def _moved_from_outside(bodies: Bodies, edges: Sequence[Edge]) -> list[str]:
    """Kinematic bodies that no other kinematic body carries."""
    kinematic = {path for path, body in bodies.all.items() if body.kinematic}
    carried = {edge.ends[1] for edge in edges if kinematic.issuperset(edge.ends)}
    return [path for path in bodies.all if path in kinematic - carried]


def _kruskal(
    bodies: Bodies, moved: Sequence[str], edges: Sequence[Edge]
) -> tuple[list[Edge], list[Edge]]:
    """Kruskal's algorithm: the edges of a spanning forest, and those that close loops.

    Bodies that are moved from outside count as tied to the world.
    """
    leader: dict[Node, Node] = {None: None, **{path: path for path in bodies.all}}
    leader.update(dict.fromkeys(moved))

    def find(node: Node) -> Node:
        while leader[node] != node:
            leader[node] = leader[leader[node]]
            node = leader[node]
        return node

    kept, cut = [], []
    for edge in sorted(edges, key=lambda edge: edge.rank):
        first, second = (find(end) for end in edge.ends)
        if first == second:
            cut.append(edge)
        else:
            leader[first] = second
            kept.append(edge)
    return kept, cut


def _neighbours(edges: Iterable[Edge]) -> Mapping[Node, list[tuple[Node, Edge]]]:
    found: dict[Node, list[tuple[Node, Edge]]] = {}
    for edge in edges:
        first, second = edge.ends
        found.setdefault(first, []).append((second, edge))
        found.setdefault(second, []).append((first, edge))
    return found


def _floating(
    context: Context,
    bodies: Bodies,
    moved: Sequence[str],
    kept: Sequence[Edge],
    neighbours: Mapping[Node, Sequence[tuple[Node, Edge]]],
) -> list[str]:
    """One body for each tree that no joint ties to the world."""
    seen: set[Node] = set()
    for root in (None, *moved):
        _visit(root, neighbours, seen)
    held = {edge.ends[1] for edge in kept}
    roots = []
    for path in bodies.all:
        if path in seen:
            continue
        members: set[Node] = set()
        _visit(path, neighbours, members)
        seen |= members
        component = [body for body in bodies.all.values() if body.path in members]
        roots.append(min(component, key=lambda body: _rootness(context, body, held)).path)
    return roots


def _rootness(context: Context, body: Body, held: set[Node]) -> int:
    """Smaller for bodies that make better roots."""
    if body.kinematic:
        return 0
    if body.prim.has("PhysicsArticulationRootAPI"):
        return 1
    inside = any(prim.has("PhysicsArticulationRootAPI") for prim in context.lineage(body.path))
    if body.path not in held:
        return 2 if inside else 3
    return 4


def _visit(
    start: Node, neighbours: Mapping[Node, Sequence[tuple[Node, Edge]]], seen: set[Node]
) -> None:
    stack = [start]
    while stack:
        node = stack.pop()
        if node not in seen:
            seen.add(node)
            stack.extend(end for end, _ in neighbours.get(node, ()))
