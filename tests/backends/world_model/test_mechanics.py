"""Free motion of limbs against C MuJoCo's, and the inverse."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch
from orbisim_world_model.mechanics import inverse

from tests.backends.world_model.robots import CRAWLER, TWO, of_limbs, stepped

IMPLICIT = CRAWLER.replace('timestep="0.005"', 'timestep="0.005" integrator="implicitfast"')
FINE = CRAWLER.replace('timestep="0.005"', 'timestep="0.002"')
NO_GRAVITY = CRAWLER.replace(
    '<option timestep="0.005"/>',
    '<option timestep="0.005"><flag gravity="disable" eulerdamp="disable"/></option>',
)


@pytest.mark.parametrize("xml", [CRAWLER, TWO, IMPLICIT, FINE, NO_GRAVITY])
def test_free_motion_is_mujocos(xml: str) -> None:
    model = mujoco.MjModel.from_xml_string(xml)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    dynamics, x, context = of_limbs(model, 8)
    rng = np.random.default_rng(0)
    q = model.qpos0 + rng.uniform(-1, 1, (8, model.nq))
    v, u = rng.uniform(-3, 3, (8, model.nv)), rng.uniform(-1.5, 1.5, (8, model.nu))
    limbs = dynamics.features.limbs
    assert limbs is not None
    known = limbs.known(x._replace(q=torch.tensor(q), v=torch.tensor(v)), torch.tensor(u), context)
    qpos, qvel = stepped(model, q, v, u, dynamics.layout.substeps)
    assert np.abs(qvel - v).max() > 0.1
    np.testing.assert_allclose(known.q.numpy(), qpos, atol=1e-9)
    np.testing.assert_allclose(known.v.numpy(), qvel, atol=1e-9)


def test_jacobians_and_gaps_are_mujocos() -> None:
    model = mujoco.MjModel.from_xml_string(CRAWLER)
    dynamics, x, context = of_limbs(model, 1)
    limbs = dynamics.features.limbs
    assert limbs is not None
    q = model.qpos0 + np.array([0.3, -0.1, 0.2, -0.3, 0.05, 0.4])
    known = limbs.known(x._replace(q=torch.tensor(q[None])), torch.zeros(1, 2).double(), context)
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    foot, number = model.body("foot").id, 4
    geom = model.body_geomadr[foot]
    lowest = []
    for side, end in ((-1, 0), (1, 1)):
        axis = data.geom_xmat[geom].reshape(3, 3)[:, 2]
        point = data.geom_xpos[geom] + side * model.geom_size[geom, 1] * axis
        point = point - [0, 0, model.geom_size[geom, 0]]
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, jacobian, None, point, foot)
        ours = known.floor.points.slopes[0, number, end].T.numpy()
        np.testing.assert_allclose(ours, jacobian, atol=1e-9)
        lowest.append(point[2])
    np.testing.assert_allclose(known.floor.points.gap[0, number, :2].numpy(), lowest, atol=1e-9)


def test_inverse() -> None:
    rows = torch.randn(5, 7, 9, dtype=torch.float64)
    matrix = rows @ rows.transpose(1, 2) + 0.1 * torch.eye(7)
    assert (inverse(matrix) @ matrix - torch.eye(7)).abs().max() < 1e-9
