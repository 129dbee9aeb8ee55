"""Collections: the same bytes, whatever the workers and interruptions; the reader; the command."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from orbisim.cli.main import run
from orbisim.errors import InputError, UnknownNameError
from orbisim.tasks.base import shares
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


def test_reading(file: Path) -> None:
    with EpisodeFile(file) as episodes:
        assert len(episodes) == 40
        assert (episodes.task, episodes.seed) == ("task:toss", 3)
        assert episodes.control_timestep == pytest.approx(1 / 148)
        assert episodes.select("box") == list(range(20, 40))
        one = episodes.episode(0)
        assert one["qpos"].shape == (149, 7)
        assert one["ctrl"].shape == (148, 0)
        assert episodes.columns("descriptor/objects")[3] == "mass"
        assert episodes.entities(0) == ("box",)
        assert episodes.attributes(21)["subtask"] == "box"
        assert episodes.config["cube_half"] == [0.048, 0.056]
        stacked = episodes.stack(["objects/pos", "time"], [0, 30])
        np.testing.assert_array_equal(stacked.arrays["objects/pos"][0], one["objects/pos"])
        assert stacked.masks["objects/pos"].shape == (2, 149, 1)
        assert stacked.masks["time"].all()
        assert stacked.lengths.tolist() == [148, 148]
        with pytest.raises(InputError, match="has no 'episodes/000000/robot/pos'"):
            episodes.episode(0, ["robot/pos"])
        with pytest.raises(InputError, match="40 episodes"):
            episodes.episode(40)


def test_stacking_pads_episodes_with_fewer_objects(tmp_path: Path) -> None:
    path = tmp_path / "cubes.h5"
    collect("push_cubes", path, episodes=4, workers=1, subtask="random", seed=2)
    with EpisodeFile(path) as episodes:
        counts = [len(episodes.entities(i)) - 1 for i in range(4)]
        assert set(counts) == {3, 4}
        stacked = episodes.stack(["objects/pos", "descriptor/objects", "action"])
        assert stacked.arrays["objects/pos"].shape == (4, 161, 4, 3)
        np.testing.assert_array_equal(stacked.masks["objects/pos"][:, 0].sum(axis=1), counts)
        assert (stacked.arrays["objects/pos"][~stacked.masks["objects/pos"]] == 0).all()
        assert stacked.arrays["action"].shape == (4, 160, 7)


def test_reading_needs_neither_mujoco_nor_torch(file: Path) -> None:
    code = (
        "import sys; from orbisim.tasks import EpisodeFile\n"
        f"EpisodeFile({str(file)!r}).stack(['qpos'])\n"
        "bad = {'mujoco', 'torch', 'dm_control', 'scipy'} & set(sys.modules)\n"
        "assert not bad, bad\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


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


def test_a_file_of_something_else_is_refused(tmp_path: Path) -> None:
    import h5py

    (tmp_path / "text.h5").write_text("text")
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other.attrs["schema"] = "other/1"
    with h5py.File(tmp_path / "half.h5", "w") as half:
        half.attrs["schema"] = "orbisim.episodes/1"
    for name, message in (
        ("none.h5", "no such file"),
        ("text.h5", "not an HDF5 file"),
        ("other.h5", "expected 'orbisim.episodes/1'"),
        ("half.h5", "not finished"),
    ):
        with pytest.raises(InputError, match=message):
            EpisodeFile(tmp_path / name)


def test_shares_add_up() -> None:
    assert shares([120, 640, 1840], 2600) == [120, 640, 1840]
    assert shares([120, 640, 1840], 10) == [1, 2, 7]
    assert sum(shares([1, 1, 1], 100)) == 100


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "ball.h5")
    arguments = ["collect", "ball", "--episodes", "3", "--workers", "1", "--seed", "5"]
    assert run([*arguments, "--set", "velocity_x=0.25", "--out", out, "--json"]) == 0
    captured = capsys.readouterr()
    result = json.loads(captured.out)
    assert result["schema"] == "orbisim.collect/1"
    assert (result["episodes"], result["steps"]) == (3, 108)
    with EpisodeFile(out) as episodes:
        assert episodes.episode(0)["qvel"][0, 0] == 0.25
    assert run([*arguments, "--out", out]) == 2
    assert "already exists" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["pusch"], "did you mean"),
        (["push", "--subtask", "to_hurt"], "did you mean 'to_hit'"),
        (["push", "--subtask", "three"], "say how many"),
        (["push", "--episodes", "0"], "at least one episode"),
        (["push", "--workers", "0"], "at least one worker"),
        (["push", "--seed", "-1"], "at least 0"),
        (["push", "--set", "friction=1"], "unknown setting"),
        (["push", "--set", "density=9,1"], "a range LOW,HIGH"),
        (["push", "--set", "density"], "NAME=NUMBER"),
        (["push", "--frames", "sied"], "did you mean 'side'"),
        (["push", "--frames", "side", "--size", "4"], "8 to 2048"),
        (["suite:cheetah-fly"], "unknown task"),
    ],
)
def test_wrong_input(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, arguments: list[str], message: str
) -> None:
    assert run(["collect", *arguments, "--out", str(tmp_path / "x.h5")]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert message in captured.err
    assert not list(tmp_path.iterdir())


def test_wrong_destinations(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"ends in \.h5"):
        collect("ball", tmp_path / "ball.npz", episodes=1)
    with pytest.raises(InputError, match="no folder"):
        collect("ball", tmp_path / "none" / "ball.h5", episodes=1)
    with pytest.raises(UnknownNameError):
        collect("balll", tmp_path / "ball.h5", episodes=1)


def test_frames(tmp_path: Path) -> None:
    from orbisim import load_scene, make_renderer
    from orbisim.errors import RenderingUnavailableError
    from orbisim.tasks.frames import Camera

    try:
        make_renderer("mujoco", load_scene("task:ball"))
    except RenderingUnavailableError:
        pytest.skip("no OpenGL")
    path = tmp_path / "seen.h5"
    collect("ball", path, episodes=1, workers=1, camera=Camera("side", 48))
    with EpisodeFile(path) as episodes:
        frames = episodes.episode(0)["frames/side"]
    assert frames.shape == (37, 48, 48, 3)
    assert frames.std() > 5
    assert np.abs(frames[0].astype(int) - frames[-1]).max() > 30


def test_ray_gives_the_same_bytes(file: Path, tmp_path: Path) -> None:
    ray = pytest.importorskip("ray")
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="error")
    try:
        collect("toss", tmp_path / "ray.h5", episodes=40, seed=3, workers=2, ray=True)
    finally:
        ray.shutdown()
    assert (tmp_path / "ray.h5").read_bytes() == file.read_bytes()


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


def test_mujocos_resets_are_noticed() -> None:
    import mujoco

    from orbisim.errors import DivergedError
    from orbisim.tasks.episode import check_stable

    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data)
    check_stable(data)
    data.qvel[0] = 1e12
    mujoco.mj_step(model, data)
    with pytest.raises(DivergedError, match="unstable"):
        check_stable(data)
