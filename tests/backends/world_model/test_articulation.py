"""Robots as limbs: impulses of constraints, padding, training, and bodies never seen."""

from __future__ import annotations

import warnings
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from orbisim_world_model.articulation import ENDS, LIMB_OUTPUTS, silenced
from orbisim_world_model.backend import OutsideTrainingWarning
from orbisim_world_model.config import Config
from orbisim_world_model.evaluate import evaluate
from orbisim_world_model.pack import Pack, grouped
from orbisim_world_model.packing import as_limbs
from orbisim_world_model.run import Run, train
from orbisim_world_model.schedule import Clock
from orbisim_world_model.trainer import Trainer, new_model

from orbisim import load_scene, make_backend
from orbisim.errors import InputError, UnsupportedSceneError
from tests.backends.world_model.conftest import toy
from tests.backends.world_model.robots import CRAWLER, TWO, of_limbs
from tests.backends.world_model.synthetic import PENDULUM, TABLE, simulate


def pack_of(xml: str, episodes: int = 4, steps: int = 30, substeps: int = 1) -> Pack:
    model = mujoco.MjModel.from_xml_string(xml)
    return as_limbs(simulate(xml, episodes, steps, substeps), model)


def limbs_toy(stages: str = "0.6x1x24,0.4x3x16arf", **changes: object) -> Config:
    return toy("limbs", stages, model__layers=1, **changes)


@pytest.fixture(scope="module")
def packs() -> list[Pack]:
    fine = CRAWLER.replace('timestep="0.005"', 'timestep="0.0025"')
    return [pack_of(PENDULUM), pack_of(CRAWLER), pack_of(fine, substeps=2), pack_of(TWO)]


def test_robots_of_one_integrator_are_one_pack(packs: list[Pack]) -> None:
    euler, runge_kutta = grouped(packs)
    assert euler.part_mask.sum(1).unique().tolist() == [1.0, 6.0]
    assert (euler.layout.substeps, euler.layout.nu) == (2, 2)
    assert runge_kutta.layout.runge_kutta and len(runge_kutta.layout.parts) == 2
    assert len(euler.robots().unique()) == 3


def test_a_padded_robot_moves_as_it_does_alone(packs: list[Pack]) -> None:
    together = grouped(packs[:3])[0]
    model = new_model(together, limbs_toy(), 0).double()
    for number in (0, 2):  # a pendulum, and a crawler of two substeps
        pack = packs[number]
        alone = new_model(pack, limbs_toy(), 0).double()
        alone.load_state_dict(model.state_dict())
        first = sum(p.episodes for p in packs[:number])
        for who, data, episode in ((alone, pack, 0), (model, together, first)):
            row = data.start[episode : episode + 1] + 5
            x, context = data.states(row), data.context(torch.tensor([episode]))
            context = context._replace(
                **{n: getattr(context, n).double() for n in ("world", "parts", "part_mask")}
            )
            step = who(x.to(torch.float64), who.initial_memory(1), data.ctrl[row].double(), context)
            if who is alone:
                expected = step.state
        count = len(pack.layout.parts)
        assert torch.allclose(step.state.q[:, :count], expected.q, atol=1e-9)
        assert torch.allclose(step.state.v[:, :count], expected.v, atol=1e-9)


def test_impulses_push_and_friction_is_bounded() -> None:
    model = mujoco.MjModel.from_xml_string(CRAWLER)
    dynamics, x, context = of_limbs(model, 64)
    limbs = dynamics.features.limbs
    assert limbs is not None
    generator = torch.Generator().manual_seed(0)
    q = x.q + 0.6 * (torch.rand(x.q.shape, generator=generator).double() - 0.5)
    q[:, 1] -= 0.25  # down to the floor and into it
    v = 3 * torch.randn(x.v.shape, generator=generator).double()
    known = limbs.known(x._replace(q=q, v=v), torch.zeros(64, 2).double(), context)
    contact = known.floor
    assert bool((contact.near > 0.9).any()) and bool((contact.near < 1e-3).any())
    for _ in range(3):
        said = 5 * torch.randn(64, 6, ENDS, 3, generator=generator).double()
        forces = []
        for axis in range(3):  # along each axis, the impulses' sum by a Jacobian that picks it
            picked = torch.zeros_like(contact.points.slopes)
            picked[..., 0, axis] = 1.0
            one = contact._replace(points=contact.points._replace(slopes=picked))
            keep = torch.zeros_like(said[..., 0])
            keep[:, 4, 0] = 1.0  # of one end of the foot
            one = one._replace(near=contact.near * keep)
            forces.append(limbs._contact_impulse(one, said)[:, 0])
        x_force, y_force, up = forces
        assert bool((up >= 0).all()) and bool((up > 0).any())
        assert bool((x_force.abs() <= 1.0 * up + 1e-12).all())
        assert bool((y_force.abs() <= 1.0 * up + 1e-12).all())


