"""The compiled step gives what torch gives."""

from __future__ import annotations

import ctypes
import shutil
import warnings
from pathlib import Path

import numpy as np
import pytest
import torch
from orbisim_world_model.backend import OutsideTrainingWarning
from orbisim_world_model.entities import Context
from orbisim_world_model.native import NativeStep, compiler
from orbisim_world_model.native.translate import Translator
from orbisim_world_model.native.values import contiguous
from orbisim_world_model.native.writer import Writer
from orbisim_world_model.run import Run, train
from orbisim_world_model.trainer import new_model
from torch._decomp import core_aten_decompositions
from torch.fx.experimental.proxy_tensor import make_fx

from orbisim import State, load_scene, make_backend
from orbisim.backend import Backend
from orbisim.errors import DivergedError, MissingDependencyError
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
    translator = Translator(traced)
    outputs = [translator.writer.elementwise(v.shape, "{0}", [v]) for v in translator.run()]
    writer = translator.writer
    constants = torch.cat([*writer.constants, torch.zeros(1)]).numpy()
    workspace = np.zeros(writer.workspace, np.float32)
    pointer = ctypes.POINTER(ctypes.c_float)
    arrays = [np.ascontiguousarray(t.numpy()) for t in given]
    inputs = (pointer * 2)(*(a.ctypes.data_as(pointer) for a in arrays))
    step = compiler.compiled(writer.source(), careful=True)
    step(constants.ctypes.data_as(pointer), workspace.ctypes.data_as(pointer), inputs)
    for ours, theirs in zip(outputs, function(*given), strict=True):
        np.testing.assert_allclose(workspace[ours.index.numpy()], theirs.numpy(), atol=1e-6)


@needs_compiler
@pytest.mark.parametrize("rows", [1, 2, 3, 5, 12, 13, 25])
def test_products_of_any_number_of_rows(rows: int) -> None:
    generator = torch.Generator().manual_seed(rows)
    x, weight, bias = (
        torch.randn(shape, generator=generator) for shape in ((rows, 37), (37, 70), (70,))
    )
    writer = Writer()
    out = writer.product(contiguous("in[0]", 0, x.shape), weight, bias)
    constants = torch.cat(writer.constants).numpy()
    workspace = np.zeros(writer.workspace, np.float32)
    pointer = ctypes.POINTER(ctypes.c_float)
    held = np.ascontiguousarray(x.numpy())
    inputs = (pointer * 1)(held.ctypes.data_as(pointer))
    step = compiler.compiled(writer.source())
    step(constants.ctypes.data_as(pointer), workspace.ctypes.data_as(pointer), inputs)
    np.testing.assert_allclose(
        workspace[out.index.numpy()], (x @ weight + bias).numpy(), atol=1e-4, rtol=1e-5
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


def test_without_a_compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    train(simulate(PENDULUM, 4, 20, 2), toy(), Run(out=tmp_path, steps=2))
    monkeypatch.setattr(compiler.shutil, "which", lambda name: None)
    scene = load_scene(PENDULUM)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OutsideTrainingWarning)
        assert make_backend(f"learned:{tmp_path}", scene, device="cpu").step
        with pytest.raises(MissingDependencyError, match="C compiler"):
            make_backend(f"learned:{tmp_path}", scene, device="cpu", native=True)
