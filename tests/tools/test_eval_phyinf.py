"""PhyInf over episodes of which one cannot be fitted."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

from orbisim.errors import RecordingError

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
        line.update(parameters=[], rollout_declared=rows, rollout_found=rows, rollout_true=None)

    monkeypatch.setattr(eval_phyinf, "measure", measure)
    for episode in range(3):
        eval_phyinf.one(Path(), episode, "video", Path(), "learned", tmp_path, float("inf"))
    found = eval_phyinf.summary(tmp_path)["video"]
    assert (found["episodes"], found["fitted"]) == (3, 2)
    assert found["failed"] == {1: "push seen: 'cube2' is not seen"}
    assert found["rollouts_found"]["runs"] == 2 and found["rollouts_true"]["none"] == 2