def test_without_impulses_motion_is_free_and_an_untrained_foot_stops() -> None:
    model = mujoco.MjModel.from_xml_string(CRAWLER)
    dynamics, x, context = of_limbs(model, 1)
    limbs = dynamics.features.limbs
    assert limbs is not None
    q = x.q.clone()
    q[:, 1] -= 0.1  # the foot goes into the floor
    v = torch.zeros_like(q)
    v[:, 1] = -1.0
    x = x._replace(q=q, v=v)
    control = torch.zeros(1, 2).double()
    known = limbs.known(x, control, context)
    lowest = known.floor.points.gap.min()
    assert -0.05 < float(lowest) < 0.0
    start = torch.zeros(1, 6, LIMB_OUTPUTS).double()
    last = torch.nn.Linear(3, LIMB_OUTPUTS).double()
    silenced(last)
    quiet = last(torch.randn(1, 6, 3).double()).detach()
    quiet[..., -1] = 0.0
    free = limbs.advance(x, known, quiet, context)
    dry = np.array([0, 0, 0, 0, 0.3 * 0.005, 0])
    bound = (known.inverse.abs() * torch.tensor(dry)).sum(-1)
    assert bool(((free.v - known.v).abs() <= bound + 1e-9).all())
    start[..., [0, 3, 6, 9, 12, 14, 15]] = float(np.log(np.e - 1))
    stopped = limbs.advance(x, known, start, context)
    before, after = (
        float((known.floor.points.slopes * w[:, None, None, :, None]).sum(3)[0, 4, :2, 2].min())
        for w in (known.v, stopped.v)
    )
    assert before < -0.9 and after > -0.4


def test_a_robot_is_learned_and_others_follow(packs: list[Pack], tmp_path: Path) -> None:
    config = limbs_toy()
    found = train(
        grouped(packs), config, Run(out=tmp_path / "limbs", steps=12, horizons=(5,), burn=0)
    )
    assert [len(v["layout"]["parts"]) for v in (found, *found["variants"])] == [6, 2]
    assert found["metrics"]["model"]["5"]["normalised"]["median"] < 1.0
    scene = tmp_path / "arm.xml"  # other names, other lengths, another number of joints
    longer = (
        TWO.replace("-.4", "-.5")
        .replace('size="0.03"', 'size="0.1"')
        .replace('name="a"', 'name="first"')
    )
    scene.write_text(longer.replace('integrator="RK4"', ""))
    with pytest.warns(OutsideTrainingWarning, match="radius_0 of the limb"):
        backend = make_backend(f"learned:{tmp_path / 'limbs'}", load_scene(str(scene)))
    state = backend.step(backend.reset(1), np.array([[0.4]]), nstep=3)
    true = make_backend("mujoco", load_scene(str(scene)))
    expected = true.step(true.reset(1), np.array([[0.4]]), nstep=3)
    np.testing.assert_allclose(state.qpos, expected.qpos, atol=1e-5)
    with pytest.raises(UnsupportedSceneError, match="neither hinges nor slides"):
        scene.write_text(TABLE)
        make_backend(f"learned:{tmp_path / 'limbs'}", load_scene(str(scene)))


def test_free_robots_need_no_training(packs: list[Pack]) -> None:
    pendulum = packs[0]
    model = new_model(pendulum, limbs_toy(), 0)
    assert evaluate(model, pendulum, (20,), burn=0)["20"]["normalised"]["worst"] < 1e-5


def test_gradients_stay_finite(packs: list[Pack]) -> None:
    trainer = Trainer(grouped(packs), limbs_toy("1x6x12arf"), Clock(3, None))
    for _ in range(3):
        trainer.step()
    assert trainer.losses()["skipped"] == 0
    assert bool(torch.isfinite(trainer.optimizer.gradient).all())


def test_scenes_with_objects_are_refused(packs: list[Pack]) -> None:
    with pytest.raises(InputError, match="without free bodies"):
        new_model(simulate(TABLE, 2, 10, 4), limbs_toy(), 0)
    with warnings.catch_warnings(), pytest.raises(InputError, match="integrated in different ways"):
        from orbisim_world_model.pack import joined

        joined([packs[0], packs[3]])
