"""From frames to a recording: which object is which, and like orientations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from orbisim_diffusion.estimate import _tracks, infer, load_inference
from orbisim_diffusion.inference import Inferred
from scipy.spatial.transform import Rotation

from orbisim.errors import InputError, UnsupportedSceneError
from orbisim.scene import load_scene, matrices
from tests.backends.diffusion.tiny import add_inference, arm, save_tiny

TWO = """
<mujoco><worldbody>
  <body name="red"><freejoint/><geom type="box" size="0.03 0.03 0.03" rgba="0.9 0.1 0.1 1"/></body>
  <body name="blue" pos="0.2 0 0"><freejoint/>
    <geom type="box" size="0.03 0.03 0.03" rgba="0.1 0.1 0.9 1"/></body>
</worldbody></mujoco>
"""


def seen(frames: int) -> Inferred:
    """Two cubes that cross, found in changing order, each turned by any quarter."""
    rng = np.random.default_rng(0)
    t = np.arange(frames) / frames
    true = np.stack([np.stack([t, 0.05 + 0 * t, 0 * t], 1), np.stack([1 - t, 0 * t, 0 * t], 1)], 1)
    colours = np.array([[0.9, 0.1, 0.1], [0.1, 0.1, 0.9]])
    present = np.full((frames, 4), -5.0)
    pos, rot = np.full((frames, 4, 3), 9.0), np.tile(np.eye(3), (frames, 4, 1, 1))
    colour, size = np.zeros((frames, 4, 3)), np.full((frames, 4, 3), 0.03)
    for i in range(frames):
        slots = rng.permutation(4)[:2]
        for body, slot in enumerate(slots):
            yaw = 0.3 * t[i] + rng.integers(4) * np.pi / 2
            present[i, slot], pos[i, slot], colour[i, slot] = 5.0, true[i, body], colours[body]
            rot[i, slot] = Rotation.from_euler("z", yaw).as_matrix()
    present[3] = -5.0  # the network is sure of nothing there
    tensors = (torch.as_tensor(v) for v in (present, pos, rot, size, colour))
    none = torch.zeros(frames, 3)
    return Inferred(none, torch.zeros(frames, 3, 3), torch.zeros(frames, 9), *tensors)


def test_objects_are_followed_and_turn_smoothly() -> None:
    model = load_scene(TWO).model
    rows = np.array([matrices.object_row(model, model.body(n).id) for n in ("red", "blue")])
    places, turns = _tracks(seen(20), rows)
    t = np.arange(20) / 20
    np.testing.assert_allclose(places[:, 0, 0], t)
    np.testing.assert_allclose(places[:, 1, 0], 1 - t)  # as many as the scene declares
    yaw = 2 * np.arctan2(turns[:, 0, 3], turns[:, 0, 0])
    np.testing.assert_allclose(yaw, 0.3 * t, atol=1e-6)


def test_what_cannot_be_inferred_is_refused(tmp_path: Path) -> None:
    plain = save_tiny(tmp_path / "plain", arm())
    with pytest.raises(InputError, match="has no state inference"):
        load_inference(plain)
    point, model = load_inference(add_inference(plain))
    bodies = "".join(f'<body pos="{i} 0 0"><freejoint/><geom size="0.1"/></body>' for i in range(5))
    crowd = load_scene(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    with pytest.raises(UnsupportedSceneError, match="4 objects"):
        infer(crowd, np.zeros((2, 32, 32, 3), np.uint8), np.arange(2.0), point, model)
