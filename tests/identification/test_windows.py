"""Windows on the grid of a backend's steps."""

from __future__ import annotations

import numpy as np
import pytest

from orbisim import Recording, load_scene
from orbisim.errors import RecordingError
from orbisim.identification.windows import grid, places
from orbisim.recording import bind
from orbisim.replay import prepare
from tests.cli.test_identify import PENDULUM
from tests.identification.test_parameters import XML


def test_states_are_interpolated_at_the_ends_of_steps() -> None:
    scene = load_scene(PENDULUM)
    time = np.linspace(0.0, 1.0, 11)
    recording = Recording(time, {"qpos": 2.0 * time[:, None], "qvel": np.full((11, 1), 2.0)})
    found = grid([prepare(bind(recording, scene), 0.5)], 0.04)
    assert found.target.shape == (2, 12, 1) and list(found.recording) == [0, 0]
    np.testing.assert_allclose(found.qpos[:, 0], [0.0, 1.0])
    steps = 0.04 * np.arange(1, 13)
    np.testing.assert_allclose(found.target[1, :, 0], 2 * (0.5 + steps), atol=1e-12)
    with pytest.raises(RecordingError, match="less than a step"):
        grid([prepare(bind(recording, scene), 0.5)], 0.8)


def test_addresses() -> None:
    assert places(load_scene(XML).model) == ([7], [0])
