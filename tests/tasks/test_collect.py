"""Collections: the same bytes, whatever the workers and interruptions; the reader; the command."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from orbisim.errors import InputError, UnknownNameError
from orbisim.tasks.collect import collect
from orbisim.tasks.dataset import EpisodeFile


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("toss") / "toss.h5"
    collect("toss", path, episodes=40, seed=3, workers=1)
    return path


def test_two_workers_give_the_bytes_of_one(file: Path, tmp_path: Path) -> None:
    collect("toss", tmp_path / "two.h5", episodes=40, seed=3, workers=2)
    assert (tmp_path / "two.h5").read_bytes() == file.read_bytes()


def test_another_seed_gives_other_bytes(file: Path, tmp_path: Path) -> None:
    collect("toss", tmp_path / "other.h5", episodes=40, seed=4, workers=1)
    with EpisodeFile(file) as a, EpisodeFile(tmp_path / "other.h5") as b:
        assert not np.array_equal(a.episode(0)["qpos"], b.episode(0)["qpos"])


def test_goes_on_after_a_kill(file: Path, tmp_path: Path) -> None:
    out = tmp_path / "killed.h5"
    code = (
        "import time; from orbisim.tasks import chunks, collect as c\n"
        "make = chunks.make_chunk\n"
        "def slow(*a): make(*a); time.sleep(0.5)\n"
        "chunks.make_chunk = slow\n"
        f"c.collect('toss', {str(out)!r}, episodes=40, seed=3, workers=1)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code], start_new_session=True)
    folder = out.with_name("killed.h5.partial")
    deadline = time.monotonic() + 60
    while not list(folder.glob("chunk-*.h5")) and time.monotonic() < deadline:
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    assert not out.exists()
    done = len(list(folder.glob("chunk-*.h5")))
    assert 1 <= done < 3
    result = collect("toss", out, episodes=40, seed=3, workers=2)
    assert result.resumed == 16 * done
    assert out.read_bytes() == file.read_bytes()
    assert not folder.exists()


def test_does_not_go_on_with_another_collection(tmp_path: Path) -> None:
    folder = tmp_path / "x.h5.partial"
    folder.mkdir()
    (folder / "order").write_text("something else")
    with pytest.raises(InputError, match="something else"):
        collect("toss", tmp_path / "x.h5", episodes=2)


def test_collecting_needs_no_optional_package() -> None:
    code = (
        "import sys\n"
        "missing = {'warp', 'trimesh', 'yourdfpy', 'pxr', 'meshcat', 'torch'}\n"
        "class Missing:\n"  # not None in sys.modules: SciPy looks into modules that are there
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name in missing: raise ModuleNotFoundError(name=name)\n"
        "sys.meta_path.insert(0, Missing())\n"
        "from orbisim import tasks\n"
        "tasks.make('push').episode('random', 0)\n"
        "tasks.make('suite:pendulum-swingup').episode('held', 0)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


def test_wrong_destinations(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"ends in \.h5"):
        collect("ball", tmp_path / "ball.npz", episodes=1)
    with pytest.raises(InputError, match="no folder"):
        collect("ball", tmp_path / "none" / "ball.h5", episodes=1)
    with pytest.raises(UnknownNameError):
        collect("balll", tmp_path / "ball.h5", episodes=1)


def test_an_unstable_episode_is_drawn_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from orbisim.errors import DivergedError, OrbiSimError
    from orbisim.tasks.ball import Ball

    made = Ball.episode
    seeds: list[int] = []

    def fails_first(self: Ball, subtask: str, seed: int) -> object:
        seeds.append(seed)
        if len(seeds) == 1:
            raise DivergedError("unstable")
        return made(self, subtask, seed)

    monkeypatch.setattr(Ball, "episode", fails_first)
    collect("ball", tmp_path / "ball.h5", episodes=1, workers=1)
    with EpisodeFile(tmp_path / "ball.h5") as episodes:
        assert episodes.attributes(0)["seed"] == seeds[1] != seeds[0]

    def fails(self: Ball, subtask: str, seed: int) -> object:
        raise DivergedError("unstable")

    monkeypatch.setattr(Ball, "episode", fails)
    with pytest.raises(OrbiSimError, match="throw, episode 0: unstable, 5 times"):
        collect("ball", tmp_path / "never.h5", episodes=1, workers=1)
