"""Neither the integration step nor when controls change is an effect: what they do is not named as
one."""

from __future__ import annotations

import dataclasses
from typing import Any

import mujoco
import numpy as np
import pytest

import orbisim
from orbisim.diagnosis import discretization
from orbisim.diagnosis.conclusion import attribute
from orbisim.diagnosis.context import Context, begun
from orbisim.diagnosis.discretization import as_declared, earlier, resolved, settled
from orbisim.diagnosis.explanations import Found, done
from orbisim.diagnosis.search import search
from orbisim.diagnosis.settings import Settings
from orbisim.diagnosis.simplification import simplified
from orbisim.effects import EffectInstance
from orbisim.motion.samples import Samples, prepare_all
from orbisim.recording.command_clock import Lead
from orbisim.shooting import timestep
from orbisim.shooting.bench import Bench, make_bench
from orbisim.shooting.forms import asked, foreseen_anew, untimed
from orbisim.shooting.halving import exact_enough
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.judge import Judged
from orbisim.shooting.stepping import Stepping, stepping, with_stepping
from orbisim.testing import inject_effect
from tests.balls import in_long_steps

SERVO = """<mujoco><option timestep="{step}" integrator="implicitfast"/><worldbody>
<body><joint name="hinge" axis="0 1 0" damping=".01"/>
<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".3"/></body></worldbody>
<actuator><position name="servo" joint="hinge" kp="4" kv=".2"/></actuator></mujoco>"""

RK4 = int(mujoco.mjtIntegrator.mjINT_RK4)
FAST = int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)


def _scene(step: float) -> orbisim.Scene:
    return orbisim.load_scene(SERVO.format(step=step))


def _judged(bench: Bench) -> tuple[Context, Judged]:
    """The declared scene, fitted."""
    context = begun(bench, Settings(), lambda _: None)
    judged = context.judge.judge(Hypothesis())
    assert judged is not None
    return context, judged


def test_a_step_that_is_too_long_is_shortened_instead_of_explained() -> None:
    runs = inject_effect(_scene(0.0005), [], duration=2.0, episodes=3, noise=5e-4, seed=1)
    result = orbisim.diagnose(_scene(0.01), runs, progress=False)
    assert result.verdict == "no_residual" and not result.effects
    assert stepping(result.augmented_scene).timestep == pytest.approx(0.0005, rel=0.3)
    assert any(
        "predict better than with the declared timestep of 0.01 s (implicitfast)" in n
        for n in result.notes
    )
    assert result.error["held_out"]["after"] < 0.8 * result.error["held_out"]["before"]


@pytest.mark.parametrize("count", [4, 6])
def test_steps_of_a_simulated_machine_are_found_that_are_no_half_of_others(count: int) -> None:
    """Five in a sampling interval: what four or six leave of that was named as an inertia."""
    runs = inject_effect(
        _scene(0.002), [], rate=100.0, duration=2.0, episodes=3, noise=1e-5, seed=1
    )
    scene = _scene(0.01 / count)
    context, judged = _judged(make_bench(scene, prepare_all(runs, scene), 0.5))
    found = settled(context, judged)
    assert found is not None
    assert stepping(found[0].bench.scene).timestep == pytest.approx(0.002)
    assert done(*found) and not done(context, judged)


def test_an_effect_is_found_beside_it() -> None:
    friction = EffectInstance("coulomb_friction", "hinge", {"torque": 0.05})
    runs = inject_effect(_scene(0.0005), friction, duration=2.0, episodes=3, noise=5e-4, seed=1)
    few = Settings(effects=("coulomb_friction", "viscous_damping", "clock_skew"))
    result = orbisim.diagnose(_scene(0.01), runs, settings=few, progress=False)
    assert [(e.effect, e.target) for e in result.effects] == [("coulomb_friction", "hinge")]
    assert result.effects[0].parameters["torque"].value == pytest.approx(0.05, rel=0.1)


@pytest.mark.parametrize("declared", [0.001, 0.005])
def test_commands_that_arrive_late_are_no_effect(declared: float) -> None:
    """Nor are they beside a step that is too long, which makes up for a part of it."""
    runs = [_sooner(_commanded(seed, 0.01, 0.006)) for seed in range(4)]
    result = orbisim.diagnose(_scene(declared), runs, progress=False)
    assert result.verdict == "no_residual" and not result.effects
    told = "after the sample at which they are logged (they arrive late"
    assert any(told in note for note in result.notes)


