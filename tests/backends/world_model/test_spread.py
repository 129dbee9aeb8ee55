"""The uncertainty of a rollout: its propagation, its training, and where the backend shows it."""

from __future__ import annotations

import json
import shutil
import warnings
from pathlib import Path

import numpy as np
import pytest
import torch
from orbisim_world_model.backend import (
    LearnedBackend,
    OutsideTrainingWarning,
    UncertainPredictionWarning,
)
from orbisim_world_model.checkpoint import load_checkpoint, save_checkpoint
from orbisim_world_model.pack import Pack
from orbisim_world_model.run import Run, train
from orbisim_world_model.spread import UNITS, Factors, factors_of, half_widths, propagated
from orbisim_world_model.spread_fitting import SpreadRun, fit_spread
from orbisim_world_model.stepping import MEMORY
from orbisim_world_model.watch import Watch

from orbisim import load_scene, make_backend
from orbisim.errors import InputError
from tests.backends.world_model.conftest import toy
from tests.backends.world_model.synthetic import TABLE, simulate


@pytest.fixture(scope="module")
def pack() -> Pack:
    return simulate(TABLE, 8, 25, 4)


@pytest.fixture(scope="module", params=["default", "recurrent"])
def folder(
    request: pytest.FixtureRequest, pack: Pack, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    folder = tmp_path_factory.mktemp(request.param)
    train(pack, toy(request.param, "1x2x32"), Run(out=folder, steps=20))
    checkpoint = load_checkpoint(folder)
    run = SpreadRun(steps=60, windows=32, batch=16, length=12, width=16)
    known = fit_spread(checkpoint.model, [pack], [pack], run)
    save_checkpoint(folder, [checkpoint.model], {**checkpoint.manifest, "uncertainty": known})
    return folder


_FLAT = {"robot": [[1.0, 1.0]] * 2, "objects": [[1.0, 1.0]] * 2}


def _backend(folder: Path, native: bool) -> LearnedBackend:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OutsideTrainingWarning)
        name = f"learned:{folder}"
        backend = make_backend(name, load_scene(TABLE), device="cpu", native=native)
    assert isinstance(backend, LearnedBackend)
    return backend


def test_variances_are_handed_on_and_added_up() -> None:
    gain = torch.zeros(1, 2, 2, 2, 2)
    gain[0, 0, 1, 0, 1] = 0.5  # onto position of the first, from rotation of the second
    gain[0, 1, 1, 1, 1] = 2.0
    noise = torch.tensor([[[0.1, 0.2], [0.3, 0.4]]])
    found = propagated(gain, noise, torch.tensor([[[1.0, 2.0], [3.0, 4.0]]]))
    assert torch.allclose(found, torch.tensor([[[2.1, 0.2], [0.3, 8.4]]]))


def test_factors_are_linear_in_the_logarithm_of_a_rollouts_age() -> None:
    values = torch.tensor([[[1.0, 2.0]], [[3.0, 2.0]], [[4.0, 8.0]]])
    factors = Factors(torch.tensor([10.0, 40.0, 160.0]), values)
    ages = torch.tensor([[0.0], [1.0], [10.0], [20.0], [40.0], [80.0], [160.0], [2000.0]])
    wanted = [[1.0, 2.0]] * 3 + [[2.0, 2.0], [3.0, 2.0], [3.5, 5.0], [4.0, 8.0], [4.0, 8.0]]
    torch.testing.assert_close(factors.at(ages)[:, 0], torch.tensor(wanted))
    assert torch.equal(factors.largest, torch.tensor([[4.0, 8.0]]))


