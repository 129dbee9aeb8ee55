"""Episodes of generated mechanisms, from the file to a pack."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from orbisim_world_model.packing import pack_file
from orbisim_world_model.parts import COLUMNS

from orbisim.errors import InputError
from orbisim.tasks import EpisodeFile, make
from orbisim.tasks.collect import collect


def test_a_pack_has_the_parts_of_each_episode_s_own_scene(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "door.h5"
    collect("task:mechanism:door", path, episodes=1, workers=1)
    pack = pack_file(path)
    assert [pack.layout.joints[j] for j in pack.layout.parts] == ["door_hinge", "door_handle"]
    with EpisodeFile(path) as file:
        data, known = file.episode(0), file.attributes(0)
        task = make(file.task)
    scene = task.scene(known["subtask"], known["seed"])
    high = pack.parts[0, :, COLUMNS.index("high")]
    np.testing.assert_allclose(high, scene.model.jnt_range[-2:, 1], atol=1e-6)
    np.testing.assert_allclose(pack.qpos, data["qpos"], atol=1e-6)
    other = make("task:mechanism:door", instance=7)
    monkeypatch.setattr("orbisim_world_model.packing.make", lambda *_, **__: other)
    with pytest.raises(InputError, match="episode 0 was collected from another scene"):
        pack_file(path)
