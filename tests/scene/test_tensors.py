"""Descriptors as tensors, and back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dm_control import suite as dm_suite

from orbisim import load_scene
from orbisim.errors import InputError
from orbisim.scene.tensors import columns, from_tensors, to_tensors

from .test_mjcf import EVERYTHING

SUITE = Path(dm_suite.__file__).parent


@pytest.mark.parametrize("source", [EVERYTHING, str(SUITE / "dog.xml"), str(SUITE / "stacker.xml")])
def test_descriptors_survive_tensors(source: str) -> None:
    descriptor = load_scene(source).descriptor
    tensors = to_tensors(descriptor)
    zeros = {name: np.zeros_like(table) for name, table in tensors.items()}
    blank = from_tensors(zeros, descriptor)
    assert blank != descriptor
    assert from_tensors(tensors, blank) == descriptor
    for name in ("part", "geometry", "joint", "actuator", "world"):
        assert tensors[name].shape[1] == len(columns(name))


def test_tensors_of_another_scene_are_refused() -> None:
    descriptor = load_scene(EVERYTHING).descriptor
    other = to_tensors(load_scene(SUITE / "cheetah.xml").descriptor)
    with pytest.raises(InputError, match="has shape"):
        from_tensors(other, descriptor)
    with pytest.raises(InputError, match="lack"):
        from_tensors({}, descriptor)


def test_numbers_stand_under_their_names() -> None:
    scene = load_scene(EVERYTHING)
    tensors = to_tensors(scene.descriptor)
    joints = dict(zip(columns("joint"), tensors["joint"].T, strict=True))
    assert joints["frictionloss"].tolist() == scene.model.dof_frictionloss[[0, 6, 9]].tolist()
    assert joints["stiffness/2"].tolist() == [0.0, 0.0, 0.5]
    world = dict(zip(columns("world"), tensors["world"][0], strict=True))
    assert world["gravity/2"] == -9.81
    assert world["timestep"] == 0.003


def test_a_changed_number_comes_back_at_its_place() -> None:
    descriptor = load_scene(EVERYTHING).descriptor
    tensors = to_tensors(descriptor)
    tensors["joint"][2, columns("joint").index("armature")] = 0.25
    changed = from_tensors(tensors, descriptor)
    assert [joint.armature for joint in changed.joints] == [0.0, 0.0, 0.25]
    assert changed.world == descriptor.world
    assert changed.actuators == descriptor.actuators


def test_tables_that_do_not_exist() -> None:
    with pytest.raises(KeyError):
        columns("furniture")
