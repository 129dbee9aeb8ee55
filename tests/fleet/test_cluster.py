"""A fleet on a Ray cluster."""

from __future__ import annotations

import builtins
from pathlib import Path
from typing import Any

import pytest

from orbisim.errors import MissingDependencyError
from orbisim.fleet.cluster import in_memory, spread


def attempt(scene: str, recordings: list[int], folder: Path, options: str) -> str:
    """Writes two files; says that something is wrong if there is nothing to work on."""
    (folder / "augmented").mkdir()
    (folder / "augmented" / "scene.xml").write_text(scene)
    (folder / "report.json").write_text(f"{recordings} {options}")
    return "" if recordings else "no recordings"


def test_files_come_back_in_memory() -> None:
    files, problem = in_memory(attempt, "<mujoco/>", [1], "o")
    assert files == {"augmented/scene.xml": b"<mujoco/>", "report.json": b"[1] o"}
    assert problem == ""


def test_without_ray_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def refuse(name: str, *args: Any, **kwargs: Any) -> Any:
        if name == "ray":
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(MissingDependencyError, match="--ray"):
        list(spread(attempt, "", [], 1))


@pytest.mark.slow
def test_robots_are_spread_over_a_cluster(tmp_path: Path) -> None:
    pytest.importorskip("ray")
    tasks = [([1], tmp_path / "a", "m", "o"), ([], tmp_path / "b", "m", "o"),
             ("run0.npz: no time", tmp_path / "c", "m", "o")]  # fmt: skip
    found = {place.name: (sorted(files), problem)
             for place, _, files, problem in spread(attempt, "<mujoco/>", tasks, 2)}  # fmt: skip
    both = ["augmented/scene.xml", "report.json"]
    assert found == {"a": (both, ""), "b": (both, "no recordings"), "c": ([], "run0.npz: no time")}
