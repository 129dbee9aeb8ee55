"""Named configurations."""

from __future__ import annotations

import dataclasses

import pytest
from orbisim_world_model.presets import DEFAULT, PAPER, PRESETS, preset

from orbisim.errors import UnknownNameError


def test_names_are_those_of_the_configurations() -> None:
    assert all(config.name == name for name, config in PRESETS.items())
    assert preset("default") is DEFAULT
    with pytest.raises(UnknownNameError, match="did you mean 'dreamer'"):
        preset("draemer")


@pytest.mark.parametrize("name", [n for n in PRESETS if n.startswith("no_")])
def test_an_ablation_takes_away_what_it_is_named_after(name: str) -> None:
    config = PRESETS[name]
    changed = [
        f"{group}.{field.name}"
        for group in ("model", "loss", "train")
        for field in dataclasses.fields(getattr(config, group))
        if getattr(getattr(config, group), field.name)
        != getattr(getattr(DEFAULT, group), field.name)
    ]
    assert any(path.endswith(name.removeprefix("no_")) for path in changed)
    assert len(changed) <= 2


def test_the_paper_predicts_absolute_values_without_angular_velocities() -> None:
    model = PAPER.model
    assert not any((model.residual, model.manifold, model.relative, model.extended, model.skip))
    assert model.memory == "gru"
