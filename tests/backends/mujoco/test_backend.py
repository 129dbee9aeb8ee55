"""What only C MuJoCo's backend does."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import mjcf_assets
from orbisim import load_scene, make_backend
from orbisim.effects import Hook, StepInputs

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
