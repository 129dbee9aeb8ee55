"""What only C MuJoCo's backend does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mjcf_assets
from orbisim import load_scene, make_backend
from orbisim.effects import Hook, StepInputs
from orbisim.errors import DivergedError

ARM = Path(mjcf_assets.__file__).parent / "arm2" / "scene.xml"


class Push(Hook):
    """A constant force at the first degree of freedom."""

    def force(self, inputs: StepInputs) -> None:
        inputs.qfrc[:, 0] += self.value("force")


def test_hooks_of_the_configuration_act_at_every_timestep() -> None:
    scene = load_scene(ARM, trusted=True)
    hooked = make_backend("mujoco", scene, nworld=2, hooks=lambda model: [Push({"force": 0.3})])
    plain = make_backend("mujoco", scene, nworld=2)
    pushed = plain.reset(2)
    applied = np.zeros((2, scene.model.nv))
    applied[:, 0] = 0.3
    pushed = pushed.replace(memory={**pushed.memory, "qfrc_applied": applied})
    controls = np.full((2, 10, scene.model.nu), 0.1)
    one = hooked.rollout(hooked.reset(2), controls, nstep=3)
    two = plain.rollout(pushed, controls, nstep=3)
    assert np.array_equal(one.qpos, two.qpos)
    assert not np.allclose(one.qpos, plain.rollout(plain.reset(2), controls, nstep=3).qpos)


def test_a_matrix_that_is_not_the_scene_s_is_divergence() -> None:
    """MuJoCo goes on with a matrix that can be factorized, and only counts a warning."""
    scene = load_scene(
        '<mujoco><option integrator="implicitfast" timestep="0.01"/><worldbody><body>'
        '<joint axis="0 1 0" damping="-1"/><geom size="0.1" mass="1"/></body></worldbody></mujoco>'
    )
    backend = make_backend("mujoco", scene, nworld=2)
    state = backend.reset()
    state = state.replace(qvel=np.array([[0.0], [0.1]]))
    with pytest.raises(DivergedError, match="mjWARN_INERTIA"):
        backend.step(state)
    assert (backend.rollout(state, np.zeros((3, 0))).diverged_at == 0).all()
