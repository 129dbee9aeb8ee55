"""Hooks are called in order, with what they ask for."""

from __future__ import annotations

import mujoco
import numpy as np

from orbisim import Scene
from orbisim.effects import Hook, StepInputs
from orbisim.effects.running import HookRunner, changes_fields, derived_of, stage_of


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
