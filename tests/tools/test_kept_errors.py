"""tools/kept_errors.py and the curves that tools/plot_curves.py draws of it."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
from matplotlib.figure import Figure
from orbisim_world_model.pack import Pack

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))
import kept_errors
import plot_curves

ZOO = Path(kept_errors.__file__).parents[1] / "backends" / "orbisim_world_model" / "zoo"


def test_kept_checkpoints_come_in_the_order_of_their_steps(tmp_path: Path) -> None:
    training = tmp_path / "push"
    for folder in (training, tmp_path / "push-kept" / "000200", tmp_path / "push-kept" / "000030"):
        folder.mkdir(parents=True)
        (folder / "manifest.json").touch()
    names = [folder.name for folder in kept_errors.checkpoints(training)]
    assert names == ["000030", "000200", "push"]


def test_a_row_has_median_90_and_worst(pushes: Pack) -> None:
    row = kept_errors.row(ZOO / "push", pushes, 20)
    training = json.loads((ZOO / "push" / "manifest.json").read_text())["training"]
    assert row["steps"] == training["steps"]
    median, most, worst = row["errors"]["hand_position"]
    assert 0.0 <= median <= most <= worst < 5.0  # mm, one second of a trained model


def test_called_again_it_evaluates_what_is_new(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    training, out = tmp_path / "push", tmp_path / "errors.json"
    evaluated = []

    def row(folder: Path, pack: Any, horizon: int) -> dict[str, Any]:
        evaluated.append(folder.name)
        return {"steps": kept_errors.steps(folder), "errors": {}}

    monkeypatch.setattr(kept_errors, "row", row)
    monkeypatch.setattr(kept_errors, "_read", lambda path: torch.zeros(1))
    words = [training, "--data", tmp_path / "none.h5", "--out", out]
    monkeypatch.setattr(sys, "argv", ["kept_errors.py", *map(str, words)])
    for done, name in ((90, "push"), (30, "push-kept/000030"), (120, "push")):
        folder = tmp_path / name
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "manifest.json").write_text(json.dumps({"training": {"steps": done}}))
        kept_errors.main()
    assert evaluated == ["push", "000030", "push"]
    found = json.loads(out.read_text())["push"]
    assert [one["steps"] for one in found] == [30, 90, 120]


def test_errors_are_drawn_beside_losses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "push_fair_paper"
    folder.mkdir()
    lines = [{"seconds": s, "loss": 2.0 - s} for s in (0.5, 1.0)]
    (folder / "metrics.jsonl").write_text("\n".join(map(json.dumps, lines)))
    rows = [{"seconds": s, "errors": {"object_position": [s, 2 * s, 9.0]}} for s in (1.0, 2.0)]
    (tmp_path / "errors.json").write_text(json.dumps({"push_fair_paper-s1": rows}))
    drawn: list[Figure] = []
    save = Figure.savefig

    def kept(figure: Figure, *args: Any, **options: Any) -> None:
        drawn.append(figure)
        save(figure, *args, **options)

    monkeypatch.setattr(Figure, "savefig", kept)
    words = [folder / "metrics.jsonl", "--errors", tmp_path / "errors.json"]
    words += ["--out", tmp_path / "curves.png"]
    monkeypatch.setattr(sys, "argv", ["plot_curves.py", *map(str, words)])
    plot_curves.main()
    losses, errors = drawn[0].axes
    assert list(losses.lines[0].get_ydata()) == [1.5, 1.0]
    assert [list(line.get_ydata()) for line in errors.lines] == [[1.0, 2.0], [2.0, 4.0]]
    assert errors.lines[0].get_color() == losses.lines[0].get_color()
