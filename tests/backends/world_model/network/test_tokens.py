"""Which token is conditioned on what: actions are the robot's, attributes each object's own."""

from __future__ import annotations

import pytest
import torch
from orbisim_world_model.config import ModelConfig
from orbisim_world_model.network.folded import FoldedNetwork
from orbisim_world_model.network.inputs import Inputs, Sizes
from orbisim_world_model.network.objects import ObjectCentricNetwork
from orbisim_world_model.network.tokens import TokenNetwork

SIZES = Sizes(
    robot=5,
    objects=6,
    many=2,
    edges=4,
    attributes=3,
    world=2,
    control=3,
    robot_out=4,
    objects_out=13,
)


@pytest.fixture(params=["plain", "folded"])
def network(request: pytest.FixtureRequest) -> TokenNetwork:
    torch.manual_seed(0)
    made = ObjectCentricNetwork(SIZES, ModelConfig(width=8, layers=1, heads=2))
    for parameter in made.parameters():  # AdaLN begins blind to its condition
        torch.nn.init.normal_(parameter, std=0.3)
    return made if request.param == "plain" else FoldedNetwork(made)


def _inputs() -> Inputs:
    shapes = ((3, 5), (3, 2, 6), (3, 3, 3, 4), (3, 2, 3), (3, 2), (3, 3))
    return Inputs(*(torch.randn(shape) for shape in shapes), None)


def _changed(network: TokenNetwork, name: str, index: tuple[int, ...] = ()) -> list[bool]:
    """Of each token: whether its condition changes with a part of the inputs."""
    inputs = _inputs()
    moved = getattr(inputs, name).clone()
    moved[(slice(None), *index)] += 1.0
    before = network.condition(inputs)
    after = network.condition(inputs._replace(**{name: moved}))
    return [not torch.equal(before[:, k], after[:, k]) for k in range(3)]


def test_the_robot_sees_the_action_and_objects_their_own_attributes(network: TokenNetwork) -> None:
    assert _changed(network, "control") == [True, False, False]
    assert _changed(network, "attributes", (0,)) == [False, True, False]
    assert _changed(network, "attributes", (1,)) == [False, False, True]
    assert _changed(network, "world") == [True, True, True]


def test_the_state_is_no_condition(network: TokenNetwork) -> None:
    for name in ("robot", "objects", "edges"):
        assert _changed(network, name) == [False, False, False]


def test_actions_and_attributes_enter_through_the_condition_alone(network: TokenNetwork) -> None:
    inputs, memory = _inputs(), network.initial_memory(3)
    fixed = network.condition(inputs)
    other = inputs._replace(**{n: getattr(inputs, n) + 1.0 for n in ("control", "world")})
    other = other._replace(attributes=inputs.attributes + 1.0)
    free = network(other, memory).robot  # type: ignore[operator]
    assert not torch.allclose(free, network(inputs, memory).robot)  # type: ignore[operator]
    network.condition = lambda _: fixed  # type: ignore[method-assign]
    for a, b in zip(network(inputs, memory)[:2], network(other, memory)[:2], strict=True):  # type: ignore[operator]
        assert torch.equal(a, b)
