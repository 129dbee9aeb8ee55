"""Trials as they are made, run and judged."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

TOOLS = Path(__file__).resolve().parents[3] / "tools"
sys.path.insert(0, str(TOOLS))

import rig_trials  # noqa: E402  (needs the path above)
from processes import read_lines  # noqa: E402
from rigs import instruments, running, scoring, stability  # noqa: E402
from rigs.bodies import Misread  # noqa: E402
from rigs.excitation import motion  # noqa: E402
from rigs.machines import MACHINES  # noqa: E402
from rigs.making import Wish, as_read, make, name_of  # noqa: E402
from rigs.outcomes import Outcome  # noqa: E402
from rigs.running import Job, jobs_of  # noqa: E402
from rigs.truth import Run, Stepping, Truth  # noqa: E402


@pytest.fixture(scope="module")
def arm() -> tuple[Truth, Run]:
    machine = MACHINES["servo_arm"]
    truth = Truth(machine, machine.text(), Stepping(1e-3, "implicitfast"), ())
    one = motion(machine, truth, np.random.default_rng(1), 1e-4)
    ticks = np.arange(0, 2, 0.01)
    return truth, truth.run(one.qpos, one.qvel, 2.0, one.controller, ticks, 0.0)


def log(arm: tuple[Truth, Run], *artefacts: str) -> dict[str, Any]:
    truth, run = arm
    chain = instruments.drawn(truth.model, 100.0, artefacts, np.random.default_rng(2))
    return instruments.logged(run, truth.model, chain, (), 0, False)


def test_a_trial_is_the_same_for_the_same_seed_and_says_nothing(tmp_path: Path) -> None:
    for out in (tmp_path / "a", tmp_path / "b"):
        made = make(NUMBER, 5, out, Wish(("served_ball",), "single"))
        assert made["laws"] and made["visibility"] > 0 and made["distinct"] > 0
    folders = [tmp_path / x / "trials" / name_of(NUMBER) for x in "ab"]
    files = sorted(path.name for path in folders[0].iterdir())
    assert files[-1] == "scene.xml" and all(n.split("_")[0] in ("fit", "held") for n in files[:-1])
    for name in files[:-1]:
        one, other = (np.load(folder / name) for folder in folders)
        assert all(np.array_equal(one[key], other[key]) for key in one.files)
    assert (folders[0] / "scene.xml").read_text() == MACHINES["served_ball"].text()


def test_artefacts_and_noise_change_nothing_else(tmp_path: Path) -> None:
    wishes = {
        "plain": Wish(("served_ball",), "single", ()),
        "late": Wish(("served_ball",), "single", ("jitter",)),
        "loud": Wish(("served_ball",), "single", (), 2.0),
    }
    made = {name: make(NUMBER, 5, tmp_path / name, wish) for name, wish in wishes.items()}
    assert made["plain"]["laws"] == made["late"]["laws"] == made["loud"]["laws"]
    assert made["late"]["artefacts"] == ["jitter"] and not made["plain"]["artefacts"]
    assert made["loud"]["noise"] == 2 * made["plain"]["noise"]
    assert made["loud"]["visibility"] == pytest.approx(made["plain"]["visibility"] / 2, rel=1e-6)


def test_clean_commands_change_exactly_at_samples(arm: tuple[Truth, Run]) -> None:
    _, run = arm
    found = log(arm)
    assert np.allclose(np.diff(found["time"]), 0.01)
    rows = np.round(found["time"] / 1e-3).astype(int)
    assert np.array_equal(found["ctrl"], run.sent[rows])
    assert np.array_equal(run.sent[rows], run.sent[rows + 9])  # held to the next sample


def test_artefacts_are_what_they_say(arm: tuple[Truth, Run]) -> None:
    steps = log(arm, "encoder")["qpos"] / (2 * np.pi / 4096)
    assert np.allclose(steps, np.round(steps), atol=1e-6)
    assert len(log(arm, "dropped")["time"]) < 192
    stamps = log(arm, "host_stamps")["time"]
    assert (np.diff(stamps) > 0).all() and np.std(np.diff(stamps)) > 1e-4
    assert "qvel" not in log(arm, "positions_only")
    assert {"torque/yaw", "torque/lift", "ctrl"} <= set(log(arm, "current_torque"))
    noise = log(arm, "coloured")["qpos"] - _true(arm)
    assert np.corrcoef(noise[1:, 0], noise[:-1, 0])[0, 1] > 0.5
    white = log(arm)["qpos"] - _true(arm)
    assert abs(np.corrcoef(white[1:, 0], white[:-1, 0])[0, 1]) < 0.25


def test_jitter_is_of_the_sensors_alone(arm: tuple[Truth, Run]) -> None:
    """A sample that is read a little before its time does not log the command before."""
    jittered, clean = log(arm, "jitter"), log(arm)
    assert np.array_equal(jittered["ctrl"], clean["ctrl"])
    assert np.array_equal(jittered["time"], clean["time"])
    assert not np.array_equal(jittered["qpos"], clean["qpos"])


def _true(arm: tuple[Truth, Run]) -> Any:
    _, run = arm
    return run.qpos[np.round(log(arm)["time"] / 1e-3).astype(int)]


NUMBER = 5
"""Of a trial whose truth takes few steps."""


def outcome(
    found: list[tuple[str, str]], kind: str = "single", allowed: tuple[str, ...] = ()
) -> Outcome:
    laws = {
        "none": [],
        "pair": [("a", "x"), ("b", "y")],
        "triple": [("b", "y"), ("a", "x"), ("f", "z")],
    }.get(kind, [("a", "x")])
    truth = {
        "trial": "r00001",
        "kind": kind,
        "machine": "m",
        "artefacts": [],
        "noise": 1e-3,
        "visibility": 9.0,
        "laws": [{"effect": e, "target": t, "value": 2.0, "size": 1.0} for e, t in laws],
        "same": [["c", "x", "a", "x"]],
        "allowed": list(allowed),
    }
    numbers = {"p": {"value": 2.1, "ci95": [1.9, 2.3]}}
    effects = tuple({"effect": e, "target": t, "parameters": numbers} for e, t in found)
    return Outcome(truth, "diagnose", "explained", effects, (), "", 1.0, 0.1, 3.0)


def test_names_are_judged() -> None:
    right = outcome([("a", "x")])
    assert right.right_first and right.right_any and not right.wrong and not right.needless
    assert right.interval == (1.9, 2.3, 2.0)
    assert outcome([("c", "x")]).right_first  # the same physics
    assert not outcome([("a", "y")]).right_any  # another place
    second = outcome([("a", "x"), ("d", "x")])
    assert second.right_first and second.needless == [("d", "x")]
    late = outcome([("d", "x"), ("a", "x")])
    assert not late.right_first and late.right_any and not late.wrong
    assert outcome([("d", "x")]).wrong
    chain = outcome([("sensor_delay", "x"), ("a", "x")], allowed=("sensor_delay",))
    assert chain.right_first and not chain.needless
    assert not outcome([("a", "x")], "pair").all_found
    assert outcome([("b", "y"), ("a", "x")], "pair").all_found
    assert outcome([("sensor_delay", "x")], "none").needless
    assert not outcome([("sensor_delay", "x")], "none", ("sensor_delay",)).needless


def test_of_those_that_show_some_are_distinct() -> None:
    plain = outcome([])
    assert plain.distinct  # where nothing else is known, what shows
    hidden = dataclasses.replace(plain, truth={**plain.truth, "distinct": 0.3})
    assert hidden.visible and not hidden.distinct
    words = [line for line in scoring.summary([plain, hidden], []) if "leave unknown" in line]
    assert len(words) == 1 and "0 of 1" in words[0]


def test_a_declared_parameter_beside_an_effect_may_be_the_other_law() -> None:
    found = outcome([("a", "x")], "pair")
    laws = [found.truth["laws"][0], {"effect": "torque_gain", "target": "motor", "value": 1.02}]
    found = dataclasses.replace(found, truth={**found.truth, "laws": laws})
    assert not found.all_found
    assert dataclasses.replace(found, retuned=("gain of motor",)).all_found
    many = tuple(f"mass of link{k}" for k in range(2))
    assert not dataclasses.replace(found, retuned=("gain of motor", *many)).all_found


def test_of_several_some_show_beside_the_others() -> None:
    plain = outcome([("a", "x")], "pair")
    assert not plain.apart and not plain.separate  # nothing is known of it
    one, both = (
        dataclasses.replace(plain, truth={**plain.truth, "beside": shows})
        for shows in ([7.0, 0.1], [7.0, 3.0])
    )
    assert not one.apart and one.separate == [("a", "x")]
    assert both.apart and both.separate == [("a", "x"), ("b", "y")]
    lines = [line for line in scoring.summary([one, both], []) if "beside the other" in line]
    assert "0 of 1" in lines[0] and "2 of 3" in lines[1]


def test_a_declared_parameter_is_judged_as_the_effect_that_it_is() -> None:
    law = {"effect": "torque_gain", "target": "motor", "value": 1.02, "size": 0.02}
    nothing = outcome([])
    nothing = dataclasses.replace(nothing, truth={**nothing.truth, "laws": [law]})
    off = dataclasses.replace(nothing, retuned=("gain of motor",))
    assert off.right_first and not off.needless and not off.wrong
    assert dataclasses.replace(nothing, retuned=("gain of other",)).wrong
    assert dataclasses.replace(nothing, retuned=("mass of motor",)).wrong
    both = dataclasses.replace(nothing, retuned=("mass of arm", "gain of motor"))
    assert not both.right_first and both.needless == [("declared mass", "arm")]
    beside = dataclasses.replace(outcome([("a", "x")]), retuned=("mass of arm",))
    assert beside.right_first and not beside.needless
    alone = dataclasses.replace(outcome([], "none"), retuned=("mass of arm",))
    assert alone.needless  # a false alarm


def test_a_summary_counts_with_bounds() -> None:
    some = [outcome([("a", "x")]), outcome([("d", "x")]), outcome([("d", "x")], "none")]
    text = "\n".join(scoring.summary(some, [o.truth for o in some]))
    assert "right first | 1 of 2, 50 % (9 to 91)" in text
    assert "| all | 1 of 1, 100 % (3 to 100) | 0 of 1 | explained 1 |" in text  # a false alarm


def test_several_effects_are_counted_one_by_one() -> None:
    two = outcome([("c", "x"), ("d", "x"), ("f", "z")], "triple")
    assert two.known == {("a", "x"), ("f", "z")}  # the first one by the same physics
    assert two.right_first and not two.all_found
    every = outcome([("a", "x"), ("b", "y"), ("f", "z")], "triple")
    assert every.all_found
    text = "\n".join(scoring.summary([two, every], [two.truth]))
    assert "| triple: all found | 1 of 2" in text and "of all there are | 5 of 6" in text
    assert "that are needless | 1 of 6" in text


@pytest.mark.parametrize("kind", ["triple", "many"])
def test_trials_with_several_effects_are_made(kind: str, tmp_path: Path) -> None:
    made = make(NUMBER, 5, tmp_path, Wish(("gym_reacher",), kind, ()))
    laws = [(law["effect"], law["target"]) for law in made["laws"]]
    assert len(set(laws)) == len(laws) and made["visibility"] > 0
    if kind == "triple":
        assert len({effect for effect, _ in laws}) == 3
    else:
        assert [e for e, _ in laws[:4]] == 2 * ["coulomb_friction"] + 2 * ["viscous_damping"]
        assert [e for e, _ in laws].count("payload") == 1 and len(laws) == 6


def test_without_an_effect_nothing_may_be_off() -> None:
    late = outcome([("sensor_delay", "x")], "none", ("sensor_delay",))
    assert late.quiet
    assert not dataclasses.replace(late, retuned=("mass of m",)).quiet
    assert dataclasses.replace(outcome([], "none"), verdict="no_residual").quiet
    assert not outcome([], "none").quiet  # explained by nothing


@pytest.mark.parametrize("name", ["suite_cartpole", "suite_acrobot", "urdf_arm2"])
def test_an_encoder_of_a_last_link_that_is_off_is_a_turned_centre_of_mass(name: str) -> None:
    one = MACHINES[name]
    pairs = {(a[1], b[1]) for a, b in one.same if (a[0], b[0]) == ("sensor_bias", "com_offset")}
    ((joint, body),) = pairs
    runs = []
    for off in (0.0, 0.05):
        model = Truth(one, one.text(), Stepping(1e-3, "rk4"), ()).model
        hinge, link = model.joint(joint), model.body(body).id
        assert (model.body_parentid != link).all() and not hinge.pos.any()
        turn = np.empty(4)
        mujoco.mju_axisAngle2Quat(turn, hinge.axis, -off)
        mujoco.mju_rotVecQuat(model.body_ipos[link], model.body_ipos[link].copy(), turn)
        model.dof_damping[:], model.jnt_limited[:] = 0.01, 0
        mujoco.mj_setConst(model, mujoco.MjData(model))
        data, address = mujoco.MjData(model), int(hinge.qposadr[0])
        data.qpos[:], data.qvel[:] = 0.3, 1.0
        data.qpos[address] += off  # as it is read
        rows = []
        for _ in range(300):
            mujoco.mj_step(model, data)
            rows.append(data.qpos.copy())
        rows = np.array(rows)
        rows[:, address] -= off
        runs.append(rows)
    np.testing.assert_allclose(runs[1], runs[0], atol=1e-9)


def test_a_delay_of_the_chain_adds_to_a_sensors_own(arm: tuple[Truth, Run]) -> None:
    model, late = arm[0].model, Misread("sensor_delay", "lift", 0.004, 0.004)
    for artefacts in ((), ("sensor_delays",)):
        chain = instruments.drawn(model, 100.0, artefacts, np.random.default_rng(2))
        more = float(chain.delays[model.joint("lift").id])
        assert (more > 0) == bool(artefacts)
        told = as_read(late, model, chain)
        assert told["value"] == pytest.approx(0.004 + more) and told["size"] == 0.004
    scaled = Misread("sensor_scale", "lift", 1.1, 0.1)
    assert as_read(scaled, model, chain)["value"] == 1.1


def test_late_stamps_have_the_sensors_clock() -> None:
    """In ten minutes at 200 Hz, a mean's slope is known to 1e-7; they never stand still."""
    machine = MACHINES["servo_arm"]
    model = Truth(machine, machine.text(), Stepping(1e-3, "implicitfast"), ()).model
    chain = instruments.drawn(model, 200.0, ("host_stamps",), np.random.default_rng(0))
    grid = np.arange(2, 120_000) * (1 / chain.rate)
    taken, stamps = instruments._clock(grid, chain, np.random.default_rng(1))
    assert abs(np.polyfit(taken, stamps - taken, 1)[0]) < 1e-7
    assert np.diff(stamps).min() >= 0.99e-6 and (stamps >= taken).all()


