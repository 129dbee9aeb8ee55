"""A declared parameter at the end of its range gives way to the effect that it stands for."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import orbisim
from orbisim.diagnosis.bench import Hypothesis, make_bench
from orbisim.diagnosis.paying import strain
from orbisim.diagnosis.refine import Judge
from orbisim.diagnosis.relieving import gathered, meant, relieved
from orbisim.diagnosis.retune import REACH, Tunable, retuned, tunables
from orbisim.diagnosis.samples import prepare_all
from orbisim.diagnosis.settings import Settings
from orbisim.diagnosis.state import SearchState
from orbisim.effects import EffectInstance, add_effects
from orbisim.testing import inject_effect

SPRUNG = """
<mujoco>
  <worldbody>
    <body name="block" pos="0 0 1">
      <joint name="slide" type="slide" axis="1 0 0" damping="0.5" frictionloss="0.2"
        armature="0.1" stiffness="3" springref="0.1"/>
      <geom type="box" size="0.1 0.1 0.1" mass="2" pos="0.05 0 0"/>
    </body>
  </worldbody>
  <actuator><motor name="push" joint="slide" gear="5"/></actuator>
</mujoco>
"""
"""Every kind of declared parameter."""


def meaning(only: tuple[str, ...] | None = None) -> Any:
    """What `meant` reads of a search."""
    scene = orbisim.load_scene(SPRUNG)
    return SimpleNamespace(bench=SimpleNamespace(scene=scene), settings=Settings(effects=only))


@pytest.mark.parametrize("one", tunables(orbisim.load_scene(SPRUNG).model), ids=str)
def test_the_effect_is_the_same_as_the_parameter_times_its_factor(one: Tunable) -> None:
    state = meaning()
    instance = meant(state, one, 1.2)
    if one.kind == "stiffness":
        assert instance is None  # a joint has one spring
        return
    assert instance is not None and instance.target == one.target
    scene = state.bench.scene
    changed, wanted = add_effects(scene, [instance]), retuned(scene, {one: 1.2})
    if one.kind == "mass":  # a point mass has no inertia of its own: the block cannot turn
        total = [s.model.body_subtreemass[0] for s in (changed, wanted)]
        assert total[0] == pytest.approx(total[1])
        return
    ends = []
    for each in (changed, wanted):
        physics = orbisim.Physics.from_scene(each)
        with physics.reset_context():
            physics.data.qpos[0] = 0.5
        for step in range(200):
            physics.set_control([np.sin(0.05 * step)])
            physics.step()
        ends.append([*physics.data.qpos, *physics.data.qvel])
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)


def test_what_cannot_be_is_not_meant() -> None:
    friction, gain = Tunable("frictionloss", "slide"), Tunable("gain", "push")
    assert meant(meaning(), friction, 0.9) is None  # less friction than declared
    assert meant(meaning(), gain, 0.9) is not None
    assert meant(meaning(("coulomb_friction",)), gain, 0.9) is None  # only those were asked for


def test_a_gain_that_all_others_make_up_for_is_named(arm: orbisim.Scene) -> None:
    """All masses and the other gain a little up are the same as one gain a little down."""
    gain, other = Tunable("gain", "shoulder"), Tunable("gain", "elbow")
    masses = (Tunable("mass", "upper_arm"), Tunable("mass", "forearm"))
    true = retuned(arm, {gain: 0.87})
    runs = inject_effect(true, [], duration=4.0, episodes=2, noise=1e-3, seed=4)
    state = SearchState(make_bench(arm, prepare_all(runs, arm), 0.5), Settings(), lambda _: None)
    state.find_tunables()
    assert {gain, other, *masses} <= set(state.tunables)
    tuned = state.tuned(Hypothesis())
    assert tuned is not None and state.done(tuned)
    assert gain in strain(tuned.hypothesis)
    found = relieved(state, tuned)
    assert found is not None and strain(found.hypothesis) == []
    (effect,) = found.hypothesis.effects
    assert (effect.effect, effect.target) == ("torque_gain", "shoulder")
    masses_now = dict(found.hypothesis.factors)[masses[0]]
    assert effect.values["gain"] / masses_now == pytest.approx(0.87, rel=0.01)
    assert [r.instance.effect for r in state.rivals] == ["torque_gain"]


def test_a_gain_that_several_parameters_share_is_named(arm: orbisim.Scene) -> None:
    """No factor is at its limit, and yet masses, dampings and gains moved together."""
    gain = Tunable("gain", "elbow")
    for factor, named in ((1.12, True), (1.04, False)):
        runs = inject_effect(retuned(arm, {gain: factor}), [], duration=4.0, episodes=2,
                             noise=5e-4, seed=4)  # fmt: skip
        bench = make_bench(arm, prepare_all(runs, arm), 0.5)
        state = SearchState(bench, Settings(), lambda _: None)
        state.find_tunables()
        tuned = state.tuned(Hypothesis())
        assert tuned is not None and state.done(tuned)
        found = gathered(state, tuned)
        assert (found is not tuned) == named
        if named:
            (effect,) = found.hypothesis.effects
            assert (effect.effect, effect.target) == ("torque_gain", "elbow")
            assert effect.values["gain"] == pytest.approx(1.12, rel=0.03)


def test_nothing_is_relieved_without_strain(arm: orbisim.Scene) -> None:
    runs = inject_effect(arm, [], duration=2.0, episodes=2, noise=2e-4, seed=4)
    state = SearchState(make_bench(arm, prepare_all(runs, arm), 0.5), Settings(), lambda _: None)
    state.find_tunables()
    nothing = state.need(Hypothesis().tuned(state.tunables))
    assert relieved(state, nothing) is None
    far = dataclasses.replace(Hypothesis(), factors=((Tunable("gain", "elbow"), 1 - REACH),))
    assert strain(far) == [Tunable("gain", "elbow")]


def test_numbers_that_have_run_off_to_a_far_bound_are_undetermined(arm: orbisim.Scene) -> None:
    """A force across the plane in which the arm moves, however much rounding makes of it."""
    runs = inject_effect(arm, [], duration=2.0, episodes=2, noise=2e-4, seed=4)
    bench = make_bench(arm, prepare_all(runs, arm), 0.5)
    judge = Judge(bench, bench.intervals)

    def undetermined(y: float) -> list[tuple[int, str]]:
        parts = {"x": 1.7, "y": y, "z": -1.6}
        force = EffectInstance("constant_force", "upper_arm", {"magnitude": 1e6, **parts})
        values = np.array([1.7, y, -1.6])
        fit: Any = SimpleNamespace(values=values, information=1e9 * np.eye(3)[None])
        return judge._undetermined(Hypothesis((force,)), fit)

    assert undetermined(1e6) == undetermined(-1e6) == [(0, "y")]
    assert undetermined(2.0) == []
