"""What explains forces and what explains free runs, by both."""

import dataclasses
from typing import Any

import numpy as np
import pytest

import orbisim
from orbisim.diagnosis.both import _of_forces, _of_runs, by_runs, worth_in_both
from orbisim.diagnosis.conclusion import Attribution
from orbisim.diagnosis.force_data import ForceData, force_data
from orbisim.diagnosis.force_search import ForceAttribution
from orbisim.diagnosis.run import _settled, _weighed
from orbisim.effects import EffectInstance
from orbisim.evidence import Gain, gain
from orbisim.motion.samples import prepare_all
from orbisim.shooting.bench import Bench, make_bench
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.judge import Judge
from orbisim.testing import inject_effect


@pytest.fixture(scope="module")
def data(
    arm: orbisim.Scene, several: tuple[EffectInstance, ...]
) -> tuple[Bench, ForceData, Hypothesis]:
    runs = inject_effect(arm, several, duration=2.0, episodes=3, noise=1e-4, seed=5)
    samples = prepare_all(runs, arm)
    return make_bench(arm, samples, 0.5), force_data(arm, samples), Hypothesis(several)


def test_the_truth_is_worth_more_than_a_part_of_it(
    data: tuple[Bench, ForceData, Hypothesis],
) -> None:
    bench, forces, truth = data
    part = truth.without(len(truth.effects) - 1)
    assert worth_in_both(bench, forces, Hypothesis(), truth).sure > 10
    assert worth_in_both(bench, forces, part, truth).sure > 0
    back = worth_in_both(bench, forces, truth, part)
    assert back.total == pytest.approx(-worth_in_both(bench, forces, part, truth).total)


def test_both_kinds_of_evidence_count(data: tuple[Bench, ForceData, Hypothesis]) -> None:
    bench, forces, truth = data
    (nothing, all_of_it), runs = _of_runs(bench, Hypothesis(), truth)
    assert np.median(nothing) > 20 and np.median(all_of_it) < 1.5
    (missing, left), stretches = _of_forces(forces, Hypothesis(), truth)
    assert np.mean(missing) > 4 * np.mean(left)
    assert (left >= stretches.floor**2).all()
    whole = worth_in_both(bench, forces, Hypothesis(), truth)
    parts = gain(nothing, all_of_it, runs), gain(missing, left, stretches)
    assert whole.mean == pytest.approx(sum(one.mean for one in parts))
    assert all(one.sure > 0 for one in parts)


def test_what_cannot_be_simulated_is_worth_nothing(
    data: tuple[Bench, ForceData, Hypothesis],
) -> None:
    bench, forces, truth = data
    none = Hypothesis((EffectInstance("armature", "elbow", {"inertia": -1.0}),))
    assert worth_in_both(bench, forces, none, truth).sure > 0


@dataclasses.dataclass(frozen=True)
class Answer:
    """What is weighed of a diagnosis."""

    attribution: object
    notes: tuple[str, ...] = ()
    verdict: str = "explained"
    history: tuple[str, ...] = ()


def test_the_better_answer_is_given_whichever_was_fitted_to_what(
    data: tuple[Bench, ForceData, Hypothesis],
) -> None:
    bench, forces, truth = data
    judge, part = Judge(bench, bench.intervals), truth.without(1)
    for moved, pushed in ((part, truth), (truth, part)):
        judged = judge.judge(moved, 3)
        assert judged is not None
        runs = Attribution(bench, judged, judged, None, (), (), (), False)
        other = ForceAttribution(forces, pushed, None, 9.0, 1.0)  # type: ignore[arg-type]
        found = _weighed(Answer(runs), Answer(other))  # type: ignore[arg-type]
        assert found.attribution is (other if pushed is truth else runs)
        assert "by free runs and by forces together" in found.notes[-1]


def test_what_free_runs_contradict_is_no_answer(
    data: tuple[Bench, ForceData, Hypothesis], monkeypatch: pytest.MonkeyPatch
) -> None:
    """However much forces are in favour of it."""
    monkeypatch.setattr("orbisim.diagnosis.run.worth_in_both", lambda *_: Gain(1e3, 1.0))
    bench, forces, truth = data
    judged = Judge(bench, bench.intervals).judge(truth.without(1), 3)
    assert judged is not None
    pushed = EffectInstance("torque_bias", "elbow", {"offset": 50.0})
    assert by_runs(bench, truth).gain.sure > 0 and by_runs(bench, truth).left < 1.5
    assert by_runs(bench, Hypothesis((pushed,))).left > 100
    runs = Attribution(bench, judged, judged, None, (), (), (), False)
    other = ForceAttribution(forces, Hypothesis((pushed,)), None, 9.0, 1.0)  # type: ignore[arg-type]
    found = _weighed(Answer(runs), Answer(other))  # type: ignore[arg-type]
    assert found.attribution is runs and "worse than the declared scene" in found.notes[-1]


def test_what_leaves_something_of_free_runs_does_not_explain_everything(
    data: tuple[Bench, ForceData, Hypothesis],
) -> None:
    bench, forces, truth = data
    declared = Judge(bench, bench.intervals).judge(Hypothesis(), 1)
    assert declared is not None
    runs = Attribution(bench, declared, declared, None, (), (), (), False)
    for pushed, verdict in ((truth, "explained"), (truth.without(1), "partly_explained")):
        other = ForceAttribution(forces, pushed, None, 9.0, 1.0)  # type: ignore[arg-type]
        found = _weighed(Answer(runs), Answer(other))  # type: ignore[arg-type]
        assert found.attribution is other and found.verdict == verdict


@dataclasses.dataclass(frozen=True)
class ByForces(Answer):
    """The same of one that explains forces."""

    scene: orbisim.Scene | None = None
    effects: tuple[EffectInstance, ...] = ()


def test_many_effects_settle_it_unless_free_runs_contradict(
    data: tuple[Bench, ForceData, Hypothesis], arm: orbisim.Scene
) -> None:
    """Late sensors look like forces at every joint, with which free runs go elsewhere."""
    bench, forces, truth = data
    assert len(truth.effects) >= arm.model.nv
    driven = Hypothesis(
        tuple(
            EffectInstance("viscous_damping", joint, {"coefficient": -0.01})
            for joint in ("shoulder", "elbow")
        )
    )

    def answer(one: Hypothesis, verdict: str = "partly_explained") -> Any:
        found = ForceAttribution(forces, one, None, 10.0, 5.0)  # type: ignore[arg-type]
        return ByForces(found, (), verdict, (), arm, one.effects)

    assert _settled(bench, answer(truth))
    assert not _settled(bench, answer(driven))
    assert not _settled(bench, answer(truth, "explained"))
    assert not _settled(bench, answer(truth.without(0).without(0)))
