"""Scenes: edited, compiled, named."""

from __future__ import annotations

import pytest

from orbisim import Scene, load_scene
from orbisim.errors import InputError, UnknownNameError

from .test_mjcf import EVERYTHING


def test_editing_a_copy() -> None:
    scene = load_scene(EVERYTHING)
    spec = scene.spec
    spec.option.gravity = [0, 0, -1]
    assert Scene.from_spec(spec).model.opt.gravity[2] == -1
    assert load_scene(EVERYTHING).fingerprint == scene.fingerprint
    assert Scene.from_spec(spec).fingerprint != scene.fingerprint
    assert scene.model.opt.gravity[2] == -9.81


def test_a_compiled_model_has_no_document() -> None:
    scene = Scene.from_model(load_scene(EVERYTHING).model)
    assert not scene.editable
    with pytest.raises(InputError, match="cannot be edited"):
        _ = scene.spec


def test_task_names() -> None:
    scene = load_scene("suite:cheetah-run")
    assert scene.model.nv == 9
    assert scene.source == "suite:cheetah-run"
    with pytest.raises(UnknownNameError, match="did you mean 'cheetah-run'"):
        load_scene("suite:cheetah-runn")
