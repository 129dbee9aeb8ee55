"""Episodes that are not what they say: nothing else is opened, nothing is made up."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from orbisim_world_model.baseline import with_baseline
from orbisim_world_model.pack import Pack
from orbisim_world_model.packing import pack_file, read_data
from orbisim_world_model.parts import COLUMNS
from safetensors import safe_open
from safetensors.torch import save_file

from orbisim.errors import InputError
from orbisim.tasks import EpisodeFile, make
from orbisim.tasks.collect import collect

h5py = pytest.importorskip("h5py")


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("ball") / "ball.h5"
    collect("ball", path, episodes=3, workers=1)
    return path


@pytest.fixture
def file(original: Path, tmp_path: Path) -> Path:
    """A copy to damage."""
    return Path(shutil.copy(original, tmp_path / "ball.h5"))


def _replace(path: Path, name: str, change: Any) -> None:
    with h5py.File(path, "r+") as file:
        group = file["episodes/000001"]
        array, columns = group[name][()], dict(group[name].attrs)
        del group[name]
        group[name] = change(array)
        group[name].attrs.update(columns)


def test_whole_episodes_are_read(original: Path) -> None:
    pack = read_data([original])
    assert pack.episodes == 3
    assert pack.notes["sources"] == [
        {"file": "ball.h5", "task": "task:ball", "seed": 0, "episodes": 3}
    ]


@pytest.mark.parametrize(
    ("task", "told"),
    [
        ("/etc/passwd", "expected the name of a scene"),
        ("<mujoco><size nkey='2000000000'/></mujoco>", "expected the name of a scene"),
        ("task:", "expected the name of a scene"),
        ("x:y", "expected the name of a scene"),
        ("", "expected the name of a scene"),
        ("secret.xml", "of the file 'secret.xml', which is not opened .* give the scene with"),
    ],
)
def test_a_task_is_a_name(
    file: Path, task: str, told: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "secret.xml").write_text("<mujoco/>")
    with h5py.File(file, "r+") as opened:
        opened.attrs["task"] = task
    with pytest.raises(InputError, match=told):
        read_data([file])


def test_a_pack_names_a_task_too(original: Path, tmp_path: Path) -> None:
    scene = tmp_path / "scene.xml"
    scene.write_text("<mujoco/>")
    pack = read_data([original])
    notes = {**pack.notes, "sources": [{"task": str(scene)}]}
    with pytest.raises(InputError, match="expected the name of a scene"):
        with_baseline(dataclasses.replace(pack, notes=notes), None)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300, 1e30])
@pytest.mark.parametrize("name", ["qpos", "qvel", "descriptor/world"])
def test_numbers_that_mean_nothing_are_refused(file: Path, name: str, value: float) -> None:
    def change(array: Any) -> Any:
        array[7] = value
        return array

    _replace(file, name, change)
    where = "episode 1, step 7: " + name if name[0] == "q" else "episode 1: world"
    with pytest.raises(InputError, match=f"{file}: {where} holds"):
        read_data([file])


@pytest.mark.parametrize(
    ("name", "change", "says"),
    [
        ("qpos", lambda a: a[:3], "has shape .* an episode of 36 steps has 37 rows"),
        ("ctrl", lambda a: a[:3], "an episode of 36 steps has 36 rows"),
        ("qpos", lambda a: a[:, :5], "has 5 coordinates"),
        ("qvel", lambda a: a[:, 0], "expected rows of a number"),
        ("qvel", lambda a: a.astype("S8"), "expected rows of a number"),
        ("ctrl", lambda a: np.zeros((36, 4)), "expected rows of 0 numbers"),
        ("action", lambda a: np.zeros((36, 4)), "different widths"),
        ("descriptor/objects", lambda a: a[:0], "expected a row for each of 1 objects"),
        ("descriptor/world", lambda a: a[:2], "descriptor/world is not"),
        ("entities/names", lambda a: np.zeros(3), "is not a list of names"),
        ("entities/names", lambda a: np.array([b"a", b"a"]), "the same name"),
        ("time", lambda a: a[:0], r"expected one axis, \[T\+1\]"),
        ("time", lambda a: a[:1], "has .* rows"),
    ],
)
def test_shapes_that_do_not_fit_are_refused(file: Path, name: str, change: Any, says: str) -> None:
    _replace(file, name, change)
    with pytest.raises(InputError, match=says) as caught:
        read_data([file])
    assert str(caught.value).startswith(f"{file}: ")


def test_numbers_of_another_file_are_not_read(file: Path, original: Path) -> None:
    with h5py.File(file, "r+") as opened:
        del opened["episodes/000001/qpos"]
        opened["episodes/000001/qpos"] = h5py.ExternalLink(original, "/episodes/000001/qpos")
    with pytest.raises(InputError, match="a link to elsewhere"):
        read_data([file])


def test_packs_come_back(original: Path, tmp_path: Path) -> None:
    pack = read_data([original])
    pack.save(tmp_path / "a.pack")
    again = Pack.load(tmp_path / "a.pack")
    assert again.layout == pack.layout
    assert torch.equal(again.qpos, pack.qpos)


@pytest.mark.parametrize(
    ("name", "change", "says"),
    [
        ("qpos", lambda t: t[:, :3].contiguous(), "tensor qpos is"),
        ("qpos", lambda t: t.double(), "expected torch.float32"),
        ("qpos", lambda t: t[0].contiguous(), "tensor"),
        ("start", lambda t: t + 10**9, "lies outside of the data"),
        ("start", lambda t: t * 0 - 1, "lies outside of the data"),
        ("length", lambda t: t * 0 + 2**62, "lies outside of the data"),
        ("group", lambda t: t + 1, "has no group"),
        ("mask", lambda t: t[:1].contiguous(), "tensor mask is"),
        ("qvel", lambda t: t * torch.nan, "qvel holds nan"),
        ("more", lambda t: torch.zeros(1), "unknown tensor more"),
        ("world", None, "lacks tensor world"),
    ],
)
def test_packs_that_do_not_fit_together_are_refused(
    original: Path, tmp_path: Path, name: str, change: Any, says: str
) -> None:
    path = tmp_path / "a.pack"
    read_data([original]).save(path)
    with safe_open(str(path), framework="pt") as opened:
        header = opened.metadata()
        tensors = {key: opened.get_tensor(key) for key in opened.keys()}  # noqa: SIM118
    if change is None:
        del tensors[name]
    else:
        tensors[name] = change(tensors.get(name))
    save_file(tensors, str(path), metadata=header)
    with pytest.raises(InputError, match=says):
        read_data([path])


@pytest.mark.parametrize("layout", ["", "[]", "{}", '{"nq": "x"}', "[" * 100_000])
def test_headers_of_packs_are_checked(original: Path, tmp_path: Path, layout: str) -> None:
    path = tmp_path / "a.pack"
    read_data([original]).save(path)
    with safe_open(str(path), framework="pt") as opened:
        header = {**opened.metadata(), "layout": layout}
        tensors = {key: opened.get_tensor(key) for key in opened.keys()}  # noqa: SIM118
    save_file(tensors, str(path), metadata=header)
    with pytest.raises(InputError, match="layout"):
        read_data([path])


def test_a_pack_has_the_parts_of_each_episode_s_own_scene(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "door.h5"
    collect("task:mechanism:door", path, episodes=1, workers=1)
    pack = pack_file(path)
    assert [pack.layout.joints[j] for j in pack.layout.parts] == ["door_hinge", "door_handle"]
    with EpisodeFile(path) as file:
        data, known = file.episode(0), file.attributes(0)
        task = make(file.task)
    scene = task.scene(known["subtask"], known["seed"])
    high = pack.parts[0, :, COLUMNS.index("high")]
    np.testing.assert_allclose(high, scene.model.jnt_range[-2:, 1], atol=1e-6)
    np.testing.assert_allclose(pack.qpos, data["qpos"], atol=1e-6)
    other = make("task:mechanism:door", instance=7)
    monkeypatch.setattr("orbisim_world_model.packing.make", lambda *_, **__: other)
    with pytest.raises(InputError, match="episode 0 was collected from another scene"):
        pack_file(path)
