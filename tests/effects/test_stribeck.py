"""Static friction is what exceeds the Coulomb level."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from orbisim import load_scene
from orbisim.effects import find

MODEL = load_scene(
    """
<mujoco><worldbody><body><joint name="hinge"/><geom size=".1"/></body></worldbody></mujoco>
"""
).model
LEVEL = st.floats(0, 100)


@given(coulomb=LEVEL, static=LEVEL, velocity=st.floats(1e-3, 10))
def test_values_there_and_back(coulomb: float, static: float, velocity: float) -> None:
    effect = find("stribeck_friction")
    values = {"coulomb": coulomb, "static": static, "velocity": velocity}
    free = effect.encode(MODEL, "hinge", values)
    assert tuple(free) == effect.free_parameters(MODEL, "hinge")
    again = effect.complete(MODEL, "hinge", free)
    assert again["static"] == pytest.approx(max(static, coulomb))
    assert (again["coulomb"], again["velocity"]) == (coulomb, velocity)


def test_a_fit_cannot_make_it_less() -> None:
    effect = find("stribeck_friction")
    found = effect.complete(MODEL, "hinge", {"coulomb": 2.0, "excess": -1.0, "velocity": 0.1})
    assert found["static"] == 2.0
