"""What is replaced in the suite, and only there."""

from __future__ import annotations

from typing import Any

from dm_control.suite import cheetah, quadruped

from orbisim.vector.overrides import PHYSICS_METHODS, methods_for


class Own(quadruped.Physics):
    def torso_upright(self) -> Any:
        return 1.0


class Further(quadruped.Physics):
    pass


def test_methods_of_classes() -> None:
    assert methods_for(quadruped.Physics) == PHYSICS_METHODS[quadruped.Physics]
    assert methods_for(Further) == PHYSICS_METHODS[quadruped.Physics]
    assert methods_for(Own).keys() == {"origin_distance"}, "a user's method is the user's"
    assert not methods_for(cheetah.Physics)


def test_replaced_methods_exist() -> None:
    for cls, methods in PHYSICS_METHODS.items():
        assert methods.keys() <= vars(cls).keys()
