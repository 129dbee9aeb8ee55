"""Objects and mechanisms in one model."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest
import torch
from orbisim_world_model.checkpoint import load_for
from orbisim_world_model.config import Config
from orbisim_world_model.manifest import read_manifest
from orbisim_world_model.pack import Pack, grouped
from orbisim_world_model.run import Run, train
from orbisim_world_model.trainer import new_models

from orbisim import load_scene, make_backend
from orbisim.errors import InputError, UnsupportedSceneError
from tests.backends.world_model.conftest import toy
from tests.backends.world_model.synthetic import PANEL, TABLE, simulate


@pytest.fixture(scope="module")
def packs() -> list[Pack]:
    return grouped([simulate(TABLE, 6, 20, 4), simulate(PANEL, 6, 20, 4)])


def mixed(value: bool = True) -> Config:
    return toy("parts", "0.5x1x16,0.5x3x16ar", model__mixed=value)


def test_they_share_what_both_need(packs: list[Pack]) -> None:
    cubes, panel = new_models(packs, mixed(), 0)
    assert panel.network.f_cp is cubes.network.f_cp
    assert panel.network.start is cubes.network.start
    assert panel.see_edges is cubes.see_edges
    assert cubes.network.f_dec.parts is None and panel.network.f_dec.objects is None
    assert panel.see_robot is not cubes.see_robot
    with pytest.raises(InputError, match=r"only with model\.mixed"):
        new_models(packs, mixed(False), 0)


def test_scales_of_what_is_shared_are_of_all_data(packs: list[Pack]) -> None:
    cubes, panel = new_models(packs, mixed(), 0)
    (alone,) = new_models(packs[:1], mixed(), 0)
    assert not torch.equal(alone.see_edges.std, cubes.see_edges.std)
    torch.testing.assert_close(alone.object_scale.std, cubes.object_scale.std)
    assert bool((panel.part_scale.std > 0).any())


def test_a_checkpoint_steps_scenes_of_both_kinds(packs: list[Pack], tmp_path: Path) -> None:
    train(packs, mixed(), Run(out=tmp_path / "one", steps=4, horizons=(5,)))
    manifest = read_manifest(tmp_path / "one")
    assert "shapes" in manifest["data"] and len(manifest["metrics"]["variants"]) == 1
    models = [load_for(tmp_path / "one", pack.layout).model for pack in packs]
    for name, tensor in models[0].network.f_cp.state_dict().items():
        assert torch.equal(tensor, models[1].network.f_cp.state_dict()[name]), name
    for scene in (TABLE, PANEL):  # of a robot that it does not know
        with pytest.raises(UnsupportedSceneError, match=r"with joints .*scene has \('left'"):
            make_backend(f"learned:{tmp_path / 'one'}", load_scene(scene.replace('"x"', '"left"')))
    for scene, objects in ((TABLE, 1), (PANEL, 0)):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            backend = make_backend(f"learned:{tmp_path / 'one'}", load_scene(scene))
            state = backend.step(backend.reset(2))
        assert state.finite.all()
        assert len(backend.engine.layout.objects) >= objects  # type: ignore[attr-defined]
