"""`<transmission>` elements, which yourdfpy does not read."""

from __future__ import annotations

from collections.abc import Mapping

from orbisim.scene.reading import Unsupported
from orbisim.scene.safety.xmlsafe import Node
from orbisim.scene.urdf.grammar import finite_numbers
from orbisim.scene.urdf.model import Joint, Transmission


def read_transmissions(
    root: Node, joints: Mapping[str, Joint]
) -> tuple[tuple[Transmission, ...], tuple[Unsupported, ...]]:
    """One entry for each joint of each transmission, and those that cannot be used.

    A reduction stands in the actuator (ROS since Indigo), in the joint, or in the transmission
    itself (PR2); where there is none it is 1.
    """
    found: list[Transmission] = []
    idle: list[Unsupported] = []
    for node in root.children("transmission"):
        actuators = node.children("actuator")
        for index, joint in enumerate(node.children("joint")):
            name = joint.get("name", "")
            actuator = actuators[min(index, len(actuators) - 1)] if actuators else None
            text = _reduction((actuator, joint, node))
            numbers = finite_numbers(text) or ()
            if name not in joints:
                feature = f"drives {name!r}, which is not a joint of the robot"
            elif len(numbers) != 1 or numbers[0] == 0.0:
                feature = f"mechanicalReduction={text[:60]!r} is not a number other than zero"
            else:
                label = (actuator.get("name") if actuator is not None else None) or name
                found.append(Transmission(node.label(), name, label, numbers[0]))
                continue
            idle.append(Unsupported(node.label(), feature, "no actuator is made"))
    return tuple(found), tuple(idle)


def _reduction(places: tuple[Node | None, ...]) -> str:
    for place in places:
        element = place.child("mechanicalReduction") if place is not None else None
        text = (element.text or "").strip() if element is not None else ""
        if text:
            return text
    return "1"
