"""Episodes with different numbers of objects, and robots that share a model."""

from __future__ import annotations

import dataclasses
import warnings
from pathlib import Path

import numpy as np
import pytest
import torch
from orbisim_world_model.checkpoint import load_checkpoint, load_for
from orbisim_world_model.config import Config, replaced
from orbisim_world_model.manifest import read_manifest, variants
from orbisim_world_model.pack import Pack, grouped, joined
from orbisim_world_model.packing import pack_file, read_groups
from orbisim_world_model.run import Run, train
from orbisim_world_model.sampling import Windows
from orbisim_world_model.schedule import Clock
from orbisim_world_model.trainer import Trainer, new_models
from orbisim_world_model.unroll import open_loop

from orbisim import make_backend, tasks
from orbisim.errors import InputError
from orbisim.tasks import EpisodeFile
from orbisim.tasks.collect import collect
from tests.backends.world_model.conftest import toy
from tests.backends.world_model.synthetic import BOX, TABLE, simulate

STAGES = "0.5x1x32,0.5x3x16ar"


@pytest.fixture(scope="module")
def cubes(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """A few episodes of two robots with two to four cubes."""
    folder = tmp_path_factory.mktemp("cubes")
    paths = [folder / "push_cubes.h5", folder / "pick_and_place.h5"]
    collect("push_cubes", paths[0], episodes=6, workers=1)
    collect("pick_and_place", paths[1], episodes=3, workers=1)
    return paths


@pytest.fixture(scope="module")
def checkpoint(cubes: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("trained")
    train(read_groups(cubes), toy("default", STAGES), Run(out=out, steps=6, horizons=(10,)))
    return out


def test_each_object_keeps_its_states_and_attributes(cubes: list[Path]) -> None:
    pack = pack_file(cubes[0])
    assert pack.layout.objects == ("cube1", "cube2", "cube3", "cube4")
    assert len(set(pack.mask.sum(1).tolist())) > 1
    with EpisodeFile(cubes[0]) as file:
        for index in range(len(file)):
            data = file.episode(index)
            count = data["objects/pos"].shape[1]
            assert pack.mask[index].tolist() == [1.0] * count + [0.0] * (4 - count)
            first, length = int(pack.start[index]), int(pack.length[index])
            x = pack.states(torch.arange(first, first + length + 1))
            np.testing.assert_allclose(x.pos[:, :count], data["objects/pos"], atol=1e-6)
            np.testing.assert_allclose(x.ang[:, :count], data["objects/angvel"], atol=1e-4)
            np.testing.assert_allclose(x.q, data["robot/qpos"], atol=1e-6)
            assert not x.pos[:, count:].any() and not x.vel[:, count:].any()
            columns = file.columns("descriptor/objects", index)
            mass = data["descriptor/objects"][:, columns.index("mass")]
            column = pack.layout.attributes.index("mass")
            np.testing.assert_allclose(pack.attributes[index, :count, column], mass, rtol=1e-6)


def test_objects_beyond_the_nominal_scenes_are_read(tmp_path: Path) -> None:
    path = tmp_path / "three.h5"
    collect("push", path, episodes=1, workers=1, subtask="three")
    pack = pack_file(path)
    assert pack.layout.objects == ("cube1", "cube2", "cube3")
    with EpisodeFile(path) as file:
        x = pack.states(torch.arange(len(pack.qpos)))
        np.testing.assert_allclose(x.pos, file.episode(0)["objects/pos"], atol=1e-6)


def _larger(pack: Pack) -> Pack:
    """The pack with an object that no episode has."""
    layout = pack.layout
    wider = dataclasses.replace(
        layout,
        nq=layout.nq + 7,
        nv=layout.nv + 6,
        objects=(*layout.objects, "absent"),
        object_q=(*layout.object_q, layout.nq),
        object_v=(*layout.object_v, layout.nv),
    )
    other = dataclasses.replace(pack, layout=wider)
    rows = len(pack.qpos)
    unturned = torch.tensor([0.0, 0, 0, 1, 0, 0, 0]).expand(rows, 7)
    other = dataclasses.replace(
        other,
        qpos=torch.cat([pack.qpos, unturned], 1),
        qvel=torch.cat([pack.qvel, torch.zeros(rows, 6)], 1),
        attributes=torch.cat([pack.attributes, torch.zeros_like(pack.attributes[:, :1])], 1),
        mask=torch.cat([pack.mask, torch.zeros_like(pack.mask[:, :1])], 1),
    )
    return joined([other])


def _gradient(pack: Pack, config: Config) -> tuple[torch.Tensor, torch.Tensor]:
    trainer = Trainer(pack, config, Clock(2, None))
    trainer.step()
    return trainer.losses()["loss"], trainer.optimizer.gradient.clone()  # type: ignore[return-value]


def test_an_absent_object_changes_neither_loss_nor_gradient() -> None:
    pack = simulate(TABLE, 4, 20, 4)
    config = toy("default", "1x3x16ar", train__noise=0.0)
    plain, padded = _gradient(pack, config), _gradient(_larger(pack), config)
    assert plain[0] == pytest.approx(padded[0], rel=1e-5)
    torch.testing.assert_close(plain[1], padded[1], rtol=1e-3, atol=1e-6)


def test_absent_objects_stay_where_they_are() -> None:
    pack = _larger(simulate(TABLE, 4, 20, 4))
    model = Trainer(pack, toy(), Clock(2, None)).models[0].eval()
    batch = Windows(pack, 10, model.config).batch(pack.start, torch.arange(4))
    predicted = open_loop(model, batch, 0)
    assert not predicted.pos[:, :, 2].any() and not predicted.vel[:, :, 2].any()


def test_packs_are_grouped_by_robot(cubes: list[Path]) -> None:
    packs = [pack_file(path) for path in cubes]
    assert [len(pack.layout.joints) for pack in grouped([packs[0], packs[1], packs[0]])] == [8, 9]
    with pytest.raises(InputError, match="do not fit into one model"):
        joined(packs)


def test_robots_share_all_but_their_own_parts(cubes: list[Path]) -> None:
    one, two = new_models(read_groups(cubes), toy(), 0)
    mine = {id(p) for p in one.parameters()}
    own = {name for name, p in two.named_parameters() if id(p) not in mine}
    assert own and all(
        name.startswith(("network.f_enc.robot", "network.f_dec.robot", "network.robot_condition"))
        for name in own
    )
    assert two.object_scale is one.object_scale and two.see_robot is not one.see_robot
    with pytest.raises(InputError, match="fit into one model only"):
        new_models([read_groups(cubes)[0], simulate(BOX, 3, 10, 2)], toy("global"), 0)


def test_a_checkpoint_of_two_robots_steps_their_scenes(cubes: list[Path], checkpoint: Path) -> None:
    manifest = read_manifest(checkpoint)
    assert [len(view["layout"]["joints"]) for view in variants(manifest)] == [8, 9]
    assert len(manifest["metrics"]["variants"]) == 1
    for name, joints, cubes_of in (("push_cubes", 8, {2, 3, 4}), ("pick_and_place", 9, {3, 4})):
        seen = set()
        for seed in range(6):
            subtask = ("to_hit", None)[seed % 2] if name == "push_cubes" else None
            scene = tasks.make(name).scene(subtask, seed=seed)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                backend = make_backend(f"learned:{checkpoint}", scene)
                state = backend.step(backend.reset(2))
            assert state.finite.all() and backend.engine.layout.joints  # type: ignore[attr-defined]
            assert len(backend.engine.layout.joints) == joints  # type: ignore[attr-defined]
            seen.add(len(backend.engine.layout.objects))  # type: ignore[attr-defined]
        assert seen <= cubes_of and len(seen) > 1


def test_the_checkpoint_of_two_robots_is_what_was_trained(
    cubes: list[Path], checkpoint: Path
) -> None:
    packs = read_groups(cubes)
    for number, pack in enumerate(packs):
        found = load_for(checkpoint, pack.layout)
        assert found.layout == pack.layout
        other = load_checkpoint(checkpoint, variant=number).model.state_dict()
        for name, tensor in found.model.state_dict().items():
            assert torch.equal(tensor, other[name]), name
    with pytest.raises(InputError, match=r"trained on 8 joints, 4 objects.* and on 9 joints"):
        load_for(checkpoint, simulate(TABLE, 2, 5, 4).layout)


def test_a_training_of_two_robots_is_resumed_and_fine_tuned(
    cubes: list[Path], tmp_path: Path
) -> None:
    packs, config = read_groups(cubes), toy("default", STAGES)
    train(packs, config, Run(out=tmp_path / "whole", steps=4, horizons=(10,)))

    class Killed(Exception):
        pass

    def kill(line: dict[str, float]) -> None:
        if line["step"] == 2:
            raise Killed

    parts = tmp_path / "parts"
    with pytest.raises(Killed):
        train(packs, config, Run(out=parts, steps=4, log_every=1, save_every=0.0), kill)
    train(packs, config, Run(out=parts, steps=4, resume=True, horizons=(10,)))
    for number in range(2):
        whole = load_checkpoint(tmp_path / "whole", variant=number).model.state_dict()
        for name, tensor in load_checkpoint(parts, variant=number).model.state_dict().items():
            assert torch.equal(tensor, whole[name]), name
    tuned = Run(out=tmp_path / "tuned", steps=1, start=parts, horizons=(10,))
    assert train(packs[1], config, tuned)["layout"]["nu"] == 8
    rested = replaced(config, {"model.rest": True, "model.width": 8})
    found = train(packs[1], rested, dataclasses.replace(tuned, out=tmp_path / "rested"))
    assert found["model"]["rest"] is True  # needs no weights
    assert found["model"]["width"] == config.model.width  # is the checkpoint's
