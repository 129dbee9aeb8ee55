"""Bodies whose inertia is declared as a full matrix can be edited."""

import numpy as np
import pytest

import orbisim
from orbisim.effects import EffectInstance, add_effects
from orbisim.shooting.retune import retuned, tunables

SCENE = """<mujoco><worldbody><body name="link"><joint name="hinge" axis="0 1 0"/>
<inertial pos="0 0 -.1" mass="2" fullinertia=".03 .025 .02 .001 0 0"/></body>
</worldbody></mujoco>"""


def test_edits_of_a_full_inertia() -> None:
    scene = orbisim.load_scene(SCENE)
    (mass,) = (one for one in tunables(scene.model) if one.kind == "mass")
    heavier = retuned(scene, {mass: 1.5}).model
    assert heavier.body("link").mass[0] == pytest.approx(3.0)
    np.testing.assert_allclose(heavier.body("link").inertia, 1.5 * scene.model.body("link").inertia)
    shift = EffectInstance("com_offset", "link", {"offset": 0.05, "x": 0.0, "y": 0.0, "z": 0.05})
    moved = add_effects(scene, [shift]).model
    np.testing.assert_allclose(moved.body("link").ipos, [0, 0, -0.05], atol=1e-12)
