"""The step made fast is the same step."""

from __future__ import annotations

import shutil
import warnings
from typing import Literal

import mujoco
import pytest
import torch
from orbisim_world_model.dynamics import Dynamics, example
from orbisim_world_model.entities import Context, Entities
from orbisim_world_model.network.folded import FoldedNetwork
from orbisim_world_model.stepper import Speedups, Stepper, cause, compiled_step, plain_step
from orbisim_world_model.trainer import new_model

from orbisim.errors import EngineError
from tests.backends.world_model.conftest import toy
from tests.backends.world_model.robots import CRAWLER, of_limbs
from tests.backends.world_model.synthetic import BOX, PENDULUM, TABLE, simulate

CPU = torch.device("cpu")


def _trained_looking(xml: str, name: str = "default") -> Dynamics:
    """A model whose weights are all different from zero."""
    model = new_model(simulate(xml, 4, 20, 4), toy(name), 0).eval()
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for parameter in model.parameters():
            parameter += 0.05 * torch.randn(parameter.shape, generator=generator)
    return model


def _inputs(model: Dynamics, worlds: int) -> tuple[Entities, torch.Tensor, torch.Tensor, Context]:
    generator = torch.Generator().manual_seed(2)
    x, context = example(model.layout, worlds)

    def near(values: torch.Tensor) -> torch.Tensor:
        return values + 0.1 * torch.randn(values.shape, generator=generator)

    x = x._replace(q=near(x.q), v=near(x.v), pos=near(x.pos), vel=near(x.vel), ang=near(x.ang))
    control = near(torch.zeros(worlds, model.controls))
    attributes = near(model.see_attributes.mean.expand_as(context.attributes))
    world = model.see_world.mean.expand_as(context.world).clone()
    memory = model.initial_memory(worlds).detach().clone()
    return model.completed(x), memory, control, Context(attributes, world, None)


@pytest.mark.parametrize(
    ("xml", "name"),
    [
        (TABLE, "default"),
        (TABLE, "no_relative"),
        (TABLE, "no_skip"),
        (TABLE, "recurrent"),
        (BOX, "default"),
        (PENDULUM, "default"),
        (PENDULUM, "recurrent"),
    ],
)
def test_combined_weights_give_the_same_step(xml: str, name: str) -> None:
    model = _trained_looking(xml, name)
    plain = Stepper(model, CPU, Speedups(folded=False))
    folded = Stepper(model, CPU, Speedups())
    assert isinstance(folded.model.network, FoldedNetwork)
    inputs = _inputs(model, 5)
    for expected, found in zip(plain(*inputs)[0], folded(*inputs)[0], strict=True):
        torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(folded(*inputs)[1], plain(*inputs)[1], rtol=1e-4, atol=1e-5)
    assert torch.equal(folded.initial_memory(3), plain.initial_memory(3))


