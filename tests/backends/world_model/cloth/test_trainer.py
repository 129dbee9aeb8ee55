"""Training of a cloth, its checkpoints, and how they step scenes."""

from __future__ import annotations

import json
import shutil
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from orbisim_world_model.backend import LearnedBackend, OutsideTrainingWarning
from orbisim_world_model.cloth.card import cloth_card, worse_than_known
from orbisim_world_model.cloth.checkpoint import load_cloth
from orbisim_world_model.cloth.config import cloth_preset
from orbisim_world_model.cloth.evaluate import evaluate_cloth
from orbisim_world_model.cloth.manifest import read_cloth_manifest
from orbisim_world_model.cloth.mesh import Cloth
from orbisim_world_model.cloth.run import train_cloth
from orbisim_world_model.run import Run

from orbisim import load_scene, make_backend
from orbisim.errors import DivergedError, InputError, UnknownNameError, UnsupportedSceneError
from orbisim.tasks.drape import Drape
from orbisim.testing import scenes
from tests.backends.world_model.cloth.falls import falls, toy_cloth

EDIT = Callable[[dict[str, Any]], None]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cloth") / "toy"
    train_cloth(falls(), toy_cloth(), Run(out=folder, steps=20, held_out=0.25))
    return folder


def _backend(folder: Path, **options: Any) -> LearnedBackend:
    scene = load_scene(scenes.CLOTH)
    backend = make_backend(f"learned:{folder}", scene, device="cpu", **options)
    assert isinstance(backend, LearnedBackend)
    return backend


@pytest.mark.parametrize("name", ["cloth", "cloth_free", "cloth_shape"])
def test_training_brings_the_error_down(name: str, tmp_path: Path) -> None:
    """Of what it was trained on: below that of going on as before, and of its own start."""
    lines: list[dict[str, Any]] = []
    stages = {"train__stages": "1x4x8", "train__noise": "0.05"}
    run = Run(out=tmp_path / "out", steps=60, log_every=10)
    train_cloth(falls(), toy_cloth(name, **stages), run, lines.append, held=falls())
    assert lines[-1]["loss"] < 0.9 * lines[0]["loss"]
    metrics = read_cloth_manifest(tmp_path / "out")["metrics"]
    ours, theirs = (metrics[who]["10"]["vertex_position"] for who in ("model", "constant_velocity"))
    assert ours["mean"] < theirs["mean"]


def test_a_training_goes_on_exactly_where_it_was(tmp_path: Path) -> None:
    weights = []
    for name, parts in (("once", (8,)), ("twice", (4, 8))):
        for steps in parts:
            run = Run(out=tmp_path / name, steps=steps, resume=steps == 8 and name == "twice")
            # the rate depends on the whole length, which a resumed training knows
            train_cloth(falls(), toy_cloth(train__rate="0.001", train__final_rate="0.001"), run)
        weights.append(load_cloth(tmp_path / name, falls().mesh).model.state_dict())
    for key, value in weights[0].items():
        torch.testing.assert_close(weights[1][key], value, rtol=0, atol=0)


def test_it_leaves_what_every_training_leaves(folder: Path) -> None:
    names = {path.name for path in folder.iterdir()}
    assert {"model.safetensors", "manifest.json", "card.md", "metrics.jsonl", "curves.png"} <= names
    manifest = read_cloth_manifest(folder)
    card = (folder / "card.md").read_text()
    assert card == cloth_card(manifest) and f"{manifest['parameters']:,} parameters" in card
    metrics = manifest["metrics"]
    truth = falls().split(0.25)[1]
    again = evaluate_cloth(load_cloth(folder, truth.mesh).model, truth)
    found, known = (m["10"]["vertex_position"]["median"] for m in (metrics["model"], again))
    assert found == pytest.approx(known, rel=1e-6)
    assert set(worse_than_known(metrics)) <= set(metrics["model"])


