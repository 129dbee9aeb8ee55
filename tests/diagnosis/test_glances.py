"""Where fits of more general effects begin."""

import mujoco
import numpy as np
import pytest

import orbisim
from orbisim.diagnosis.glances import _scaled
from orbisim.effects import EffectInstance, add_effects, find

HAMMER = """
<mujoco model="hammer">
  <worldbody>
    <body name="head" pos="0 0 0.1">
      <joint name="slide" type="slide" axis="0 0 1" damping="3"/>
      <geom name="head" type="sphere" size="0.05" mass="0.5"/>
    </body>
  </worldbody>
  <actuator><motor name="lift" joint="slide" gear="10"/></actuator>
</mujoco>
"""
BIAS = EffectInstance("torque_bias", "lift", {"offset": 0.06})


@pytest.fixture(scope="module")
def hammer() -> orbisim.Scene:
    """A mass on a rail that a motor lifts."""
    return orbisim.load_scene(HAMMER)


def test_stribeck_friction_can_begin_at_coulomb_friction(hammer: orbisim.Scene) -> None:
    stribeck, model = find("stribeck_friction"), hammer.model
    values = {"coulomb": 5.0, "static": 9.0, "velocity": 0.3}
    coulomb = EffectInstance("coulomb_friction", "slide", {"torque": 2.0})
    (found,) = stribeck.generalized(model, coulomb, values)
    assert found["coulomb"] == 2.0 and found["velocity"] == 0.3
    assert 2.0 < found["static"] < 3.0
    assert stribeck.generalized(model, BIAS, values) == []
    assert stribeck.generalized(model, coulomb) == []  # its velocity is not known
    assert find("torque_bias").generalized(model, coulomb, {"offset": 1.0}) == []


def test_a_payload_can_begin_at_an_offset_of_the_centre_of_mass(hammer: orbisim.Scene) -> None:
    """Each has the same centre of mass as the body with the offset."""
    parts = {"x": 0.01, "y": -0.02, "z": 0.005}
    offset = EffectInstance("com_offset", "head", {"offset": 0.0229, **parts})
    moved = add_effects(hammer, [offset]).model
    found = find("payload").generalized(hammer.model, offset)
    assert len(found) == 4
    for values in found:
        model = add_effects(hammer, [EffectInstance("payload", "head", values)]).model
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        head = model.body("head").id
        place = data.subtree_com[head] - data.xpos[head]
        np.testing.assert_allclose(place, moved.body("head").ipos, atol=1e-9)
    assert find("payload").generalized(hammer.model, BIAS) == []
    heavy = EffectInstance("payload", offset.target, dict(found[0]))
    (back,) = find("com_offset").generalized(hammer.model, heavy)
    assert back == pytest.approx(offset.values, rel=1e-3)
    assert find("com_offset").generalized(hammer.model, BIAS) == []


def test_an_effect_is_scaled_by_what_it_changes(hammer: orbisim.Scene) -> None:
    """Twice as much more friction than declared, not twice the friction; a load is more mass."""
    declared = find("sliding_friction").parameters(hammer.model, "head")[0].neutral
    slippery = EffectInstance("sliding_friction", "head", {"coefficient": declared - 0.2})
    twice = _scaled(hammer, slippery, 2.0)
    assert twice is not None
    assert twice.values["coefficient"] == pytest.approx(declared - 0.4)
    (load,) = [
        EffectInstance("payload", "head", dict(v))
        for v in find("payload").trials(hammer.model, "head")[:1]
    ]
    heavier = _scaled(hammer, load, 2.0)
    assert heavier is not None and heavier.values["mass"] == pytest.approx(2 * load.values["mass"])
