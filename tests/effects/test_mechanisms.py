"""Latches hold until they are released; detents draw to their places."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

from orbisim import Scene, load_scene, make_backend
from orbisim.effects import EffectInstance, add_effects, effect_names, find
from orbisim.errors import InputError, UnknownNameError

from .motion import random_motion

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


class _Pulled:
    """A leaf that is pulled at all times; it moves where the handle is turned, or it is open."""

    def __init__(self) -> None:
        self.model = mujoco.MjModel.from_xml_string(GATE.partition("<actuator>")[0] + "</mujoco>")
        turned = np.tile(np.repeat([0.0, 0.7, 0.0], 100), 2)
        play = 0.02 * np.sin(np.arange(100))
        q = np.tile(np.concatenate([play, np.linspace(0, 1, 100), np.ones(100)]), 2)
        v = np.tile(np.repeat([0.0, 1.0, 0.0], 100), 2)
        n = len(q)
        self.qpos = np.tile(np.stack([q, turned], axis=1), (2, 1))
        self.qvel = np.tile(np.stack([v, np.zeros(n)], axis=1), (2, 1))
        self.time = np.concatenate([0.01 * np.arange(n), 0.01 * np.arange(n) + 0.01])
        self.velocity_noise = np.full(2, 1e-3)
        self.missing_force = np.zeros((n, 2))
        self.missing_force[(np.abs(q) < 0.5) & (turned == 0), 0] = -2.0


def test_a_latch_is_seen_where_a_pulled_joint_stands() -> None:
    view: Any = _Pulled()
    latch = find("latch")
    catch, lock = latch.screen(view, "hinge")
    values = catch.solve(np.ones(1))
    assert not catch.options and values is not None
    assert values["force"] == pytest.approx(2.0)
    assert abs(values["position"]) < 0.01 and 0.015 < values["width"] < 0.03
    released = lock.solve(np.ones(1))
    assert lock.options == {"other": "handle", "side": "above"} and released is not None
    assert 0.0 < released["threshold"] < 0.7 and released["force"] > 2.0
    assert latch.screen(view, "handle") == []


def test_clicks_are_found_as_cogging() -> None:
    """A diagnosis has one name for a wave along the travel, whatever makes it."""
    free = random_motion(
        mujoco.MjModel.from_xml_string(GATE.partition("<actuator>")[0] + "</mujoco>")
    )
    assert find("cogging").screen(free, "hinge") and not find("detent").screen(free, "hinge")
    assert "detent" not in effect_names() and "latch" in effect_names()


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
