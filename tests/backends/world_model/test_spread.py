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
from orbisim_world_model.spread import (
    FREEDOM,
    LEVEL,
    SURE,
    UNITS,
    WIDER,
    Calibration,
    calibration_of,
    propagated,
)
from orbisim_world_model.spread_fitting import SpreadRun, fit_spread
from orbisim_world_model.stepping import MEMORY
from orbisim_world_model.watch import FAR, TURNED, UNSURE, Watch
from scipy import stats

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


def test_half_widths_and_their_variances() -> None:
    calibration = Calibration(torch.tensor([[1.0, 2.0], [10.0, 3.0]]), 3.0)
    variance = torch.tensor([[[16.0, 0.0], [7.0, 16.0]]])  # deviations 5 and 3, 4 and 5
    widths = calibration.half_widths(variance)
    expected = torch.tensor([[[5.0, 6.0], [40.0, 15.0]]]) * torch.tensor(UNITS)
    torch.testing.assert_close(widths, expected)
    for entity in range(2):
        back = calibration.variances(widths[0, entity])[entity]
        torch.testing.assert_close(back, variance[0, entity], atol=1e-4, rtol=1e-5)


def test_a_checkpoint_that_does_not_say_has_the_floor_of_before(folder: Path) -> None:
    found = load_checkpoint(folder)
    known = found.manifest["uncertainty"]
    assert known["floor"] == calibration_of(known, found.layout).floor == 0.05
    former = {name: value for name, value in known.items() if name != "floor"}
    assert calibration_of(former, found.layout).floor == 1e-3


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
        state.memory[MEMORY][..., -2:], path.final.memory[MEMORY][..., -2:], rtol=4e-3
    )
    known = backend.checkpoint.manifest["uncertainty"]["factor"]
    factor = np.array([known["robot"], known["objects"], known["objects"]])
    exact = np.sqrt(path.final.memory[MEMORY][..., -2:] + 0.05**2) * factor * UNITS
    np.testing.assert_allclose(whole[:, -1], exact, rtol=1e-4)


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
    # of a micrometre: 6 mm, of which the 99 % interval is 15 mm wide at least
    wide = {"robot": [1.0, 1.0], "objects": [6e3, 6e3]}
    backend.checkpoint.manifest["uncertainty"] |= {"factor": wide, "floor": 1e-3}
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        if way == "rollout":
            final = backend.rollout(backend.reset(2), np.zeros((2, 3, 2))).final
        else:
            backend.watch = Watch(backend.engine, backend.watch.label)  # has read the factors
            final = backend.reset(1)
            for _ in range(3):
                final = backend.step(final)
    found = [w for w in said if issubclass(w.category, UncertainPredictionWarning)]
    assert len(found) == 1  # once, though it stays so
    assert "world 0, step 0 (t = 0.02 s), 'one': its 99 % interval" in str(found[0].message)
    since = np.asarray(final.memory[UNSURE])
    assert since.shape == (final.nworld, 3)
    assert np.isinf(since[:, 0]).all()  # the hand's interval stays narrow
    np.testing.assert_allclose(since[:, 1:], 0.02)


def test_what_has_been_lost_stays_lost(folder: Path) -> None:
    """An interval that shrinks again takes nothing back, in this call or in a later one."""
    backend = _backend(folder, False)
    narrow = {"robot": [1.0, 1.0], "objects": [1.0, 1.0]}
    backend.checkpoint.manifest["uncertainty"] |= {"factor": narrow}
    state, limit = backend.reset(2), np.array([FAR, TURNED])
    width = torch.zeros(4, 2, 3, 2)
    width[1, 1, 2] = torch.tensor(1.01 * limit / WIDER)
    width[3, 0, 1] = torch.tensor(0.99 * limit / WIDER)
    with pytest.warns(UncertainPredictionWarning, match="world 1, step 1 .*'two'"):
        since = backend.watch._unsure_since(state, width, 0.5)
    assert since[1, 2] == 1.0 and np.isinf(np.delete(since.ravel(), 5)).all()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        later = state.replace(time=state.time + 2.0).with_memory(**{UNSURE: since})
        again = backend.watch._unsure_since(later, width, 0.5)
    np.testing.assert_array_equal(again, since)


def test_a_hand_that_is_lost_is_warned_of_too() -> None:
    """An arm that runs into the table; a robot without a hand has no pose to lose."""
    backend = make_backend("learned:push_contacts", load_scene("task:push"), device="cpu")
    assert isinstance(backend, LearnedBackend) and backend.engine.layout.hand
    width = torch.zeros(1, 1, 3, 2)
    width[0, 0, 0, 0] = 1.01 * FAR / WIDER
    with pytest.warns(UncertainPredictionWarning, match="step 0 .*'robot': its 99 % interval"):
        since = backend.watch._unsure_since(backend.reset(1), width, 0.05)
    assert since.tolist() == [[0.05, np.inf, np.inf]]


def test_warnings_go_by_the_interval_that_holds_99_percent() -> None:
    """Of Student's t with the degrees of freedom that spreads are trained with."""
    ends = [stats.t.ppf(0.5 + 0.5 * level, FREEDOM) for level in (SURE, LEVEL)]
    assert pytest.approx(ends[0] / ends[1], rel=1e-4) == WIDER


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width": 0}, r"uncertainty\.width is 0"),
        ({"floor": -1.0}, r"uncertainty\.floor is -1"),
        ({"floor": "0.05"}, r"uncertainty\.floor"),
        ({"factor": {"robot": [1.0, 1.0], "objects": [1.0, -1.0]}}, "two numbers above 0"),
        ({"factor": {"robot": [1.0]}}, "expected 2 entries"),
        ({"factor": {"robot": [1.0, 1.0]}}, "no entry 'objects'|objects"),
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
