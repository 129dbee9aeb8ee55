"""Effects of which the recordings tell a sum, and not what is where."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import orbisim
from orbisim.cli.diagnose import _print
from orbisim.diagnosis.combinations import combined_in_forces, combined_in_runs
from orbisim.diagnosis.conclusion import Attribution
from orbisim.diagnosis.force_data import force_data, spread
from orbisim.diagnosis.force_search import ForceAttribution, fit_forces
from orbisim.diagnosis.found import Combination, Term
from orbisim.diagnosis.settings import Settings
from orbisim.diagnosis.wording import together
from orbisim.effects import EffectInstance
from orbisim.motion.samples import Samples, prepare_all
from orbisim.shooting.bench import make_bench
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.judge import Judge
from orbisim.testing import inject_effect

ARM = """
<mujoco><option timestep="0.002" integrator="implicitfast"/>
<default><geom type="capsule" size="0.02" mass="0.6" contype="0" conaffinity="0"/></default>
<worldbody>
  <body name="upper"><joint name="shoulder" axis="0 1 0" damping="0.1"/>
    <geom fromto="0 0 0 0 0 -.3"/>
    <body name="fore" pos="0 0 -.3"><joint name="elbow" axis="0 1 0" damping="0.05"/>
      <geom fromto="0 0 0 0 0 -.2"/>
      <body name="hand" pos="0 0 -.2"><joint name="wrist" axis="{axis}" damping="0.02"/>
        <geom fromto="0 0 0 0 0 -.15"/></body></body></body>
</worldbody>
<actuator><motor name="shoulder" joint="shoulder" ctrlrange="-6 6" ctrllimited="true"/>
  <motor name="elbow" joint="elbow" ctrlrange="-3 3" ctrllimited="true"/>
  <motor name="wrist" joint="wrist" ctrlrange="-{most} {most}" ctrllimited="true"/></actuator>
</mujoco>
"""
"""A planar arm. Its wrist bends in the plane, or rolls about the forearm: then, as long as nothing
turns it, the last two links are one straight link."""
STRAIGHT, BENDING = ARM.format(axis="0 0 1", most="1e-9"), ARM.format(axis="0 1 0", most="1")
GEAR = """
<mujoco><option timestep="0.0005" integrator="implicitfast"/>
<default><geom type="box" size=".1 .02 .02" pos=".05 0 0" mass=".6" contype="0" conaffinity="0"/>
</default>
<worldbody>
  <body name="a"><joint name="left" axis="0 1 0" damping="0.02"/><geom/></body>
  <body name="b" pos="0 .2 0"><joint name="right" axis="0 1 0" damping="0.02"/><geom/></body>
</worldbody>
<actuator><motor name="drive" joint="left" ctrlrange="-3 3" ctrllimited="true"/></actuator>
<equality><joint joint1="right" joint2="left" polycoef="0 {ratio} 0 0 0" solref=".001 1"
  solimp=".9999 .9999 .001"/></equality>
