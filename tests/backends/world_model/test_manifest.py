"""Manifests that ask for more than there is, or are not what they must be."""

from __future__ import annotations

import copy
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from orbisim_world_model import zoo
from orbisim_world_model.checkpoint import load_checkpoint, load_for
from orbisim_world_model.cloth.manifest import CLOTH_SCHEMA
from orbisim_world_model.evaluate import evaluate
from orbisim_world_model.families import read_any
from orbisim_world_model.manifest import SCHEMA, read_manifest, variants
from orbisim_world_model.packing import read_data
from safetensors.torch import load_file, save_file
from torch import nn

from orbisim import load_scene, make_backend
from orbisim.errors import InputError, UnsupportedSceneError
from orbisim.tasks.collect import collect
from tests.clock import Stopwatch

ZOO = Path(zoo.__file__).parent / "zoo"
Change = Callable[[dict[str, Any]], None]


def _set(value: Any, *place: Any) -> Change:
    def change(manifest: dict[str, Any]) -> None:
        for name in place[:-1]:
            manifest = manifest[name]
        manifest[place[-1]] = value

    return change


def _drop(*place: Any) -> Change:
    def change(manifest: dict[str, Any]) -> None:
        for name in place[:-1]:
            manifest = manifest[name]
        del manifest[place[-1]]

    return change


