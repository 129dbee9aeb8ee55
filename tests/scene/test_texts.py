"""JSON that a scene carries."""

from __future__ import annotations

from xml.sax.saxutils import quoteattr

import mujoco
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orbisim import load_scene
from orbisim.effects import EffectInstance, add_effects
from orbisim.errors import SceneError
from orbisim.scene.texts import acts_between_timesteps, check_texts, read_text, replace_text

JSON = st.recursive(
    st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=4,
)


@given(JSON)
def test_what_is_written_is_read(data: object) -> None:
    spec = mujoco.MjSpec()
    replace_text(spec, "orbisim:test", data)
    assert read_text(spec.compile(), "orbisim:test") == data


def test_a_text_is_replaced_and_removed() -> None:
    spec = mujoco.MjSpec()
    spec.add_text(name="other", data="kept")
    for data in ([1], [2]):
        replace_text(spec, "orbisim:test", data)
    assert len(spec.texts) == 2
    assert read_text(spec.compile(), "orbisim:test") == [2]
    replace_text(spec, "orbisim:test", None)
    assert [text.name for text in spec.texts] == ["other"]
    assert read_text(spec.compile(), "orbisim:test") is None


@pytest.mark.parametrize("data", ["{", "null", "nul"])
def test_what_is_not_json_is_said(data: str) -> None:
    spec = mujoco.MjSpec()
    spec.add_text(name="orbisim:test", data=data)
    with pytest.raises(ValueError, match=r"Expecting|null"):
        read_text(spec.compile(), "orbisim:test")


PLAIN = "<mujoco><worldbody><body name='b'><joint/><geom size='1'/></body></worldbody></mujoco>"


def test_what_acts_between_timesteps() -> None:
    scene = load_scene(PLAIN)
    assert not acts_between_timesteps(scene.model)
    drag = EffectInstance("linear_drag", "b", {"coefficient": 1.0})
    assert acts_between_timesteps(add_effects(scene, [drag]).model)
    spec = scene.spec
    replace_text(spec, "orbisim:hidden", ["j"])
    assert not acts_between_timesteps(spec.compile())


def test_what_we_carry_is_checked_by_those_who_know_it() -> None:
    spec = load_scene(PLAIN).spec
    replace_text(spec, "orbisim:effects", [{"effect": "no_such"}])
    with pytest.raises(SceneError, match=r"there: .*not an effect"):
        check_texts(spec.compile(), "there")
    check_texts(load_scene(PLAIN).model, "there")


CARRYING = """
<mujoco>
  <worldbody><body name="b"><joint name="j"/><geom size="0.1"/></body></worldbody>
  <sensor><jointpos name="s" joint="j"/></sensor>
  <custom><text name="orbisim:effects" data={}/></custom>
</mujoco>
"""
_HUGE = "1" + "0" * 400


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[" * 100_000, "nested too deeply"),
        ('{"a":' * 100_000, "nested too deeply"),
        ('[{"effect": "sensor_bias", "target": "s", "parameters": {}}]', "lacks offset"),
        ('[{"effect": "sensor_delay", "target": "j", "parameters": {"x": 1}}]', "unknown param"),
        ('[{"effect": "periodic_disturbance", "target": "b", "parameters": {}}]', "lacks ampl"),
        (
            f'[{{"effect": "backlash", "target": "j", "parameters": {{"width": {_HUGE}}}}}]',
            "not an effect",
        ),
    ],
)
def test_effects_that_are_none(text: str, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        load_scene(CARRYING.format(quoteattr(text)))
