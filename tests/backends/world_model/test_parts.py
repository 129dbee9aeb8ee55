"""Parts of mechanisms: kinematics against MuJoCo's, masks, training, and the backend."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from orbisim_world_model.backend import OutsideTrainingWarning
from orbisim_world_model.config import Config, replaced
from orbisim_world_model.dynamics import Dynamics
from orbisim_world_model.entities import Context, Entities
from orbisim_world_model.evaluate import constant_velocity
from orbisim_world_model.features import Features
from orbisim_world_model.pack import Pack, joined
from orbisim_world_model.parts import COLUMNS, Parts
from orbisim_world_model.presets import preset
from orbisim_world_model.rotation import rotate
from orbisim_world_model.run import Run, train
from orbisim_world_model.trainer import new_model

from orbisim import load_scene, make_backend
from orbisim.errors import InputError, UnsupportedSceneError
from tests.backends.world_model.conftest import toy
from tests.backends.world_model.synthetic import DOOR, PANEL, TABLE, simulate

STAGES = "0.5x2x32,0.5x6x16arf/3"


def parts_of(layout: object, config: Config | None = None) -> Parts:
    found = Features(layout, (config or preset("parts")).model).parts  # type: ignore[arg-type]
    assert found is not None
    return found


def moments(pack: Pack, episode: int = 0) -> tuple[Entities, torch.Tensor, Context]:
    rows = pack.start[episode] + torch.arange(int(pack.length[episode]))
    context = pack.context(torch.full((len(rows),), episode))
    return pack.states(rows), pack.ctrl[rows], context


@pytest.fixture(scope="module")
def panel() -> Pack:
    return simulate(PANEL, 6, 40, 4)


@pytest.fixture(scope="module")
def both(panel: Pack) -> Pack:
    return joined([simulate(DOOR, 4, 40, 4, seed=1), panel])


def test_poses_and_velocities_against_mujoco(panel: Pack) -> None:
    model = mujoco.MjModel.from_xml_string(PANEL)
    data, parts = mujoco.MjData(model), parts_of(panel.layout)
    x, _, context = moments(panel)
    now = parts.placed(x, context)
    centre = rotate(now.rot, parts.column(context, "centre_x", 3))
    for t in (3, 17, 39):
        data.qpos[:], data.qvel[:] = panel.qpos[t].double(), panel.qvel[t].double()
        mujoco.mj_forward(model, data)
        for i, name in enumerate(("leaf", "lever", "button")):
            body, velocity = data.body(name), np.zeros(6)
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body.id, velocity, 0)
            np.testing.assert_allclose(now.pos[t, i] - centre[t, i], body.xpos, atol=1e-6)
            np.testing.assert_allclose(now.rot[t, i].ravel(), body.xmat, atol=1e-6)
            np.testing.assert_allclose(now.ang[t, i], velocity[:3], atol=1e-5)
            arm = np.cross(velocity[:3], centre[t, i])
            np.testing.assert_allclose(now.vel[t, i], velocity[3:] + arm, atol=1e-5)
            joint = data.joint(("hinge", "turn", "press")[i])
            np.testing.assert_allclose(now.axis[t, i], joint.xaxis, atol=1e-6)
        hinge = np.cross(
            now.axis[t, 0], now.anchor[t, 0] - torch.tensor(data.joint("hinge").xanchor)
        )
        np.testing.assert_allclose(hinge, 0.0, atol=1e-6)


def test_a_part_that_the_hand_carries_moves_with_it(panel: Pack) -> None:
    parts = parts_of(panel.layout)
    x, _, context = moments(panel)
    share = torch.tensor([1.0, 0.0, 1.0]).expand(len(x.q), 3)
    after = parts.carried(x, x, share, context)
    now = parts.placed(after._replace(q=x.q), context)
    at_hand = torch.linalg.cross(now.ang[:, 0], x.hand_pos - now.anchor[:, 0])
    about = torch.linalg.cross(now.axis[:, 0], x.hand_pos - now.anchor[:, 0])
    slip = ((at_hand - x.hand_vel) * about).sum(-1) / about.square().sum(-1)
    away = about.norm(dim=-1) > 0.05
    assert bool(away.any())
    assert float(slip[away].abs().max()) < 0.01 * float(x.hand_vel.norm(dim=-1).max()) / 0.05
    along = ((now.vel[:, 2] - x.hand_vel) * now.axis[:, 2]).sum(-1)
    np.testing.assert_allclose(along, 0.0, atol=1e-6)
    untouched = [*parts.own.tolist(), int(parts.joints[1])]
    assert torch.equal(after.v[:, untouched], x.v[:, untouched])


def test_joints_stay_within_their_ranges(panel: Pack) -> None:
    parts = parts_of(panel.layout)
    x, _, context = moments(panel)
    far = x._replace(q=x.q + 10.0, v=x.v + 1.0)
    q, v = parts.coordinates(parts.limited(far, context))
    low, high = parts.column(context, "low"), parts.column(context, "high")
    assert bool((q <= high + 0.01 * (high - low) + 1e-6).all())
    assert float(v.max()) <= 0.0
    inside, _ = parts.coordinates(parts.limited(x._replace(q=0 * x.q, v=0 * x.v), context))
    assert torch.equal(inside, torch.zeros_like(inside))


def test_numbers_of_robot_and_parts_are_put_together_and_taken_apart(panel: Pack) -> None:
    parts, count = parts_of(panel.layout), 2 * len(panel.layout.joints)
    raw = torch.arange(float(3 * count)).reshape(3, count)
    robot, moves = parts.split(raw)
    assert robot.shape == (3, 4) and moves.shape == (3, 3, 2)
    assert torch.equal(parts.whole(robot, moves), raw)


def test_padding_changes_nothing(both: Pack) -> None:
    """A door has two parts; among scenes with three, the third is not there."""
    alone = simulate(DOOR, 4, 40, 4, seed=1)
    assert both.part_mask[:4].sum(1).tolist() == [2.0] * 4
    assert both.layout.robot == alone.layout.robot
    config = toy("parts", STAGES)
    model = new_model(both, config, 0).eval()
    small = Dynamics(alone.layout, config.model).build(2).eval()
    small.load_state_dict(model.state_dict())
    found = []
    for one, pack in ((model, both), (small, alone)):
        x, control, context = moments(pack, 2)
        memory = one.initial_memory(len(x.q))
        with torch.no_grad():
            found.append(one(one.completed(x), memory, control, context).state)
    for name in ("q", "v"):
        wide, narrow = getattr(found[0], name), getattr(found[1], name)
        order = [*model.layout.robot_joints, *model.layout.parts[:2]]
        own = [*small.layout.robot_joints, *small.layout.parts]
        torch.testing.assert_close(wide[:, order], narrow[:, own], atol=2e-6, rtol=1e-5)


@pytest.mark.parametrize(
    ("name", "column", "matters"),
    [
        ("parts", "shape_07", True),
        ("parts_no_geometry", "shape_07", False),
        ("parts", "high", True),
        ("parts_no_joints", "high", False),
        ("parts_no_joints", "frictionloss", False),
        ("parts_no_joints", "mass", True),
    ],
)
def test_what_a_configuration_sees(panel: Pack, name: str, column: str, matters: bool) -> None:
    parts = parts_of(panel.layout, preset(name))
    x, control, context = moments(panel)
    assert context.parts is not None
    changed = context.parts.clone()
    changed[..., COLUMNS.index(column)] += 0.5
    other = context._replace(parts=changed)
    same = torch.equal(parts.attributes(context), parts.attributes(other)) and torch.equal(
        parts.features(x, control, context), parts.features(x, control, other)
    )
    assert same is not matters


def test_constant_velocity_keeps_the_velocities_of_parts(panel: Pack) -> None:
    config = preset("parts").model
    still = constant_velocity(panel, config)
    x, control, context = moments(panel)
    calm = x._replace(q=0 * x.q, v=0.01 * torch.ones_like(x.v))
    after = still(still.completed(calm), still.initial_memory(len(x.q)), control, context).state
    np.testing.assert_allclose(after.v, 0.01, atol=1e-6)
    np.testing.assert_allclose(after.q, 0.01 * panel.layout.timestep, atol=1e-6)


@pytest.mark.parametrize("changes", [{"kind": "global"}, {"extended": False}, {"residual": False}])
def test_models_without_tokens_or_changes_are_refused(panel: Pack, changes: dict) -> None:  # type: ignore[type-arg]
    config = dataclasses.replace(preset("parts").model, **changes)
    with pytest.raises(InputError, match="a configuration such as 'parts'"):
        Dynamics(panel.layout, config)


def test_the_linear_part_predicts_servos() -> None:
    """By least squares alone, before any training, where nothing touches."""
    panel = simulate(PANEL.replace("<geom ", '<geom contype="0" conaffinity="0" '), 6, 40, 4)
    errors = []
    for linear in (True, False):
        model = new_model(panel, replaced(toy("parts", STAGES), {"model.linear": linear}), 0).eval()
        torch.nn.init.zeros_(model.network.f_dec.robot[-1].weight)
        x, control, context = moments(panel, 5)
        with torch.no_grad():
            state = model(x, model.initial_memory(len(x.q)), control, context).state
        own = list(panel.layout.robot_joints)
        errors.append(float((state.v[:-1] - x.v[1:])[:, own].square().mean().sqrt()))
    assert errors[0] < 0.3 * errors[1]


@pytest.fixture(scope="module")
def checkpoint(both: Pack, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("parts")
    config = toy("parts", STAGES)
    train(both, config, Run(out=out, steps=30, horizons=(10,), held_out=0.2))
    return out


@pytest.mark.filterwarnings("ignore::orbisim_world_model.backend.OutsideTrainingWarning")
@pytest.mark.parametrize(
    ("xml", "count"), [(DOOR, 4), pytest.param(PANEL, 5, marks=pytest.mark.slow)]
)
def test_the_backend_steps_mechanisms(checkpoint: Path, xml: str, count: int) -> None:
    """Of any number of parts; singly and in batches, in compiled C and by torch."""
    scene = load_scene(xml)
    backend = make_backend("learned", scene, argument=str(checkpoint), native=False)
    state = backend.reset(3)
    controls = np.full((3, 12, 2), 0.1)
    path = backend.rollout(state, controls)
    assert path.qpos.shape == (3, 12, count)
    one = backend.step(backend.step(backend.reset(1), controls[:1, 0]), controls[:1, 0])
    np.testing.assert_allclose(one.qpos[0], path.qpos[0, 1], atol=1e-5)
    compiled = make_backend("learned", scene, argument=str(checkpoint))
    now = compiled.step(compiled.step(compiled.reset(1), controls[:1, 0]), controls[:1, 0])
    np.testing.assert_allclose(now.qpos, one.qpos, atol=1e-5)


def test_what_does_not_fit_is_said(checkpoint: Path) -> None:
    with pytest.raises(UnsupportedSceneError, match="mechanisms of up to 3 parts"):
        make_backend("learned", load_scene(TABLE), argument=str(checkpoint))
    heavy = DOOR.replace('mass="0.3"', 'mass="30"')
    with pytest.warns(OutsideTrainingWarning, match="mass of the part on joint 'hinge'"):
        make_backend("learned", load_scene(heavy), argument=str(checkpoint))