def _sooner(one: orbisim.Recording) -> orbisim.Recording:
    """With commands that are logged a sample before."""
    values = one.signals["ctrl/servo"]
    return one.replace(signals={**one.signals, "ctrl/servo": np.append(values[1:], values[-1])})


def test_controls_are_looked_for_elsewhere_with_another_step() -> None:
    """Two steps of a constant force from rest move a body by 3 / 2 as much as one of twice their
    length that begins with them, as if it had begun half a step earlier."""
    runs = [_commanded(seed, 0.01, -0.004) for seed in range(2)]
    scene = _scene(0.005)
    bench = make_bench(scene, prepare_all(runs, scene), 0.5).led(Lead(-0.4))
    finer = timestep.stepped(bench, 0.0025)
    assert finer.lead is not None and finer.lead.share == pytest.approx(-0.4 + 0.0025 / 2 / 0.01)
    again = timestep.stepped(finer, 0.005)
    assert again.lead is not None and again.lead.share == pytest.approx(-0.4)
    model = _scene(0.005).spec
    model.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    other = dataclasses.replace(bench, scene=orbisim.Scene.from_spec(model, source="servo"))
    exact = timestep.stepped(other, 0.0025)
    assert exact.lead is not None and exact.lead.share == -0.4


BESIDE = """<worldbody><geom type="plane" size="1 1 1" pos="0 0 -1"/>
<body pos=".5 0 -.9"><joint type="slide" axis="0 0 1"/><geom size=".1" mass="1"/></body>"""


@pytest.mark.parametrize("beside", [False, True], ids=["alone", "beside a ball at rest"])
@pytest.mark.parametrize("share", [-0.5, -0.2, 0.2])
def test_what_another_form_would_leave_is_foreseen(share: float, beside: bool) -> None:
    """Numbers and starts move with the form: as they are, they leave more. Where bodies touch, it
    is foreseen from windows without impacts."""
    scene = _scene(0.005)
    if beside:
        text = SERVO.format(step=0.005).replace("<worldbody>", BESIDE, 1)
        scene = orbisim.load_scene(text)
    friction = EffectInstance("coulomb_friction", "hinge", {"torque": 0.03})
    runs = inject_effect(scene, friction, duration=2.0, episodes=3, noise=5e-4, seed=1)
    bench = make_bench(scene, prepare_all(runs, scene), 0.5).led(Lead())
    assert bench.contacts == beside and not bench.rugged
    context = begun(bench, Settings(), lambda _: None)
    judged = context.judge.judge(Hypothesis((friction,)))
    assert judged is not None
    there = context.trying(bench.led(Lead(share))).judge
    fitted = there.judge(judged.hypothesis, begin=context.judge.begin(judged))
    seen = there.foreseen(judged, context.judge)
    assert fitted is not None and seen is not None
    before = _loss_without_impacts(bench, judged)
    after = _loss_without_impacts(bench, fitted)
    assert seen == pytest.approx(before - after, rel=0.1)
    held = dataclasses.replace(judged.hypothesis, frozen=frozenset({(0, "torque")}))
    as_it_was = there.judge(held, begin=context.judge.begin(judged))
    assert as_it_was is not None
    assert _loss_without_impacts(bench, as_it_was) > 1.05 * (before - seen)
    assert before - seen == pytest.approx(after, rel=0.05)


def _loss_without_impacts(bench: Bench, judged: Judged) -> float:
    """`Judged.loss` of windows without impacts."""
    fitted, checked = bench.smooth[bench.fit], bench.smooth[bench.check]
    return float(np.log1p([*judged.fitted[fitted], *judged.checked[checked]]).mean())


def test_of_late_sensors_nothing_is_foreseen() -> None:
    """Which of their readings are of a window changes with how late they are."""
    scene = _scene(0.005)
    late = EffectInstance("sensor_delay", "hinge", {"delay": 0.01})
    runs = inject_effect(scene, late, duration=2.0, episodes=2, noise=5e-4, seed=1)
    bench = make_bench(scene, prepare_all(runs, scene), 0.5)
    context = begun(bench, Settings(), lambda _: None)
    judged = context.judge.judge(Hypothesis((late,)))
    assert judged is not None
    assert context.judge.foreseen(judged, context.judge) is None


