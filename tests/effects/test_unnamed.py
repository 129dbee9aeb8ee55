"""Laws without a name: they can be simulated, and no catalogue lists them."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from orbisim import Scene, load_scene, make_backend
from orbisim.effects import EffectInstance, add_effects, effect_names, find
from orbisim.effects.measurement import measurement_of
from orbisim.effects.unnamed import UNNAMED
from orbisim.errors import SceneError

SWING = """
<mujoco>
  <option timestep="0.002" gravity="0 0 0"/>
  <worldbody>
    <body name="rod">
      <joint name="hinge" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.02" mass="1"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="hinge"/></actuator>
</mujoco>
"""


def scene() -> Scene:
    return load_scene(SWING)


def accelerated(law: str, values: dict[str, float], q: float, v: float, time: float) -> float:
    """Acceleration in the first timestep, rad/s^2, times the inertia."""
    plain = scene()
    changed = add_effects(plain, [EffectInstance(law, "hinge", values)])
    backend = make_backend("mujoco", changed)
    state = backend.reset(1, 0)
    state = state.replace(qpos=np.array([[q]]), qvel=np.array([[v]]), time=np.array([time]))
    after = backend.step(state, np.array([[0.7]]), 1)
    full = np.zeros((1, 1))
    data = mujoco.MjData(plain.model)
    mujoco.mj_forward(plain.model, data)
    mujoco.mj_fullM(plain.model, data, full)
    gained = float(after.qvel[0, 0]) - v
    return gained / float(plain.model.opt.timestep) * float(full[0, 0]) - 0.7


@pytest.mark.parametrize("law", [one.name for one in UNNAMED])
def test_no_catalogue_lists_them(law: str) -> None:
    assert law not in effect_names()
    assert find(law).name == law


def test_a_law_of_position_is_its_polynomial() -> None:
    values = {"c0": 0.1, "c1": -0.5, "c2": 0.3, "c3": -2.0}
    expected = 0.1 - 0.5 * 0.4 + 0.3 * 0.4**2 - 2.0 * 0.4**3
    assert accelerated("law_of_position", values, 0.4, 1.0, 0.0) == pytest.approx(
        expected, rel=1e-6
    )


def test_a_law_of_velocity_is_its_polynomial() -> None:
    values = {"c0": 0.0, "c1": -0.2, "c2": 0.1, "c3": -0.05}
    expected = -0.2 * 1.5 + 0.1 * 1.5**2 - 0.05 * 1.5**3
    assert accelerated("law_of_velocity", values, 0.4, 1.5, 0.0) == pytest.approx(
        expected, rel=1e-6
    )


def test_a_law_of_gain_scales_the_actuator_with_time() -> None:
    values = {"c0": 0.0, "c1": 0.1, "c2": 0.0, "c3": 0.0}
    assert accelerated("law_of_gain", values, 0.0, 0.0, 2.0) == pytest.approx(0.7 * 0.2, rel=1e-6)


def test_what_mujoco_does_not_write_is_a_scene_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise ValueError("inertia must satisfy A + B >= C")

    monkeypatch.setattr(type(find("armature")), "edit", refuse)
    with pytest.raises(SceneError, match=r"armature.*cannot be written.*A \+ B >= C"):
        add_effects(scene(), [EffectInstance("armature", "hinge", {"inertia": 0.1})])


def test_a_law_of_one_side_acts_beyond_its_position_only() -> None:
    values = {"stiffness": 2.0, "damping": 0.3, "position": 0.1, "side": 1.0}
    expected = -2.0 * (0.4 - 0.1) - 0.3 * 1.5
    assert accelerated("law_of_one_side", values, 0.4, 1.5, 0.0) == pytest.approx(
        expected, rel=1e-6
    )
    assert accelerated("law_of_one_side", values, -0.2, 1.5, 0.0) == pytest.approx(0.0, abs=1e-9)
    values["side"] = -1.0
    expected = -2.0 * (-0.2 - 0.1) - 0.3 * 1.5
    assert accelerated("law_of_one_side", values, -0.2, 1.5, 0.0) == pytest.approx(
        expected, rel=1e-6
    )


def test_a_law_of_reading_is_its_waves() -> None:
    """Positions are read too large by them, and velocities by their slope."""
    values = {"offset": 0.02, "cos1": 0.01, "sin1": -0.03, "cos2": 0.005, "sin2": 0.004}
    law = EffectInstance("law_of_reading", "hinge", values)
    q, v = 0.6, 1.5
    truth = np.array([[[q, v]]])
    read = measurement_of(scene().model, [law]).of(np.zeros_like(truth), truth, np.zeros((1, 1)))

    def waves(x: float) -> float:
        once = 0.01 * np.cos(x) - 0.03 * np.sin(x)
        return 0.02 + once + 0.005 * np.cos(2 * x) + 0.004 * np.sin(2 * x)

    slope = (waves(q + 1e-6) - waves(q - 1e-6)) / 2e-6
    assert read[0, 0] == pytest.approx([q + waves(q), v * (1 + slope)], rel=1e-7)


def test_a_law_of_reading_is_of_hinges() -> None:
    slide = load_scene(SWING.replace('axis="0 1 0"', 'axis="0 1 0" type="slide"'))
    assert find("law_of_reading").possible(scene().model, "hinge")
    assert not find("law_of_reading").possible(slide.model, "hinge")
