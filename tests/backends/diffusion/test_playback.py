"""Recorded work gives what the same work gives kernel by kernel."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from orbisim_diffusion.solids import constant

from orbisim.errors import InputError
from orbisim.registry import make_renderer
from orbisim.state import State
from tests.backends.diffusion.tiny import arm, save_tiny


@pytest.mark.skipif(not torch.cuda.is_available(), reason="a CUDA graph needs a GPU")
def test_images_of_a_graph_are_the_same(tmp_path: Path) -> None:
    folder, scene = save_tiny(tmp_path, arm()), arm()
    qpos = np.tile(scene.model.qpos0, (3, 1))
    qpos[:, 0] = [0.0, 0.2, 0.4]
    state = State(np.arange(3) * 0.05, qpos, np.zeros((3, scene.model.nv)), np.zeros((3, 0)))
    look = {"camera": "side", "height": 32, "width": 32}
    options = {"argument": str(folder), "device": "cuda"}
    plain, played = (make_renderer("diffusion", scene, **options, graph=g) for g in (False, True))
    for _ in range(2):  # the second time with a frame to go on from
        wanted, memory = plain.observe(state, **look)
        found, _ = played.observe(state, **look)
        assert np.abs(wanted.astype(int) - found.astype(int)).max() <= 2  # of 255
        state = State(np.asarray(state.time) + 0.05, state.qpos, state.qvel, state.act).with_memory(
            **memory
        )


def test_a_graph_needs_a_gpu(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="GPU"):
        make_renderer(
            "diffusion", arm(), argument=str(save_tiny(tmp_path, arm())), device="cpu", graph=True
        )


def test_constants_stay_where_a_recording_reads_them() -> None:
    like = torch.zeros(1)
    place = constant((0.25, 0.5), like)
    for number in range(300):  # of other scenes
        constant((float(number),), like)
    assert constant((0.25, 0.5), like).data_ptr() == place.data_ptr()
