"""What a live page can change, and what becomes of it."""

from __future__ import annotations

import json

import numpy as np
import pytest

from orbisim.registry import make_backend
from orbisim.scene import load_scene
from orbisim.view.drawing import Drawing
from orbisim.view.panel import Request, panel, request_of
from orbisim.view.simulation import Pace, Simulation
from tests.view.test_live import PENDULUM, Page, clock, live

ROBOT = load_scene(
    "<mujoco><compiler angle='radian'/><worldbody><geom name='floor' type='plane' size='2 2 .1'/>"
    "<camera name='wall' pos='0 -3 1' xyaxes='1 0 0 0 0 1' fovy='50'/>"
    "<body name='arm' pos='0 0 1'><joint name='j' axis='0 1 0' range='-1 2' limited='true'/>"
    "<joint name='s' type='slide'/><camera name='eye' pos='.1 0 0'/><site name='tip' pos='0 0 .3'/>"
    "<geom name='link' type='capsule' fromto='0 0 0 0 0 .3' size='.05'/>"
    "<geom name='hull' type='box' size='.1 .1 .2' group='3'/></body></worldbody><actuator>"
    "<motor name='m' joint='j' ctrlrange='-4 4' ctrllimited='true'/><motor joint='s'/></actuator>"
    "</mujoco>"
)


def test_what_a_page_is_told() -> None:
    offered = panel(ROBOT, Drawing(ROBOT.model), "mujoco", ["learned", "mujoco", "warp"])
    assert offered["backends"] == ["mujoco", "learned", "warp"]
    assert [(j["name"], j["low"], j["high"]) for j in offered["joints"]] == [
        ("j", -1, 2),
        ("s", -1, 1),
    ]
    assert [(a["name"], a["high"]) for a in offered["actuators"]] == [("m", 4), ("actuator 1", 1)]
    assert list(offered["bodies"]) == ["arm"]
    assert [(c["name"], c["path"], c["fov"]) for c in offered["cameras"]] == [
        ("wall", None, 50),
        ("eye", offered["bodies"]["arm"], 45),
    ]
    assert np.reshape(offered["cameras"][1]["matrix"], (4, 4)).T[:3, 3] == pytest.approx(
        [0.1, 0, 0]
    )
    assert offered["toggles"] == {"contacts": False, "sites": False, "collisions": False}
    json.dumps(offered)


@pytest.mark.parametrize(
    "text",
    ["", "pause!", "{}", "[]", "1", '{"do": "joint", "value": "x"}',
     '{"do": "speed", "value": 1e999}', '{"do": "joint", "index": 1e999}'],
)  # fmt: skip
def test_messages_that_are_no_requests(text: str) -> None:
    assert request_of(text) is None


def test_requests() -> None:
    assert request_of("step") == Request("step")
    found = request_of('{"do": "joint", "index": 2, "value": 0.5}')
    assert found == Request("joint", "", 2, 0.5)


def test_joints_controls_and_backends_can_be_changed() -> None:
    simulation = Simulation(make_backend("mujoco", PENDULUM))
    simulation.place_joint(0, 0.7)
    assert simulation.state.qpos[0, 0] == 0.7
    simulation.command(0, 2.0)
    simulation.advance(0.05)
    expected = make_backend("mujoco", PENDULUM)
    state = expected.reset().replace(qpos=np.array([[0.7]]))
    state = expected.step(state, np.array([[2.0]]), 5)
    np.testing.assert_allclose(simulation.state.qpos, state.qpos, rtol=0, atol=1e-12)
    simulation.release()
    simulation.step_once()
    assert simulation.elapsed == pytest.approx(0.06)
    simulation.use(make_backend("mujoco", PENDULUM))
    before = simulation.state.qpos.copy()
    simulation.step_once()
    assert simulation.elapsed == pytest.approx(0.07)
    assert 0 < np.abs(simulation.state.qpos - before).max() < 0.1
    simulation.restart()
    assert simulation.elapsed == 0 and simulation.state.qpos[0, 0] == 0


def test_speed_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr("time.perf_counter", lambda: now[0])
    slept: list[float] = []
    monkeypatch.setattr("time.sleep", slept.append)
    pace = Pace(10, True)
    pace.speed = 0.5
    pace.start(0.0)
    pace.keep(1.0)
    assert slept == [2.0]


@pytest.mark.slow
def test_pages_change_a_running_simulation() -> None:
    with live(ROBOT) as running:
        page = Page(running.url)
        page.next()
        page.ask("pause")
        page.ask('{"do": "joint", "index": 0, "value": 1.5}')
        deadline = 200
        while (values := joints(page.next())) is None or values[0] != 1.5:
            deadline -= 1
            assert deadline
        page.ask("nonsense")
        page.ask('{"do": "joint", "index": 99, "value": 1.5}')
        page.ask('{"do": "show", "name": "collisions", "value": 1}')
        frame = page.next()
        assert frame[0]["type"] == "delete"
        assert any("hull" in c["path"] for c in frame if c["type"] == "set_object")
        page.ask('{"do": "backend", "name": "no such"}')
        (notice,) = page.next()
        assert "unknown backend 'no such'" in notice["text"]
        page.ask("step")
        page.ask("step")
        first, second = clock(page.next()), clock(page.next())
        assert second - first == pytest.approx(0.002, abs=0.011)


def joints(frame: list[dict[str, object]]) -> list[float] | None:
    found = [c["values"] for c in frame if c["type"] == "set_joints"]
    return found[0] if found else None  # type: ignore[return-value]
