"""Every registered reader passes the conformance tests."""

from __future__ import annotations

from orbisim.scene.readers import suffixes
from orbisim.testing import ReaderConformance
from tests.scene.urdf import urdf_text
from tests.scene.usd import usd_text

BODIES = usd_text.body("B") + usd_text.joint(
    "PhysicsRevoluteJoint", "j", usd_text.joins(None, "/B", pos1=(0, 0, 0.3))
)


class TestMjcf(ReaderConformance):
    suffix = ".xml"
    joints = ("swing",)
    document = (
        "<mujoco><worldbody><body><joint name='swing' axis='0 1 0'/>"
        "<geom size='.1' fromto='0 0 0 0 0 1' type='capsule'/></body></worldbody></mujoco>"
    )


class TestUrdf(ReaderConformance):
    suffix = ".urdf"
    joints = ("j",)
    document = urdf_text.two_links()


class TestUsd(ReaderConformance):
    suffix = ".usda"
    joints = ("j",)
    document = usd_text.stage(BODIES)


def test_every_suffix_is_tested() -> None:
    tested = {".xml", ".mjcf", ".urdf", ".usd", ".usda", ".usdc", ".usdz"}
    assert tested <= set(suffixes())
