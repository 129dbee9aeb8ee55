from __future__ import annotations

import numpy as np
import torch
from orbisim_policies.demonstrations import Commander, demonstrate
from orbisim_policies.push import REACH, TURN, PushProblem

from orbisim.tasks.motion import pointing_down


def test_the_commander_goes_where_its_actions_go() -> None:
    arm = Commander(np.array([0.4, 0.0, 0.1]), 0.0)
    action = arm.action_to(np.array([0.5, 0.0, 0.1]), pointing_down(0.05), 1.0)
    np.testing.assert_allclose(action, [1.0, 0.0, 0.0, 0.05 / TURN], atol=1e-12)
    np.testing.assert_allclose(arm.pos, [0.4 + REACH, 0.0, 0.1])


def test_the_script_succeeds_in_a_whole_episode() -> None:
    problem = PushProblem(64)
    shown = demonstrate(problem, [11, 12], nthread=1)
    assert shown.success == 1.0 and shown.steps == 128 and shown.episodes == 2
    assert shown.observations.shape == (128, problem.observations)
    assert shown.actions.abs().max() <= 1.0 + 1e-6 and torch.isfinite(shown.observations).all()
