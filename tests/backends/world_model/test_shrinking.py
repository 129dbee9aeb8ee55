"""Checkpoints that are written again in few bits a weight."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from orbisim_world_model import shrinking, zoo
from orbisim_world_model.checkpoint import load_checkpoint
from orbisim_world_model.cloth.checkpoint import load_cloth
from orbisim_world_model.cloth.run import train_cloth
from orbisim_world_model.dynamics import Dynamics
from orbisim_world_model.packing import read_data
from orbisim_world_model.run import Run
from orbisim_world_model.shrinking import (
    remove_unused,
    save_cloth_in_few_bits,
    save_in_few_bits,
)

from orbisim.errors import InputError
from orbisim.files.reading import read_json
from orbisim.tasks.collect import collect
from tests.backends.world_model.cloth.falls import falls, toy_cloth

ZOO = Path(zoo.__file__).parent / "zoo"
TASKS = {"cartpole": "suite:cartpole-swingup", "ball": "ball"}
"""A robot alone, and an object alone."""


def _next(model: Dynamics, path: Path) -> torch.Tensor:
    """The states after one step from those of an episode, all numbers of each."""
    pack = read_data([path])
    rows = torch.arange(30)
    x = model.completed(pack.states(rows))
    context = pack.context(torch.zeros(30, dtype=torch.long))
    with torch.no_grad():
        after = model(x, model.initial_memory(30), pack.controls(model.config)[rows], context)
    return torch.cat([field.flatten(1) for field in after.state], dim=1)


@pytest.mark.parametrize("name", TASKS)
def test_what_is_removed_was_not_used(name: str, tmp_path: Path) -> None:
    path = tmp_path / "some.h5"
    collect(TASKS[name], path, episodes=1, seed=5)
    before, removed = (load_checkpoint(ZOO / name).model for _ in range(2))
    remove_unused([removed])
    assert torch.allclose(_next(removed, path), _next(before, path), atol=2e-6)


def test_few_bits_give_nearly_the_same_step(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shrinking, "_SEQUENCES", 60)
    path = tmp_path / "some.h5"
    collect("ball", path, episodes=2, seed=5)
    before = load_checkpoint(ZOO / "ball").model
    save_in_few_bits(ZOO / "ball", tmp_path / "small", [read_data([path])], 8)
    after = load_checkpoint(tmp_path / "small").model
    size = (tmp_path / "small" / "model.safetensors").stat().st_size
    assert size < 1_150_000  # 1.01 million weights
    change, error = _next(before, path), _next(after, path)
    scale = (change - change.mean(0)).abs().amax(0).clamp_min(1e-3)
    assert ((error - change).abs() / scale).max() < 3e-3


def test_nearest_in_many_bits_changes_less_than_half_precision(tmp_path: Path) -> None:
    save_in_few_bits(ZOO / "cubes", tmp_path / "small", None, 14)
    for variant in (0, 1):
        before, after = (
            load_checkpoint(folder, variant=variant).model.state_dict()
            for folder in (ZOO / "cubes", tmp_path / "small")
        )
        name = "network.f_cp.blocks.0.mix.0.weight"
        off = (before[name] - after[name]).abs().max()
        assert 0 < off < 2.0**-13 * before[name].abs().max()


def test_a_cloth_in_few_bits_steps_nearly_as_before(tmp_path: Path) -> None:
    toy, small = tmp_path / "toy", tmp_path / "small"
    data = falls()
    train_cloth(data, toy_cloth(), Run(out=toy, steps=2))
    save_cloth_in_few_bits(toy, small, 10)
    assert read_json(small / "manifest.json") == read_json(toy / "manifest.json")
    before, after = (load_cloth(folder, data.mesh).model for folder in (toy, small))
    for (name, old), new in zip(
        before.state_dict().items(), after.state_dict().values(), strict=True
    ):
        off = (new - old).abs().max() / old.abs().max().clamp_min(1e-9)
        assert off <= (2.0**-9 if name.startswith("network.") and old.dim() == 2 else 0.0), name
    with pytest.raises(InputError, match="has few bits a weight already"):
        save_cloth_in_few_bits(small, tmp_path / "smaller", 8)


def test_what_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="knows 2 robots; got episodes of 1"):
        save_in_few_bits(ZOO / "cubes", tmp_path, [None], 8)  # type: ignore[list-item]
