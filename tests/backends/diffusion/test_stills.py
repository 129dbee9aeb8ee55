"""Images whose cubes are drawn anew each: what is written down is what they show."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from orbisim_diffusion import stills
from orbisim_diffusion.inference import objects_of, robots
from orbisim_diffusion.raycast import cast
from orbisim_diffusion.solids import project
from orbisim_diffusion.stills import SUFFIX, load_stills, make_stills
from orbisim_diffusion.train_inference import tune
from orbisim_diffusion.training import Run

from orbisim.errors import InputError
from orbisim.tasks.push import Push
from orbisim.tasks.registry import make
from tests.backends.diffusion.tiny import save_tiny

SIZE = 64


@pytest.fixture(scope="module")
def paths(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder, before = tmp_path_factory.mktemp("stills"), Push.steps
    Push.steps = 12  # the whole of an episode takes long to draw
    try:
        found = [folder / f"{number}{SUFFIX}" for number in range(2)]
        for number, path in enumerate(found):
            assert make_stills("push", "random", 7, number, path, size=SIZE) == 13
    finally:
        Push.steps = before
    return found


def test_no_two_images_share_a_cube_and_rays_see_what_is_written_down(paths: list[Path]) -> None:
    store = load_stills(paths, torch.device("cpu"))
    index = torch.arange(len(store))
    objects = objects_of(store.solids(index))
    there = objects.entity > 0
    colours = objects.colour[there]
    assert len(colours) == 52 and len(torch.unique(colours, dim=0)) == 52
    assert objects.size[there].min() > 0.019 and objects.size[there].max() < 0.033
    view = store.view(index)
    seen = cast(store.solids(index), view, SIZE, SIZE)
    place, _ = project(view, objects.pos)
    spot = ((place + 0.5) * SIZE).long()
    checked = 0
    for i, k in there.nonzero().tolist():
        x, y = spot[i, k].tolist()
        if not (2 <= x < SIZE - 2 and 2 <= y < SIZE - 2):
            continue
        if (seen.colour[i, :, y, x] - objects.colour[i, k]).abs().max() > 1e-3:
            continue  # something is before it
        pixel = store.frames[i, y, x].double() / 255.0
        base = objects.colour[i, k].double()
        bright = float((pixel @ base) / (base @ base))  # its colour, darker or lighter
        if pixel.max() < 0.99:  # no channel is at its end
            assert float((pixel - bright * base).abs().max()) < 0.15
            checked += 1
    assert checked > 10
    robot = robots(store)
    assert robot.jointed.sum(1).unique().tolist() == [8]
    assert float((robot.joints[1:] - robot.joints[:-1]).abs().max()) > 0.1  # it was moved


def test_what_overlaps_is_not_shown(paths: list[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stills, "_DEPTH", -1.0)  # everything that touches counts: nothing passes
    monkeypatch.setattr(Push, "steps", 3)
    path = paths[0].with_name(f"same{SUFFIX}")
    make_stills("push", "random", 7, 0, path, size=32)
    found = load_stills([path], torch.device("cpu"))
    objects = objects_of(found.solids(torch.arange(4)))
    sizes = objects.size[objects.entity > 0].reshape(4, 2, 3)
    assert float((sizes - sizes[:1]).abs().max()) == 0.0  # the episode's own


def test_a_network_is_trained_on_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Push, "steps", 3)
    folder, path = save_tiny(tmp_path / "look", make("push").scene()), tmp_path / f"a{SUFFIX}"
    make_stills("push", "random", 7, 0, path, size=32)
    metrics = tune(folder, [path], [], Run(60.0, 2), report=lambda _: None)
    assert metrics["steps"] == 2 and metrics["frames"] == 4
    with pytest.raises(InputError, match="not mixed"):
        tune(folder, [path, tmp_path / "push.h5"], [], Run(1.0, 1))


def test_a_damaged_file_is_refused(paths: list[Path], tmp_path: Path) -> None:
    half = tmp_path / f"half{SUFFIX}"
    half.write_bytes(paths[0].read_bytes()[:1000])
    with pytest.raises(InputError, match="cannot be read as stills"):
        load_stills([half], torch.device("cpu"))
    other = tmp_path / f"other{SUFFIX}"
    np.savez(other.with_suffix(""), frames=np.zeros(3))
    with pytest.raises(InputError, match="has no"):
        load_stills([other], torch.device("cpu"))
