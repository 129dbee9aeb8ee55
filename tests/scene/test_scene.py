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
def test_without_visuals_the_physics_are_the_same_to_the_bit(name: str) -> None:
    scene = load_scene(Path(suite.__file__).with_name(f"{name}.xml"))
    bare = scene.without_visuals()
    assert bare.model.ntexdata == 0 < scene.model.ntexdata
    np.testing.assert_array_equal(*(_rolled(one.model) for one in (scene, bare)))


def test_without_visuals_geoms_keep_what_they_are_called_by() -> None:
    scene = Scene.from_spec(mujoco.MjSpec.from_string(_VISUAL_FIRST))
    bare = scene.without_visuals()
    assert [bare.model.geom(i).name for i in range(bare.model.ngeom)] == ["geom1", "ball"]
    assert bare.model.body_mass[1] == scene.model.body_mass[1]  # that of what is left out, too


def test_without_visuals_is_the_scene_where_mujoco_cannot() -> None:
    inferred = _VISUAL_FIRST.replace("<worldbody>", _INFERRED + "<worldbody>")
    scene = Scene.from_spec(mujoco.MjSpec.from_string(inferred))
    assert scene.without_visuals() is scene
    compiled = Scene.from_model(scene.model)
    assert compiled.without_visuals() is compiled


def _rolled(model: mujoco.MjModel) -> np.ndarray:
    data, random = mujoco.MjData(model), np.random.default_rng(0)
    for _ in range(100):
        data.ctrl[:] = random.normal(size=model.nu)
        mujoco.mj_step(model, data)
    return np.concatenate([data.qpos, data.qvel])


_INFERRED = '<compiler inertiafromgeom="true"/>'
_VISUAL_FIRST = """
<mujoco>
  <worldbody>
    <body>
      <freejoint/>
      <geom type="box" size=".1 .1 .1" contype="0" conaffinity="0"/>
      <geom type="box" size=".1 .1 .1"/>
      <geom name="ball" size=".1"/>
    </body>
  </worldbody>
</mujoco>
"""


def test_task_names() -> None:
    scene = load_scene("suite:cheetah-run")
    assert scene.model.nv == 9
    assert scene.source == "suite:cheetah-run"
    with pytest.raises(UnknownNameError, match="did you mean 'cheetah-run'"):
        load_scene("suite:cheetah-runn")
