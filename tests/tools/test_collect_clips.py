"""Clips around contacts: thrown cubes among them."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from orbisim_world_model.pack import Pack

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))
import collect_clips

FIRST, SECOND, VELOCITY, LENGTH = 8, 15, 8, 16
"""Coordinates of the cubes, of the velocity of the first, and control steps of a clip."""


def _clips(pushes: Pack, folder: Path, monkeypatch: pytest.MonkeyPatch, *options: str) -> Pack:
    source, out = folder / "push.pack", folder / "clips.pack"
    pushes.save(source)
    count = ["--clips", "12", "--length", str(LENGTH)]
    monkeypatch.setattr(sys, "argv", ["", str(source), "--out", str(out), *count, *options])
    collect_clips.main()
    return Pack.load(out)


def test_thrown_cubes_begin_in_motion_on_the_table_and_some_meet(
    pushes: Pack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = _clips(pushes, tmp_path, monkeypatch, "--throws", "1")
    speed = found.qvel[found.start, VELOCITY : VELOCITY + 2].norm(dim=-1)
    assert (speed > 0.2).all()
    assert (found.qvel[found.start, VELOCITY + 6 :] == 0).all()
    ways = [
        (found.qpos[found.start + LENGTH] - found.qpos[found.start])[:, at : at + 2].norm(dim=-1)
        for at in (FIRST, SECOND)
    ]
    assert (ways[0] > 0.01).all() and (ways[1] > 0.002).sum() >= 4
    column = found.layout.attributes.index("mass")
    assert len(set(found.attributes[:, :, column].flatten().tolist())) == 2 * found.episodes


def test_without_throws_cubes_are_those_of_the_episodes(
    pushes: Pack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = _clips(pushes, tmp_path, monkeypatch)
    column = found.layout.attributes.index("half_x")
    known = set(pushes.attributes[:, :, column].flatten().tolist())
    assert set(found.attributes[:, :, column].flatten().tolist()) <= known
