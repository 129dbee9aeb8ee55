"""Which effects look alike, and what tells them apart."""

import pytest

from orbisim.effects import effect_names
from orbisim.effects.confounds import advice, standing


@pytest.mark.parametrize("name", effect_names())
def test_every_name_is_in_the_catalogue_and_advice_goes_both_ways(name: str) -> None:
    for other, text in standing(name):
        assert other in effect_names()
        assert advice(name, other) == advice(other, name) == text


def test_two_of_the_same_are_told_apart_by_motion_of_each() -> None:
    assert advice("payload", "payload") == "record motion of each of the two alone"
    assert advice("magnus", "armature") is None
