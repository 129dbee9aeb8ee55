"""Batches of C MuJoCo with hooks, against single simulations of it."""

from __future__ import annotations

import mujoco
import mujoco.batch
import numpy as np
import pytest

from orbisim import Scene
from orbisim.effects import Hook, StepInputs
from orbisim.effects.stepping import BatchStepper, step_batch

WORLDS, STEPS = 3, 20
CONTROLS = np.array([[0.1, 0.2], [-0.3, 0.4], [0.5, -0.6]])


class Drags(Hook):
    """-0.3 times each world's own speed of the elbow, from MjData or a derived field."""

    derived = frozenset({"qfrc_actuator"})

    def force(self, inputs: StepInputs) -> None:
        inputs.qfrc[:, 1] += 0.1 * inputs.derived["qfrc_actuator"][:, 0] - 0.3 * inputs.qvel[:, 1]


def singly(model: mujoco.MjModel, hook: bool) -> np.ndarray:
    ends = []
    for control in CONTROLS:
        data = mujoco.MjData(model)
        data.ctrl[:] = control
        data.qfrc_applied[0] = 0.05
        for _ in range(STEPS):
            if hook:
                mujoco.mj_forward(model, data)
                data.qfrc_applied[1] = 0.1 * data.qfrc_actuator[0] - 0.3 * data.qvel[1]
            mujoco.mj_step(model, data)
        ends.append(data.qpos.copy())
    return np.array(ends)


@pytest.mark.parametrize("hook", [False, True])
def test_worlds_are_stepped_as_single_ones(scene: Scene, hook: bool) -> None:
    batch = mujoco.batch.Batch(scene.model, WORLDS)
    batch.bind("qfrc_applied")[:, 0] = 0.05
    step_batch(scene.model, batch, [Drags({})] if hook else [], CONTROLS, STEPS)
    np.testing.assert_allclose(batch.bind("qpos"), singly(scene.model, hook), atol=1e-12)
    np.testing.assert_array_equal(batch.bind("qfrc_applied")[:, :2], [[0.05, 0.0]] * WORLDS)


class Bends(Hook):
    """A force by the positions of a body, which a step's first half computes."""

    derived = frozenset({"xipos"})

    def force(self, inputs: StepInputs) -> None:
        inputs.qfrc[:, 1] -= 2.0 * inputs.derived["xipos"][:, -1, 0]


@pytest.mark.parametrize("hook", [Drags, Bends])
@pytest.mark.parametrize("persistent", [False, True])
def test_steps_go_on_from_what_the_last_ones_computed(
    scene: Scene, hook: type[Hook], persistent: bool
) -> None:
    """As from nothing, whatever controls and forces come between; also of some worlds alone."""
    batch, apart = (mujoco.batch.Batch(scene.model, WORLDS, 1, p) for p in (persistent, False))
    stepper = BatchStepper(scene.model, batch, [hook({})])
    for number in range(STEPS):
        controls, ids = np.roll(CONTROLS, number, axis=0), None if number < STEPS / 2 else [0, 2]
        for one in (batch, apart):
            one.bind("qfrc_applied")[:, 0] = 0.01 * number
        stepper.step(controls, 3, ids, more=True)
        step_batch(scene.model, apart, [hook({})], controls, 3, ids)
    np.testing.assert_allclose(batch.bind("qpos"), apart.bind("qpos"), rtol=0, atol=1e-12)
    assert np.ptp(batch.bind("qpos"), axis=0).max() > 0.01


def test_controls_change_at_every_timestep(scene: Scene) -> None:
    class Fades(Hook):
        def control(self, inputs: StepInputs) -> None:
            inputs.ctrl *= np.exp(-100 * inputs.time)[:, None]

    batch = mujoco.batch.Batch(scene.model, WORLDS)
    step_batch(scene.model, batch, [Fades({})], CONTROLS, STEPS)
    data = mujoco.MjData(scene.model)
    for _ in range(STEPS):
        data.ctrl[:] = CONTROLS[0] * np.exp(-100 * data.time)
        mujoco.mj_step(scene.model, data)
    np.testing.assert_allclose(np.asarray(batch.bind("qpos"))[0], data.qpos, atol=1e-12)