def test_the_backend_is_the_model(folder: Path) -> None:
    data, backend = falls(), _backend(folder, nworld=2)
    qpos, qvel, act = data.mesh.join(data.x.at((slice(0, 2), 0)))
    state = backend.reset(2).replace(qpos=qpos.double().numpy(), qvel=qvel.double().numpy())
    rolled = backend.rollout(state, np.zeros((2, 12, 0)))
    model = load_cloth(folder, data.mesh).model
    x = data.x.at((slice(0, 2), 0))
    with torch.no_grad():
        for _ in range(12):
            x = model(x, data.solids.at(slice(0, 2)))
    last = (rolled.qpos[:, -1], rolled.qvel[:, -1])
    places = data.mesh.split(*(torch.as_tensor(a, dtype=torch.float32) for a in last)).pos
    torch.testing.assert_close(places, x.pos, atol=1e-5, rtol=0)
    assert backend.entity_names == ("cloth",) and backend.uncertainty(rolled) is None
    assert act.shape == (2, 0)


def test_gradients_flow_to_the_first_state(folder: Path) -> None:
    backend = _backend(folder)
    state = backend.reset(1)
    qvel = torch.zeros(1, backend.model.nv, dtype=torch.float64, requires_grad=True)
    given = state.replace(qpos=torch.as_tensor(state.qpos), qvel=qvel)
    final = backend.rollout(given, np.zeros((1, 4, 0))).final
    final.qpos.sum().backward()
    assert qvel.grad is not None
    eps, way = 1e-2, np.random.default_rng(0).standard_normal(qvel.shape)
    ahead, behind = (
        backend.rollout(state.replace(qvel=sign * eps * way), np.zeros((1, 4, 0))).final.qpos.sum()
        for sign in (1, -1)
    )
    slope = float((qvel.grad.numpy() * way).sum())
    assert slope == pytest.approx((ahead - behind) / (2 * eps), rel=0.05, abs=1e-3)


def test_divergence_names_the_cloth(folder: Path) -> None:
    backend = _backend(folder, nworld=2)
    state = backend.reset(2)
    torn = np.array(state.qpos)
    torn[1, 0] += 3.0  # one vertex, three metres away
    calm = backend.stepping.model.forward  # type: ignore[attr-defined]

    def away(x: Cloth, *_: Any) -> Cloth:
        after = calm(x, *_)
        return after._replace(pos=after.pos * torch.tensor([[[1.0]], [[30.0]]]))

    backend.stepping.model.forward = away  # type: ignore[attr-defined]
    try:
        with pytest.raises(DivergedError, match=r"world 1 first, at step 0 by 'cloth'") as caught:
            backend.step(state)
        assert caught.value.worlds == (1,)
    finally:
        backend.stepping.model.forward = calm  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("what", "match"), [("high", "m high"), ("fast", "speed"), ("wide", "strain")]
)
def test_what_lies_outside_the_training_data_is_said(folder: Path, what: str, match: str) -> None:
    backend = _backend(folder)
    state, mesh = backend.reset(1), falls().mesh
    qpos, qvel = np.array(state.qpos), np.array(state.qvel)
    if what == "high":
        qpos[:, mesh.address[:, 2].numpy()] += 0.5
    elif what == "fast":
        qvel += 10.0
    else:
        qpos[:, mesh.address[0, 0].item()] -= 0.3
    with pytest.warns(OutsideTrainingWarning, match=match):
        backend.rollout(state.replace(qpos=qpos, qvel=qvel), np.zeros((1, 1, 0)))


def test_another_cloth_is_warned_of_by_what_differs(folder: Path) -> None:
    scene = load_scene(scenes.CLOTH.replace('mass="0.02"', 'mass="0.2"'))
    with pytest.warns(OutsideTrainingWarning, match="the cloth's mass"):
        make_backend(f"learned:{folder}", scene)


