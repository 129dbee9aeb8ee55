"""Toy checkpoints for the tests of the learned backend."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from orbisim_world_model import zoo
from orbisim_world_model.cloth.run import train_cloth
from orbisim_world_model.config import Config, replaced
from orbisim_world_model.pack import Pack
from orbisim_world_model.presets import preset
from orbisim_world_model.run import Run, train

from orbisim.testing import scenes
from tests.backends.world_model.cloth.falls import falls, toy_cloth
from tests.backends.world_model.synthetic import simulate

TOY = {"model.width": 32, "model.layers": 2, "model.heads": 2}


def toy(name: str = "default", stages: str = "1x1x64", **changes: object) -> Config:
    """A configuration that trains in seconds on a CPU."""
    dotted = {key.replace("__", "."): value for key, value in changes.items()}
    return replaced(preset(name), {**TOY, "train.stages": stages, **dotted})


@pytest.fixture(scope="session")
def toy_checkpoints(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a hardly trained model for each scene of the conformance tests."""
    folder = tmp_path_factory.mktemp("zoo")
    for name in ("CARTPOLE", "FILTERED", "FREE_BODY", "RESTING_BOX"):
        pack = simulate(getattr(scenes, name), 6, 30, 1)
        train(pack, toy(), Run(out=folder / name.lower(), steps=30))
    train_cloth(falls(), toy_cloth(), Run(out=folder / "cloth", steps=20))
    return folder


@pytest.fixture(scope="module")
def toy_zoo(toy_checkpoints: Path) -> Iterator[Path]:
    """Instead of the zoo, until the module's tests are over."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(zoo, "FOLDER", toy_checkpoints)
        yield toy_checkpoints


@pytest.fixture(scope="session", autouse=True)
def one_thread() -> None:
    """Small products are slower on many threads."""
    torch.set_num_threads(1)


def halves(pack: Pack) -> Pack:
    """The pack without its last object."""
    layout = pack.layout
    fewer = dataclasses.replace(layout, objects=layout.objects[:-1])
    return dataclasses.replace(pack, layout=fewer)
