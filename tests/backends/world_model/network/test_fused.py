"""The kernels compute the network; without a GPU, by Triton's interpreter."""

from __future__ import annotations

import os
from typing import Any

import pytest
import torch
from orbisim_world_model.dynamics import Dynamics, example
from orbisim_world_model.entities import Context
from orbisim_world_model.network.inputs import Inputs
from orbisim_world_model.trainer import new_model

from tests.backends.world_model.conftest import toy
from tests.backends.world_model.synthetic import PENDULUM, TABLE, simulate

DEVICE = torch.device("cuda" if torch.cuda.is_available() else "cpu")
if DEVICE.type == "cpu":
    os.environ.setdefault("TRITON_INTERPRET", "1")
pytest.importorskip("triton", reason="the kernels are written in Triton")
from orbisim_world_model.network import fused  # noqa: E402

WORLDS = 11


@pytest.fixture(scope="module")
def model() -> Dynamics:
    made = new_model(simulate(TABLE, 4, 20, 4), toy("default"), 0).eval()
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for parameter in made.parameters():
            parameter += 0.05 * torch.randn(parameter.shape, generator=generator)
    return made.to(DEVICE).requires_grad_(False)


def _inputs(model: Dynamics, worlds: int = WORLDS) -> Inputs:
    torch.manual_seed(2)
    sizes = model.sizes
    many, tokens = sizes.many, sizes.tokens
    shapes: tuple[tuple[int, ...], ...] = (
        (sizes.robot,),
        (many, sizes.objects),
        (tokens, tokens, sizes.edges),
        (many, sizes.attributes),
        (sizes.world,),
        (sizes.control,),
    )
    return Inputs(*(torch.randn(worlds, *shape, device=DEVICE) for shape in shapes), None)


def _apart(found: torch.Tensor, wanted: torch.Tensor) -> float:
    return float((found.double() - wanted.double()).norm() / wanted.double().norm())


@pytest.mark.parametrize("tile", [(16, 16, 32, 64, 4, 2), (32, 16, 16, 64, 4, 2)])
def test_they_give_the_networks_numbers(model: Dynamics, tile: tuple[int, ...]) -> None:
    inputs, network = _inputs(model), model.network
    wanted = network(inputs, network.initial_memory(WORLDS))
    kernels = fused.FusedNetwork(network, fused.Tile(*tile)).to(DEVICE)
    found = kernels(inputs, network.initial_memory(WORLDS))
    assert _apart(found.robot, wanted.robot) < 3e-3
    assert _apart(found.objects, wanted.objects) < 3e-3


def test_descriptors_that_worlds_share_are_computed_once(model: Dynamics) -> None:
    inputs, network = _inputs(model), model.network
    attributes = inputs.attributes[:1].expand_as(inputs.attributes)
    world = inputs.world[:1].expand_as(inputs.world)
    inputs = inputs._replace(attributes=attributes, world=world)
    kernels = fused.FusedNetwork(network, fused.Tile(16, 16, 32, 64, 4, 2)).to(DEVICE)
    memory = network.initial_memory(WORLDS)
    each = kernels(inputs, memory)
    one = kernels(inputs._replace(scales=kernels.scales(attributes[:1], world[:1])), memory)
    torch.testing.assert_close(one.objects, each.objects)


def test_variances_are_those_of_spread(model: Dynamics) -> None:
    with_spread = model.with_spread(24).to(DEVICE)
    spread: Any = with_spread.spread
    torch.manual_seed(3)
    with torch.no_grad():
        for parameter in spread.parameters():
            parameter += 0.2 * torch.randn_like(parameter)
    inputs, variance = _inputs(model), torch.rand(WORLDS, model.sizes.tokens, 2, device=DEVICE)
    found = fused.FusedSpread(spread, model.sizes).to(DEVICE)(inputs, variance)
    with torch.no_grad():
        wanted = spread(inputs, variance)
    model.spread = None
    assert ((found - wanted).abs() / wanted).max() < 0.02


def test_which_networks_suit() -> None:
    def suits(xml: str, name: str) -> bool:
        return fused.FusedNetwork.suits(new_model(simulate(xml, 4, 20, 4), toy(name), 0).network)

    assert suits(TABLE, "default")
    assert not suits(TABLE, "recurrent")  # a memory
    assert not suits(TABLE, "no_relative")  # no features of pairs
    assert not suits(PENDULUM, "default")  # one token


def test_a_step_with_kernels_is_the_step(model: Dynamics) -> None:
    from orbisim_world_model.stepper import Speedups, Stepper

    speedups = Speedups(compiled=None, graphed=DEVICE.type == "cuda")
    stepper = Stepper(model, DEVICE, speedups)
    if DEVICE.type == "cpu":  # what a GPU would do
        stepper.on_gpu = True
        stepper._kernels = stepper._with_kernels(model)
    x, context = example(model.layout, WORLDS)
    x = model.completed(x.to(DEVICE))
    attributes = model.see_attributes.mean.expand_as(context.attributes)
    context = Context(attributes, model.see_world.mean.expand_as(context.world), None)
    control = 0.1 * torch.randn(WORLDS, model.controls, device=DEVICE)
    memory = stepper.initial_memory(WORLDS)
    slot = stepper.prepared(x, memory, control, context)
    assert isinstance(stepper.fastest.network, fused.FusedNetwork)
    slot.load(x, memory, control, context)
    found, _ = slot.run()
    wanted = model(x, memory, control, context).state
    torch.testing.assert_close(found.pos, wanted.pos, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(found.q, wanted.q, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(found.vel, wanted.vel, rtol=1e-2, atol=1e-3)
