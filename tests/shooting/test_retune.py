"""Declared parameters times factors."""

import pytest

import orbisim
from orbisim.shooting.retune import Tunable, retuned, tunables

SCENE = """<mujoco><worldbody><body name="link"><joint name="hinge" axis="0 1 0" damping="0.4"/>
<geom name="rod" type="capsule" size=".02 .1" mass="2"/></body></worldbody>
<actuator><position name="servo" joint="hinge" kp="10"/></actuator></mujoco>"""


def test_parameters_that_are_not_zero_can_be_retuned() -> None:
    scene = orbisim.load_scene(SCENE)
    found = {str(one) for one in tunables(scene.model)}
    assert found == {"mass of link", "damping of hinge", "gain of servo"}


def test_each_is_multiplied_alone() -> None:
    scene = orbisim.load_scene(SCENE)
    kept = scene.model
    other = retuned(scene, {Tunable("gain", "servo"): 1.1, Tunable("damping", "hinge"): 0.5}).model
    assert other.actuator_gainprm[0, 0] == pytest.approx(11)
    assert other.actuator_biasprm[0, 1] == pytest.approx(-11)
    assert other.dof_damping[0] == pytest.approx(0.2)
    assert other.body_mass.tolist() == kept.body_mass.tolist()
    assert retuned(scene, {Tunable("mass", "link"): 1.0}) is scene
