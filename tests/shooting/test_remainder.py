"""Noise that is not white is no missing effect."""

from __future__ import annotations

import dataclasses
import time

import numpy as np
import pytest

import orbisim
from orbisim.diagnosis.settings import Settings
from orbisim.effects import EffectInstance
from orbisim.host.deadline import Deadline
from orbisim.motion.samples import prepare_all
from orbisim.recording import Recording
from orbisim.shooting.bench import Bench, make_bench
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.judge import Judge, Judged
from orbisim.shooting.remainder import bare_is_noise, left_of, told_as_noise
from orbisim.testing import inject_effect

NOISE = 1e-3
FEW = Settings(effects=("coulomb_friction", "sensor_delay"))


def _runs(scene: orbisim.Scene, effects: list[EffectInstance], episodes: int) -> list[Recording]:
    """With noise of three times the white one's size, correlated over three samples."""
    runs = inject_effect(
        scene, effects, duration=4.0, episodes=episodes, noise=NOISE, seed=2, velocities=False
    )
    found, decay = [], np.exp(-1 / 3)
    for number, one in enumerate(runs):
        rng, signals = np.random.default_rng(number), dict(one.signals)
        for name in (n for n in signals if n.startswith("qpos")):
            added = rng.normal(size=len(one))
            for k in range(1, len(added)):
                added[k] = decay * added[k - 1] + np.sqrt(1 - decay**2) * added[k]
            signals[name] = signals[name] + 3 * NOISE * added
        found.append(one.replace(signals=signals))
    return found


def _judged(scene: orbisim.Scene, runs: list[Recording]) -> tuple[Bench, Judged]:
    bench = make_bench(scene, prepare_all(runs, scene), 0.5)
    judged = Judge(bench, bench.intervals).judge(Hypothesis())
    assert judged is not None
    return bench, judged


def test_coloured_noise_is_no_residual(arm: orbisim.Scene) -> None:
    result = orbisim.diagnose(arm, _runs(arm, [], 3), settings=FEW, progress=False)
    assert result.verdict == "no_residual" and not result.effects
    assert not result.residual["significant"]
    assert any("it is noise (noise of qpos/shoulder" in note for note in result.notes)


@pytest.mark.slow
def test_friction_beside_coloured_noise_is_found(arm: orbisim.Scene) -> None:
    dry = EffectInstance("coulomb_friction", "elbow", {"torque": 0.1})
    result = orbisim.diagnose(arm, _runs(arm, [dry], 3), settings=FEW, progress=False)
    (found,) = result.effects
    assert (found.effect, found.target) == ("coulomb_friction", "elbow")
    assert found.parameters["torque"].value == pytest.approx(0.1, rel=0.1)
    assert result.verdict in ("explained", "partly_explained")


def test_what_is_structured_is_not_called_noise(arm: orbisim.Scene) -> None:
    dry = EffectInstance("coulomb_friction", "elbow", {"torque": 0.1})
    bench, judged = _judged(arm, _runs(arm, [dry], 2))
    left = left_of(bench, judged)
    assert left is not None and left.structured
    assert told_as_noise(bench, judged, left) is None


@pytest.mark.parametrize("true", [1.0, 1.02])
def test_an_effect_has_to_be_worth_it_beside_noise_that_lasts(
    arm: orbisim.Scene, true: float
) -> None:
    scale = EffectInstance("sensor_scale", "elbow", {"factor": true})
    bench, bare = _judged(arm, _runs(arm, [scale] if true != 1 else [], 3))
    after = Judge(bench, bench.intervals).judge(Hypothesis((scale.replace(factor=1.001),)))
    assert after is not None
    left = left_of(bench, after)
    assert left is not None and not left.structured
    found = bare_is_noise(bench, bare, after, left, -8.0)
    assert (found is not None) == (true == 1)
    assert bare_is_noise(bench, bare, bare, left, 0.0) is None  # nothing to weigh
    slow = dataclasses.replace(left, structured=True)
    assert bare_is_noise(bench, bare, after, slow, -8.0) is None


def test_nothing_is_said_where_that_is_not_known(arm: orbisim.Scene) -> None:
    """White noise is all, bodies touch, or the time is up."""
    bench, judged = _judged(arm, _runs(arm, [], 2))
    assert judged.ratio > 1.5 and left_of(bench, judged) is not None
    assert left_of(bench, dataclasses.replace(judged, ratio=1.4)) is None
    assert left_of(dataclasses.replace(bench, contacts=True), judged) is None
    late = dataclasses.replace(bench, deadline=Deadline(time.monotonic()))
    assert left_of(late, judged) is None
    assert told_as_noise(bench, judged, None) is None


def test_what_is_in_few_windows_is_no_noise(arm: orbisim.Scene) -> None:
    bench, judged = _judged(arm, _runs(arm, [], 2))
    assert left_of(bench, judged) is not None
    few, most = np.full(2, 400.0), np.full(len(judged.fitted) - 2, 1.1)
    event = dataclasses.replace(
        judged, fitted=np.concatenate([few, most]), checked=np.full(len(judged.checked), 1.1)
    )
    assert left_of(bench, event) is None


def test_an_event_beside_coloured_noise_is_no_noise(arm: orbisim.Scene) -> None:
    """A stop that one window shows: that noise is in the others does not make it noise."""
    bench, judged = _judged(arm, _runs(arm, [], 2))
    assert judged.pooled > 1.5 and left_of(bench, judged) is not None
    fitted, every = judged.fitted.copy(), len(judged.fitted) + len(judged.checked)
    fitted[0] = 4e4
    pooled = float(np.sqrt((fitted.sum() + judged.checked.sum()) / every))
    event = dataclasses.replace(judged, fitted=fitted, pooled=pooled)
    assert left_of(bench, event) is None