def test_stability_compares_the_same_trials() -> None:
    before = {"r1": outcome([("a", "x")]), "r2": outcome([("a", "x")]), "r3": outcome([])}
    after = {"r1": outcome([("a", "x")]), "r2": outcome([("d", "x")])}
    text = "\n".join(stability.table(before, {"half": after}))
    assert "| half | 1 of 2, 50 % (9 to 91) |" in text and "| 2 and 1 of 2; -50 (-" in text
    assert "a(x) -> d(x)" in text


def test_bounds_of_a_difference_hold_it_as_often_as_they_say() -> None:
    """Drawn trials, of which 80 % are right before and 70 % after."""
    rng, held = np.random.default_rng(0), 0
    for _ in range(2000):
        before = rng.random(40) < 0.8
        after = np.where(rng.random(40) < 0.75, before, rng.random(40) < 0.4)  # 70 %, paired
        low, high = stability.difference((~before & after).sum(), (before & ~after).sum(), 40)
        held += low <= -0.1 <= high
    assert 0.93 < held / 2000 < 0.98
    assert stability.difference(0, 0, 40)[0] < 0 < stability.difference(0, 0, 40)[1]


def test_a_run_goes_on_where_it_was_stopped(tmp_path: Path) -> None:
    for name in ("r00000", "r00001", "r00002"):
        (tmp_path / "trials" / name).mkdir(parents=True)
        (tmp_path / "trials" / name / "scene.xml").write_text("<mujoco/>")
    results = tmp_path / "results.jsonl"
    done = {"trial": "r00000", "tool": "diagnose", "failure": None, "report": {}, "seconds": 1.0}
    results.write_text(json.dumps(done) + '\n{"trial": "r00002", "to')
    args = argparse.Namespace(
        trials=tmp_path, out=results, only=[], limit=0, shard=(0, 2), tools=["diagnose", "recipe"],
        timeout=5.0, peer_timeout=5.0, again=False, seed=1, half=True,
    )  # fmt: skip
    assert [(job.trial, job.tool) for job in jobs_of(args)] == [
        ("r00000", "recipe"),
        ("r00002", "diagnose"),
        ("r00002", "recipe"),
    ]
    assert len(read_lines(results)) == 1
    assert jobs_of(args)[1].words == ("--seed", "1", "--half")  # a peer has no seed
    assert jobs_of(args)[0].words == ()


def test_what_might_not_end_in_time_is_not_begun(tmp_path: Path) -> None:
    until = time.perf_counter() + 30  # less than a process may take at worst
    assert running.entry_of(tmp_path, Job("r00000", "diagnose", 60.0), until) is None


def test_shards_are_read() -> None:
    assert rig_trials.shard_of("1/4") == (1, 4)
    for text in ("4/4", "a/b", "1"):
        with pytest.raises(argparse.ArgumentTypeError):
            rig_trials.shard_of(text)
