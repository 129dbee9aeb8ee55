"""Scenes that are declared a little wrongly."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np

WRONG = ("mass", "damping", "gains")


def alter(text: str, what: str, rng: np.random.Generator) -> tuple[str, dict[str, float]]:
    """A scene's MJCF with masses, damping or gains that are off by 2 to 5 %, up or down.

    Returns:
      The document, and declared over true value by element; empty if there is nothing to alter.
    """
    root = ElementTree.fromstring(text)
    factors: dict[str, float] = {}
    parents = {child: parent for parent in root.iter() for child in parent}
    for number, element in enumerate(root.iter()):
        names = _attributes(element, what)
        if not names:
            continue
        factor = float(1 + rng.choice([-1, 1]) * rng.uniform(0.02, 0.05))
        for name in names:
            numbers = [float(x) * factor for x in element.get(name, "1").split()]
            element.set(name, " ".join(f"{x:.10g}" for x in numbers))
        owner = element.get("name") or f"{parents[element].tag}/{element.tag}{number}"
        factors[f"{what}:{owner}"] = factor
    return ElementTree.tostring(root, encoding="unicode"), factors


def _attributes(element: ElementTree.Element, what: str) -> list[str]:
    """Attributes of an element that hold what is to be altered."""
    if what == "mass" and element.tag == "geom" and float(element.get("mass", "0")) > 0:
        return ["mass"]
    if what == "damping" and element.tag == "joint" and "damping" in element.attrib:
        return ["damping"]
    if what == "gains" and element.tag == "motor":
        return ["gear"]
    if what == "gains" and element.tag == "position":
        return ["kp", "kv"]
    return []
