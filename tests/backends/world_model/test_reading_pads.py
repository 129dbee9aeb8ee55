"""Which boxes of a hand are read, and which not."""

from __future__ import annotations

import mujoco
import numpy as np
from orbisim_world_model.layout import Layout
from orbisim_world_model.reading import read_layout

from tests.backends.world_model.synthetic import PUSHER


def test_boxes_of_the_hand_and_of_its_slides() -> None:
    layout = read_layout(mujoco.MjModel.from_xml_string(PUSHER), 0.05)
    palm, finger = layout.pads
    assert (palm.joint, layout.joints[finger.joint]) == (-1, "finger")
    np.testing.assert_allclose(palm.pos, [0, 0, 0.06], atol=1e-9)
    np.testing.assert_allclose(finger.half, [0.01, 0.008, 0.03])
    assert (palm.friction, finger.friction) == (1.0, 0.8)
    turn = np.deg2rad(30)  # of the site
    np.testing.assert_allclose(finger.axis, [np.sin(turn), np.cos(turn), 0], atol=1e-9)
    assert Layout.from_dict(layout.to_dict()) == layout


def test_boxes_that_nothing_can_touch_are_left_out() -> None:
    xml = PUSHER.replace('name="palm"', 'name="palm" contype="0" conaffinity="0"')
    layout = read_layout(mujoco.MjModel.from_xml_string(xml), 0.05)
    assert [pad.joint >= 0 for pad in layout.pads] == [True]
