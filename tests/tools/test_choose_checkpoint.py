"""Checkpoints that a training keeps, and the choice among them."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))
import choose_checkpoint
import train_all


def test_the_score_is_a_geometric_mean() -> None:
    assert choose_checkpoint.score([0.1, 0.4]) == pytest.approx(0.2)
    assert choose_checkpoint.score([0.1, math.inf]) == math.inf
    assert choose_checkpoint.score([0.1, math.nan]) == math.inf


class Now:
    """Jobs are done when they are submitted."""

    def __init__(self, *_: object, **__: object) -> None:
        pass

    def __enter__(self) -> Now:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def submit(self, function: object, *given: object) -> Now:
        self.found = function(*given)  # type: ignore[operator]
        one = Now()
        one.found = self.found
        return one

    def result(self) -> object:
        """What the function gave."""
        return self.found


@pytest.mark.parametrize(("errors", "best"), [([0.2, 0.3, 0.1], 2), ([0.2, 0.2, 0.3], 0)])
def test_the_least_error_is_copied_and_of_equals_the_first(
    errors: list[float], best: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folders = [tmp_path / str(number) for number in range(3)]
    for folder in folders:
        folder.mkdir()
        (folder / "manifest.json").write_text(folder.name)
    monkeypatch.setattr(choose_checkpoint.concurrent.futures, "ProcessPoolExecutor", Now)
    monkeypatch.setattr(choose_checkpoint, "error", lambda folder, *_: errors[int(folder.name)])
    options = ["--data", str(tmp_path), "--out", str(tmp_path / "best"), "--names", "hopper,walker"]
    monkeypatch.setattr(sys, "argv", ["choose_checkpoint.py", *map(str, folders), *options])
    assert choose_checkpoint.main() == 0
    assert (tmp_path / "best" / "manifest.json").read_text() == str(best)


def test_a_training_keeps_checkpoints_by_their_steps(tmp_path: Path) -> None:
    folder = tmp_path / "hopper"
    folder.mkdir()
    train_all._keep(folder)  # nothing is saved yet
    assert list(tmp_path.iterdir()) == [folder]
    for steps in (20, 300):
        (folder / "manifest.json").write_text(json.dumps({"training": {"steps": steps}}))
        (folder / "model.safetensors").write_text(f"weights after {steps}")
        (folder / "training.safetensors").write_text("not to be kept")
        train_all._keep(folder)
    kept = sorted((tmp_path / "hopper-kept").iterdir())
    assert [path.name for path in kept] == ["000020", "000300"]
    assert [(path / "model.safetensors").read_text() for path in kept] == [
        "weights after 20",
        "weights after 300",
    ]
    assert not list(tmp_path.glob("hopper-kept/*/training.safetensors"))
