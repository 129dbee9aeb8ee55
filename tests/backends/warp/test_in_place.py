"""Worlds that stay where MuJoCo-Warp keeps them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from orbisim_warp import WarpBackend

import orbisim
from orbisim.scene import Scene

COUNT = 3
FIELDS = ("qpos", "qvel", "act")
DERIVED = ("xpos", "xmat", "geom_xpos", "subtree_com", "sensordata")

FALLING = """
<mujoco>
  <option timestep="0.005" {options}/>
  <worldbody>
    <geom type="plane" size="2 2 .1"/>
    <body name="box" pos="0 0 .3">
      <freejoint/>
      <geom type="box" size=".1 .1 .1"/>
      <site name="middle"/>
      <body pos=".2 0 0">
        <joint name="arm" axis="0 1 0" damping=".1"/>
        <geom type="capsule" fromto="0 0 0 .3 0 0" size=".03"/>
      </body>
    </body>
  </worldbody>
  <actuator><position joint="arm" kp="5" timeconst=".05"/></actuator>
  <sensor>
    <accelerometer site="middle"/>
    <jointvel joint="arm"/>
    <touch site="middle"/>
    <framepos objtype="site" objname="middle"/>
  </sensor>
</mujoco>
"""


def falling(options: str = "") -> Scene:
    return orbisim.load_scene(FALLING.format(options=options))


def starts(backend: WarpBackend) -> Any:
    state = backend.reset(COUNT)
    turned = state.qpos + 0.05 * np.random.default_rng(0).normal(size=state.qpos.shape)
    turned[:, 3:7] /= np.linalg.norm(turned[:, 3:7], axis=1, keepdims=True)
    return state.replace(qpos=turned)


def put(place: Any, state: Any) -> None:
    rows = {"time": state.time, **{n: getattr(state, n) for n in FIELDS}, **state.memory}
    given = {n: torch.as_tensor(np.asarray(r)) for n, r in rows.items() if n in place.names}
    place.write(torch.arange(COUNT), given)
    place.refresh()


@pytest.mark.slow
@pytest.mark.parametrize("options", ["", 'integrator="implicitfast"', 'integrator="RK4"'])
def test_steps_are_those_of_the_backend(options: str) -> None:
    backend = WarpBackend(nworld=COUNT, device="cpu")
    backend.load(falling(options))
    backend.report = {"sensordata", "qacc"}
    state, place = starts(backend), backend.in_place(COUNT)
    assert place is not None
    put(place, state)
    for k in range(60):
        control = np.full((COUNT, 1), np.sin(k / 5.0))
        state = backend.step(state, control, 2)
        place.field("ctrl").copy_(torch.as_tensor(control))
        place.step(2)
        for name in FIELDS:
            expected = getattr(state, name)
            np.testing.assert_allclose(place.field(name).numpy(), expected, rtol=0, atol=1e-4)
            put(place, state) if name == "act" and k % 20 == 19 else None
    reported = state.memory["sensordata"]
    derived = backend.derive(state, DERIVED)
    for name in DERIVED[:-1]:
        np.testing.assert_allclose(place.field(name).numpy(), derived[name], rtol=0, atol=1e-4)
    found = place.field("sensordata").numpy()
    np.testing.assert_allclose(found[:, 3], derived["sensordata"][:, 3], rtol=0, atol=1e-4)
    np.testing.assert_allclose(found[:, 5:], derived["sensordata"][:, 5:], rtol=0, atol=1e-4)
    last = [0, 1, 2, 4]  # accelerations and forces are those of the last timestep
    assert np.abs(reported[:, last]).max() > 1.0
    del found
    assert place.field("time")[0] == pytest.approx(60 * 0.01, rel=1e-5)


@pytest.mark.slow
def test_accelerations_are_those_of_the_last_timestep() -> None:
    backend = WarpBackend(nworld=COUNT, device="cpu")
    backend.load(falling())
    backend.report = {"sensordata"}
    state, place = starts(backend), backend.in_place(COUNT)
    assert place is not None
    put(place, state)
    state = backend.step(state, np.ones((COUNT, 1)), 3)
    place.field("ctrl").fill_(1.0)
    place.step(3)
    found, reported = place.field("sensordata").numpy(), state.memory["sensordata"]
    np.testing.assert_allclose(found[:, :3], reported[:, :3], rtol=0, atol=1e-4)
    assert np.abs(reported[:, :3]).max() > 0.01
    assert np.abs(found[:, 3] - reported[:, 3]).max() > 1e-3, "velocities are of the new state"


@pytest.mark.slow
def test_buffers_that_are_too_small() -> None:
    scene = falling()
    roomy, small = (WarpBackend(nworld=COUNT, device="cpu", **sizes) for sizes in ({}, SMALL))
    places = []
    for backend in (roomy, small):
        backend.load(scene)
        place = backend.in_place(COUNT)
        assert place is not None
        put(place, starts(backend))
        places.append(place)
    for _ in range(80):
        for place in places:
            place.field("ctrl").fill_(0.3)
            place.step(1)
            while place.overflowed:
                before = place.generation
                place.repair()
                assert place.generation > before
                place.step(1)
        for name in FIELDS:
            ours, theirs = (place.field(name).numpy() for place in places)
            np.testing.assert_allclose(theirs, ours, rtol=0, atol=2e-3)
    assert places[1].generation > 1
    places[0].step(1)
    places[0].take_back()
    ours, theirs = (place.field("qpos").numpy() for place in places)
    np.testing.assert_allclose(theirs, ours, rtol=0, atol=2e-3)


SMALL: dict[str, Any] = {"nconmax": 1, "njmax": 2}


@pytest.mark.slow
def test_worlds_that_are_lost() -> None:
    backend = WarpBackend(nworld=COUNT, device="cpu")
    backend.load(falling())
    place = backend.in_place(COUNT)
    assert place is not None
    put(place, starts(backend))
    place.field("ctrl")[1] = torch.nan
    place.step(2)
    assert place.lost.tolist() == [False, True, False]