@pytest.mark.parametrize("within", [False, True])
def test_where_commands_change_within_steps_shorter_ones_are_tried(
    within: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However little the step matters else: each blurs a change over its length."""
    scene = _scene(0.005)
    runs = inject_effect(scene, [], duration=2.0, episodes=2, noise=5e-4, seed=1)
    context, judged = _judged(make_bench(scene, prepare_all(runs, scene), 0.5).led(Lead(-0.9)))
    monkeypatch.setattr(discretization, "matters", lambda *_: False)
    monkeypatch.setattr(discretization, "_gain", lambda *_: (0.1, (context, judged)))
    assert (discretization._finer(context, judged, within) is not None) == within


def test_a_step_that_is_right_stays() -> None:
    scene = _scene(0.005)
    runs = inject_effect(scene, [], duration=2.0, episodes=3, noise=5e-4, seed=1)
    bench = make_bench(scene, prepare_all(runs, scene), 0.5)
    context, judged = _judged(bench)
    assert (
        settled(context, judged) is None and as_declared(context, judged, stepping(scene)) is None
    )


def test_a_step_does_not_stand_in_for_an_effect_in_the_end() -> None:
    """What damping explains, another step does not have to; the next test asks for its way back."""
    scene = _scene(0.005)
    damping = EffectInstance("viscous_damping", "hinge", {"coefficient": 0.05})
    runs = inject_effect(scene, damping, duration=2.0, episodes=3, noise=5e-4, seed=1)
    few = Settings(effects=("viscous_damping", "armature", "clock_skew"))
    result = orbisim.diagnose(scene, runs, settings=few, progress=False)
    assert [(e.effect, e.target) for e in result.effects] == [("viscous_damping", "hinge")]
    assert result.augmented_scene.model.opt.timestep == pytest.approx(0.005)


def test_one_that_was_shortened_in_vain_grows_again() -> None:
    scene = _scene(0.005)
    runs = inject_effect(scene, [], duration=2.0, episodes=3, noise=5e-4, seed=1)
    fine = with_stepping(scene, Stepping(0.00125, RK4))
    bench = make_bench(fine, prepare_all(runs, fine), 0.5)
    context, judged = _judged(bench)
    found = as_declared(context, judged, stepping(scene))
    assert found is not None
    assert stepping(found[0].bench.scene) == stepping(scene)


def _in_exact_steps(
    scene: orbisim.Scene, runs: list[orbisim.Recording], step: float, *effects: EffectInstance
) -> tuple[Context, Judged]:
    exact = with_stepping(scene, Stepping(step, RK4))
    bench = make_bench(exact, prepare_all(runs, exact), 0.5)
    context = begun(bench, Settings(), lambda _: None)
    judged = context.judge.judge(Hypothesis(effects))
    assert judged is not None
    return context, judged


def test_declared_steps_come_back_once_friction_shows_that_they_predict_better(
    arm: orbisim.Scene,
) -> None:
    """Long steps through dry friction are not exact; what they leave was named."""
    friction = EffectInstance("coulomb_friction", "elbow", {"torque": 0.0231})
    runs = inject_effect(arm, friction, duration=2.0, episodes=2, noise=1e-4, seed=4)
    declared = stepping(arm)
    context, judged = _in_exact_steps(arm, runs, 0.005, friction)
    found = settled(context, judged, declared)
    assert found is not None and found[1].ratio < 1.1 < 2.0 < judged.ratio
    assert stepping(found[0].bench.scene) == declared
    assert settled(*found, declared) is None  # and stay


def test_declared_steps_do_not_come_back_where_exact_ones_predict_better() -> None:
    runs = inject_effect(_scene(0.00025), [], duration=2.0, episodes=3, noise=5e-4, seed=1)
    scene = _scene(0.01)
    context, judged = _in_exact_steps(scene, runs, 0.01)
    assert settled(context, judged, stepping(scene)) is None


def _commanded(seed: int, tick: float, early: float | None = None) -> orbisim.Recording:
    """A servo whose commands change every tick, logged at 100 Hz: what was in force at a sample.

    Args:
      early: by how much each change comes before a multiple of the tick, s; drawn where None.
    """
    scene = _scene(0.001)
    rng, data = np.random.default_rng(seed), mujoco.MjData(scene.model)
    levels = rng.uniform(-1, 1, 402)
    phase = (rng.uniform(0, tick) if early is None else early) + 1e-6
    rows = []
    for step in range(2000):
        data.ctrl[0] = levels[int((data.time + phase) / tick)]
        if step % 10 == 0:
            rows.append((data.time, data.qpos[0] + 5e-4 * rng.normal(), data.ctrl[0]))
        mujoco.mj_step(scene.model, data)
    time, qpos, ctrl = np.array(rows).T
    return orbisim.Recording(time, {"qpos/hinge": qpos, "ctrl/servo": ctrl}, source=f"log{seed}")


def test_controls_that_change_between_samples_are_no_early_sensor() -> None:
    runs = [_commanded(seed, 0.0273) for seed in range(4)]
    few = Settings(effects=("actuator_delay", "clock_skew", "sensor_delay", "viscous_damping"))
    result = orbisim.diagnose(_scene(0.001), runs, settings=few, progress=False)
    assert not result.effects
    assert any("by the clock of their own that the log shows" in note for note in result.notes)
    assert result.error["held_out"]["after"] < 0.9 * result.error["held_out"]["before"]


def test_a_clock_is_found_beside_a_step_that_makes_up_for_it() -> None:
    """Euler's forces act half a step early, as early as commands change before their samples on
    average: neither the clock nor a finer step is better without the other."""
    runs = [_commanded(seed, 0.0273) for seed in range(4)]
    scene = _scene(0.01)
    bench = asked(make_bench(scene, prepare_all(runs, scene), 0.5))
    context, judged = _judged(bench)
    found = settled(context, judged)
    assert found is not None and found[1].ratio < 0.15 * judged.ratio
    lead = found[0].bench.lead
    assert lead is not None and lead.clock and lead.share == pytest.approx(0.0, abs=0.06)


def test_controls_that_change_at_samples_are_held_from_there() -> None:
    scene = _scene(0.001)
    runs = [_commanded(seed, 0.01, 0.0) for seed in range(4)]
    bench = asked(make_bench(scene, prepare_all(runs, scene), 0.5))
    assert bench.lead == Lead()
    context, judged = _judged(bench)
    found = earlier(context, judged)
    assert found is None or not found[0].bench.lead


def test_the_time_by_which_controls_lead_is_found() -> None:
    scene = _scene(0.001)
    runs = [_commanded(seed, 0.01, 0.002) for seed in range(4)]
    bench = asked(make_bench(scene, prepare_all(runs, scene), 0.5))
    context, judged = _judged(bench)
    found = earlier(context, judged)
    assert found is not None
    assert found[0].bench.lead is not None and not found[0].bench.lead.clock
    assert found[0].bench.lead.share == pytest.approx(0.2, abs=0.03)


def test_a_lead_takes_the_place_of_sensors_that_are_early() -> None:
    scene = _scene(0.001)
    runs = [_commanded(seed, 0.01, 0.005) for seed in range(4)]
    bench = asked(make_bench(scene, prepare_all(runs, scene), 0.5))
    context, declared = _judged(bench)
    early = EffectInstance("sensor_delay", "hinge", {"delay": -0.005})
    damping = EffectInstance("viscous_damping", "hinge", {"coefficient": 0.001})
    named = context.judge.judge(Hypothesis((early, damping)), begin=context.judge.begin(declared))
    assert named is not None
    found = earlier(context, named)
    assert found is not None
    assert [one.effect for one in found[1].hypothesis.effects] == ["viscous_damping"]
    assert found[0].bench.lead is not None
    assert found[0].bench.lead.share == pytest.approx(0.5, abs=0.05)


def test_early_commands_take_the_place_of_a_late_sensor_that_reaches_the_noise() -> None:
    """Where nothing is left, nothing is added, but what there is may still have another reason."""
    scene = _scene(0.001)
    runs = [_commanded(seed, 0.01, 0.007) for seed in range(4)]
    bench = asked(make_bench(scene, prepare_all(runs, scene), 0.5))
    context, declared = _judged(bench)
    late = EffectInstance("sensor_delay", "hinge", {"delay": 0.007})
    named = context.judge.judge(Hypothesis((late,)), begin=context.judge.begin(declared))
    assert named is not None and done(context, named)
    found = Found(context, *[stepping(scene)] * 2, declared, named)
    found = simplified(dataclasses.replace(found, screening=context.screen(named)), 2)
    assert not found.best.hypothesis.effects and found.context.bench.lead
    assert found.context.bench.lead.share == pytest.approx(0.7, abs=0.05)


def test_delays_say_how_late_commands_would_be_in_their_place() -> None:
    scene = _scene(0.001)
    bench = asked(make_bench(scene, prepare_all([_commanded(0, 0.01)], scene), 0.5))
    _, declared = _judged(bench)
    damping = EffectInstance("viscous_damping", "hinge", {"coefficient": 0.001})
    seen = EffectInstance("sensor_delay", "hinge", {"delay": 0.004})
    done_late = EffectInstance("actuator_delay", "servo", {"delay": 0.002})
    named = dataclasses.replace(declared, hypothesis=Hypothesis((seen, damping, done_late)))
    ((fewer, shares),) = untimed(bench, named)
    assert fewer.hypothesis.effects == (damping,) and shares == pytest.approx([-0.3])
    assert not list(untimed(bench, declared))


@pytest.mark.parametrize("dry", [True, False])
def test_friction_is_as_dry_as_the_machines(dry: bool) -> None:
    """What a default of MuJoCo's does to a joint at rest is neither named nor put in its place."""
    made = _scene(0.001)
    true = with_stepping(made, stepping(made)._replace(dry=dry))
    friction = EffectInstance("coulomb_friction", "hinge", {"torque": 0.3})
    runs = inject_effect(true, [friction], duration=3.0, episodes=3, noise=1e-5, seed=5)
    context, declared = _judged(make_bench(made, prepare_all(runs, made), 0.5))
    named = context.judge.judge(Hypothesis((friction,)), begin=context.judge.begin(declared))
    assert named is not None
    found = settled(context, named)
    assert (found is not None and stepping(found[0].bench.scene).dry) == dry
    if found is not None:
        assert found[1].ratio < 0.7 * named.ratio


def test_what_a_form_changes_is_compared_with_the_noise_however_much_is_left(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A joint rests in a part of the windows only; beside what is missing that is little, and may
    still be what hides it."""
    made = _scene(0.001)
    friction, damping = (
        EffectInstance(effect, "hinge", {name: value})
        for effect, name, value in (
            ("coulomb_friction", "torque", 0.3),
            ("viscous_damping", "coefficient", 0.1),
        )
    )
    runs = inject_effect(made, [friction, damping], duration=2.0, episodes=2, noise=1e-4, seed=5)
    context, _ = _judged(make_bench(made, prepare_all(runs, made), 0.5))
    named = context.judge.judge(Hypothesis((friction,)))
    assert named is not None and named.ratio > 20.0
    for change, tried in ((1.0, True), (0.1, False)):
        monkeypatch.setattr(discretization, "difference", lambda *_, c=change: c)
        dry = discretization._other_friction(context, named, dry=True)
        assert (dry is not None) == tried
    asked = list[float]()
    monkeypatch.setattr(discretization, "matters", lambda _, ratio, *__: asked.append(ratio))
    assert discretization._finer(context, named) is None and asked == [1.0]


@pytest.mark.parametrize("true", [0.00025, 0.0005, 0.001])
def test_steps_that_are_more_exact_are_found(true: float) -> None:
    """What is left of a simulated machine's own step would be named as a damping or a clock."""
    runs = inject_effect(_scene(true), [], duration=2.0, episodes=3, noise=5e-4, seed=1)
    scene = _scene(0.01)
    bench = make_bench(scene, prepare_all(runs, scene), 0.5)
    context, judged = _judged(bench)
    found = settled(context, judged)
    assert found is not None and found[1].ratio < 1.06 < judged.ratio
    taken = stepping(found[0].bench.scene)
    assert taken.integrator == RK4 or taken.timestep == pytest.approx(true, rel=0.3)


def test_steps_take_the_place_of_what_they_were_named_for_beside_an_effect() -> None:
    """A simulated servo's steps add to its inertia (implicit damping)."""
    spring = EffectInstance("joint_spring", "hinge", {"stiffness": 0.5, "rest_position": 0.2})
    inertia = EffectInstance("armature", "hinge", {"inertia": 1e-4})
    runs = inject_effect(_scene(0.001), spring, duration=2.0, episodes=3, noise=1e-4, seed=1)
    scene = _scene(0.01)
    context, both = _in_exact_steps(scene, runs, 0.005, spring, inertia)
    alone = context.judge.judge(Hypothesis((spring,)))
    assert alone is not None and 2.0 < both.ratio < 0.9 * alone.ratio
    simpler = simplified(Found(context, *[stepping(scene)] * 2, both, both), 2)
    assert [one.effect for one in simpler.best.hypothesis.effects] == ["joint_spring"]
    assert simpler.best.ratio < 1.05
    taken = stepping(simpler.context.bench.scene)
    assert taken.integrator != RK4 and taken.timestep == pytest.approx(0.001, rel=0.05)


def test_a_search_takes_as_few_steps_as_hardly_matter_and_ends_in_those_given() -> None:
    friction = EffectInstance("coulomb_friction", "hinge", {"torque": 0.05})
    scene = _scene(0.001)  # ten a sample
    runs = inject_effect(scene, friction, duration=2.0, episodes=3, noise=3e-3, seed=1)
    bench = make_bench(scene, prepare_all(runs, scene), 0.5)
    effects = Settings(effects=("coulomb_friction", "viscous_damping"))
    found = search(bench, effects)
    assert found.given == stepping(scene)
    assert found.stepping.timestep >= 2 * found.given.timestep
    final = attribute(bench, effects)
    assert stepping(final.bench.scene) == found.given
    assert [one.effect for one in final.hypothesis.effects] == ["coulomb_friction"]
    assert final.hypothesis.effects[0].values["torque"] == pytest.approx(0.05, rel=0.1)


def test_exact_steps_are_as_few_as_are_exact() -> None:
    runs = inject_effect(_scene(0.0005), [], duration=2.0, episodes=3, noise=1e-4, seed=1)
    scene = _scene(0.001)
    found = exact_enough(make_bench(scene, prepare_all(runs, scene), 0.5))
    assert found is not None and timestep.is_exact(found)
    assert stepping(found.scene).timestep == pytest.approx(0.01)
    assert exact_enough(found) is None


def test_a_step_is_halved_where_another_integrator_is_not_stable() -> None:
    stiff = SERVO.replace('kv=".2"', 'kv="5"')  # over 0.009 kg m^2: too much for explicit 10 ms
    truth, scene = (orbisim.load_scene(stiff.format(step=step)) for step in (0.0005, 0.01))
    runs = inject_effect(truth, [], duration=2.0, episodes=3, noise=1e-4, seed=1)
    bench = make_bench(scene, prepare_all(runs, scene), 0.5)
    context, judged = _judged(bench)
    found = settled(context, judged)
    assert found is not None
    taken = stepping(found[0].bench.scene)
    assert taken.timestep < 0.006 and taken.integrator != RK4


def test_a_step_is_shortened_where_bodies_touch() -> None:
    bench = in_long_steps()
    context, judged = _judged(bench)
    found = settled(context, judged)
    assert found is not None and found[0].bench.contacts
    # held by another integrator, whose error is another one: a step of about the truth's
    assert 0.0005 < stepping(found[0].bench.scene).timestep < 0.0012


def test_controls_that_hardly_change_are_not_asked() -> None:
    scene = _scene(0.001)
    runs = [_commanded(0, 1.5)]
    assert asked(make_bench(scene, prepare_all(runs, scene), 0.5)).lead is None


def test_a_step_whose_error_goes_on_is_finer_where_most_windows_have_impacts_too() -> None:
    runs = inject_effect(_scene(0.001), [], duration=2.0, episodes=2, noise=5e-4, seed=1)
    scene = _scene(0.01)
    smooth = make_bench(scene, prepare_all(runs, scene), 0.5)
    jumps = [np.ones_like(one.jumps) for one in smooth.samples]
    samples = [
        dataclasses.replace(one, jumps=each)
        for one, each in zip(smooth.samples, jumps, strict=True)
    ]
    for contacts in (False, True):
        bench = dataclasses.replace(smooth, samples=tuple(samples), contacts=contacts)
        context = begun(bench, Settings(), lambda _: None)
        judged = context.judge.judge(Hypothesis())
        assert judged is not None
        form = settled(context, judged)
        assert form is not None and form[1].loss < judged.loss
        if contacts:  # a fiftieth of the time constant of contacts is short enough
            assert bench.rugged and timestep.taken(form[0].bench) >= 2e-4
            short = begun(timestep.stepped(bench, 4e-4), Settings(), lambda _: None)
            again = short.judge.judge(Hypothesis())
            assert again is not None and discretization._finer(short, again) is None


@pytest.mark.parametrize(("place", "kept"), [(-0.15, ["payload"]), (-5.0, [])])
def test_what_no_machine_has_in_another_form_is_left_out_there(
    place: float, kept: list[str]
) -> None:
    """A load that stood in for the error of long steps is next to nothing in short ones, and may
    lie anywhere: that must not speak against these steps."""
    declared = SERVO.replace("<body>", '<body name="rod">')
    scene = orbisim.load_scene(declared.format(step=0.01).replace("implicitfast", "Euler"))
    lighter = declared.format(step=0.0005).replace('mass=".3"', 'mass=".29"')
    runs = inject_effect(
        orbisim.load_scene(lighter), [], duration=2.0, episodes=3, noise=2e-4, seed=1
    )
    bench = make_bench(scene, prepare_all(runs, scene), 0.5)
    load = {"mass": 0.01, "com_x": 0.0, "com_y": 0.0, "com_z": place}
    context = begun(bench, Settings(), lambda _: None)
    held = frozenset((0, name) for name in ("com_x", "com_y", "com_z"))
    judged = context.judge.judge(Hypothesis((EffectInstance("payload", "rod", load),), frozen=held))
    assert judged is not None
    there = settled(context, judged)
    assert there is not None
    assert stepping(there[0].bench.scene) != stepping(scene)
    assert [one.effect for one in there[1].hypothesis.effects] == kept


BOX = """<mujoco><option timestep="{step}" integrator="implicitfast" cone="{cone}"/><worldbody>
<geom name="floor" type="plane" size="5 5 1" friction="0.5"/>
<body name="box" pos="0 0 0.3"><freejoint name="box"/>
<geom name="box" type="box" size="0.05 0.06 0.04" mass="0.5" friction="0.5"/></body></worldbody>
</mujoco>"""


def _boxes(step: float, cone: str, starts: list[list[float]]) -> Bench:
    """What boxes do in steps of 0.25 ms with elliptic cones, of a scene that has others."""
    truth, scene = (
        orbisim.load_scene(BOX.format(step=one, cone=kind))
        for one, kind in ((0.00025, "elliptic"), (step, cone))
    )
    runs = inject_effect(
        truth, [], starts=starts, duration=0.6, episodes=len(starts), noise=1e-4, seed=3
    )
    return make_bench(scene, prepare_all(runs, scene), 0.3)


@pytest.fixture(scope="module")
def tossed() -> Bench:
    rng = np.random.default_rng(2)
    pose = [0.0, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0]
    starts = [[*pose, *rng.normal(0, 1, 2), 0.5, *rng.normal(0, 4, 3)] for _ in range(6)]
    return _boxes(0.004, "elliptic", starts)


def test_where_bodies_touch_steps_that_matter_are_shortened_first(tossed: Bench) -> None:
    """And what impacts leave unknown is asked anew in them: it is less."""
    context, declared = _judged(tossed)
    there, judged = resolved(context, declared)
    assert timestep.taken(there.bench) < 0.6 * timestep.taken(tossed)
    before, after = (one.windows.scatter for one in (tossed, there.bench))
    assert before is not None and after is not None
    unsure = (before > 1) & tossed.windows.predictable()
    assert np.median(after[unsure]) < 0.7 * np.median(before[unsure])
    again = there.judge.judge(Hypothesis(), begin=there.judge.begin(judged))
    assert again is not None and judged.loss < 1.1 * again.loss  # of what is unknown there


def test_where_nothing_touches_or_steps_are_short_they_stay(tossed: Bench) -> None:
    context, declared = _judged(make_bench(*_pendulum(), 0.5))
    assert resolved(context, declared) == (context, declared)
    fine = timestep.stepped(tossed, 0.00025)
    context, declared = _judged(fine)
    assert resolved(context, declared)[0] is context


def _pendulum() -> tuple[orbisim.Scene, list[Samples]]:
    scene = _scene(0.01)
    runs = inject_effect(_scene(0.0005), [], duration=1.0, episodes=2, noise=5e-4, seed=1)
    return scene, prepare_all(runs, scene)


def test_friction_that_knows_no_directions_is_a_form_of_the_data() -> None:
    """Of a box that slides along the edges of MuJoCo's pyramids, these slow down more."""
    pose = [0.0, 0.0, 0.04, 1.0, 0.0, 0.0, 0.0]
    starts = [[*pose, 1.5 * np.cos(a), 1.5 * np.sin(a), 0, 0, 0, 0] for a in (0.6, 0.8, 2.3, 4.0)]
    bench = _boxes(0.001, "pyramidal", starts)
    context, declared = _judged(bench)
    form = settled(context, declared)
    assert form is not None and stepping(form[0].bench.scene).elliptic
    assert form[1].loss < declared.loss
    assert settled(*form) is None  # nothing is better still
    back = as_declared(*form, stepping(bench.scene))
    assert back is None  # pyramids are worth less


def test_elliptic_cones_that_are_declared_stay() -> None:
    pose = [0.0, 0.0, 0.04, 1.0, 0.0, 0.0, 0.0]
    bench = _boxes(0.001, "elliptic", [[*pose, 1.0, 1.0, 0, 0, 0, 0]] * 2)
    finer = timestep.stepped(bench, 0.0005)
    assert stepping(finer.scene) == Stepping(0.0005, FAST, elliptic=True)
    context, declared = _judged(bench)
    assert discretization._other_friction(context, declared, elliptic=True) is None
    back = as_declared(context, declared, stepping(bench.scene))
    assert back is None or stepping(back[0].bench.scene).elliptic


def test_a_form_that_gains_no_more_than_a_fit_from_its_starts_is_not_taken(tossed: Bench) -> None:
    """The same steps once more, of a fit that has ended poorly: no form of the data at all."""
    context, better = _judged(tossed)
    poor = dataclasses.replace(better, fitted=better.fitted + 5.0, checked=better.checked + 5.0)
    assert discretization._surest(context, poor, [(context, better)]) is None
    there = dataclasses.replace(context, bench=dataclasses.replace(tossed, contacts=False))
    assert discretization._surest(there, poor, [(there, better)]) is not None


@pytest.mark.parametrize("declared", [False, True])
def test_forms_of_friction_go_back_one_by_one_and_no_further_than_declared(
    tossed: Bench, declared: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried = list[Stepping]()

    def again(_: Context, __: Judged, change: Any) -> None:
        bench = change(timestep.stepped(tossed, 0.004, dry=True, elliptic=True))
        tried.extend([] if bench is None else [stepping(bench.scene)])

    monkeypatch.setattr(discretization, "_again", again)
    context, judged = _judged(tossed)
    known = stepping(tossed.scene)._replace(timestep=0.004, dry=declared, elliptic=declared)
    assert as_declared(context, judged, known) is None
    forms = {(one.dry, one.elliptic) for one in tried}
    assert forms <= {(True, True)} if declared else forms >= {(False, True), (True, False)}


def test_what_impacts_leave_unknown_is_the_same_for_the_same_steps(tossed: Bench) -> None:
    """Windows that end early are simulated to their ends for it, and end where they did."""
    again, known = foreseen_anew(tossed).windows, tossed.windows
    assert known.scatter is not None and again.scatter is not None
    assert known.horizon is not None and (known.horizon < known.length).any()
    np.testing.assert_array_equal(again.reach(), known.reach())
    sure = known.predictable() & (known.scatter > 1)  # drawn anew, of so many windows
    assert np.median(again.scatter[sure] / known.scatter[sure]) == pytest.approx(1.0, abs=0.4)


def test_where_bodies_touch_exact_steps_are_none_that_are_off(tossed: Bench) -> None:
    """A thrown box is not exact in one step of Runge and Kutta's between samples."""
    found = exact_enough(tossed)
    assert found is None or timestep.taken(found) < 0.005