def _many_variants(manifest: dict[str, Any]) -> None:
    robot = {n: manifest[n] for n in ("layout", "controls", "ranges")} | {"robot": {}}
    manifest["variants"] = [robot] * 1_000


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A copy of a checkpoint to damage."""
    return Path(shutil.copytree(ZOO / "cartpole", tmp_path / "checkpoint"))


def _rewrite(folder: Path, change: Change) -> None:
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text())
    change(manifest)
    path.write_text(json.dumps(manifest))


@pytest.mark.parametrize("name", sorted(path.name for path in ZOO.iterdir() if path.is_dir()))
def test_the_zoo_is_sound(name: str) -> None:
    assert read_any(ZOO / name)["schema"] in (SCHEMA, CLOTH_SCHEMA)


REFUSED: dict[str, tuple[Change, str]] = {
    "controls": (_set(10**9, "controls"), "controls is 1000000000"),
    "controls, plausible": (_set(9_999, "controls"), "the manifest describes"),
    "width": (_set(16_384, "model", "width"), "width is 16384"),
    "width, plausible": (_set(8_192, "model", "width"), "parameters|the manifest describes"),
    "layers": (_set(100_000, "model", "layers"), "layers is 100000"),
    "layers, plausible": (_set(100, "model", "layers"), "not in the weights"),
    "heads": (_set(3, "model", "heads"), "a multiple of heads"),
    "variants": (_many_variants, "at most 100 robots"),
    "expansion": (_set(0, "model", "expansion"), "expansion is 0"),
    "type": (_set("128", "model", "width"), "model.width: expected int; got '128'"),
    "truth": (_set(1, "model", "skip"), "model.skip: expected bool"),
    "kind": (_set("other", "model", "kind"), "expected one of 'objects'"),
    "unknown": (_set(1, "model", "new"), "unknown entry 'new'"),
    "model": (_set([], "model"), "model: expected an object"),
    "no model": (_drop("model"), "no entry 'model'"),
    "layout": (_set(3, "layout"), "layout: expected an object"),
    "nq": (_set(10**9, "layout", "nq"), "nq is 1000000000"),
    "address": (_set([7, 8], "layout", "joint_q"), "addresses"),
    "names": (_set([1, 2], "layout", "joints"), r"layout.joints\[0\]: expected str"),
    "timestep": (_set(0, "layout", "timestep"), "timestep is 0"),
    "infinity": (_set(float("inf"), "layout", "timestep"), "expected float"),
    "large": (_set(10**400, "layout", "timestep"), "expected float"),
    "servo": (_set([99], "layout", "servo"), "servo"),
    "no ranges": (_drop("ranges"), "no entry 'ranges'"),
    "no joints": (_set({}, "ranges", "joints"), "ranges.joints has no entry"),
    "range": (_set([1], "ranges", "joints", "slider"), "expected 2 entries"),
    "far": (_set(1e300, "ranges", "joint_speed"), r"ranges go to 1e\+300"),
    "far, either side": (_set([-1e200, 0], "ranges", "joints", "slider"), "ranges go to"),
    "speed": (_set(None, "ranges", "joint_speed"), "expected float"),
    "sources": (_set("x", "data", "sources"), "data.sources"),
    "robot": (_set({"mass": "x"}, "data", "robot"), "data.robot.mass"),
    "config": (_drop("config"), "no entry 'config'"),
    "variant": (_set([{}], "variants"), "no entry"),
    "schema": (_set("other", "schema"), "not the manifest"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused(folder: Path, name: str) -> None:
    change, says = REFUSED[name]
    _rewrite(folder, change)
    watch = Stopwatch()
    with pytest.raises(InputError, match=says) as caught:
        load_checkpoint(folder)
    assert str(folder) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert watch.seconds < 20


@pytest.mark.parametrize("text", ["", "{", "[]", '{"schema": ' + "[" * 100_000, "null"])
def test_what_is_no_manifest(folder: Path, text: str) -> None:
    (folder / "manifest.json").write_text(text)
    with pytest.raises(InputError, match="not a checkpoint of learned dynamics"):
        load_checkpoint(folder)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda t: t * torch.nan, "is not finite"),
        (lambda t: torch.zeros(3), "of shape"),
        (lambda t: t.to(torch.int32), "is I32"),
        (lambda t: None, "is not in the weights"),
    ],
)
def test_weights_are_what_the_manifest_says(folder: Path, change: Any, says: str) -> None:
    path = str(folder / "model.safetensors")
    tensors = load_file(path)
    name = next(n for n, t in tensors.items() if t.dim() == 2)
    changed = change(tensors.pop(name))
    save_file(tensors if changed is None else {**tensors, name: changed}, path)
    with pytest.raises(InputError, match=says):
        load_checkpoint(folder)


def test_damaged_weights(folder: Path) -> None:
    path = folder / "model.safetensors"
    data = path.read_bytes()
    for damaged in (b"", data[:100], (2**60).to_bytes(8, "little") + data[8:]):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match="damaged"):
            load_checkpoint(folder)
    path.unlink()
    with pytest.raises(InputError, match="no such file"):
        load_checkpoint(folder)


def test_the_manifest_stays_as_it_is() -> None:
    manifest = read_manifest(ZOO / "push")
    before = copy.deepcopy(manifest)
    load_checkpoint(ZOO / "push")
    assert manifest == before


def test_numbers_of_a_robot_that_this_version_does_not_read(folder: Path) -> None:
    _rewrite(folder, _set([1.0], "data", "robot", "colour"))
    with pytest.warns(UserWarning, match="'colour', which this version does not read"):
        make_backend(f"learned:{folder}", load_scene("suite:cartpole-swingup"), native=False)


def test_figures_of_a_shipped_checkpoint_are_recomputed(tmp_path: Path) -> None:
    """On the first steps of the 40 held-out episodes: the median and the tail of the manifest."""
    path = tmp_path / "test.h5"
    collect("suite:cartpole-swingup", path, episodes=40, seed=1, workers=1, changes={"steps": 10})
    pack = read_data([path])
    checkpoint = load_for(ZOO / "cartpole", pack.layout)
    found = evaluate(checkpoint.model, pack, (10,), burn=0)["10"]
    said = checkpoint.manifest["metrics"]["model"]["10"]
    assert found["episodes"] == said["episodes"] == 40
    for quantity in ("joint_position", "joint_velocity"):  # rounded to 15 bits since
        for level in ("median", "p95"):
            assert found[quantity][level] == pytest.approx(said[quantity][level], rel=0.1)


@pytest.mark.parametrize("name", ["cartpole", "cubes"])
def test_the_number_of_parameters_is_that_of_the_network(name: str) -> None:
    manifest = read_manifest(ZOO / name)
    models = [
        load_checkpoint(ZOO / name, variant=number).model
        for number in range(len(variants(manifest)))
    ]
    for model in models[1:]:
        model.share(models[:1])
    assert manifest["parameters"] == sum(p.numel() for p in nn.ModuleList(models).parameters())


def test_a_checkpoint_is_taken_by_its_name_or_its_folder() -> None:
    backend = make_backend("learned:push_contacts", load_scene("task:push"))
    assert backend.checkpoint.path == ZOO / "push_contacts"
    assert zoo.located(ZOO / "push") == ZOO / "push"
    with pytest.raises(InputError, match=r"push_contact: no such folder, and the zoo .*push_cont"):
        make_backend("learned:push_contact", load_scene("task:push"))


def test_of_those_that_know_a_task_the_one_of_fewest_tasks_is_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, more in (("first", ["task:stack", "task:push_cubes"]), ("second", [])):
        shutil.copytree(ZOO / "push", tmp_path / name)
        path = tmp_path / name / "manifest.json"
        manifest = json.loads(path.read_text())
        manifest["data"]["sources"] += [{"task": task, "episodes": 1} for task in more]
        path.write_text(json.dumps(manifest))
    monkeypatch.setattr(zoo, "FOLDER", tmp_path)
    found, _ = zoo.find(load_scene("task:push"))
    assert found.name == "second"


def test_one_of_any_robot_stands_in_for_a_robots_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("cartpole", "suite_one", "finger"):
        (tmp_path / name).symlink_to(ZOO / name)
    monkeypatch.setattr(zoo, "FOLDER", tmp_path)
    for task in ("pendulum-swingup", "reacher-easy", "walker-run"):
        found, fit = zoo.find(load_scene(f"suite:{task}"))
        assert found.name == "suite_one" and not fit.concerns
    assert zoo.find(load_scene("suite:cartpole-balance"))[0].name == "cartpole"  # its own robot's
    for task, reason in (
        ("humanoid-run", "neither hinges nor slides"),
        ("ball_in_cup-catch", "no tendons with springs"),
    ):
        with pytest.raises(UnsupportedSceneError) as refused:
            zoo.find(load_scene(f"suite:{task}"))
        assert "suite_one: a model of limbs knows" in str(refused.value)
        assert reason in str(refused.value) and "finger:" not in str(refused.value)
