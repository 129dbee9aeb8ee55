from __future__ import annotations

import numpy as np
import torch
from orbisim_policies.arm import ArmKinematics, inverse_of_positive, pointing_down

from orbisim.tasks.arm import PANDA, UR5E, ArmController


def test_it_is_the_arm_of_the_tasks() -> None:
    rng = np.random.default_rng(0)
    for config in (UR5E, PANDA):
        arm, controller = ArmKinematics(config, torch.device("cpu")), ArmController(config)
        for _ in range(3):
            q = arm.home.double().numpy() + rng.normal(0, 0.3, config.joints)
            controller.reset(q)
            pos, rot = arm.pose(torch.tensor(controller.target[None]).float())
            np.testing.assert_allclose(pos[0], controller.pos, atol=2e-6)
            np.testing.assert_allclose(rot[0], controller.rot, atol=2e-6)


def test_it_descends_as_the_controller_does() -> None:
    arm, controller = ArmKinematics(UR5E, torch.device("cpu")), ArmController(UR5E)
    pos, yaw = (0.45, 0.1, 0.08), 0.4
    expected = controller.solve(pos, yaw)
    found, _ = arm.descend(arm.home[None], torch.tensor([pos]), torch.tensor([yaw]), 60)
    np.testing.assert_allclose(found[0], expected, atol=5e-6)
    assert torch.allclose(arm.pose(found)[1], pointing_down(torch.tensor([yaw])), atol=1e-5)


def test_the_inverse_is_the_inverse() -> None:
    a = torch.randn(5, 6, 6, generator=torch.Generator().manual_seed(0))
    matrix = a @ a.transpose(1, 2) + 0.1 * torch.eye(6)
    product = inverse_of_positive(matrix) @ matrix
    assert torch.allclose(product, torch.eye(6).expand(5, 6, 6), atol=1e-3)
