"""Physics with any backend: switched, kept and restored, reloaded, diverging."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from dm_control.mujoco import engine
from dm_control.rl import control

from orbisim import Backend, Physics, State, load_scene, make_backend, register_backend
from orbisim.errors import DivergedError, InputError, SceneError, UnknownNameError
from orbisim.physics import hybrid
from orbisim.testing import scenes

TOUCH = """
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <geom type="plane" size="1 1 0.1"/>
    <body pos="0 0 0.1"><freejoint/><geom size="0.1"/><site name="s" size="0.2"/></body>
    <body pos="1 0 1"><joint name="hinge" axis="0 1 0"/><geom size="0.1" pos="0 0 -0.3"/></body>
  </worldbody>
  <actuator><motor name="m" joint="hinge"/></actuator>
  <sensor><touch site="s"/><jointpos joint="hinge"/><accelerometer site="s"/></sensor>
</mujoco>
"""


class Drift(Backend):
    """Moves everything along its velocity; knows nothing of accelerations."""

    name = "drift"

    def __init__(self, **config: object) -> None:
        super().__init__(**config)  # type: ignore[arg-type]
        self.loads = 0

    def load(self, scene: object) -> None:
        self._scene = scene
        self.loads += 1

    def reset(self, nworld: int | None = None, seed: int | None = None) -> State:
        return make_backend("mujoco", self.scene).reset(nworld or self.nworld)

    def step(self, state: State, control: object = None, nstep: int = 1) -> State:
        control = self.check_control(state, control)
        dt = nstep * self.timestep
        seen = state.memory.get("steps", np.zeros(state.nworld)) + nstep
        qpos = np.array(state.qpos)
        qpos[:, 7:] += dt * np.array(state.qvel)[:, 6:]
        if not np.isfinite(qpos).all() or (np.abs(control) > 100).any():
            raise DivergedError("drift diverged", [0])
        return state.replace(time=state.time + dt, qpos=qpos).with_memory(steps=seen)


register_backend("drift", Drift)


@pytest.fixture
def physics() -> Physics:
    return Physics.from_xml_string(TOUCH, backend="drift")


def test_snapshot_and_restore(physics: Physics) -> None:
    physics.named.data.qvel["hinge"] = 2.0
    physics.step(2)
    kept = physics.snapshot()
    physics.step(5)
    physics.restore(kept)
    assert physics.snapshot().memory["steps"] == 2
    assert physics.named.data.qpos["hinge"] == pytest.approx(0.04)


@pytest.mark.parametrize("steps", [1, 7])
def test_restoring_in_contact_gives_the_same_future(steps: int) -> None:
    physics = Physics.from_xml_string(scenes.RESTING_BOX)
    physics.data.qvel[:] = [0.5, 0, 0, 1, 2, 3]
    physics.step(20)
    kept = physics.snapshot()
    physics.step(steps)
    future = physics.get_state()
    physics.restore(kept)
    physics.step(steps)
    np.testing.assert_array_equal(physics.get_state(), future)


def test_divergence_is_dm_controls_physics_error(physics: Physics) -> None:
    physics.data.ctrl[:] = 1000.0
    with pytest.raises(control.PhysicsError) as caught:
        physics.step()
    assert isinstance(caught.value, DivergedError)


def test_warnings_are_dm_controls_own() -> None:
    messages = []
    for cls in (engine.Physics, Physics):
        native = cls.from_xml_string(TOUCH)
        native.data.qpos[0] = np.nan
        with pytest.raises(control.PhysicsError) as caught:
            native.step()
        messages.append(str(caught.value))
        native.data.qpos[0] = np.nan
        with native.suppress_physics_errors():
            native.step()
        native.step()  # nothing new
        with pytest.raises(ZeroDivisionError), native.check_invalid_state():
            native.data.warning.number[0] += 1
            raise ZeroDivisionError
    assert messages[0] == messages[1]
    assert "mjWARN_BADQPOS" in messages[0]


def test_a_check_of_a_users_own_is_kept() -> None:
    class Careful(engine.Physics):
        checks = 0

        @contextlib.contextmanager
        def check_invalid_state(self):
            self.checks += 1
            yield

    class MoreCareful(Careful):
        pass

    physics = hybrid(MoreCareful).from_xml_string(TOUCH)
    before = physics.checks
    physics.step()
    assert physics.checks == before + 1


def test_an_unknown_backend_leaves_the_old_one() -> None:
    physics = Physics.from_xml_string(TOUCH, backend="drift")
    with pytest.raises(UnknownNameError, match="did you mean 'mujoco'"):
        physics.use_backend("mujoko")
    assert physics.backend == "drift"
    physics.step()


def test_from_xml_path_reads_any_scene(tmp_path: object) -> None:
    with pytest.raises(SceneError, match="no such file"):
        Physics.from_xml_path("nothing/here.xml")


def test_a_scene_stays_as_it_is() -> None:
    scene = load_scene(TOUCH)
    physics = Physics.from_scene(scene)
    physics.model.opt.gravity[2] = 0
    assert scene.model.opt.gravity[2] == -9.81
    assert physics.scene.model.opt.gravity[2] == 0


def test_reloading_takes_the_backend_along(physics: Physics) -> None:
    physics.reload_from_xml_string(scenes.CARTPOLE)
    assert physics.backend == "drift"
    assert physics.scene.model.nu == 1
    physics.step()


def test_renderers_are_switched() -> None:
    physics = Physics.from_xml_string(scenes.COLOURS, renderer="null")
    assert physics.renderer == "null"
    assert physics.render(4, 6, depth=True).shape == (4, 6)
    with pytest.raises(InputError, match="overlays"):
        physics.render(4, 6, overlays=("text",))
    with pytest.raises(UnknownNameError):
        physics.use_renderer("opengl")
    assert physics.renderer == "null"
