"""Transmissions."""

from __future__ import annotations

import pytest

from orbisim.scene.safety.xmlsafe import parse
from orbisim.scene.urdf.transmissions import read_transmissions

RATIO = "<mechanicalReduction>{}</mechanicalReduction>"


def read(*content: str):  # type: ignore[no-untyped-def]
    root = parse(f"<robot><transmission name='t'>{''.join(content)}</transmission></robot>", "s")
    return read_transmissions(root, {"j": None, "k": None})  # type: ignore[dict-item]


@pytest.mark.parametrize(
    ("content", "reduction"),
    [
        (["<joint name='j'/>", f"<actuator name='m'>{RATIO.format(50)}</actuator>"], 50.0),
        ([f"<joint name='j'>{RATIO.format(-2)}</joint>", "<actuator name='m'/>"], -2.0),
        (["<joint name='j'/>", "<actuator name='m'/>", RATIO.format(7)], 7.0),
        (["<joint name='j'/>", "<actuator name='m'/>"], 1.0),
    ],
)
def test_where_a_reduction_stands(content: list[str], reduction: float) -> None:
    (one,), idle = read(*content)
    assert (one.joint, one.actuator, one.reduction) == ("j", "m", reduction)
    assert idle == ()


def test_without_a_name_it_is_the_joints() -> None:
    (one,), _ = read("<joint name='k'/>")
    assert one.actuator == "k"


@pytest.mark.parametrize("ratio", ["0", "fast", "1 2", "nan"])
def test_what_drives_nothing_is_listed(ratio: str) -> None:
    found, (idle,) = read(f"<joint name='j'>{RATIO.format(ratio)}</joint>")
    assert found == ()
    assert "is not a number other than zero" in idle.feature
    found, (idle,) = read("<joint name='gone'/>")
    assert found == ()
    assert "drives 'gone', which is not a joint" in idle.feature