def test_half_widths_grow_with_the_age_alone_where_variances_do_not(folder: Path) -> None:
    known = {"steps": [10, 1000], "robot": [[1.0, 1.0]] * 2, "objects": [[1.0, 3.0], [2.0, 9.0]]}
    carried = torch.ones(2, 3, 3)  # two worlds, a robot and two objects
    carried[..., 2] = torch.tensor([[10.0], [100.0]])
    widths = half_widths(carried, factors_of(known, load_checkpoint(folder).layout))
    expected = torch.tensor([[[1.0, 1.0], [1.0, 3.0]], [[1.0, 1.0], [1.5, 6.0]]])
    expected = expected[:, [0, 1, 1]] * torch.tensor(UNITS)
    torch.testing.assert_close(widths, expected, rtol=1e-5, atol=0.0)


@pytest.mark.parametrize("native", [False, True])
def test_the_backend_carries_it_along(folder: Path, native: bool) -> None:
    if native and not any(map(shutil.which, ("cc", "gcc", "clang"))):
        pytest.skip("no C compiler")
    if native and "recurrent" in folder.name:
        pytest.skip("is compiled alike; native/test_step.py compares memories")
    backend = _backend(folder, native)
    state, controls = backend.reset(1), np.full((1, 4, 2), 0.05)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OutsideTrainingWarning)
        path = backend.rollout(state, controls)
        for t in range(4):
            state = backend.step(state, controls[:, t])
    whole = backend.uncertainty(path)
    assert whole is not None and whole.shape == (1, 4, 3, 2)
    assert backend.entity_names == ("robot", "one", "two")
    intervals = backend.intervals(path)
    assert intervals is not None and intervals.level == 0.9
    hand = backend.engine.layout.hand
    assert intervals.frames[-2:] == (("body", "one"), ("body", "two"))
    assert intervals.frames[:-2] == ((("site", hand),) if hand else ())
    seen = whole if hand else whole[:, :, 1:]
    np.testing.assert_array_equal(intervals.position, seen[..., 0])
    np.testing.assert_array_equal(intervals.rotation, seen[..., 1])
    assert (whole > 0).all() and np.isfinite(whole).all()
    np.testing.assert_allclose(backend.uncertainty(state), whole[:, -1], rtol=2e-3)
    np.testing.assert_allclose(
        state.memory[MEMORY][..., -3:], path.final.memory[MEMORY][..., -3:], rtol=4e-3
    )
    carried = path.final.memory[MEMORY][..., -3:]
    np.testing.assert_array_equal(carried[..., 2], 4.0)  # steps
    np.testing.assert_array_equal(state.memory[MEMORY][..., -1], 4.0)
    known = backend.checkpoint.manifest["uncertainty"]["factor"]
    factor = np.array([known["robot"][0], known["objects"][0], known["objects"][0]])
    exact = np.sqrt(carried[..., :2] + 1e-6) * factor * UNITS
    np.testing.assert_allclose(whole[:, -1], exact, rtol=1e-4)


@pytest.mark.parametrize("way", ["rollout", "held", "steps", "native", "gradients"])
def test_every_path_widens_intervals_by_age(folder: Path, way: str) -> None:
    if way == "native" and not any(map(shutil.which, ("cc", "gcc", "clang"))):
        pytest.skip("no C compiler")
    if way == "native" and "recurrent" in folder.name:
        pytest.skip("is compiled alike; native/test_step.py compares memories")
    backend = _backend(folder, way == "native")
    factor = {"steps": [1, 4], "robot": [[1.0, 1.0]] * 2, "objects": [[1.0, 1.0], [3.0, 5.0]]}
    backend.checkpoint.manifest["uncertainty"]["factor"] = factor
    state, controls = backend.reset(1), np.full((1, 4, 2), 0.05)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OutsideTrainingWarning)
        if way == "rollout":
            state = backend.rollout(state, controls).final
        elif way == "held":
            state = backend.rollout(state, controls[:, :2], nstep=2).final
        elif way == "gradients":
            asked = torch.tensor(controls, requires_grad=True)
            state = backend.rollout(state, asked).final
        else:
            for t in range(4):
                state = backend.step(state, controls[:, t])
    carried = torch.as_tensor(state.memory[MEMORY]).detach().numpy()[0, :, -3:]
    assert (carried[:, 2] == 4.0).all()
    found = torch.as_tensor(backend.uncertainty(state)).numpy()[0]
    exact = np.sqrt(carried[:, :2] + 1e-6) * UNITS * [[1.0, 1.0], [3.0, 5.0], [3.0, 5.0]]
    np.testing.assert_allclose(found, exact, rtol=1e-4)


