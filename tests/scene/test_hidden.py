"""Joints that no encoder reads."""

from __future__ import annotations

import mujoco
import pytest

from orbisim.scene.hidden import TEXT_NAME, hidden_joints, hide_joint


def document(*joints: str) -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    for name in joints:
        body = spec.worldbody.add_body()
        body.add_joint(name=name)
        body.add_geom(size=[1, 0, 0])
    return spec


def test_hidden_joints_are_remembered_in_order() -> None:
    spec = document("a", "b", "c")
    assert hidden_joints(spec.compile()) == ()
    hide_joint(spec, "c")
    hide_joint(spec, "a")
    assert hidden_joints(spec.compile()) == ("c", "a")
    assert len(spec.texts) == 1


def test_joints_that_are_gone_are_not_hidden() -> None:
    spec = document("a")
    hide_joint(spec, "a")
    hide_joint(spec, "gone")
    assert hidden_joints(spec.compile()) == ("a",)


@pytest.mark.parametrize("data", ["no json", "null", '{"a": 1}', '"a"', "[1, [2]]"])
def test_what_cannot_be_read_hides_nothing(data: str) -> None:
    spec = document("a")
    spec.add_text(name=TEXT_NAME, data=data)
    assert hidden_joints(spec.compile()) == ()
    hide_joint(spec, "a")
    assert hidden_joints(spec.compile()) == ("a",)
