"""A dm_control `Physics` of many worlds reads as one of each."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from dm_control.suite import dog, finger

from orbisim.vector.models import ModelFields
from orbisim.vector.physics import Selection, batched
from orbisim.vector.simulator import Threads
from orbisim.vector.worlds import NotBatchedError, Worlds

NWORLD = 3


def worlds_of(physics: Any) -> tuple[Any, Selection, Threads, ModelFields]:
    """Worlds at different positions and velocities."""
    model = physics.model.ptr
    fields = ModelFields(model, physics.copy().model.ptr, NWORLD)
    simulator = Threads(model, fields, NWORLD)
    random, data = np.random.default_rng(0), mujoco.MjData(model)
    for world in range(NWORLD):
        data.qpos[:] = physics.data.qpos + 0.1 * random.normal(size=model.nq)
        data.qvel[:] = random.normal(size=model.nv)
        mujoco.mj_normalizeQuat(model, data.qpos)
        simulator.set_world(world, data)
    simulator.step(np.arange(NWORLD), 2)
    selection = Selection()
    return batched(physics, simulator, fields.varied, selection), selection, simulator, fields


@pytest.fixture(scope="module")
def turning() -> Any:
    physics = finger.Physics.from_xml_string(*finger.get_model_and_assets())
    return physics, *worlds_of(physics)


READS = {
    "a method": lambda p: p.bounded_position(),
    "a method of the subclass in place of dm_control's": lambda p: p.velocity(),
    "dm_control's methods": lambda p: np.hstack((p.position(), p.time(), p.control())),
    "the state": lambda p: p.get_state(),
    "names": lambda p: p.named.data.xpos[["proximal", "distal"], ["x", "z"]],
    "a name": lambda p: p.named.data.qpos["hinge"],
    "a mask": lambda p: p.data.qpos[p.model.jnt_limited == 1],
    "the model": lambda p: p.named.model.site_size["target", 0] + p.data.qpos[0],
    "counts": lambda p: p.data.ncon + p.timestep(),
    "attributes of a field": lambda p: p.named.data.qvel.copy(),
}


@pytest.mark.parametrize("name", READS)
@pytest.mark.parametrize("ids", [None, [2, 0]], ids=["all", "some"])
def test_reads_as_one_world(turning: Any, name: str, ids: Any) -> None:
    physics, many, selection, simulator, _ = turning
    selection.ids = None if ids is None else np.array(ids)
    found = READS[name](many)
    assert isinstance(found, Worlds)
    for row, world in enumerate(range(NWORLD) if ids is None else ids):
        simulator.fill(world, physics.data.ptr)
        np.testing.assert_array_equal(found.rows[row], READS[name](physics))


REFUSED = {
    "contacts": lambda p: p.data.contact,
    "the C structs": lambda p: mujoco.mj_energyPos(p.model.ptr, p.data.ptr),
    "writing": lambda p: p.named.data.qpos.__setitem__("hinge", 0.0),
    "controls": lambda p: p.set_control(np.zeros(2)),
    "a step": lambda p: p.step(),
    "images": lambda p: p.render(),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_of_one_world_is_refused(turning: Any, name: str) -> None:
    with pytest.raises(NotBatchedError):
        REFUSED[name](turning[1])


def test_fields_are_read_only(turning: Any) -> None:
    with pytest.raises(ValueError, match="read-only"):
        turning[1].data.qpos[0] = 1.0


def test_models_that_differ(turning: Any) -> None:
    physics, _, _, simulator, _fields = turning
    selection = Selection()
    varied = {
        "site_size": np.repeat(physics.model.site_size[None], NWORLD, axis=0),
        "opt.gravity": np.arange(9.0).reshape(3, 3),
    }
    varied["site_size"][:, :, 0] = [[1.0], [2.0], [3.0]]
    many = batched(physics, simulator, varied, selection)
    assert many.named.model.site_size["target", 0].rows.tolist() == [1, 2, 3]
    assert many.model.opt.gravity[2].rows.tolist() == [2, 5, 8]
    assert many.timestep() == physics.timestep()
    assert many.model.nq == physics.model.nq


def test_velocities_of_objects() -> None:
    xml, assets = dog.get_model_and_assets(10, remove_ball=False)
    physics = dog.Physics.from_xml_string(xml, assets)
    many, _, simulator, _ = worlds_of(physics)
    for name, kind, local in (
        ("head", "site", False),
        ("ball", "geom", True),
        ("skull", "body", 0),
    ):
        found = many.data.object_velocity(name, kind, local)
        for world in range(NWORLD):
            simulator.fill(world, physics.data.ptr)
            expected = physics.data.object_velocity(name, kind, local)
            np.testing.assert_array_equal(found.rows[world], expected)
