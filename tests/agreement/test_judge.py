"""Single steps beside C MuJoCo's."""

from __future__ import annotations

import numpy as np
import pytest

from orbisim import load_scene, make_backend, suite
from orbisim.agreement import StepJudge, checkable
from orbisim.testing import scenes
from tests.agreement.engines import FALLING, Blind, Frozen, Reckless, Rounded, loaded


def test_right_steps_have_no_faults() -> None:
    scene = load_scene(FALLING)
    engine = loaded(Rounded, scene)
    state = engine.reset(3)
    judge = StepJudge(scene)
    for _ in range(20):
        after = engine.step(state, None, 4)
        assert not judge.faults(state, np.zeros((3, 0)), 4, after)
        state = after


def test_what_stands_still_is_found_in_its_world() -> None:
    scene = load_scene(FALLING)
    engine, frozen = loaded(Rounded, scene), loaded(Frozen, scene)
    state = engine.reset(3)
    after = engine.step(state)
    still = frozen.step(state)
    qpos, qvel = np.array(after.qpos), np.array(after.qvel)
    qpos[1], qvel[1] = still.qpos[1], still.qvel[1]
    found = StepJudge(scene).faults(
        state, np.zeros((3, 0)), 1, after.replace(qpos=qpos, qvel=qvel), step=7
    )
    assert set(found) == {1}
    assert (found[1].kind, found[1].step) == ("still", 7)
    assert scene.model.dof_jntid[found[1].dof] == scene.model.joint("hinge").id


def test_dropped_contacts_are_found_beside_what_moves_rightly() -> None:
    """The pendulum moves a hundred times as much as the box, and as it should."""
    scene = load_scene(FALLING)
    engine = loaded(Blind, scene)
    state = engine.reset()
    (fault,) = StepJudge(scene).faults(state, np.zeros((1, 0)), 1, engine.step(state)).values()
    assert fault.kind == "apart"
    assert scene.model.dof_jntid[fault.dof] == scene.model.joint("free").id


def test_where_mujoco_diverges() -> None:
    scene = load_scene(scenes.diverging('gainprm="1e30"'))
    engine = loaded(Reckless, scene)
    state, control = engine.reset(), np.array([[0.5]])
    (fault,) = StepJudge(scene).faults(state, control, 1, engine.step(state, control)).values()
    assert fault.kind == "lost"


def test_a_contact_about_to_begin_is_no_fault() -> None:
    """With and without it a body moves otherwise; rounding decides which it is."""
    scene = load_scene("""
        <mujoco><worldbody><geom type="plane" size="1 1 .1"/>
        <body pos="0 0 .1"><freejoint/><geom size=".1"/></body></worldbody></mujoco>""")
    judge = StepJudge(scene)
    engine = make_backend("mujoco", scene)
    state = engine.reset()
    qvel = np.array(state.qvel)
    qvel[0, 2] = -1.0
    state = state.replace(qvel=qvel)
    qpos = np.array(state.qpos)
    qpos[0, 2] -= 1e-8  # just a contact
    other = engine.step(state)
    touching = engine.step(state.replace(qpos=qpos))
    assert abs(other.qvel[0, 2] - touching.qvel[0, 2]) > 0.1
    assert not judge.faults(state, np.zeros((1, 0)), 1, touching)


def test_what_can_be_checked() -> None:
    scene = load_scene(FALLING)
    assert checkable(loaded(Frozen, scene))
    assert not checkable(make_backend("mujoco", scene))


def test_scenes_without_joints() -> None:
    scene = load_scene("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    engine = loaded(Frozen, scene)
    state = engine.reset()
    assert not StepJudge(scene).faults(state, np.zeros((1, 0)), 1, engine.step(state))


@pytest.mark.parametrize(
    ("domain", "task"),
    [
        ("humanoid", "run"),
        pytest.param("quadruped", "fetch", marks=pytest.mark.slow),
        ("swimmer", "swimmer6"),
    ],
)
def test_warp_on_chaotic_scenes(domain: str, task: str) -> None:
    """tools/corpus_suite.py does this for all tasks."""
    pytest.importorskip("mujoco_warp")
    environment = suite.load(domain, task, {"random": 1})
    environment.reset()
    physics = environment.physics
    engine, judge = make_backend("warp", physics.scene), StepJudge(physics.scene)
    state, rng = physics.snapshot(), np.random.default_rng(0)
    faulty = []
    for _ in range(15):
        control = rng.uniform(-1, 1, (1, engine.model.nu))
        after = engine.step(state, control, 2)
        faulty.append(bool(judge.faults(state, control, 2, after)))
        state = after
    assert sum(faulty) <= 1  # by chance, and not in a row
