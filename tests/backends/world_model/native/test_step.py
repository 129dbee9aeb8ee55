"""The compiled step gives what torch gives."""

from __future__ import annotations

import copy
import ctypes
import platform
import shutil
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from orbisim_world_model.backend import OutsideTrainingWarning
from orbisim_world_model.entities import Context
from orbisim_world_model.native import NativeStep, compiler
from orbisim_world_model.native.step import _traced
from orbisim_world_model.native.translate import Translator, simplified
from orbisim_world_model.native.values import contiguous
from orbisim_world_model.native.writer import Writer
from orbisim_world_model.run import Run, train
from orbisim_world_model.stepping import MEMORY
from orbisim_world_model.trainer import new_model
from torch._decomp import core_aten_decompositions
from torch.fx.experimental.proxy_tensor import make_fx

from orbisim import State, load_scene, make_backend
from orbisim.backend import Backend
from orbisim.errors import DivergedError, MissingDependencyError, OrbiSimError
from tests.backends.world_model.conftest import toy
from tests.backends.world_model.synthetic import BOX, PENDULUM, PUSHER, TABLE, simulate

needs_compiler = pytest.mark.skipif(
    not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="no C compiler"
)


@needs_compiler
@pytest.mark.parametrize(
    ("xml", "name"),
    [(PUSHER, "contacts"), (BOX, "recurrent"), (PENDULUM, "default")],
)
def test_the_compiled_step_agrees_with_torch(xml: str, name: str) -> None:
    pack = simulate(xml, 3, 20, 2)
    model = new_model(pack, toy(name), 0).eval().requires_grad_(False)
    generator = torch.Generator().manual_seed(0)
    for parameter in model.parameters():
        parameter.add_(0.05 * torch.randn(parameter.shape, generator=generator))
    context = pack.context(torch.zeros(1, dtype=torch.long))._replace(mask=None)
    native, memory = NativeStep(model, context), model.initial_memory(1)
    for row in (0, 7, 19):
        rows = slice(row, row + 1)
        inputs = [pack.qpos[rows], pack.qvel[rows], pack.act[rows]]
        x = model.completed(pack.layout.split(*inputs))
        after = model(x, memory, pack.ctrl[rows], context)
        expected = [*pack.layout.join(after.state), after.memory]
        found = native(*(t.numpy() for t in (*inputs, pack.ctrl[rows], memory)))
        for ours, theirs in zip(found, expected, strict=True):
            np.testing.assert_allclose(ours, theirs.numpy(), atol=2e-5, rtol=1e-4)


