"""Where fits of more general effects begin."""

from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

import orbisim
from orbisim.diagnosis import Settings
from orbisim.diagnosis import glances as module
from orbisim.diagnosis.context import begun
from orbisim.diagnosis.glances import shortlist
from orbisim.diagnosis.suspects import Suspect
from orbisim.effects import EffectInstance, add_effects, find
from orbisim.motion.samples import prepare_all
from orbisim.recording import Recording
from orbisim.shooting.bench import make_bench
from orbisim.shooting.hypothesis import Hypothesis, sized

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
    twice = sized(hammer, slippery, 2.0)
    assert twice is not None
    assert twice.values["coefficient"] == pytest.approx(declared - 0.4)
    (load,) = [
        EffectInstance("payload", "head", dict(v))
        for v in find("payload").trials(hammer.model, "head")[:1]
    ]
    heavier = sized(hammer, load, 2.0)
    assert heavier is not None and heavier.values["mass"] == pytest.approx(2 * load.values["mass"])


TABLE = """
<mujoco model="slide">
  <option timestep="0.002" integrator="implicitfast" cone="elliptic"/>
  <worldbody>
    <geom name="table" type="plane" size="2 2 0.1" priority="1" friction="{friction}"/>
    <body name="block" pos="0 0 0.02">
      <freejoint name="block"/>
      <geom name="block" type="box" size="0.04 0.03 0.02" density="500"/>
    </body>
  </worldbody>
</mujoco>
"""


def slides(friction: float) -> list[Recording]:
    """A block that is set going over a table three times, with 0.1 mm and 0.4 mrad of noise."""
    model = mujoco.MjModel.from_xml_string(TABLE.format(friction=friction))
    rng, found = np.random.default_rng(0), []
    for speed in (0.8, 1.2, 1.6):
        data, heading = mujoco.MjData(model), rng.uniform(-np.pi, np.pi)
        mujoco.mj_step(model, data, 200)  # it settles
        data.qvel[:2] = speed * np.cos(heading), speed * np.sin(heading)
        rows = []
        for _ in range(30):
            rows.append(data.qpos + rng.normal(0.0, [1e-4] * 3 + [2e-4] * 4))
            mujoco.mj_step(model, data, 5)
        found.append(Recording(np.arange(30) * 0.01, {"qpos/block": np.array(rows)}))
    return found


@pytest.mark.parametrize(("true", "low", "high"), [(0.2, 0.15, 0.3), (0.6, 0.42, 0.8)])
def test_friction_is_suspected_on_its_side_of_the_declared(
    true: float, low: float, high: float
) -> None:
    declared = orbisim.load_scene(TABLE.format(friction=0.35))
    bench = make_bench(declared, prepare_all(slides(true), declared), 0.25)
    context = begun(bench, Settings(), lambda _: None)
    nothing = context.judge.judge(Hypothesis())
    assert nothing is not None
    listed = shortlist(context, nothing, context.screen(nothing).suspects)
    levels = [
        one.instance.values["coefficient"]
        for one in listed
        if one.instance.effect == "sliding_friction"
    ]
    assert low < levels[0] < high
    assert all((level < 0.35) == (true < 0.35) for level in levels)


def test_every_effect_is_looked_at_in_another_size(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also one whose first size leaves more than three forms of another do."""
    monkeypatch.setattr(module, "_FIRST", 3)
    again: list[str] = []

    def resized(context: Any, current: Any, glance: Any) -> Any:
        again.append(glance.one.instance.effect)
        return glance

    monkeypatch.setattr(module, "_again", resized)
    forms = [EffectInstance("adhesion", "puck", {"force": 0.1 * k}) for k in (1, 2, 3)]
    forms.append(EffectInstance("sliding_friction", "puck", {"coefficient": 0.9}))
    left = iter(range(len(forms)))
    judge = SimpleNamespace(begin=lambda _: None, sized_glance=lambda *_: (next(left), 1.0))
    context: Any = SimpleNamespace(judge=judge, deadline=SimpleNamespace(left=100.0))
    current: Any = SimpleNamespace(hypothesis=Hypothesis())
    module._resized(context, current, [Suspect(one) for one in forms])
    assert set(again) == {"adhesion", "sliding_friction"}
