"""Who is named in a message."""

from __future__ import annotations

import numpy as np

from orbisim import load_scene, make_backend
from orbisim.agreement.blame import blame
from tests.agreement.engines import FALLING, STAND


def test_the_contact_that_pushes_most() -> None:
    scene = load_scene(STAND)
    found = blame(scene.model, make_backend("mujoco", scene).reset(), np.zeros((1, 0)), 1)
    assert (found.joint, found.unit, found.deep) == ("joint 'shoulder'", "rad/s", True)
    assert "overlap by 30 mm" in found.text


def test_contacts_of_other_trees_are_not_named() -> None:
    scene = load_scene(FALLING)
    state = make_backend("mujoco", scene).reset()
    hinge = int(scene.model.joint("hinge").dofadr[0])
    free = int(scene.model.joint("free").dofadr[0])
    assert not blame(scene.model, state, np.zeros((1, 0)), hinge).text
    resting = blame(scene.model, state, np.zeros((1, 0)), free + 2)
    assert (resting.unit, resting.deep) == ("m/s", False)
    assert "'floor'" in resting.text


def test_elements_without_names() -> None:
    scene = load_scene("""
        <mujoco><worldbody><geom type="plane" size="1 1 1"/><body pos="0 0 .09"><freejoint/>
        <geom size=".1"/></body></worldbody></mujoco>""")
    found = blame(scene.model, make_backend("mujoco", scene).reset(), np.zeros((1, 0)), 2)
    assert found.joint == "joint 'joint0'"
    assert "'geom0'" in found.text
