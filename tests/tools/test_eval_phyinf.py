"""PhyInf over episodes of which one cannot be fitted."""

from __future__ import annotations

import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orbisim import Recording
from orbisim.errors import RecordingError
from orbisim.identification import identify
from orbisim.identification.parameters import parameters, patched
from orbisim.tasks.collect import collect
from orbisim.tasks.dataset import EpisodeFile
from orbisim.tasks.registry import make

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))
import eval_phyinf


def test_an_episode_that_cannot_be_fitted_is_counted_and_ends_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def prepared(data: Path, line: dict[str, Any], *_: object) -> None:
        line["moving"] = int(line["episode"] < 3)
        if line["episode"] == 1:
            raise RecordingError("push seen", "'cube2' is not seen")

    monkeypatch.setattr(eval_phyinf, "prepared", prepared)
    monkeypatch.setattr(eval_phyinf.Case, "load", staticmethod(lambda path: path.name))
    for episode in range(4):
        eval_phyinf.one(Path(), episode, "video", Path(), tmp_path, float("inf"))
    eval_phyinf.one(Path(), 9, "video", Path(), tmp_path, 0.0)  # the time is over
    cases: Any = eval_phyinf.read_cases(tmp_path, "video")
    assert [case for _, case in cases] == ["case_video_000.npz", None, "case_video_002.npz"]
    lines = [line for line, _ in cases]
    errors = dict.fromkeys(eval_phyinf._UNITS, 4.0)
    for line in (lines[0], lines[2]):
        found = {"name": "friction:table", "true": 0.4, "declared": 0.5, "fit": [0.3, 0.2, 0.35]}
        line |= {"parameters": [found], "rollouts": {"fit": errors, "true": {"none": "infinite"}}}
    found = eval_phyinf.summary(lines)["video"]
    assert (found["episodes"], found["fitted"]) == (3, 2)
    assert found["failed"] == {1: "push seen: 'cube2' is not seen"}
    assert found["rollouts fit"]["runs"] == 2 and not found["rollouts fit"]["none"]
    assert found["rollouts true"]["none"] == dict.fromkeys((0, 2), "infinite")
    assert found["friction_percent"]["fit"]["mean"] == pytest.approx(25.0)
    assert found["friction_percent"]["fit"]["covered"] == 0.0


def test_a_video_is_read_once(tmp_path: Path) -> None:
    calls = []

    def read() -> Recording:
        calls.append(1)
        signals = {"qpos/arm": np.array([0.0, np.nan, 0.2])}
        return Recording(np.arange(3) * 0.05, signals, metadata={"noise": {"qpos/arm": 0.01}})

    kept = tmp_path / "video_000.npz"
    first, second = (eval_phyinf.read_once(kept, read) for _ in range(2))
    assert calls == [1] and list(tmp_path.iterdir()) == [kept]
    for one in (first, second):
        np.testing.assert_array_equal(one.signals["qpos/arm"], [0.0, np.nan, 0.2])
        assert one.metadata["noise"] == {"qpos/arm": 0.01}


@pytest.fixture(scope="module")
def episode(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("phyinf")
    collect("push", folder / "push.h5", episodes=1, workers=1, seed=4)
    eval_phyinf.one(folder / "push.h5", 0, "true", Path(), folder, float("inf"))
    return folder


def test_a_rollout_that_diverges_says_where(episode: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ((_, case),) = eval_phyinf.read_cases(episode, "true")
    assert case is not None
    batch = eval_phyinf.Batch([case], "learned", "cpu")

    def run(at: int) -> list[dict[str, Any]]:
        path = types.SimpleNamespace(qpos=case.qpos[None, 1:], qvel=case.qvel[None, 1:],
                                     diverged_at=np.array([at]))  # fmt: skip
        monkeypatch.setattr(batch, "_run", lambda *_: path)
        return batch.rollout(batch.truth)

    assert run(5) == [{"none": "diverged at step 5 of 63"}]
    (exact,) = run(-1)
    nothing = dict.fromkeys((*eval_phyinf._UNITS, "mm_last"), 0.0)
    assert exact == pytest.approx(nothing, abs=0.1)  # float32 knows a hundredth of a degree


@pytest.mark.slow
def test_all_as_one_batch_is_what_the_command_fits(
    episode: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(eval_phyinf, "_STEPS", 2)
    ((_, case),) = eval_phyinf.read_cases(episode, "true")
    assert case is not None
    batch = eval_phyinf.Batch([case, case], "learned", "cpu")
    found = batch.fit(None)
    task = make("push")
    with EpisodeFile(episode / "push.h5") as file:
        known = file.attributes(0)
        arrays = file.episode(0, ["qpos", "ctrl"])
    scene = task.scene(known["subtask"], known["seed"])
    cubes = [int(scene.model.joint(n).qposadr[0]) for n in eval_phyinf.free_bodies(scene.model)]
    rows = eval_phyinf.busiest(arrays["qpos"], cubes)
    ctrl = arrays["ctrl"][rows.start : rows.stop - 1]
    signals = {"qpos": arrays["qpos"][rows], "ctrl": np.concatenate([ctrl, ctrl[-1:]])}
    recording = Recording(np.arange(64) * 0.05, signals)
    chosen = [0, *(i + 1 for i in np.flatnonzero(case.moving))]
    names = [["friction:table", "density:cube1", "density:cube2"][i] for i in chosen]
    wanted = parameters(scene, names)
    middle = [float(batch.middle[0, i]) for i in chosen]
    declared = patched(scene, dict(zip(wanted, middle, strict=True)))
    alone = identify(declared, [recording], names, steps=2, check=False)
    for number in range(2):
        got = [x[number, chosen].tolist() for x in (found.value, found.low, found.high)]
        for a, b in zip(got, (alone.values, alone.low, alone.high), strict=True):
            assert a == pytest.approx(b, rel=0.02)
