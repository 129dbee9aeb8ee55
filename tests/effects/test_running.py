"""Hooks are called in order, with what they ask for."""

from __future__ import annotations

import mujoco
import numpy as np

from orbisim import Scene
from orbisim.effects import Hook, StepInputs
from orbisim.effects.running import (
    HookRunner,
    changes_fields,
    derived_of,
    same_physics,
    side_by_side,
    stage_of,
)


class Adds(Hook):
    derived = frozenset({"cvel"})

    def force(self, inputs: StepInputs) -> None:
        inputs.qfrc[:, 0] += self.value("force")


class Doubles(Hook):
    def control(self, inputs: StepInputs) -> None:
        inputs.ctrl *= 2

    def force(self, inputs: StepInputs) -> None:
        inputs.qfrc *= 2


class Rubs(Hook):
    derived = frozenset({"qfrc_actuator"})

    def fields(self, inputs: StepInputs) -> None:
        inputs.fields["dof_frictionloss"] += 1.0


def test_each_hook_sees_what_those_before_it_did(scene: Scene) -> None:
    model = scene.model
    ctrl, applied = np.ones((2, 2)), {"qfrc_applied": np.ones((2, model.nv))}
    applied["xfrc_applied"] = np.zeros((2, model.nbody, 6))
    runner = HookRunner(model, [Adds({"force": [1.0, 3.0]}), Doubles({})])
    inputs = runner.inputs(lambda name: np.full((2, 1), len(name)), ctrl, applied, {})
    np.testing.assert_array_equal(inputs.qfrc[:, 0], [4.0, 8.0])  # a value for each world
    np.testing.assert_array_equal(inputs.qfrc[:, 1], [2.0, 2.0])
    np.testing.assert_array_equal(inputs.ctrl, 2 * np.ones((2, 2)))
    assert set(inputs.derived) == {"cvel"}
    assert inputs.fields == {}
    # what the caller holds is not changed
    assert ctrl[0, 0] == 1.0
    assert applied["qfrc_applied"][0, 0] == 1.0


def test_fields_start_from_their_declared_values(scene: Scene) -> None:
    base = {"dof_frictionloss": np.full((1, 8), 0.5)}
    zero = {"qfrc_applied": np.zeros((1, 8)), "xfrc_applied": np.zeros((1, 4, 6))}
    runner = HookRunner(scene.model, [Rubs({})])
    for _ in range(2):  # not 2.5 the second time
        inputs = runner.inputs(lambda name: np.zeros((1, 8)), np.zeros((1, 2)), zero, base)
        np.testing.assert_array_equal(inputs.fields["dof_frictionloss"], np.full((1, 8), 1.5))


def test_the_stage_that_hooks_need() -> None:
    assert derived_of([Adds({}), Rubs({})]) == {"cvel", "qfrc_actuator"}
    assert stage_of(frozenset()) == mujoco.mjtStage.mjSTAGE_NONE
    assert stage_of(frozenset({"cvel"})) == mujoco.mjtStage.mjSTAGE_VEL
    assert stage_of(frozenset({"cvel", "qfrc_actuator"})) == mujoco.mjtStage.mjSTAGE_ACC
    assert changes_fields([Adds({}), Rubs({})])
    assert not changes_fields([Adds({}), Doubles({})])


def test_scenes_that_differ_in_texts_alone_simulate_alike() -> None:
    arm = """<mujoco><option gravity="0 0 {g}"/><worldbody><body>
    <joint name="{name}" damping="{d}"/><geom size=".1"/></body></worldbody>
    <custom><text name="a" data="{text}"/></custom></mujoco>"""
    usual = {"g": -9.81, "d": 0.1, "name": "hinge", "text": "b"}
    one = mujoco.MjModel.from_xml_string(arm.format(**usual))
    same = mujoco.MjModel.from_xml_string(arm.format(**usual | {"name": "elbow", "text": "bcd"}))
    assert same_physics(one, same)
    for change in ({"g": -9.8}, {"d": 0.2}):
        assert not same_physics(one, mujoco.MjModel.from_xml_string(arm.format(**usual | change)))


def test_hooks_of_several_scenes_stand_side_by_side() -> None:
    def hooks(gain: float, where: int = 0) -> list[Hook]:
        hook = Hook({"gain": gain})
        hook.where = where  # type: ignore[attr-defined]
        return [hook]

    found = side_by_side([hooks(1.0), hooks(2.0)], 3)
    assert found is not None and found[0].values["gain"].tolist() == [1, 1, 1, 2, 2, 2]
    assert side_by_side([hooks(1.0), hooks(2.0, where=1)], 3) is None
    assert side_by_side([hooks(1.0), []], 3) is None
    assert side_by_side([[Hook({"gain": 1.0})], [Hook({"rate": 1.0})]], 3) is None
    assert side_by_side([[], []], 3) == []