def test_a_constant_factor_of_before_is_read(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder, tmp_path / "before")
    path = tmp_path / "before" / "manifest.json"
    manifest = json.loads(path.read_text())
    manifest["uncertainty"]["factor"] = {"robot": [1.0, 2.0], "objects": [3.0, 4.0]}
    path.write_text(json.dumps(manifest))
    found = load_checkpoint(path.parent)
    factors = factors_of(found.manifest["uncertainty"]["factor"], found.layout)
    for age in (0.0, 1.0, 700.0):
        values = factors.at(torch.full((3,), age))
        assert torch.equal(values, torch.tensor([[1.0, 2.0], [3.0, 4.0], [3.0, 4.0]]))


def test_the_rest_of_a_step_is_the_same_with_it(pack: Pack, folder: Path) -> None:
    model = load_checkpoint(folder).model
    x = model.completed(pack.states(torch.arange(3)))
    context = pack.context(torch.zeros(3, dtype=torch.long))
    with_it = model(x, model.initial_memory(3), pack.ctrl[:3], context)
    model.spread = None
    without = model(x, model.initial_memory(3), pack.ctrl[:3], context)
    for a, b in zip(with_it.state, without.state, strict=True):
        assert torch.equal(a, b)


@pytest.mark.parametrize("way", ["rollout", "step", "native"])
def test_an_interval_that_is_too_wide_is_warned_of(folder: Path, way: str) -> None:
    if way == "native" and not any(map(shutil.which, ("cc", "gcc", "clang"))):
        pytest.skip("no C compiler")
    if way == "native" and "recurrent" in folder.name:
        pytest.skip("is compiled alike; native/test_step.py compares memories")
    backend = _backend(folder, way == "native")
    # of a micrometre: 15 mm
    wide = {"steps": [1], "robot": [[1.0, 1.0]], "objects": [[1.5e4, 1.5e4]]}
    backend.checkpoint.manifest["uncertainty"]["factor"] = wide
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        if way == "rollout":
            backend.rollout(backend.reset(2), np.zeros((2, 3, 2)))
        else:
            backend.watch = Watch(backend.engine, backend.watch.label)  # has read the factors
            state = backend.step(backend.reset(1))
            backend.step(state)
    found = [w for w in said if issubclass(w.category, UncertainPredictionWarning)]
    assert len(found) == 1
    assert "world 0, step 0 (t = 0.02 s), 'one': its 90 % interval" in str(found[0].message)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width": 0}, r"uncertainty\.width is 0"),
        ({"factor": {"robot": [1.0, 1.0], "objects": [1.0, -1.0]}}, "two numbers above 0"),
        ({"factor": {"robot": [1.0]}}, "expected 2 entries"),
        ({"factor": {"robot": [1.0, 1.0]}}, "no entry 'objects'|objects"),
        ({"factor": {"steps": [3, 3], **_FLAT}}, r"steps is \[3, 3\]; expected rising"),
        ({"factor": {"steps": [0, 3], **_FLAT}}, r"steps is \[0, 3\]; expected rising"),
        ({"factor": {"steps": [], **_FLAT}}, "expected rising"),
        ({"factor": {"steps": [3], **_FLAT}}, "for each of the 1 steps"),
        ({"factor": {"steps": 3, **_FLAT}}, "factor.steps"),
        ({"width": 17}, "weights|the manifest describes"),
    ],
)
def test_damaged_manifests_are_refused(
    folder: Path, tmp_path: Path, change: dict[str, object], message: str
) -> None:
    shutil.copy(folder / "model.safetensors", tmp_path)
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["uncertainty"].update(change)
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(InputError, match=message):
        load_checkpoint(tmp_path)
