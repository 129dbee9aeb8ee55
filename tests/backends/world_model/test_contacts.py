"""Candidate contacts: pads where MuJoCo has them, impulses in their cone, overlaps undone."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch
from orbisim_world_model.boxes import separation
from orbisim_world_model.contacts import SEEN, Contacts
from orbisim_world_model.entities import Context, Entities
from orbisim_world_model.kinematics import Kinematics
from orbisim_world_model.pack import Pack
from orbisim_world_model.trainer import new_model

from tests.backends.world_model.conftest import toy
from tests.backends.world_model.synthetic import PUSHER, TABLE, simulate


@pytest.fixture(scope="module")
def pack() -> Pack:
    return simulate(PUSHER, 3, 20, 4)


def _states(pack: Pack, rows: list[int]) -> tuple[Entities, Context]:
    x = pack.states(torch.tensor(rows))
    x = x._replace(hand=Kinematics(pack.layout)(x.q, x.v))
    return x, pack.context(torch.zeros(len(rows), dtype=torch.long))


def test_pads_are_where_mujoco_has_them(pack: Pack) -> None:
    contacts, row = Contacts(pack.layout), 7
    x, context = _states(pack, [row])
    boxes = contacts.boxes(x, context)
    model = mujoco.MjModel.from_xml_string(PUSHER)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = pack.qpos[row].double(), pack.qvel[row].double()
    mujoco.mj_forward(model, data)
    for place, name in ((2, "palm"), (3, "finger")):
        geom, speed = model.geom(name).id, np.zeros(6)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_GEOM, geom, speed, 0)
        np.testing.assert_allclose(boxes.pos[0, place], data.geom_xpos[geom], atol=1e-5)
        np.testing.assert_allclose(boxes.rot[0, place].flatten(), data.geom_xmat[geom], atol=1e-5)
        np.testing.assert_allclose(boxes.vel[0, place], speed[3:], atol=1e-4)


def test_impulses_stay_in_the_cone_and_are_equal_and_opposite(pack: Pack) -> None:
    contacts = Contacts(pack.layout)
    x, context = _states(pack, [3] * 64)
    near = x.pos.clone()
    near[:, 1, :2] = near[:, 0, :2] + torch.tensor([0.0705, 0.0])
    near[:, 1, 2] = near[:, 0, 2]
    flat = torch.zeros_like(x.quat)
    flat[..., 0] = 1.0
    x = x._replace(pos=near, quat=flat, vel=torch.zeros_like(x.vel), ang=torch.zeros_like(x.ang))
    given = contacts.geometry(x, context)
    wanted = 5 * torch.randn(64, contacts.pairs, 3, generator=torch.Generator().manual_seed(0))
    impulse = contacts.impulses(context, given, wanted)[:, 0]  # of the two boxes
    along = (impulse * given.normal[:, 0]).sum(-1)
    across = (impulse - along[:, None] * given.normal[:, 0]).norm(dim=-1)
    friction = context.attributes[:, :, contacts.friction].amax(1)[:, 0]
    assert (along > 0).all() and (across <= friction * along + 1e-6).all()
    assert (across > 0.5 * friction * along).any()
    only = wanted.clone()
    only[:, 1:, 0] = -1e9  # the pads give nothing
    dvel, dang = contacts.changes(x, context, given, only)
    mass = context.attributes[..., contacts.mass]
    torch.testing.assert_close((mass * dvel).sum(1), torch.zeros(64, 3), atol=1e-7, rtol=0)
    # ... and so is angular momentum about the origin
    inertia = context.attributes[..., contacts.inertia]
    total = torch.linalg.cross(x.pos, mass * dvel) + inertia * dang
    torch.testing.assert_close(total.sum(1), torch.zeros(64, 3), atol=1e-7, rtol=0)
    far = x._replace(pos=x.pos + torch.tensor([[0.0, 0, 0], [0.02, 0, 0]]))
    apart = contacts.geometry(far, context)
    assert not contacts.impulses(context, apart, wanted)[:, 0].any()


def test_overlaps_are_undone_by_the_ratio_of_masses(pack: Pack) -> None:
    contacts = Contacts(pack.layout)
    x, context = _states(pack, [3])
    pos, flat = x.pos.clone(), torch.zeros_like(x.quat)
    flat[..., 0] = 1.0
    pos[:, 1] = pos[:, 0] + torch.tensor([0.066, 0.0, 0.0])  # 4 mm too near
    vel = torch.tensor([[[0.3, 0.1, 0.0], [0.0, 0.0, 0.0]]])
    x = x._replace(pos=pos, quat=flat, vel=vel)
    after = contacts.apart(x, context)
    moved = after.pos - pos
    np.testing.assert_allclose(moved[0, 1, 0] / -moved[0, 0, 0], 2.0, rtol=1e-3)  # 0.2, 0.1 kg
    np.testing.assert_allclose((after.pos[0, 1] - after.pos[0, 0])[0], 0.07, atol=1e-5)
    np.testing.assert_allclose(after.vel[0, :, 0], [0.2, 0.2], atol=1e-5)  # no longer inwards
    np.testing.assert_allclose(after.vel[0, :, 1], [0.1, 0.0], atol=1e-6)
    boxes = contacts.boxes(after, context)
    assert separation(boxes.chosen(contacts.one), boxes.chosen(contacts.other))[0].min() > -1e-5
    contacts.slack += 0.01  # deeper than that is usual in the data: nothing to undo
    assert torch.equal(contacts.apart(x, context).pos, x.pos)


def test_what_tokens_see(pack: Pack) -> None:
    model = new_model(pack, toy("contacts"), 0)
    assert model.contacts is not None and model.contacts.slots == 2
    assert model.sizes.edges == 18 + 2 * SEEN
    assert float(model.contacts.slack[0]) >= 0
    x, context = _states(pack, [0, 5])
    seen = model._edges(x, context, model.contacts.geometry(x, context))
    assert seen.shape == (2, 3, 3, model.sizes.edges) and bool(seen.isfinite().all())
    gaps = seen[..., 18:24]
    torch.testing.assert_close(gaps[:, 0, 1], gaps[:, 1, 0])  # both sides see the same gap
    assert not seen[:, 0, 0, 18:].any() and not seen[:, 1, 2, 18 + SEEN :].any()


def test_layouts_without_boxes() -> None:
    layout = simulate(TABLE, 1, 3, 2).layout
    assert not layout.pads and Contacts.suits(layout)
    alone = layout.objects[:1]
    assert not Contacts.suits(type(layout)(**{**layout.__dict__, "objects": alone}))