def test_a_graph_steps_a_cloth_of_another_size_and_a_shape_does_not(
    folder: Path, tmp_path: Path
) -> None:
    other = load_scene(scenes.CLOTH.replace('count="4 4 1"', 'count="5 3 1"'))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OutsideTrainingWarning)
        engine = make_backend(f"learned:{folder}", other)
        assert engine.step(engine.reset()).finite.all()
    train_cloth(falls(), toy_cloth("cloth_shape"), Run(out=tmp_path / "shape", steps=1))
    with pytest.raises(UnsupportedSceneError, match="cloths of 16 vertices; the scene's has 15"):
        make_backend(f"learned:{tmp_path / 'shape'}", other)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (scenes.CARTPOLE, "one flex of free vertices"),
        (scenes.CLOTH.replace('timestep="0.002"', 'timestep="0.003"'), "not a multiple"),
    ],
)
def test_checkpoints_of_other_scenes_say_so(folder: Path, text: str, match: str) -> None:
    with pytest.raises(UnsupportedSceneError, match=match):
        make_backend(f"learned:{folder}", load_scene(text))


def test_other_backends_and_commands_refuse_it(folder: Path) -> None:
    with pytest.raises(InputError, match="backend 'learned'"):
        make_backend(f"hybrid:{folder}", load_scene(scenes.CLOTH))
    with pytest.raises(UnsupportedSceneError, match="no robot, objects or descriptors"):
        backend = _backend(folder)
        backend.with_properties(backend.reset(), world={"gravity_z": -1.0})


@pytest.mark.parametrize(
    ("edit", "match"),
    [
        (lambda m: m.update(schema="orbisim.cloth/9"), "not the manifest"),
        (lambda m: m["model"].update(width="wide"), "model.width"),
        (lambda m: m["model"].update(width=10**6), "model.width is 1000000; expected 1 to"),
        (lambda m: m["model"].update(colour=1), "unknown entry 'colour'"),
        (lambda m: m["ranges"].pop("strain"), "strain"),
        (lambda m: m["ranges"].update(vertices=[3, 2]), "ranges.vertices"),
        (lambda m: m.update(control_timestep=0.0), "control_timestep"),
        (lambda m: m["data"].update(sources=3), "sources"),
        (lambda m: m["model"].update(layers=3), "damaged"),
    ],
)
def test_damaged_manifests_are_named(folder: Path, tmp_path: Path, edit: EDIT, match: str) -> None:
    broken = tmp_path / "broken"
    shutil.copytree(folder, broken)
    manifest = json.loads((broken / "manifest.json").read_text())
    edit(manifest)
    (broken / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(InputError, match=match) as caught:
        make_backend(f"learned:{broken}", load_scene(scenes.CLOTH))
    assert "broken" in str(caught.value)


def test_damaged_weights_are_named(folder: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken"
    shutil.copytree(folder, broken)
    (broken / "model.safetensors").write_bytes(b"no weights")
    with pytest.raises(InputError, match="damaged"):
        make_backend(f"learned:{broken}", load_scene(scenes.CLOTH))


def test_unknown_configurations_and_settings_are_named() -> None:
    with pytest.raises(UnknownNameError, match="cloht"):
        cloth_preset("cloht")
    with pytest.raises(UnknownNameError, match=r"model\.widht"):
        cloth_preset("cloth", {"model.widht": "3"})
    with pytest.raises(InputError, match=r"train\.stages"):
        cloth_preset("cloth", {"train.stages": "half"})


def test_nothing_to_learn_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nothing is learned"):
        train_cloth(falls(), toy_cloth(model__kind="copy"), Run(out=tmp_path / "out", steps=1))


def test_drape_from_its_own_episodes(tmp_path: Path) -> None:
    """From `orbisim collect` to the backend, on one fall."""
    from orbisim_world_model.cloth.data import read_falls

    from orbisim.tasks.collect import collect

    collect("task:drape", tmp_path / "drape.h5", episodes=2, workers=1, subtask="unseen")
    data = read_falls([tmp_path / "drape.h5"])
    assert (data.episodes, data.steps, data.notes["groups"]) == (2, 100, ["unseen"])
    train_cloth(data, toy_cloth(), Run(out=tmp_path / "out", steps=1))
    scene = Drape().scene("unseen", 0)
    engine = make_backend(f"learned:{tmp_path / 'out'}", scene, nworld=1)
    assert engine.step(engine.reset()).finite.all()
    assert engine.timestep == 0.02