</mujoco>
"""


def payload(body: str, mass: float, z: float) -> EffectInstance:
    return EffectInstance("payload", body, {"mass": mass, "com_x": 0.0, "com_y": 0.0, "com_z": z})


def friction(joint: str, torque: float) -> EffectInstance:
    return EffectInstance("coulomb_friction", joint, {"torque": torque})


LOADS = (payload("hand", 0.3, -0.02), payload("fore", 0.4, -0.22))
"""At the same place while the arm is straight."""


def recorded(
    xml: str, truth: Sequence[EffectInstance], noise: float
) -> tuple[orbisim.Scene, list[Samples]]:
    scene = orbisim.load_scene(xml)
    runs = inject_effect(scene, truth, duration=3.0, episodes=3, noise=noise, seed=3)
    return scene, prepare_all(runs, scene)


def in_runs(
    xml: str,
    truth: Sequence[EffectInstance],
    begin: Sequence[EffectInstance],
    settings: Settings = Settings(),  # noqa: B008
    noise: float = 3e-4,
) -> tuple[Combination, ...]:
    """What is said after a fit to free runs."""
    bench = make_bench(*recorded(xml, truth, noise), 0.5).whole()
    judge = Judge(bench, bench.intervals)
    before, after = judge.judge(Hypothesis()), judge.judge(Hypothesis(tuple(begin)), 8)
    assert before is not None and after is not None and after.ratio < 0.1 * before.ratio
    found = Attribution(bench, before, after, None, (), (), (), cut_short=False)
    return combined_in_runs(found, settings)


def in_forces(
    xml: str, truth: Sequence[EffectInstance], begin: Sequence[EffectInstance]
) -> tuple[Combination, ...]:
    """What is said after a fit to the missing forces."""
    data = force_data(*recorded(xml, truth, 3e-5))
    hypothesis, fit = fit_forces(data, Hypothesis(tuple(begin)), spread(data, data.force))
    return combined_in_forces(ForceAttribution(data, hypothesis, fit, 10.0, 1.0), Settings())


def only(found: Sequence[Combination]) -> Combination:
    (one,) = found
    return one


def test_loads_along_a_straight_chain_are_one() -> None:
    one = only(in_runs(STRAIGHT, LOADS, [payload("hand", 0.6, -0.02)]))
    assert {(t.effect, t.target, t.parameter) for t in one.terms} == {
        ("payload", "hand", "mass"),
        ("payload", "fore", "mass"),
    }
    assert [t.coefficient for t in one.terms] == pytest.approx([1.0, 1.0], abs=1e-3)
    assert one.value == pytest.approx(0.7, rel=0.01) and one.unit == "kg"
    assert one.ci95[0] < one.value < one.ci95[1] < one.value + 0.01
    assert one.told.startswith("mass of a payload at 'hand' or 'fore': only the sum is determined")


def test_loads_on_two_links_that_bend_are_two() -> None:
    assert in_runs(BENDING, [payload("hand", 0.3, -0.12)], [payload("hand", 0.5, -0.1)]) == ()


def test_two_loads_that_were_found_are_a_sum() -> None:
    """The numbers of each have no value of their own, and the sum has one."""
    one = only(in_runs(STRAIGHT, LOADS, LOADS))
    assert {t.target for t in one.terms} == {"hand", "fore"}
    assert one.value == pytest.approx(0.7, rel=0.01)
    assert np.ptp(one.ci95) < 0.02


def test_two_loads_that_bend_are_found_apart() -> None:
    assert in_runs(BENDING, LOADS, LOADS) == ()


def test_the_same_of_forces() -> None:
    one = only(in_forces(STRAIGHT, LOADS, [payload("hand", 0.6, -0.03)]))
    assert [(t.effect, t.target) for t in one.terms] == [("payload", "hand"), ("payload", "fore")]
    assert one.ci95[0] < 0.7 < one.ci95[1]
    assert in_forces(BENDING, [payload("hand", 0.3, -0.12)], [payload("hand", 0.5, -0.1)]) == ()


@pytest.mark.parametrize("ratio", [1.0, -2.0])
def test_friction_of_joints_that_move_together(ratio: float) -> None:
    """Friction on the other side of a gear counts by the ratio."""
    truth = [friction("left", 0.1), friction("right", 0.05)]
    gear = GEAR.format(ratio=ratio)
    one = only(in_runs(gear, truth, [friction("left", 0.1)], noise=5e-4))
    assert [(t.target, t.parameter) for t in one.terms] == [("left", "torque"), ("right", "torque")]
    assert [t.coefficient for t in one.terms] == pytest.approx([1.0, abs(ratio)], rel=0.03)
    assert one.value == pytest.approx(0.1 + 0.05 * abs(ratio), rel=0.03)


def test_friction_of_joints_that_move_apart(arm: orbisim.Scene) -> None:
    truth = friction("elbow", 0.2)
    assert in_runs(arm.to_xml(), [truth], [truth]) == ()


def test_what_a_user_rules_out_is_not_said() -> None:
    few = Settings(effects=("coulomb_friction",))
    assert in_runs(STRAIGHT, LOADS, [payload("hand", 0.6, -0.02)], few) == ()


def test_a_deadline_leaves_it_unsaid() -> None:
    none = Settings(patience=1e-9)
    assert in_runs(STRAIGHT, LOADS, [payload("hand", 0.6, -0.02)], none) == ()


def test_words_for_a_combination() -> None:
    terms = [
        Term("armature", "hinge", "inertia", 1.0),
        Term("payload", "pole", "mass", 0.0902),
        Term("armature", "other", "inertia", -1.004),
    ]
    assert together(terms, 0.05, (0.048, 0.051), "kg*m^2") == (
        "inertia of reflected rotor inertia at 'hinge', mass of a payload at 'pole' or inertia of "
        "reflected rotor inertia at 'other': only inertia at 'hinge' + 0.09 * mass at 'pole' - "
        "inertia at 'other' is determined, 0.05 ± 0.002 kg*m^2"
    )
    gains = [Term("torque_gain", name, "gain", 1.0) for name in ("a", "b", "c")]
    assert together(gains, 2.7, (2.6, 2.8), "1") == (
        "gain of another gain at 'a', 'b' or 'c': only the sum is determined, 2.7 ± 0.1"
    )


def test_a_diagnosis_says_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = orbisim.load_scene(STRAIGHT)
    runs = inject_effect(scene, LOADS, duration=3.0, episodes=4, noise=3e-5, seed=3)
    few = Settings(effects=("payload", "coulomb_friction"))
    found = orbisim.diagnose(
        scene, runs, residual="force", settings=few, out=tmp_path, progress=False
    )
    one = only(found.combinations)
    assert one.ci95[0] < 0.7 < one.ci95[1]
    _print(found)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == found.sentence
    assert lines[1].startswith("Mass of a payload at ") and "only the sum is determined" in lines[1]
    (listed,) = json.loads((tmp_path / "report.json").read_text())["combinations"]
    assert listed["told"] == one.told
    assert {t["target"] for t in listed["terms"]} == {"hand", "fore"}
    assert listed["unit"] == "kg" and listed["ci95"] == list(one.ci95)
    page = (tmp_path / "report.html").read_text()
    assert "do not tell apart" in page and "only the sum is determined" in page
