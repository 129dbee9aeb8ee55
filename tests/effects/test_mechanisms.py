"""Latches hold until they are released; detents draw to their places."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from orbisim import Scene, load_scene, make_backend
from orbisim.effects import EffectInstance, add_effects, effect_names, find
from orbisim.effects.mechanisms import MECHANISMS
from orbisim.errors import InputError, UnknownNameError

GATE = """
<mujoco>
  <option timestep="0.002" gravity="0 0 0" integrator="implicitfast"/>
  <worldbody>
    <body name="leaf">
      <joint name="hinge" axis="0 0 1" damping="0.05" frictionloss="0.01"
        solreffriction="0.004 1" solimpfriction="0.9999 0.9999 0.001 0.5 2"/>
      <geom type="box" size="0.2 0.01 0.2" pos="0.2 0 0" mass="2"/>
      <body name="lever" pos="0.35 -0.02 0">
        <joint name="handle" axis="0 1 0" damping="0.01" frictionloss="0.01"/>
        <geom type="capsule" fromto="0 0 0 0.1 0 0" size="0.01" mass="0.1"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="pull" joint="hinge"/>
    <position name="turn" joint="handle" kp="5" kv="0.3"/>
  </actuator>
</mujoco>
"""
LOCK = {"force": 50.0, "position": 0.0, "width": 0.02, "threshold": 0.4}
CLOSED, TURNED = np.array([1.0, 0.0]), np.array([1.0, 0.7])


def gate(side: str = "above", **changes: float) -> Scene:
    values, options = {**LOCK, **changes}, {"other": "handle", "side": side}
    return add_effects(load_scene(GATE), [EffectInstance("latch", "hinge", values, options)])


def after(scene: Scene, control: Any, steps: int = 400, backend: str = "mujoco") -> np.ndarray:
    """Positions of hinge and handle."""
    engine = make_backend(backend, scene)
    return np.asarray(engine.step(engine.reset(), control, steps).numpy().qpos[0])


def test_a_latch_holds_until_it_is_released() -> None:
    assert abs(after(gate(), CLOSED)[0]) < 1e-4
    hinge, handle = after(gate(), TURNED)
    assert handle > LOCK["threshold"] and hinge > 0.5


def test_the_side_that_releases() -> None:
    assert after(gate("below", threshold=-0.4), TURNED)[0] < 1e-4
    assert after(gate("below", threshold=-0.4), TURNED * [1, -1])[0] > 0.5


def test_a_catch_gives_way_to_force() -> None:
    weak = EffectInstance("latch", "hinge", {**LOCK, "force": 0.5})
    held = EffectInstance("latch", "hinge", {**LOCK, "force": 2.0})
    assert after(add_effects(load_scene(GATE), [weak]), CLOSED)[0] > 0.5
    assert abs(after(add_effects(load_scene(GATE), [held]), CLOSED)[0]) < 1e-4


def test_a_leaf_that_has_left_is_not_held() -> None:
    engine = make_backend("mujoco", gate())
    state = engine.reset().replace(qpos=np.array([[0.3, 0.0]]))
    assert engine.step(state, CLOSED, 200).qpos[0, 0] > 0.5


def test_a_state_is_all_there_is_to_know() -> None:
    scene = gate()
    engine, other = make_backend("mujoco", scene), make_backend("mujoco", scene)
    middle = engine.step(engine.reset(), TURNED, 60)
    straight = engine.step(middle, TURNED, 100)
    np.testing.assert_array_equal(other.step(middle, TURNED, 100).qpos, straight.qpos)
    np.testing.assert_array_equal(engine.step(middle, TURNED, 100).qpos, straight.qpos)


def test_warp_has_the_same_latch() -> None:
    pytest.importorskip("mujoco_warp")
    assert abs(after(gate(), CLOSED, 50, "warp")[0]) < 1e-4
    ends = [after(gate(), TURNED, 150, backend) for backend in ("mujoco", "warp")]
    np.testing.assert_allclose(ends[0], ends[1], atol=2e-3)


def test_detents_draw_to_their_places() -> None:
    values = {"amplitude": 0.2, "pitch": 0.5, "position": 0.1}
    scene = add_effects(load_scene(GATE), [EffectInstance("detent", "hinge", values)])
    engine = make_backend("mujoco", scene)
    for start, place in ((0.3, 0.1), (0.45, 0.6), (-0.3, -0.4)):
        state = engine.reset().replace(qpos=np.array([[start, 0.0]]))
        assert engine.step(state, np.zeros(2), 4000).qpos[0, 0] == pytest.approx(place, abs=0.01)


@pytest.mark.parametrize("effect", [one.name for one in MECHANISMS])
def test_no_diagnosis_looks_for_them(effect: str) -> None:
    assert effect not in effect_names()
    assert find(effect).name == effect


@pytest.mark.parametrize(
    ("options", "error", "match"),
    [
        ({"other": "knob"}, UnknownNameError, "knob"),
        ({"other": "handle", "side": "left"}, UnknownNameError, "left"),
        ({"by": "handle"}, UnknownNameError, "by"),
        ({"other": "free"}, InputError, "hinge or a slide"),
    ],
)
def test_options_that_are_none(options: dict[str, str], error: type[Exception], match: str) -> None:
    ball = GATE.replace(
        "</worldbody>",
        '<body name="ball"><freejoint name="free"/><geom size="0.1"/></body></worldbody>',
    )
    with pytest.raises(error, match=match):
        add_effects(load_scene(ball), [EffectInstance("latch", "hinge", LOCK, options)])
