"""Configurations to and from JSON and settings."""

from __future__ import annotations

import json

import pytest
from orbisim_world_model.config import Config, Stage, replaced, settings
from orbisim_world_model.presets import PRESETS

from orbisim.errors import InputError, UnknownNameError


@pytest.mark.parametrize("name", PRESETS)
def test_json_there_and_back(name: str) -> None:
    config = PRESETS[name]
    assert Config.from_dict(json.loads(json.dumps(config.to_dict()))) == config


def test_settings_as_text() -> None:
    found = replaced(
        Config(),
        {"model.width": "64", "train.rate": "1e-4", "model.touch": "yes", "model.kind": "global"},
    )
    assert (found.model.width, found.train.rate) == (64, 1e-4)
    assert found.model.touch is True
    assert found.model.kind == "global"
    assert found.loss == Config().loss


def test_stages_as_text() -> None:
    text = "0.4x4x2048, 0.6x16x512ar,1x2x3arf,0.5x108x256arw8/36"
    found = replaced(Config(), {"train.stages": text}).train.stages
    assert found == (
        Stage(0.4, 4, 2048),
        Stage(0.6, 16, 512, autoregressive=True),
        Stage(1.0, 2, 3, autoregressive=True, full=True),
        Stage(0.5, 108, 256, autoregressive=True, warm=8, reach=36),
    )


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("model.width", "wide"),
        ("model.touch", "perhaps"),
        ("train.stages", "1x2"),
        ("train.stages", "1x2x3ra"),
        ("train.stages", "1x2x3arw"),
        ("train.rate", ""),
    ],
)
def test_values_that_do_not_fit(name: str, value: str) -> None:
    with pytest.raises(InputError, match=f"setting {name} is {value!r}"):
        replaced(Config(), {name: value})


@pytest.mark.parametrize("name", ["model.widht", "width", "name", "other.width"])
def test_unknown_settings(name: str) -> None:
    with pytest.raises(UnknownNameError):
        replaced(Config(), {name: "1"})
    assert "model.width" in settings(Config())


def test_what_was_said_until_0_1() -> None:
    old = Config().to_dict()
    old["train"]["precision"] = "bf16"
    assert Config.from_dict(old).train.precision == "tf32"
