"""LeRobot folders of version 2 and 3, in the layout that is documented for them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest

from orbisim import Recording, load_scene
from orbisim.cli.main import run
from orbisim.errors import RecordingError
from orbisim.recording import load_recordings
from orbisim.recording.files import opened
from orbisim.recording.template import propose

from ..scenes import PENDULUM

NAMES = ["shoulder.pos", "elbow.pos"]


def state(episode: int) -> np.ndarray:
    """[T, 2]: of an episode with 10 + episode rows."""
    rows = np.arange(10 + episode)
    return np.stack([rows + 100.0 * episode, -rows], axis=1)


def table(episodes: list[int]) -> pyarrow.Table:
    states = [state(e) for e in episodes]
    every = np.concatenate(states)
    wide = pyarrow.list_(pyarrow.float32(), 2)
    return pyarrow.table(
        {
            "observation.state": pyarrow.array(every.tolist(), wide),
            "action": pyarrow.array((2 * every).tolist(), pyarrow.list_(pyarrow.float32())),
            "timestamp": pyarrow.array(
                np.concatenate([np.arange(len(s)) / 30 for s in states]), pyarrow.float32()
            ),
            "episode_index": np.concatenate(
                [np.full(len(s), e) for e, s in zip(episodes, states, strict=True)]
            ),
            "frame_index": np.concatenate([np.arange(len(s)) for s in states]),
        }
    )


def info(version: str, names: Any = NAMES, episodes: int = 3) -> dict[str, Any]:
    vector = {"dtype": "float32", "shape": [2], "names": names}
    return {
        "codebase_version": version,
        "fps": 30,
        "total_episodes": episodes,
        "features": {
            "observation.state": vector,
            "action": {"dtype": "float32", "shape": [2], "names": None},
            "observation.images.top": {"dtype": "video", "shape": [48, 64, 3]},
            "timestamp": {"dtype": "float32", "shape": [1]},
            "episode_index": {"dtype": "int64", "shape": [1]},
        },
    }


def write(folder: Path, version: str, **changes: Any) -> Path:
    (folder / "meta").mkdir(parents=True)
    (folder / "meta/info.json").write_text(json.dumps({**info(version), **changes}))
    chunk = folder / "data/chunk-000"
    chunk.mkdir(parents=True)
    if version.startswith("v2"):
        for episode in range(3):
            path = chunk / f"episode_{episode:06d}.parquet"
            pyarrow.parquet.write_table(table([episode]), path)
    else:
        pyarrow.parquet.write_table(table([0, 1]), chunk / "file-000.parquet")
        pyarrow.parquet.write_table(table([2]), chunk / "file-001.parquet")
    return folder


MAP = """
columns:
  observation.state/shoulder.pos: {signal: qpos/shoulder, unit: deg}
  observation.state/elbow.pos: {signal: qpos/elbow, unit: deg, sign: -1}
  "action[1]": {signal: ctrl/elbow, unit: deg}
"""


@pytest.mark.parametrize("version", ["v2.0", "v2.1", "v3.0"])
@pytest.mark.parametrize("episode", [0, 1, 2])
def test_an_episode(tmp_path: Path, version: str, episode: int) -> None:
    folder = write(tmp_path / "set", version)
    (tmp_path / "map.yaml").write_text(MAP)
    recording = Recording.load(f"{folder}#{episode}", tmp_path / "map.yaml")
    expected = np.radians(state(episode))
    np.testing.assert_allclose(recording["qpos/shoulder"], expected[:, 0], rtol=1e-6)
    np.testing.assert_allclose(recording["qpos/elbow"], -expected[:, 1], rtol=1e-6)
    np.testing.assert_allclose(recording["ctrl/elbow"], 2 * expected[:, 1], rtol=1e-6)
    np.testing.assert_allclose(recording.time, np.arange(10 + episode) / 30, rtol=1e-6)
    assert recording.source == f"{folder}#{episode}"
    assert recording.columns == ("action[0]",)


@pytest.mark.parametrize("names", [{"motors": NAMES}, {NAMES[0]: 0, NAMES[1]: 1}])
def test_other_ways_to_name_components(tmp_path: Path, names: Any) -> None:
    folder = write(tmp_path / "set", "v2.1", features=info("v2.1", names)["features"])
    assert "observation.state/elbow.pos" in opened(f"{folder}#0").names


def test_a_first_map(tmp_path: Path) -> None:
    scene = PENDULUM.replace("hinge", "shoulder")
    folder = write(tmp_path / "set", "v3.0")
    found = propose(opened(f"{folder}#0"), load_scene(scene))
    assert found.matched["observation.state/shoulder.pos"] == "qpos/shoulder"
    assert "unit: rad" in found.text
    assert "the file names no unit: rad?" in found.text


def test_all_episodes_are_taken_where_none_is_named(tmp_path: Path) -> None:
    folder = write(tmp_path / "set", "v2.1")
    (tmp_path / "map.yaml").write_text(MAP)
    read = load_recordings([folder, f"{folder}#1"], tmp_path / "map.yaml")
    assert [one.source for one in read] == [f"{folder}#{number}" for number in (0, 1, 2, 1)]
    one = write(tmp_path / "one", "v3.0", total_episodes=1)
    (alone,) = load_recordings([one], tmp_path / "map.yaml")
    assert alone.source == str(one)


def test_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write(tmp_path / "set", "v3.0")
    assert run(["recording", "info", f"{folder}#1", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["clocks"][0]["samples"] == 11
    assert run(["recording", "info", str(folder)]) == 2
    assert "holds 3 episodes" in capsys.readouterr().err


WRONG: dict[str, tuple[str, dict[str, Any], str]] = {
    "several": ("", {}, "holds 3 episodes, and a recording is one; name it: '.*#0' to '.*#2'"),
    "beyond": ("#3", {}, "has no episode '3'; it has 0 to 2"),
    "word": ("#x", {}, "has no episode 'x'"),
    "count": ("#0", {"total_episodes": "many"}, "total_episodes must be a number above 0"),
    "features": ("#0", {"features": []}, "'features' must be an object"),
    "gone": ("#3", {"total_episodes": 9}, "has no data of episode 3"),
    "absent": (
        "#0",
        {"features": {"observation.effort": {"dtype": "float32", "shape": [2]}}},
        "has no column 'observation.effort'",
    ),
    "wide": (
        "#0",
        {"features": {"action": {"dtype": "float32", "shape": [4]}}},
        r"has the shape \(10, 2\) in the data",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong(tmp_path: Path, name: str) -> None:
    part, changes, problem = WRONG[name]
    folder = write(tmp_path / "set", "v2.1", **changes)
    with pytest.raises(RecordingError, match=problem) as caught:
        log = opened(f"{folder}{part}")
        log.read(log.names)
    assert "\n" not in str(caught.value)