@pytest.mark.parametrize("name", ["default", "no_relative"])
def test_combined_weights_respect_the_mask(name: str) -> None:
    model = _trained_looking(TABLE, name)
    x, memory, control, context = _inputs(model, 4)
    context = context._replace(mask=torch.tensor([[1.0, 0.0]]).expand(4, 2))
    folded = Stepper(model, CPU, Speedups()).model
    expected = plain_step(model)(x, memory, control, context)[0]
    found = plain_step(folded)(x, memory, control, context)[0]
    torch.testing.assert_close(found.pos, expected.pos, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(found.v, expected.v, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("shared", [True, False])
def test_what_descriptors_alone_decide_is_computed_once(shared: bool) -> None:
    """Scales and shifts of limbs: for all steps, and for all worlds that have the same robot."""
    exact, x, context = of_limbs(mujoco.MjModel.from_xml_string(CRAWLER), 3)
    model, x = exact.float().eval(), x.to(torch.float32)
    assert context.parts is not None
    rows, world = (field[:1].float() for field in (context.parts, context.world))
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for parameter in model.parameters():
            parameter += 0.05 * torch.randn(parameter.shape, generator=generator)
    same = Context(torch.zeros(1, 0, 0), world, None, rows)
    given = Context(*(None if f is None else f.expand(3, *f.shape[1:]) for f in same))
    if not shared:
        several = rows.repeat(3, 1, 1)
        several[..., model.layout.part_columns.index("damping")] *= torch.arange(3.0)[:, None]
        given = given._replace(parts=several)
    stepper = Stepper(model, CPU, Speedups(compiled=None, graphed=False))
    shapes: list[tuple[int, ...]] = []
    stepper.model.network.modulation.register_forward_hook(
        lambda module, inputs, output: shapes.append(tuple(output.shape[:2]))
    )
    memory, control = model.initial_memory(3), torch.full((3, model.layout.nu), 0.4)
    expected, found, described = x, x, stepper.described(given)
    assert given.scales is None
    for _ in range(3):
        expected = model(expected, memory, control, given).state
        found, _ = stepper(found, memory, control, described)
        assert torch.allclose(found.v, expected.v, atol=1e-4)
    slot = stepper.prepared(found, memory, control, given)  # as on a GPU
    for _ in range(2):
        slot.load(found, memory, control, given)
        state, _ = slot.run()
        assert torch.allclose(state.v, model(expected, memory, control, given).state.v, atol=1e-4)
    # for three steps, for what the graph is made of, and for two steps of it
    assert shapes == 3 * [(1 if shared else 3, len(model.layout.parts))]


def test_networks_without_tokens_are_left_as_they_are() -> None:
    model = _trained_looking(TABLE, "global")
    stepper = Stepper(model, CPU)
    assert type(stepper.model.network) is type(model.network)


@pytest.mark.slow  # torch's compiler takes over half a minute
@pytest.mark.skipif(shutil.which("g++") is None, reason="torch compiles for a CPU with g++")
def test_the_compiled_step_is_the_same_step() -> None:
    model = Stepper(_trained_looking(BOX), CPU, Speedups()).model
    inputs = _inputs(model, 3)
    with torch.no_grad():
        expected = plain_step(model)(*inputs)
        found = compiled_step(model)(*inputs)
    for a, b in zip(found[0], expected[0], strict=True):
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-5)


def test_a_step_that_cannot_be_compiled_is_taken_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    from orbisim_world_model import stepper

    def broken(*_: object) -> object:
        def fail(*_: object) -> None:
            raise OSError("no compiler here")

        return fail

    monkeypatch.setattr(stepper, "compiled_step", broken)
    model = _trained_looking(BOX)
    inputs = _inputs(model, 2)
    steps = Stepper(model, CPU, Speedups(folded=False, graphed=False))
    with pytest.warns(UserWarning, match="not compiled.*OSError: no compiler here .in"):
        slot = steps.prepared(*inputs)
    with torch.no_grad(), warnings.catch_warnings():
        warnings.simplefilter("error")
        state, _ = slot.run()
        steps.prepared(*_inputs(model, 3))  # does not try again
        expected, _ = plain_step(model)(*inputs)
    assert not slot.compiled
    assert torch.equal(state.pos, expected.pos)


@pytest.mark.parametrize("compiler", ["joined", "fused"])
def test_a_device_that_no_longer_answers_is_not_tried_again(
    compiler: Literal["joined", "fused"], monkeypatch: pytest.MonkeyPatch
) -> None:
    from orbisim_world_model import stepper

    def fail(*_: object) -> None:
        raise OSError("an illegal memory access")

    asked: list[object] = []

    def broken(_: object, how: object) -> object:
        asked.append(how)
        return fail

    monkeypatch.setattr(stepper, "compiled_step", broken)
    monkeypatch.setattr(stepper, "answers", lambda _: False)
    model = _trained_looking(BOX)
    steps = Stepper(model, CPU, Speedups(folded=False, graphed=False, compiled=compiler))
    told = "no longer answers after the first step of 2 worlds .OSError: an illegal memory access"
    with pytest.raises(EngineError, match=told + ".*compiled=False"):
        steps.prepared(*_inputs(model, 2))
    assert asked == [compiler]


def test_a_device_answers_as_long_as_it_computes(monkeypatch: pytest.MonkeyPatch) -> None:
    from orbisim_world_model.stepper import answers

    assert answers(CPU)

    def lost(*_: object, **__: object) -> None:
        raise RuntimeError("CUDA error: an illegal memory access was encountered")

    monkeypatch.setattr(torch, "zeros", lost)
    assert not answers(CPU)


def test_the_cause_of_a_failure_names_its_type_and_place() -> None:
    def inner() -> None:
        raise AssertionError("\n\nfrom user code:\n File x, line 1")

    with pytest.raises(AssertionError) as caught:
        inner()
    text = cause(caught.value)
    assert text.startswith("AssertionError:  (in ") and "raise AssertionError" in text
    assert "from user code" not in text.split("(in")[0]