@needs_compiler
@pytest.mark.parametrize(
    ("name", "spread"), [("acrobot-swingup", 1.0), ("finger-spin", 1.5), ("hopper-hop", 0.3)]
)
def test_limbs_agree_with_torch(name: str, spread: float) -> None:
    """RK4; limbs that meet (the nearest of several is chosen as it runs); feet on the floor."""
    scene = load_scene(f"suite:{name}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OutsideTrainingWarning)
        fast, plain = (
            make_backend("learned:suite_one", scene, native=native, device="cpu")
            for native in (True, False)
        )
        ours, theirs = fast.engine, plain.engine  # type: ignore[attr-defined]
        rng, start, touched = np.random.default_rng(0), plain.reset(1), 0.0
        for _ in range(25):
            control = rng.uniform(-1.0, 1.0, (1, scene.model.nu))
            turned, turning = rng.normal(size=(2, 1, scene.model.nv))
            state = start.replace(qpos=start.qpos + spread * turned, qvel=turning)
            found = ours.native_step(state, control)
            expected = theirs.state(state, theirs.run(state, control[:, None], 1), plain.timestep)
            np.testing.assert_allclose(found.qpos, expected.qpos, atol=2e-5, rtol=1e-4)
            np.testing.assert_allclose(found.qvel, expected.qvel, atol=2e-5, rtol=1e-4)
            touched = max(touched, near(plain, state))
        assert touched > 0.5 or name.startswith("acrobot")  # what is learned was at work


def near(backend: Backend, state: State) -> float:
    """1 where a limb touches something, 0 far from it."""
    engine, x = backend.engine, backend.entities(state)  # type: ignore[attr-defined]
    context = Context(engine._attributes, engine._settings, None, engine._parts)
    limbs = engine.stepper.model.features.limbs
    known = limbs.known(x, torch.zeros(1, engine.layout.nu), context)
    return float(torch.maximum(known.floor.near.max(), known.limbs.near.max()))


def test_what_only_makes_zeros_is_left_out() -> None:
    """Nothing touches a pendulum: no weight is read."""
    backend = make_backend(
        "learned:suite_one", load_scene("suite:pendulum-swingup"), native=False, device="cpu"
    )
    engine = backend.engine  # type: ignore[attr-defined]
    context = Context(engine._attributes, engine._settings, None, engine._parts)
    model = engine.stepper.model
    example = [torch.zeros(1, n) for n in (1, 1, 0, 1)] + [model.initial_memory(1).clone()]
    traced = _traced(model, context, example)
    whole, rest = Translator(traced), Translator(simplified(copy.deepcopy(traced)))
    for translator in (whole, rest):
        translator.run()
    assert sum(map(len, whole.writer.constants)) > 1_000_000
    assert sum(map(len, rest.writer.constants)) < 10_000
    assert not any("product(" in line for line in rest.writer.lines)


@needs_compiler
def test_sums_and_products_with_constants() -> None:
    """Of zeros, and of what is like them."""
    zero, few, whole = torch.zeros(3), torch.tensor([0.0, 2.0, 0.0]), torch.ones(2, 3).bool()

    def function(x: torch.Tensor) -> tuple[torch.Tensor, ...]:
        gone = x.exp() * zero
        return (
            gone + x.sin(),
            torch.add(zero, x, alpha=2.0),
            x - gone,
            gone - x,
            few * x + gone / (x * x + 1.0),
            torch.where(whole, x[:1], gone),
            torch.where(~whole, gone, x[1:]),
        )

    x = torch.tensor([[0.3, -1.0, 2.0], [4.0, 0.1, -0.2]])
    traced = make_fx(function, decomposition_table=core_aten_decompositions())(x)
    for ours, theirs in zip(computed(simplified(traced), [x]), function(x), strict=True):
        np.testing.assert_allclose(ours, theirs.numpy(), atol=1e-6)


@needs_compiler
def test_the_least_and_products_of_two_inputs() -> None:
    """What is not known before it runs: which of a row is the least, what stands there."""

    def function(x: torch.Tensor, y: torch.Tensor) -> tuple[torch.Tensor, ...]:
        place = x.argmin(-1, keepdim=True)
        there = y.transpose(1, 2).gather(2, place.expand(-1, -1, 2))
        known = x.gather(2, torch.tensor([[[2, 0], [1, 1], [0, 3]]]).expand(2, 3, 2))
        half = torch.div(place, 2, rounding_mode="floor")
        fixed = torch.arange(5.0).expand(2, 3, 5).gather(2, half)
        return there, known, fixed, x @ y, torch.minimum(x[..., :2], known), x.argmin(1) * 1.0

    generator = torch.Generator().manual_seed(3)
    given = [torch.randn(shape, generator=generator) for shape in ((2, 3, 4), (2, 4, 3))]
    given[0][1, 2] = 1.0  # the first of several that are the least
    traced = make_fx(function, decomposition_table=core_aten_decompositions())(*given)
    for ours, theirs in zip(computed(traced, given), function(*given), strict=True):
        np.testing.assert_allclose(ours, theirs.numpy(), atol=1e-6)


def computed(module: Any, given: list[torch.Tensor]) -> list[np.ndarray]:
    """What a traced function gives as compiled C."""
    translator = Translator(module)
    writer, found = translator.writer, translator.run()
    outputs = [writer.elementwise(value.shape, "{0}", [value]) for value in found]
    workspace = ran(writer, given)
    return [workspace[value.index.numpy()] for value in outputs]


def ran(writer: Writer, given: list[torch.Tensor]) -> np.ndarray:
    """The workspace after the C that was written ran once."""
    constants = torch.cat([*writer.constants, torch.zeros(1)]).numpy()
    workspace = np.zeros(writer.workspace, np.float32)
    arrays = [np.ascontiguousarray(t.numpy()) for t in given]
    pointer = ctypes.POINTER(ctypes.c_float)
    inputs = (pointer * len(arrays))(*(array.ctypes.data_as(pointer) for array in arrays))
    step = compiler.compiled(writer.source(), careful=True)
    step(constants.ctypes.data_as(pointer), workspace.ctypes.data_as(pointer), inputs)
    return workspace


@needs_compiler
@pytest.mark.parametrize("rows", [1, 2, 3, 5, 12, 13, 25])
@pytest.mark.parametrize("without", ["", "-mno-avx512f", "-mno-avx"])
def test_products_of_any_number_of_rows(
    rows: int, without: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By vectors as long as this processor has them, and by shorter ones."""
    if without:
        if platform.machine() not in ("x86_64", "AMD64"):
            pytest.skip("vectors of another processor")
        monkeypatch.setattr(compiler, "_CAREFUL", (*compiler._CAREFUL, without))
    generator = torch.Generator().manual_seed(rows)
    x, weight, bias = (
        torch.randn(shape, generator=generator) for shape in ((rows, 37), (37, 70), (70,))
    )
    writer = Writer()
    out = writer.product(contiguous("in[0]", 0, x.shape), weight, bias)
    np.testing.assert_allclose(
        ran(writer, [x])[out.index.numpy()], (x @ weight + bias).numpy(), atol=1e-4, rtol=1e-5
    )


@needs_compiler
def test_the_backend_uses_it_for_one_world(tmp_path: Path) -> None:
    train(simulate(TABLE, 4, 20, 4), toy("recurrent", "1x2x16"), Run(out=tmp_path, steps=5))
    scene = load_scene(TABLE)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OutsideTrainingWarning)
        fast = make_backend(f"learned:{tmp_path}", scene, native=True, device="cpu")
        plain = make_backend(f"learned:{tmp_path}", scene, native=False, device="cpu")
        assert fast.engine.native is not None and plain.engine.native is None  # type: ignore[attr-defined]
        a, b = fast.reset(1), plain.reset(1)
        for _ in range(3):
            a, b = fast.step(a, np.full(2, 0.1), 2), plain.step(b, np.full(2, 0.1), 2)
        np.testing.assert_allclose(a.qpos, b.qpos, atol=1e-5)
        np.testing.assert_allclose(a.time, b.time)
        for name, values in b.memory.items():
            np.testing.assert_allclose(a.memory[name], values, atol=1e-4)
        for broken in (np.nan, 1e9):
            with pytest.raises(DivergedError):
                fast.step(a.replace(qvel=a.qvel + broken))
        assert fast.step(a.tile(3)).nworld == 3  # as without it


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> tuple[Backend, Backend]:
    """A table with an activation: with the compiled step, and without."""
    filtered = '<general joint="x" dyntype="filter" dynprm="0.1" gainprm="0.1"/></actuator>'
    xml, folder = TABLE.replace("</actuator>", filtered), tmp_path_factory.mktemp("table")
    train(simulate(xml, 4, 20, 4), toy("recurrent", "1x2x16"), Run(out=folder, steps=5))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OutsideTrainingWarning)
        scene = load_scene(xml)
        fast, plain = (
            make_backend(f"learned:{folder}", scene, native=native, device="cpu")
            for native in (True, False)
        )
    return fast, plain


@needs_compiler
@pytest.mark.filterwarnings("ignore::orbisim_world_model.backend.OutsideTrainingWarning")
@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf, 1e30])
@pytest.mark.parametrize("where", ["qpos", "qvel", "act", MEMORY, "control"])
def test_no_number_is_lost(pair: tuple[Backend, Backend], where: str, number: float) -> None:
    """What is not finite, or overflows, says the same as in torch, whichever number it is."""
    start = pair[1].step(pair[1].reset(1), np.full(3, 0.1))
    whole = {**{name: getattr(start, name) for name in ("qpos", "qvel", "act")}, **start.memory}
    whole["control"] = np.full((1, 3), 0.1)
    assert whole[where].size
    for index in range(min(whole[where].size, 20)):
        broken = whole[where].copy()
        broken.reshape(-1)[index] = number
        state = start
        if where == MEMORY:
            state = start.with_memory(**{MEMORY: broken})
        elif where != "control":
            state = start.replace(**{where: broken})
        control = broken if where == "control" else whole["control"]
        found, expected = (after(backend, state, control) for backend in pair)
        for name, values in expected.items():
            np.testing.assert_allclose(found[name], values, atol=1e-4, rtol=1e-4, err_msg=name)
        told, said = (outcome(backend, state, control) for backend in pair)
        assert told == said
        if where in ("qpos", "qvel", "act") and not np.isfinite(number):
            assert "DivergedError" in said
        if where == "control":
            assert ("InputError" in said) is not bool(np.isfinite(number))


def after(backend: Backend, state: State, control: np.ndarray) -> dict[str, np.ndarray]:
    """The state after a step of a backend's engine."""
    engine = backend.engine  # type: ignore[attr-defined]
    if engine.native is not None:
        found = engine.native_step(state, control)
    else:
        found = engine.state(state, engine.run(state, control[:, None], 1), backend.timestep)
    return {"qpos": found.qpos, "qvel": found.qvel, "act": found.act, MEMORY: found.memory[MEMORY]}


def outcome(backend: Backend, state: State, control: np.ndarray) -> str:
    """What a step says: its error, or which numbers of its result are finite."""
    try:
        found = backend.step(state, control)
    except OrbiSimError as error:
        return f"{type(error).__name__}: {error}"
    arrays = (found.qpos, found.qvel, found.act, found.memory[MEMORY])
    return str([np.isfinite(array).tolist() for array in arrays])


@needs_compiler
def test_finite_numbers_are_stepped_in_c(pair: tuple[Backend, Backend]) -> None:
    """Of ordinary size, and up to the bound; not beyond it."""
    native = pair[0].engine.native  # type: ignore[attr-defined]
    given = [np.zeros(array.shape) for array in native._inputs]
    given[0][0, [5, 12]] = 1.0
    for size, stepped in ((1.0, True), (9e5, True), (1.1e6, False)):
        given[1][0, 0] = size
        assert (native(*given) is not None) is stepped


def test_without_a_compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    train(simulate(PENDULUM, 4, 20, 2), toy(), Run(out=tmp_path, steps=2))
    monkeypatch.setattr(compiler.shutil, "which", lambda name: None)
    scene = load_scene(PENDULUM)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OutsideTrainingWarning)
        assert make_backend(f"learned:{tmp_path}", scene, device="cpu").step
        with pytest.raises(MissingDependencyError, match="C compiler"):
            make_backend(f"learned:{tmp_path}", scene, device="cpu", native=True)
