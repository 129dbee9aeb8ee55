"""Effects that act at some moments only, or all at once: a derivative leads nowhere at first."""

import dataclasses
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import orbisim
from orbisim.diagnosis.explanations import done, enough, quiet
from orbisim.diagnosis.findings import verdict_of
from orbisim.diagnosis.settings import Settings
from orbisim.effects import EffectInstance
from orbisim.motion.samples import prepare_all
from orbisim.recording import bind
from orbisim.shooting.bench import Bench, make_bench
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.judge import Judge
from orbisim.testing import inject_effect

ASSETS = Path(__file__).parents[2] / "mjcf_assets"


def _bench(scene: orbisim.Scene, effect: EffectInstance) -> Bench:
    runs = inject_effect(scene, effect, duration=5.0, episodes=3, noise=1e-4, seed=4)
    return make_bench(scene, prepare_all(runs, scene), 0.5)


def test_a_saturated_servo() -> None:
    """Along the declared scene a window's start is forgotten; a saturated servo remembers it."""
    scene = orbisim.load_scene(ASSETS / "servo_pendulum" / "scene.xml")
    force = float(np.abs(_forces(scene)).max())
    truth = 0.4 * force
    bench = _bench(scene, EffectInstance("torque_saturation", "servo", {"limit": truth}))
    judge = Judge(bench, bench.intervals)
    guess = EffectInstance("torque_saturation", "servo", {"limit": 0.2 * truth})
    first = judge.judge(Hypothesis((guess,)))
    assert first is not None and first.ratio > 5
    found = judge.closer(first)
    assert found.hypothesis.effects[0].values["limit"] == pytest.approx(truth, rel=0.01)
    assert found.ratio < 1.2


def test_starts_of_a_poor_scene_are_not_insisted_on() -> None:
    """What starts do to make up for a limit that is not declared leads far away with it."""
    scene = orbisim.load_scene(ASSETS / "servo_pendulum" / "scene.xml")
    limit = 0.2 * float(np.abs(_forces(scene)).max())
    truth = EffectInstance("torque_saturation", "servo", {"limit": limit})
    bench = _bench(scene, truth)
    held = Hypothesis((truth,), frozen=frozenset({(0, "limit")}))
    judge = Judge(bench, bench.intervals)
    cold, declared = judge.judge(held), judge.judge(Hypothesis())
    assert cold is not None and declared is not None and declared.ratio > 20
    far = dataclasses.replace(declared.fit, start=declared.fit.start + 0.3)
    begin = judge.begin(dataclasses.replace(declared, fit=far))
    warm = judge.judge(held, begin=begin)
    assert warm is not None and warm.loss < cold.loss + 0.01


def _forces(scene: orbisim.Scene) -> np.ndarray:
    """Of the servo in recordings without the effect."""
    (run,) = inject_effect(scene, [], duration=5.0, episodes=1, seed=4)
    bound, model = bind(run, scene), scene.model
    error = bound.ctrl[:, 0] - bound.qpos[:, 0]
    return np.asarray(model.actuator_gainprm[0, 0] * error)


def test_a_gate_that_opens_all_at_once(arm: orbisim.Scene) -> None:
    truth = EffectInstance("deadband", "elbow", {"width": 0.2}, {"kind": "gate"})
    bench = _bench(arm, truth)
    guess = EffectInstance("deadband", "elbow", {"width": 0.15}, {"kind": "gate"})
    found = Judge(bench, bench.intervals).judge(Hypothesis((guess,)))
    assert found is not None
    assert found.hypothesis.effects[0].values["width"] == pytest.approx(0.2, rel=0.03)


def test_a_residual_in_few_windows_is_looked_at() -> None:
    def declared(ratio: float, pooled: float, signals: tuple[float, ...] = (1.0, 1.0)) -> Any:
        fit = SimpleNamespace(count=5000)
        return SimpleNamespace(ratio=ratio, pooled=pooled, fit=fit, signals=np.array(signals))

    assert quiet(Settings(), declared(1.0, 1.05))
    assert quiet(Settings(), declared(1.0, 1.05, ()))
    assert not quiet(Settings(), declared(1.0, 1.05, (0.9, 1.3, 0.9, 0.9)))  # along one axis only
    # of each signal there are fewer data: by chance it is further from the noise than all are
    edge = enough(Settings(), declared(1.0, 1.0)) + 0.01
    assert quiet(Settings(), declared(1.0, 1.0, (edge, 1.0, 1.0, 1.0)))
    assert not quiet(Settings(), declared(1.0, edge))
    assert not quiet(Settings(), declared(1.0, 1.3))
    assert not quiet(Settings(), declared(1.3, 1.0))
    context: Any = SimpleNamespace(settings=Settings())
    friction = EffectInstance("coulomb_friction", "elbow", {"torque": 0.1})
    for effects, ended in ((), False), ((friction,), True):  # a few impacts no fit reproduces
        judged: Any = declared(1.0, 1.3)
        judged.hypothesis = Hypothesis(effects)
        assert done(context, judged) == ended


@pytest.mark.parametrize(("cut_short", "verdict"), [(False, "no_residual"), (True, "unexplained")])
def test_a_search_that_was_ended_says_nothing_of_few_windows(cut_short: bool, verdict: str) -> None:
    """They are in `pooled`; where it ended by itself, nothing explains them: impacts."""
    before = SimpleNamespace(ratio=1.07, pooled=8.0, fit=SimpleNamespace(count=5000))
    found: Any = SimpleNamespace(
        hypothesis=Hypothesis(), before=before, after=before, left=None, cut_short=cut_short
    )
    assert verdict_of(found, Settings()) == verdict


@pytest.mark.parametrize(("cut_short", "verdict"), [(False, "no_residual"), (True, "unexplained")])
def test_a_search_that_was_ended_calls_nothing_noise(cut_short: bool, verdict: str) -> None:
    """What is left may be an effect that was not tried: a late sensor looks like coloured noise."""
    before = SimpleNamespace(ratio=8.7, pooled=8.7, fit=SimpleNamespace(count=5000))
    left = SimpleNamespace(structured=False)
    found: Any = SimpleNamespace(
        hypothesis=Hypothesis(), before=before, after=before, left=left, cut_short=cut_short
    )
    assert verdict_of(found, Settings()) == verdict
