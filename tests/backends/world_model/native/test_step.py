"""The compiled step gives what torch gives."""

from __future__ import annotations

import shutil
import warnings
from pathlib import Path

import numpy as np
import pytest
import torch
from orbisim_world_model.backend import OutsideTrainingWarning
from orbisim_world_model.native import NativeStep, compiler
from orbisim_world_model.run import Run, train
from orbisim_world_model.trainer import new_model

from orbisim import load_scene, make_backend
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
