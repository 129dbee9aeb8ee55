"""Sizes and colours that nobody declared are found with the poses, from starts that are off."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
import torch
from orbisim_diffusion.looks import Look, LookFitter, fit_looks, together
from orbisim_diffusion.refine import Refiner
from orbisim_diffusion.synthesis import Eye
from orbisim_diffusion.tracking import Reading, follow, recording_of

from orbisim.errors import UnsupportedSceneError
from orbisim.scene import load_scene

SIZE = 64
TABLE = """
<mujoco>
  <worldbody>
    <light pos="0.2 -0.5 1.6" dir="-0.1 0.3 -1"/>
    <camera name="side" pos="0 -0.42 0.4" xyaxes="1 0 0 0 0.69 0.72"/>
    <geom name="table" type="box" size="0.3 0.3 0.02" pos="0 0 -0.02" rgba="0.76 0.66 0.52 1"/>
    <body name="one" pos="-0.1 0 0.03"><freejoint/>
      <geom type="box" size="{0} {0} {0}" rgba="{1} 1"/></body>
    <body name="two" pos="0.1 0 0.03"><freejoint/>
      <geom type="box" size="{2} {2} {2}" rgba="{3} 1"/></body>
  </worldbody>
</mujoco>
"""
TRUE = (0.026, (0.3, 0.6, 0.2)), (0.033, (0.25, 0.2, 0.7))
DECLARED = TABLE.format(0.03, "0.8 0.2 0.2", 0.03, "0.8 0.2 0.2")


def drawn(x: float) -> npt.NDArray[np.uint8]:
    """Two boxes as they are; the first one is at x."""
    words = [" ".join(map(str, colour)) for _, colour in TRUE]
    scene = load_scene(TABLE.format(TRUE[0][0], words[0], TRUE[1][0], words[1]))
    qpos = np.array([*place(0, x), *place(1, 0.08)])
    pixels = Eye(scene, 0, SIZE).draw(qpos[None], torch.arange(SIZE * SIZE)).pixels[0]
    return (255 * pixels.reshape(SIZE, SIZE, 3)).round().to(torch.uint8).numpy()


def place(number: int, x: float) -> list[float]:
    yaw = 0.3 + 0.2 * number
    return [x, 0.02, TRUE[number][0], np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]


def read(xs: list[float]) -> Reading:
    """A network's answer: sizes 8 % off, colours 0.08, places 6 mm; the second one comes first."""
    places = [[place(1, 0.086), place(0, x - 0.006)] for x in xs]
    sizes = np.array([np.full(3, 1.08 * TRUE[1][0]), np.full(3, 0.92 * TRUE[0][0])])
    colours = np.array([TRUE[1][1], TRUE[0][1]]) + 0.08
    count = len(xs)
    return Reading(
        np.zeros((count, 0)),
        np.array(places),
        np.tile(sizes, (count, 1, 1)),
        np.tile(colours, (count, 1, 1)),
        np.tile([2.0, 1.0], (count, 1)),
    )


def test_sizes_and_colours_are_found_in_a_video() -> None:
    scene = load_scene(DECLARED)
    before = scene.model.geom_size.copy()
    refiner, xs = Refiner(scene, 0, SIZE), [-0.08, -0.06]
    frames, seen = np.stack([drawn(x) for x in xs]), read(xs)
    looks = fit_looks(LookFitter(refiner, True, True), frames, seen, count=1)
    for look, (half, colour) in zip(looks, TRUE[::-1], strict=True):  # the surest is body one
        assert np.abs(look.half / half - 1.0).max() < 0.02
        assert np.abs(look.colour - colour).max() < 0.02
        assert (np.abs(look.half - half) < look.half_std).all() and look.half_std.max() < 0.1 * half
        assert 0 < look.colour_std.max() < 0.02
    found = recording_of(scene, refiner, np.array([0.0, 0.1]), follow(refiner, frames, seen), looks)
    assert np.abs(np.asarray(found.signals["xpos/two"])[:, 0] - xs).max() < 2e-3
    look = found.metadata["looks"]["two"]
    assert look["half_size"][0] == pytest.approx(TRUE[0][0], rel=0.02)
    assert (scene.model.geom_size == before).all()  # the scene stays as it was declared


def test_what_is_declared_tells_bodies_apart() -> None:
    words = " ".join(map(str, TRUE[0][1])), " ".join(map(str, TRUE[1][1]))
    scene = load_scene(TABLE.format(0.03, words[0], 0.03, words[1]))
    fitter = LookFitter(Refiner(scene, 0, SIZE), sizes=True, colours=False)
    assert fitter.slots(read([0.0]), 0) == [1, 0]
    assert LookFitter(Refiner(scene, 0, SIZE), True, True).slots(read([0.0]), 0) != [None, None]


def test_frames_count_by_what_they_show() -> None:
    none = np.full(3, np.inf)
    sure = Look(np.full(3, 0.02), np.full(3, 0.4), np.full(3, 1e-4), np.full(3, 0.01))
    unsure = Look(np.full(3, 0.03), np.full(3, 0.8), np.full(3, 1e-3), np.full(3, 0.1))
    unseen = Look(np.full(3, 0.5), np.full(3, 0.0), none, none)
    (found,) = together([(sure,), (unsure,), (unseen,)])
    assert found.half[0] == pytest.approx(0.02, abs=2e-4)
    assert found.colour[0] == pytest.approx(0.4, abs=5e-3)
    assert np.isinf(together([(unseen,)])[0].half_std).all()


def test_bodies_of_several_geoms_are_refused() -> None:
    two = DECLARED.replace('rgba="0.8 0.2 0.2 1"/></body>', '/><geom size="0.01"/></body>')
    with pytest.raises(UnsupportedSceneError, match="one geom"):
        LookFitter(Refiner(load_scene(two), 0, SIZE), True, True)
