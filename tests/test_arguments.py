"""What cannot be an argument of a backend is refused with a message that helps."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from orbisim import State, load_scene
from orbisim.arguments import (
    check_state,
    memory_shapes,
    positive_number,
    real_array,
    whole_number,
)
from orbisim.errors import InputError
from orbisim.state import MEMORY
from orbisim.testing import scenes


@pytest.mark.parametrize("value", [1, np.int64(1), np.array(1), True])
def test_whole_numbers(value: object) -> None:
    assert whole_number("nstep", value, 1) == 1


@pytest.mark.parametrize("value", [0, -3, 1.0, "1", None, np.array([1, 2]), float("nan")])
def test_what_is_no_count(value: object) -> None:
    with pytest.raises(InputError, match="nstep must be a whole number of at least 1; got"):
        whole_number("nstep", value, 1)


@pytest.mark.parametrize("value", [0, -1e-9, float("inf"), float("nan"), None, "a"])
def test_what_is_no_positive_number(value: object) -> None:
    with pytest.raises(InputError, match="eps must be a finite number above 0"):
        positive_number("eps", value)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ([[1.0], [1.0, 2.0]], "rows of different lengths"),
        ([1j], "is complex"),
        (["a"], "expected real numbers of shape \\(1,\\)"),
        ([None], "expected real numbers"),
        ({"push": 1.0}, "dict of object"),
    ],
)
def test_what_is_no_array_of_numbers(values: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        real_array("control", values, "(1,)")


def test_tensors_pass_unless_complex() -> None:
    torch = pytest.importorskip("torch")
    tensor = torch.ones(2, requires_grad=True)
    assert real_array("control", tensor, "(2,)") is tensor
    with pytest.raises(InputError, match="complex"):
        real_array("control", torch.ones(2, dtype=torch.complex64), "(2,)")


def test_memory_has_the_shapes_of_mjdata() -> None:
    model = mujoco.MjModel.from_xml_string("""
        <mujoco><size nuserdata="3"/><worldbody>
        <body name="m" mocap="true"><geom size="1"/></body>
        <body name="a"><joint name="j"/><geom size="1"/></body></worldbody>
        <equality><weld body1="a" body2="m"/></equality>
        <actuator><position joint="j" delay="0.01" nsample="8"/></actuator></mujoco>""")
    data = mujoco.MjData(model)
    assert set(memory_shapes(model)) == set(MEMORY)
    for name, shape in memory_shapes(model).items():
        assert getattr(data, name).shape == shape, name


def test_states_of_other_scenes_are_refused() -> None:
    model = load_scene(scenes.CARTPOLE).model
    good = State(np.zeros(1), np.zeros((1, 2)), np.zeros((1, 2)), np.zeros((1, 0)))
    check_state(good, model, "cartpole")
    check_state(good.replace(qpos=np.zeros((1, 2), int)), model, "cartpole")
    for wrong, message in (
        (good.replace(qvel=np.zeros((1, 3))), "State.qvel has shape \\(1, 3\\)"),
        (good.replace(qpos=np.zeros((1, 2), complex)), "holds complex128"),
        (good.with_memory(qacc_warmstart=np.zeros((1, 9))), "memory\\['qacc_warmstart'\\]"),
    ):
        with pytest.raises(InputError, match=message):
            check_state(wrong, model, "cartpole")
