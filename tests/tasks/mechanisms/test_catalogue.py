"""Every family: instances that differ, and load through URDF as they were meant."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from orbisim import load_scene
from orbisim.effects import carried_effects
from orbisim.errors import InputError, UnknownNameError
from orbisim.tasks.domains import HELD_OUT_MECHANISMS, MECHANISMS
from orbisim.tasks.mechanisms.catalogue import FAMILIES, HELD_OUT, INSTANCES, make
from orbisim.tasks.mechanisms.model import BASE
from orbisim.tasks.mechanisms.urdf import write_urdf


def test_families_have_names_and_instances() -> None:
    assert tuple(FAMILIES) == MECHANISMS
    assert set(HELD_OUT_MECHANISMS) < set(MECHANISMS)
    assert INSTANCES - HELD_OUT >= 20


def test_what_there_is_not() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'door'"):
        make("doors", 0)
    with pytest.raises(InputError, match="from 0"):
        make("door", -1)


@pytest.mark.parametrize("family", MECHANISMS)
def test_instances_differ_and_stay_the_same(family: str) -> None:
    made = [make(family, number) for number in range(INSTANCES)]
    sizes = {tuple(solid.size for part in one.parts for solid in part.solids) for one in made}
    assert len(sizes) == INSTANCES
    again = make(family, 3)
    assert again.features == made[3].features and again.effects == made[3].effects


@pytest.mark.parametrize("family", MECHANISMS)
def test_an_instance_is_a_scene(family: str, tmp_path: Path) -> None:
    mechanism = make(family, 5)
    scene = load_scene(write_urdf(mechanism, tmp_path), trusted=True)
    model = scene.model
    assert not scene.unsupported
    assert carried_effects(model) == mechanism.effects
    assert mechanism.parts[0].name == BASE
    for joint in mechanism.joints:
        made = model.joint(joint.name)
        np.testing.assert_allclose(made.range, [joint.lower, joint.upper])
        assert model.body(int(made.bodyid[0])).name == joint.child
        dof, at = int(made.dofadr[0]), int(made.qposadr[0])
        assert float(made.stiffness[0]) == joint.stiffness
        assert model.dof_frictionloss[dof] == joint.friction > 0
        assert model.qpos_spring[at] == joint.rest
        assert joint.lower <= 0.0 <= joint.upper  # every instance begins closed
    for effect in mechanism.effects:
        assert mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, effect.target) >= 0
