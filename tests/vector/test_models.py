"""What tasks change in a model is each world's own."""

from __future__ import annotations

import copy

import mujoco
import numpy as np
import pytest

from orbisim.errors import InputError
from orbisim.vector.models import ModelFields, numbers
from tests.vector import own


@pytest.fixture
def models() -> tuple[mujoco.MjModel, mujoco.MjModel]:
    model = mujoco.MjModel.from_xml_string(own.XML)
    return model, copy.copy(model)


def test_what_a_task_changes_is_kept_for_its_world(
    models: tuple[mujoco.MjModel, mujoco.MjModel],
) -> None:
    model, working = models
    fields = ModelFields(model, working, 3)
    working.body_mass[1] = 7.0
    working.opt.timestep = 0.5
    assert fields.take(1)
    assert not fields.take(1), "nothing is new"
    assert sorted(fields.varied) == ["body_mass", "opt.timestep"]
    assert fields.varied["body_mass"][:, 1].tolist() == [1.0, 7.0, 1.0]
    fields.place(0)
    assert (working.body_mass[1], working.opt.timestep) == (1.0, 0.01)
    assert not fields.take(0)
    own_model = copy.copy(model)
    fields.write(1, own_model)
    assert (own_model.body_mass[1], own_model.opt.timestep) == (7.0, 0.5)


def test_the_model_is_as_before_after_forgetting(
    models: tuple[mujoco.MjModel, mujoco.MjModel],
) -> None:
    model, working = models
    fields = ModelFields(model, working, 2)
    working.geom_size[1, 0] = 0.3
    working.opt.gravity[2] = 0.0
    fields.forget()
    assert not fields.varied
    for name, values in numbers(model).items():
        np.testing.assert_array_equal(numbers(working)[name], values, err_msg=name)


def test_actuation_that_is_off_for_a_moment_is_no_change(
    models: tuple[mujoco.MjModel, mujoco.MjModel],
) -> None:
    fields = ModelFields(*models, 2)
    models[1].opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    assert not fields.take(0)


def test_models_of_other_sizes(models: tuple[mujoco.MjModel, mujoco.MjModel]) -> None:
    fields = ModelFields(*models, 2)
    other = mujoco.MjModel.from_xml_string("<mujoco/>")
    with pytest.raises(InputError, match="world 1 has another model"):
        fields.copy_from(other, 1)


def test_a_model_that_remembers_more_is_refused(
    models: tuple[mujoco.MjModel, mujoco.MjModel],
) -> None:
    """Of the same shapes everywhere, but its history would not fit the state of the others."""
    fields = ModelFields(*models, 2)
    text = own.XML.replace('<motor name="push"', '<motor name="push" delay=".03" nsample="9"')
    with pytest.raises(InputError, match="histories of delayed controls"):
        fields.copy_from(mujoco.MjModel.from_xml_string(text), 1)
