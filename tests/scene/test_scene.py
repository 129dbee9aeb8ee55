"""Scenes: edited, compiled, named."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from dm_control import suite

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


@pytest.mark.parametrize("name", ["finger", "humanoid", "ball_in_cup"])
def test_without_images_only_textures_differ(name: str) -> None:
    scene = load_scene(Path(suite.__file__).with_name(f"{name}.xml"))
    bare = scene.without_images()
    assert 100 * bare.model.ntexdata < scene.model.ntexdata
    assert bare.model.ngeom == scene.model.ngeom and bare.model.nmat == scene.model.nmat
    np.testing.assert_array_equal(*(_rolled(one.model) for one in (scene, bare)))


def test_a_compiled_model_keeps_its_images() -> None:
    compiled = Scene.from_model(load_scene(EVERYTHING).model)
    assert compiled.without_images() is compiled


def _rolled(model: mujoco.MjModel) -> np.ndarray:
    data, random = mujoco.MjData(model), np.random.default_rng(0)
    for _ in range(100):
        data.ctrl[:] = random.normal(size=model.nu)
        mujoco.mj_step(model, data)
    return np.concatenate([data.qpos, data.qvel])


def test_task_names() -> None:
    scene = load_scene("suite:cheetah-run")
    assert scene.model.nv == 9
    assert scene.source == "suite:cheetah-run"
    with pytest.raises(UnknownNameError, match="did you mean 'cheetah-run'"):
        load_scene("suite:cheetah-runn")
