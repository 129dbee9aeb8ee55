"""USD: effects in the attribute `orbisim:effects`."""

from __future__ import annotations

from pathlib import Path

import pytest

from orbisim.effects import carried_effects
from orbisim.errors import SceneError
from orbisim.scene import Scene
from tests.scene.usd.usd_text import load

ARM = """
def Xform "arm" (prepend apiSchemas = ["PhysicsRigidBodyAPI"])
{{
    custom string orbisim:effects = '{effects}'
    def Sphere "ball" (prepend apiSchemas = ["PhysicsCollisionAPI"])
    {{
        double radius = 0.1
    }}
    def PhysicsRevoluteJoint "hinge"
    {{
        uniform token physics:axis = "Z"
        rel physics:body1 = </arm>
    }}
}}
"""
DETENT = (
    '[{"effect": "detent", "target": "hinge", '
    '"parameters": {"amplitude": 0.1, "pitch": 0.5, "position": 0}}]'
)


def arm(folder: Path, effects: str) -> Scene:
    return load(folder, ARM.format(effects=effects))


def test_effects_are_carried(tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    [detent] = carried_effects(arm(tmp_path, DETENT).model)
    assert (detent.effect, detent.target, detent.values["pitch"]) == ("detent", "hinge", 0.5)


@pytest.mark.parametrize(
    ("effects", "match"),
    [
        ("{", "/arm.*not JSON"),
        ("{}", "/arm.*expected a list"),
        ("[" * 100_000, "/arm.*not JSON"),
        (DETENT.replace("hinge", "elbow"), "elbow"),
    ],
)
def test_what_is_none(effects: str, match: str, tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    with pytest.raises(SceneError, match=match):
        arm(tmp_path, effects)
