"""PhyInf over episodes of which one cannot be fitted."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from orbisim_world_model.watch import OutsideTrainingWarning

from orbisim import Recording, State
from orbisim.errors import DivergedError, RecordingError
from orbisim.tasks.registry import make

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))
import eval_phyinf


def test_an_episode_that_cannot_be_fitted_is_counted_and_ends_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def measure(data: Path, line: dict[str, Any], *_: object) -> None:
        line["moving"] = 1
        if line["episode"] == 1:
            raise RecordingError("push seen", "'cube2' is not seen")
        rows = {"mm": 4.0, "degrees": 1.0}
        line.update(
            parameters=[],
            rollout_declared=rows,
            rollout_found=rows,
            rollout_true={"none": "infinite"},
        )

    monkeypatch.setattr(eval_phyinf, "measure", measure)
    for episode in range(3):
        eval_phyinf.one(Path(), episode, "video", Path(), "learned", tmp_path, float("inf"))
    found = eval_phyinf.summary(tmp_path)["video"]
    assert (found["episodes"], found["fitted"]) == (3, 2)
    assert found["failed"] == {1: "push seen: 'cube2' is not seen"}
    assert found["rollouts_found"]["runs"] == 2 and not found["rollouts_found"]["none"]
    assert found["rollouts_true"]["none"] == dict.fromkeys((0, 2), "infinite")


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


@pytest.mark.parametrize("good", [3, 9])
def test_a_rollout_that_diverges_says_where(monkeypatch: pytest.MonkeyPatch, good: int) -> None:
    scene = make("push").scene("push", 0)
    model = scene.model
    qpos = np.repeat(model.qpos0[None], 10, 0)

    class Backend:
        """Stays where it is, and diverges at some step."""

        timestep = 0.05

        def rollout(self, state: State, controls: Any, raise_on_divergence: bool) -> State:
            warnings.warn("'robot' left", OutsideTrainingWarning, stacklevel=1)
            if good < controls.shape[1] and raise_on_divergence:
                raise DivergedError(f"at step {good} by 'robot'", [0])
            return state.replace(qpos=np.repeat(qpos[:1], controls.shape[1], 0)[None])

    monkeypatch.setattr(eval_phyinf, "make_backend", lambda *_, **__: Backend())
    signals = {"qpos": qpos, "ctrl": np.zeros((10, model.nu))}
    recording = Recording(np.arange(10) * 0.05, signals)
    cube = int(model.joint(eval_phyinf.free_bodies(model)[0]).qposadr[0])
    found = eval_phyinf.rollout(scene, recording, qpos, [cube], "learned")
    if good == 3:
        assert found["none"] == "of 9 steps: at step 3 by 'robot'"
    else:
        assert found["mm"] == 0.0 and found["degrees"] == pytest.approx(0.0, abs=1e-3)
    assert found["outside"] == ["'robot' left"]
