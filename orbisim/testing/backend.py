"""What every backend must do."""

from __future__ import annotations

import copy
import functools
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from orbisim.backend import Backend, Capability
from orbisim.errors import DivergedError, InputError
from orbisim.metrics import energies
from orbisim.physics import Physics
from orbisim.registry import available_backends, make_backend
from orbisim.scene import Scene, load_scene
from orbisim.state import State
from orbisim.testing import scenes
from orbisim.testing.scenes import DIVERGING

_WORLDS = 3
"""The fewest with one that has neighbours on both sides."""
_STEPS = 8
"""Long enough to tell steps apart, short enough for backends that compile."""


_THREADS = 8
"""Enough for races to show on two cores: in 44 of 240 calls where they were."""
_CALLS = 2
"""Of each thread, and of each kind: enough for threads to meet within each other's calls."""


class BackendConformance:
    """Inherit, set `backend`, run with pytest.

    Attributes:
      backend: the registered name, with an argument if it takes one.
      config: further arguments for `make_backend`.
      scenes: the scenes to test on, MJCF or anything `load_scene` takes. The laws of physics are
        tested on scenes of their own, for backends with the capability CLASSICAL only.
      tolerance: by how much two computations of the same step may differ, relative to the size of
        the numbers; 0 for backends with the capability DETERMINISTIC.
      law_tolerance: by how much conserved quantities may drift, relative.
      agreement: by how much positions may differ from C MuJoCo's after 100 steps without contact.
    """

    backend: str = ""
    config: dict[str, Any] = {}  # noqa: RUF012 (overridden, not mutated)
    scenes: tuple[str, ...] = (
        scenes.CARTPOLE,
        scenes.FILTERED,
        scenes.FREE_BODY,
        scenes.RESTING_BOX,
    )
    tolerance: float = 0.0
    law_tolerance: float = 1e-3
    agreement: float = 1e-4

    # -- fixtures ------------------------------------------------------------------------------

    @pytest.fixture(scope="class")
    @classmethod
    def loaded(cls) -> list[Scene]:
        """The scenes, loaded once."""
        return [load_scene(source) for source in cls.scenes]

    @pytest.fixture(scope="class")
    @classmethod
    def engines(cls, loaded: list[Scene]) -> list[Backend]:
        """A backend for each scene."""
        return [cls.make(scene) for scene in loaded]

    @classmethod
    def make(cls, scene: Scene, nworld: int = _WORLDS) -> Backend:
        """The backend under test, with a scene loaded."""
        return make_backend(cls.backend, scene, nworld=nworld, **cls.config)

    @staticmethod
    def moved(engine: Backend, nworld: int = _WORLDS) -> State:
        """An initial state that differs between worlds."""
        state = engine.reset(nworld)
        speeds = np.linspace(0.1, 0.3, nworld)[:, None] * np.ones((1, engine.model.nv))
        return state.replace(qvel=_like(speeds, state.qvel))

    @staticmethod
    def controls(engine: Backend, nworld: int = _WORLDS, steps: int = _STEPS) -> np.ndarray:
        """Controls [nworld, steps, nu] within the actuators' ranges."""
        rng = np.random.default_rng(0)
        return rng.uniform(-0.5, 0.5, (nworld, steps, engine.model.nu))

    def assert_same(self, a: State, b: State) -> None:
        """Asserts that two states agree within the class's tolerance."""
        for name in ("time", "qpos", "qvel", "act"):
            x, y = (np.asarray(getattr(s.numpy(), name)) for s in (a, b))
            if self.tolerance:
                scale = self.tolerance * (1.0 + np.abs(y))
                assert (np.abs(x - y) <= scale).all(), (name, np.abs(x - y).max())
            else:
                np.testing.assert_array_equal(x, y, err_msg=name)

    # -- registration --------------------------------------------------------------------------

    def test_is_registered(self) -> None:
        assert self.backend.partition(":")[0] in available_backends()

    def test_knows_its_name_and_scene(self, engines: list[Backend], loaded: list[Scene]) -> None:
        for engine, scene in zip(engines, loaded, strict=True):
            assert engine.name == self.backend.partition(":")[0]
            assert engine.scene is scene
            assert engine.timestep > 0

    def test_needs_a_scene(self) -> None:
        engine = type(self.make(load_scene(self.scenes[0])))(**self.config)
        with pytest.raises(InputError, match="load"):
            _ = engine.scene

    @pytest.mark.parametrize("scene", [None, "scene.xml", 3])
    def test_scenes_that_are_none_are_refused(self, engines: list[Backend], scene: Any) -> None:
        for engine in engines:
            with pytest.raises(InputError, match="loads a Scene"):
                engine.load(scene)

    # -- threads -------------------------------------------------------------------------------

    def test_threads_may_share_one_object(self, engines: list[Backend]) -> None:
        """Eight threads, each with states and world counts of its own: exact in every call."""
        calls = [self._calls_of_a_thread(engines[0], index) for index in range(_THREADS)]
        alone = [[call() for call in of_thread] for of_thread in calls]
        begin = threading.Barrier(_THREADS)

        def run(of_thread: list[Callable[[], State]]) -> list[State]:
            begin.wait()
            return [call() for call in of_thread]

        with ThreadPoolExecutor(_THREADS) as pool:
            together = list(pool.map(run, calls))
        for expected, found in zip(alone, together, strict=True):
            for one, other in zip(expected, found, strict=True):
                self.assert_same(other, one)

    def _calls_of_a_thread(self, engine: Backend, index: int) -> list[Callable[[], State]]:
        """Steps and rollouts that leave other numbers behind than those of another thread."""
        nworld = 1 + index // (_THREADS // 2)
        state = self.moved(engine, nworld)
        state = state.replace(qvel=state.qvel * (1.0 + 0.2 * index))
        controls = self.controls(engine, nworld) * (index / _THREADS)
        calls: list[Callable[[], State]] = []
        for t in range(_CALLS):
            calls.append(functools.partial(engine.step, state, controls[:, t], 2))
            calls.append(lambda t=t: engine.rollout(state, controls[:, t : t + 3]).final)  # type: ignore[misc]
        return calls

    # -- reset ---------------------------------------------------------------------------------

    def test_reset_has_a_world_axis(self, engines: list[Backend]) -> None:
        for engine in engines:
            state = engine.reset(5, seed=0)
            model = engine.model
            assert tuple(state.time.shape) == (5,)
            assert tuple(state.qpos.shape) == (5, model.nq)
            assert tuple(state.qvel.shape) == (5, model.nv)
            assert tuple(state.act.shape) == (5, model.na)
            assert all(array.shape[0] == 5 for array in state.memory.values())
            assert state.finite.all()

    def test_reset_is_reproducible(self, engines: list[Backend]) -> None:
        for engine in engines:
            self.assert_same(engine.reset(2, seed=3), engine.reset(2, seed=3))

    def test_reset_prepares_as_many_worlds_as_announced(self, engines: list[Backend]) -> None:
        for engine in engines:
            assert engine.reset().nworld == _WORLDS

    # -- step ----------------------------------------------------------------------------------

    def test_step_does_not_touch_its_arguments(self, engines: list[Backend]) -> None:
        for engine in engines:
            state, control = self.moved(engine), self.controls(engine)[:, 0]
            before, control_before = copy.deepcopy(state.numpy()), control.copy()
            engine.step(state, control)
            for name, array in before._named():
                after = dict(state.numpy()._named())[name]
                np.testing.assert_array_equal(after, array, err_msg=name)
            np.testing.assert_array_equal(control, control_before)

    def test_save_step_restore_step(self, engines: list[Backend], tmp_path: Path) -> None:
        """Keeping a state is saving it; passing it is restoring it."""
        for engine in engines:
            controls = self.controls(engine)
            kept = engine.step(self.moved(engine), controls[:, 0], 3)
            first = engine.step(kept, controls[:, 1])
            engine.step(first, controls[:, 2], 2)  # whatever happens in between
            self.assert_same(engine.step(kept, controls[:, 1]), first)
            kept.save(tmp_path / "state.npz")
            self.assert_same(engine.step(State.load(tmp_path / "state.npz"), controls[:, 1]), first)

    def test_time_advances(self, engines: list[Backend]) -> None:
        for engine in engines:
            state = engine.step(engine.reset(), None, 3)
            np.testing.assert_allclose(state.numpy().time, 3 * engine.timestep, rtol=1e-6)

    def test_several_steps_at_once(self, engines: list[Backend]) -> None:
        for engine in engines:
            control = self.controls(engine)[:, 0]
            together = engine.step(self.moved(engine), control, 4)
            single = self.moved(engine)
            for _ in range(4):
                single = engine.step(single, control)
            self.assert_same(
                together.replace(time=_like(np.zeros(_WORLDS), together.time)),
                single.replace(time=_like(np.zeros(_WORLDS), single.time)),
            )

    def test_worlds_are_independent(self, engines: list[Backend]) -> None:
        for engine in engines:
            state, control = self.moved(engine), self.controls(engine)[:, 0]
            together = engine.step(state, control, 3)
            for world in range(_WORLDS):
                alone = engine.step(state[world], control[world : world + 1], 3)
                self.assert_same(alone, together[world])

    def test_control_for_all_worlds_at_once(self, engines: list[Backend]) -> None:
        for engine in engines:
            state, control = self.moved(engine), self.controls(engine)[0, 0]
            each = np.tile(control, (_WORLDS, 1))
            self.assert_same(engine.step(state, control), engine.step(state, each))

    def test_control_matters(self, engines: list[Backend]) -> None:
        actuated = [engine for engine in engines if engine.model.nu]
        assert actuated, "give the conformance test at least one scene with an actuator"
        for engine in actuated:
            state = engine.reset()
            pushed = engine.step(state, np.full(engine.model.nu, 0.5), 5).numpy()
            idle = engine.step(state, None, 5).numpy()
            assert np.abs(pushed.qvel - idle.qvel).max() > 1e-6

    def test_starts_from_a_bare_state(self, engines: list[Backend]) -> None:
        """A state of another backend has no memory of this one; unknown memory is ignored."""
        for engine in engines:
            state = self.moved(engine)
            bare = state.replace(memory={"of_another_backend": np.zeros((_WORLDS, 2))})
            assert engine.step(bare, None, 2).finite.all()

    def test_orientations_stay_unit_quaternions(self, engines: list[Backend]) -> None:
        for engine in engines:
            qpos = engine.step(self.moved(engine), None, 20).numpy().qpos
            model = engine.model
            for joint in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE):
                adr = model.jnt_qposadr[joint] + 3
                norms = np.linalg.norm(qpos[:, adr : adr + 4], axis=1)
                np.testing.assert_allclose(norms, 1.0, atol=1e-5)

    # -- rollout -------------------------------------------------------------------------------

    def test_rollout_is_steps(self, engines: list[Backend]) -> None:
        for engine in engines:
            state, controls = self.moved(engine), self.controls(engine)
            trajectory = engine.rollout(state, controls, nstep=2)
            assert tuple(trajectory.qpos.shape) == (_WORLDS, _STEPS, engine.model.nq)
            assert (trajectory.diverged_at == -1).all()
            for t in range(_STEPS):
                state = engine.step(state, controls[:, t], 2)
                recorded = trajectory.state_at(t)
                np.testing.assert_allclose(recorded.numpy().time, state.numpy().time, rtol=1e-6)
                zero = _like(np.zeros(_WORLDS), state.time)
                self.assert_same(recorded.replace(time=zero), state.replace(time=zero))
            self.assert_same(trajectory.final.replace(time=state.time), state)

    def test_rollout_goes_on_from_its_final_state(self, engines: list[Backend]) -> None:
        for engine in engines:
            state, controls = self.moved(engine), self.controls(engine)
            whole = engine.rollout(state, controls)
            first = engine.rollout(state, controls[:, :3])
            rest = engine.rollout(first.final, controls[:, 3:])
            zero = _like(np.zeros(_WORLDS), state.time)
            self.assert_same(rest.final.replace(time=zero), whole.final.replace(time=zero))

    def test_rollout_of_shared_controls(self, engines: list[Backend]) -> None:
        for engine in engines:
            controls = self.controls(engine)[0]
            trajectory = engine.rollout(self.moved(engine), controls)
            assert tuple(trajectory.control.shape) == (_WORLDS, _STEPS, engine.model.nu)

    # -- wrong input ---------------------------------------------------------------------------

    def test_wrong_shapes_are_refused(self, engines: list[Backend]) -> None:
        for engine in engines:
            state, nu = engine.reset(), engine.model.nu
            with pytest.raises(InputError, match="control"):
                engine.step(state, np.zeros(nu + 1))
            with pytest.raises(InputError, match="controls"):
                engine.rollout(state, np.zeros((_STEPS, nu + 1)))
            with pytest.raises(InputError, match="qpos"):
                engine.step(state.replace(qpos=_like(np.zeros((_WORLDS, 99)), state.qpos)))
            with pytest.raises(InputError, match="qacc_warmstart"):
                engine.step(state.with_memory(qacc_warmstart=np.zeros((_WORLDS, 99))))

    @pytest.mark.parametrize("nstep", [0, -1, 1.5, None, "2"])
    def test_step_counts_that_are_none_are_refused(
        self, engines: list[Backend], nstep: Any
    ) -> None:
        for engine in engines:
            state, controls = engine.reset(), self.controls(engine)
            with pytest.raises(InputError, match="nstep"):
                engine.step(state, None, nstep)
            with pytest.raises(InputError, match="nstep"):
                engine.rollout(state, controls, nstep=nstep)

    @pytest.mark.parametrize("nworld", [0, -1, 1.5, "2"])
    def test_world_counts_that_are_none_are_refused(
        self, engines: list[Backend], nworld: Any
    ) -> None:
        for engine in engines:
            with pytest.raises(InputError, match="nworld"):
                engine.reset(nworld)
        with pytest.raises(InputError, match="nworld"):
            make_backend(self.backend, engines[0].scene, nworld=nworld, **self.config)

    @pytest.mark.parametrize("seed", [-1, 0.5, "a"])
    def test_seeds_that_are_none_are_refused(self, engines: list[Backend], seed: Any) -> None:
        for engine in engines:
            with pytest.raises(InputError, match="seed"):
                engine.reset(seed=seed)

    @pytest.mark.parametrize("state", [None, {"qpos": [0.0]}, "state"])
    def test_states_that_are_none_are_refused(self, engines: list[Backend], state: Any) -> None:
        for engine in engines:
            nothing = np.zeros((_STEPS, engine.model.nu))
            with pytest.raises(InputError, match="must be a State"):
                engine.step(state)
            with pytest.raises(InputError, match="must be a State"):
                engine.rollout(state, nothing)
            with pytest.raises(InputError, match="must be a State"):
                engine.linearize(state)

    def test_a_state_without_worlds_is_refused(self, engines: list[Backend]) -> None:
        for engine in engines:
            with pytest.raises(InputError, match="no worlds"):
                engine.step(engine.reset()[[]])

    @pytest.mark.parametrize("kind", ["ragged", "complex", "text", "object"])
    def test_controls_that_are_no_numbers_are_refused(
        self, engines: list[Backend], kind: str
    ) -> None:
        for engine in engines:
            nu = engine.model.nu
            row: Any = {
                "ragged": [[0.0] * (nu + 1), [0.0] * nu, [0.0] * nu],
                "complex": np.full((_WORLDS, nu), 1j),
                "text": [["a"] * nu] * _WORLDS,
                "object": [[None] * nu] * _WORLDS,
            }[kind]
            if kind in ("text", "object") and not nu:
                continue
            with pytest.raises(InputError, match="control"):
                engine.step(engine.reset(), row)
            with pytest.raises(InputError, match="controls"):
                engine.rollout(engine.reset(), [row] * _WORLDS if kind == "ragged" else [row])

    def test_a_rollout_of_no_controls(self, engines: list[Backend]) -> None:
        for engine in engines:
            state = self.moved(engine)
            trajectory = engine.rollout(state, np.zeros((_WORLDS, 0, engine.model.nu)))
            assert tuple(trajectory.qpos.shape) == (_WORLDS, 0, engine.model.nq)
            assert (np.asarray(trajectory.diverged_at) == -1).all()
            self.assert_same(trajectory.final, state)

    @pytest.mark.parametrize("eps", [0.0, -1.0, float("nan"), float("inf"), "small"])
    def test_perturbations_that_are_none_are_refused(
        self, engines: list[Backend], eps: Any
    ) -> None:
        with pytest.raises(InputError, match="eps"):
            engines[0].linearize(engines[0].reset(), eps=eps)

    def test_controls_that_are_not_finite_are_refused(self, engines: list[Backend]) -> None:
        for engine in engines:
            if engine.model.nu:
                with pytest.raises(InputError, match="finite"):
                    engine.step(engine.reset(), np.full(engine.model.nu, np.nan))

    def test_divergence_names_the_worlds(self, engines: list[Backend]) -> None:
        engine = engines[0]
        with pytest.raises(DivergedError) as caught:
            engine.step(self.broken(engine), None, 2)
        assert caught.value.worlds == (1,)

    def test_divergence_in_a_rollout(self, engines: list[Backend]) -> None:
        engine = engines[0]
        controls = self.controls(engine)
        trajectory = engine.rollout(self.broken(engine), controls)
        assert list(np.asarray(trajectory.diverged_at) >= 0) == [False, True, False]
        qpos = trajectory.state_at(_STEPS - 1).numpy().qpos
        assert np.isnan(qpos[1]).all()
        assert np.isfinite(qpos[[0, 2]]).all()
        healthy = engine.rollout(self.moved(engine), controls)
        self.assert_same(trajectory.final[0], healthy.final[0])
        with pytest.raises(DivergedError):
            engine.rollout(self.broken(engine), controls, raise_on_divergence=True)

    def broken(self, engine: Backend) -> State:
        """A state whose second world cannot be simulated."""
        state = self.moved(engine)
        qvel = np.array(state.numpy().qvel)
        qvel[1] = np.nan
        return state.replace(qvel=_like(qvel, state.qvel))

    # -- derivatives and reports ---------------------------------------------------------------

    def test_linearization_predicts_steps(self, engines: list[Backend]) -> None:
        for engine in engines[:2]:
            model, state = engine.model, self.moved(engine)
            control = self.controls(engine)[:, 0]
            found = engine.linearize(state, control)
            ndx = 2 * model.nv + model.na
            assert tuple(found.A.shape) == (_WORLDS, ndx, ndx)
            assert tuple(found.B.shape) == (_WORLDS, ndx, model.nu)
            nudge = 1e-3 if not self.tolerance else 1e-1
            ahead = engine.step(state, control + nudge).numpy().qvel
            behind = engine.step(state, control - nudge).numpy().qvel
            slope = (ahead - behind) / (2 * nudge)
            predicted = np.asarray(found.B)[:, model.nv : 2 * model.nv].sum(axis=2)
            np.testing.assert_allclose(slope, predicted, rtol=2e-2, atol=1e-3)

    def test_reports_what_it_says(self, engines: list[Backend]) -> None:
        for engine in engines:
            engine.report = engine.reportable
            try:
                memory = engine.step(self.moved(engine), None, 2).memory
                shapes = {n: getattr(mujoco.MjData(engine.model), n).shape for n in engine.report}
                assert {n: tuple(memory[n].shape[1:]) for n in engine.report} == shapes
            finally:
                engine.report = frozenset()

    def test_refuses_to_report_what_it_does_not_know(self, engines: list[Backend]) -> None:
        with pytest.raises(InputError, match="report"):
            engines[0].report = frozenset({"no_such_field"})

    def test_gradients_match_differences(self, engines: list[Backend]) -> None:
        engine = next(e for e in engines if e.model.nu)
        if Capability.DIFFERENTIABLE not in engine.capabilities:
            pytest.skip("not differentiable")
        torch = pytest.importorskip("torch")
        state = self.moved(engine)
        control = torch.full((_WORLDS, engine.model.nu), 0.1, requires_grad=True)
        engine.step(state, control).qvel.sum().backward()
        eps = 1e-2
        with torch.no_grad():
            ahead, behind = (
                engine.step(state, control + sign * eps).qvel.sum() for sign in (1, -1)
            )
        slope = float((ahead - behind) / (2 * eps))
        assert float(control.grad.sum()) == pytest.approx(slope, rel=5e-2, abs=1e-3)

    # -- inside Physics ------------------------------------------------------------------------

    def test_physics_keeps_the_state_when_switching(self, loaded: list[Scene]) -> None:
        for scene in loaded:
            physics = Physics.from_scene(scene)
            physics.data.qvel[:] = 0.1
            physics.step(3)
            before = physics.get_state()
            physics.use_backend(self.backend, **self.config)
            np.testing.assert_array_equal(physics.get_state(), before)
            physics.use_backend("mujoco")
            np.testing.assert_array_equal(physics.get_state(), before)

    def test_physics_steps_as_the_backend_does(self, loaded: list[Scene]) -> None:
        for scene in loaded:
            physics = Physics.from_scene(scene, backend=self.make(scene, nworld=1))
            engine = self.make(scene, nworld=1)
            substeps = round(engine.timestep / scene.model.opt.timestep)
            state = physics.snapshot()
            for _ in range(3):
                physics.step(substeps)
                state = engine.step(state)
                np.testing.assert_allclose(
                    physics.get_state()[: scene.model.nq],
                    state.numpy().qpos[0],
                    rtol=0,
                    atol=max(self.tolerance, 1e-12),
                )

    # -- the laws of physics -------------------------------------------------------------------

    def classical(self, source: str) -> Backend:
        """A backend for a law's scene; skips the test if the backend is not classical."""
        engine = self.make(load_scene(self.scenes[0]))
        if Capability.CLASSICAL not in engine.capabilities:
            pytest.skip("not a classical backend")
        return self.make(load_scene(source), nworld=2)

    def test_energy_of_a_pendulum_is_conserved(self) -> None:
        engine = self.classical(scenes.PENDULUM)
        state = engine.reset()
        state = state.replace(qpos=_like(np.array([[1.0], [2.0]]), state.qpos))
        trajectory = engine.rollout(state, np.zeros((200, 0)))
        qpos = np.asarray(_host(trajectory.with_initial("qpos")), np.float64)
        qvel = np.asarray(_host(trajectory.with_initial("qvel")), np.float64)
        total = energies(engine.model, qpos, qvel).total
        swing = 1.0 * 9.81 * 0.25  # weight times distance of the centre of mass
        assert np.abs(total - total[:, :1]).max() < self.law_tolerance * swing

    def test_momentum_of_a_free_body_is_conserved(self) -> None:
        engine = self.classical(scenes.FREE_BODY)
        state = engine.reset()
        qvel = np.tile([1.0, -2.0, 0.5, 0.3, 2.0, -1.0], (2, 1))
        after = engine.step(state.replace(qvel=_like(qvel, state.qvel)), None, 200).numpy()
        np.testing.assert_allclose(after.qvel[:, :3], qvel[:, :3], rtol=self.law_tolerance)
        before = _angular_momentum(engine.model, state.numpy().qpos[0], qvel[0])
        now = _angular_momentum(engine.model, after.qpos[0], after.qvel[0])
        # the integrator conserves it to first order in the timestep
        np.testing.assert_allclose(now, before, atol=0.02 * float(np.linalg.norm(before)))

    def test_a_box_rests_on_the_floor(self) -> None:
        engine = self.classical(scenes.RESTING_BOX)
        if "qfrc_constraint" in engine.reportable:
            engine.report = frozenset({"qfrc_constraint"})
        after = engine.step(engine.reset(), None, 300).numpy()
        np.testing.assert_allclose(after.qpos[:, :3], [[0, 0, 0.1]] * 2, atol=2e-3)
        np.testing.assert_allclose(after.qvel, 0.0, atol=1e-3)
        if "qfrc_constraint" in after.memory:
            force = after.memory["qfrc_constraint"][:, 2]
            np.testing.assert_allclose(force, 9.81, rtol=2e-2)

    @pytest.mark.parametrize("attributes", DIVERGING)
    def test_diverges_where_mujoco_does(self, attributes: str) -> None:
        """A gain of 1e30, a negative damping: no finite numbers that mean nothing."""
        engine = self.classical(scenes.diverging(attributes))
        reference = make_backend("mujoco", engine.scene, nworld=2)
        control = np.array([[0.5], [0.5]])
        for backend in (reference, engine):
            with pytest.raises(DivergedError):
                backend.step(backend.reset(), control, 20)
            trajectory = backend.rollout(backend.reset(), np.tile(control[:, None], (1, 20, 1)))
            assert (np.asarray(trajectory.diverged_at) >= 0).all()

    def test_runge_kutta_is_linearized(self) -> None:
        """MuJoCo's own finite differences refuse it."""
        engine = self.classical(scenes.RUNGE_KUTTA)
        reference = make_backend("mujoco", engine.scene, nworld=2)
        state, control = self.moved(reference, 2), np.array([0.3])
        found = engine.linearize(state, control)
        ahead, behind = (
            reference.step(state, control + sign * 1e-4).qvel[:, 0] for sign in (1, -1)
        )
        slope = (ahead - behind) / 2e-4
        nv = engine.model.nv
        np.testing.assert_allclose(np.asarray(found.B)[:, nv, 0], slope, rtol=1e-2)

    def test_agrees_with_mujoco_without_contact(self) -> None:
        engine = self.classical(scenes.CARTPOLE)
        reference = make_backend("mujoco", engine.scene, nworld=2)
        controls = self.controls(engine, 2, 100)
        start = self.moved(reference, 2)
        ours = _host(engine.rollout(start, controls).qpos)
        theirs = reference.rollout(start, controls).qpos
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=self.agreement)


def _angular_momentum(model: mujoco.MjModel, qpos: Any, qvel: Any) -> Any:
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = qpos, qvel
    mujoco.mj_forward(model, data)
    mujoco.mj_subtreeVel(model, data)
    return data.subtree_angmom[1].copy()


def _host(array: Any) -> Any:
    return array.detach().cpu().numpy() if hasattr(array, "detach") else array


def _like(values: np.ndarray, reference: Any) -> Any:
    """The values as the same kind of array as `reference`."""
    if isinstance(reference, np.ndarray):
        return values.astype(np.float64)
    import torch

    return torch.as_tensor(values, dtype=reference.dtype, device=reference.device)
