"""`Backend`: what advances a state."""

from __future__ import annotations

import abc
import dataclasses
import enum
import functools
import threading
from collections.abc import Callable, Iterable, Mapping
from typing import Any, ClassVar, Protocol, TypeVar

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.arguments import (
    check_finite,
    check_state,
    positive_number,
    real_array,
    whole_number,
)
from orbisim.errors import DivergedError, InputError, UnsupportedSceneError
from orbisim.scene import Scene
from orbisim.state import Array, State
from orbisim.tangent import perturbed, tangent_difference
from orbisim.trajectory import Trajectory

F = TypeVar("F", bound=Callable[..., Any])


class Capability(enum.Enum):
    """What a backend can do beyond stepping."""

    DIFFERENTIABLE = "differentiable"
    """Steps and rollouts of torch tensors carry gradients."""
    DEVICE_BATCH = "device_batch"
    """Many worlds are stepped at once on an accelerator."""
    CONTACT_FORCES = "contact_forces"
    """The acceleration stage (accelerations, contact forces, force sensors) is reported."""
    DETERMINISTIC = "deterministic"
    """The same state and control give the same bits, whatever other worlds do."""
    CLASSICAL = "classical"
    """Integrates the equations of motion of the scene (as opposed to learned)."""


@dataclasses.dataclass(frozen=True)
class Linearization:
    """Derivatives of one step in the tangent space of the state.

    The tangent vector is (dq [nv], v [nv], act [na]), as in `mujoco.mjd_transitionFD`.

    Attributes:
      A: [nworld, 2 nv + na, 2 nv + na], next state by state.
      B: [nworld, 2 nv + na, nu], next state by control.
    """

    A: Array
    B: Array


@dataclasses.dataclass(frozen=True)
class Intervals:
    """How far off a backend says that its own rollout may be: half-widths of intervals.

    Attributes:
      frames: of each of K frames its kind, `body` or `site`, and its name.
      level: share of the intervals that are to hold the truth.
      position: [nworld, T, K], m. rotation: [nworld, T, K], rad, of geodesic distances on SO(3).
    """

    frames: tuple[tuple[str, str], ...]
    level: float
    position: npt.NDArray[np.float64]
    rotation: npt.NDArray[np.float64]


class InPlace(Protocol):
    """Worlds that stay on a device, with the fields of MjData as torch tensors that are not copied.

    Attributes:
      device: where they are.
      generation: grows whenever fields move to other memory.
      names: of the fields.
    """

    device: Any
    generation: int
    names: frozenset[str]

    def field(self, name: str) -> Array:
        """A field's own memory [nworld, ...], in MjData's shape; `ctrl` is there to be written."""

    @property
    def lost(self) -> Array:
        """[nworld] booleans: whether the last step has lost a world."""

    @property
    def overflowed(self) -> Array:
        """[] a boolean: whether the last step has to be taken back by `repair`, and repeated."""

    def write(self, worlds: Array, rows: Mapping[str, Array]) -> None:
        """Gives the worlds of these numbers [n] a state, by name [n, ...]; `refresh` is due."""

    def refresh(self) -> None:
        """The position and velocity stages of the state that there is."""

    def step(self, nstep: int) -> None:
        """Advances all worlds by `nstep` steps under `ctrl`.

        Positions and velocities then have gone through MuJoCo's stages of them, and what depends on
        accelerations is that of the last step.
        """

    def take_back(self) -> None:
        """Goes back to the state before the last step."""

    def repair(self) -> None:
        """Makes room, and goes back to the state before the last step.

        Raises:
          CapacityError: there is no more room.
        """

    def close(self) -> None:
        """Frees the memory."""


def one_at_a_time(method: F) -> F:
    """Lets threads that call methods of one backend take turns."""

    @functools.wraps(method)
    def in_turn(self: Backend, *args: Any, **kwargs: Any) -> Any:
        with self._turn:
            return method(self, *args, **kwargs)

    return in_turn  # type: ignore[return-value]


_IN_TURN = ("load", "reset", "step", "rollout", "linearize", "close")
"""Methods that may use what a backend keeps for speed: buffers, graphs, a batch of MjData."""


class Backend(abc.ABC):
    """Advances states of one scene; holds no state of its own between calls.

    One object may be used from several threads: its methods take turns, those of subclasses, too
    (a method that is not of this class needs `one_at_a_time`). Threads that are to run at the same
    time need a backend each.

    Subclasses implement `load`, `reset` and `step`; `rollout` and `linearize` have defaults that a
    subclass may replace by something faster. See backends/README.md for a complete example and
    `orbisim.testing.BackendConformance` for the tests that every backend must pass.

    Args:
      nworld: how many worlds to prepare for (a state with another number works too).
      device: where to compute, by torch's names (`cpu`, `cuda`, `cuda:1`); None for the default.

    Attributes:
      name: the name under which the backend is registered.
      capabilities: what it can do.
      reportable: names of MjData's derived fields (accelerations, forces, `sensordata`) that it
        can put into `State.memory`; it does not know the others.
      derivable: names of those (poses, velocities of bodies, sensors of both) that `derive` gives.
      perturbation: of states and controls in `linearize`. Central differences are most exact near
        the cube root of the rounding error: 1e-6 for float64, some 1e-3 for float32.
    """

    name: ClassVar[str] = ""
    capabilities: frozenset[Capability] = frozenset()
    reportable: frozenset[str] = frozenset()
    derivable: frozenset[str] = frozenset()
    perturbation: float = 1e-6

    def __init__(self, *, nworld: int = 1, device: str | None = None) -> None:
        self.nworld = whole_number("nworld", nworld, 1)
        self.device = device
        self._report: frozenset[str] = frozenset()
        self._turn = threading.RLock()

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        for name in vars(cls).keys() & set(_IN_TURN):
            setattr(cls, name, one_at_a_time(vars(cls)[name]))

    @property
    def report(self) -> frozenset[str]:
        """Derived fields that `step` puts into `State.memory`; none unless asked for.

        As after `mj_step`, they belong to the state where the last substep began.
        """
        return self._report

    @report.setter
    def report(self, names: Iterable[str]) -> None:
        if isinstance(names, str) or not isinstance(names, Iterable):
            raise InputError(f"report is a set of names; got {names!r}")
        unknown = sorted(map(str, set(names) - self.reportable))
        if unknown:
            raise InputError(
                f"backend {self.name!r} does not report {', '.join(unknown)}; it can report "
                f"{', '.join(sorted(self.reportable)) or 'nothing'}"
            )
        self._report = frozenset(names)

    def derive(self, state: State, names: Iterable[str]) -> dict[str, Any]:
        """Fields that follow from the positions and velocities of a state, by MuJoCo's stages.

        Args:
          names: of `derivable`. Of `sensordata` only sensors of positions and velocities count.

        Returns:
          By name, [nworld, ...] as in MjData.
        """
        raise InputError(f"backend {self.name!r} derives nothing; got {sorted(names)}")

    def in_place(self, nworld: int) -> InPlace | None:
        """Worlds of the loaded scene that stay on the device between steps.

        They are independent of what the backend is used for otherwise.

        Args:
          nworld: number of worlds.

        Returns:
          None from a backend (or for a scene) that has no such worlds.
        """
        return None

    @property
    def scene(self) -> Scene:
        """The scene that was loaded.

        Raises:
          InputError: none was.
        """
        scene: Scene | None = getattr(self, "_scene", None)
        if scene is None:
            raise InputError(f"backend {self.name!r} has no scene; call load(scene) first")
        return scene

    @property
    def model(self) -> mujoco.MjModel:
        """The loaded scene's model; read-only."""
        return self.scene.model

    @property
    def timestep(self) -> float:
        """Duration of one step, s."""
        return float(self.model.opt.timestep)

    @abc.abstractmethod
    def load(self, scene: Scene) -> None:
        """Prepares to simulate `scene`.

        Raises:
          InputError: it is no scene.
          UnsupportedSceneError: the scene has something that this backend cannot simulate.
        """

    @abc.abstractmethod
    def reset(self, nworld: int | None = None, seed: int | None = None) -> State:
        """The scene's initial state in `nworld` worlds.

        Args:
          nworld: number of worlds; the number given at construction if None.
          seed: for backends with randomness of their own; deterministic backends ignore it.
        """

    @abc.abstractmethod
    def step(self, state: State, control: Array | None = None, nstep: int = 1) -> State:
        """Advances every world by `nstep` steps under a constant control.

        Args:
          state: as returned by any backend; memory that this backend lacks starts afresh.
          control: [nu] or [nworld, nu]; None for zeros.

        Raises:
          DivergedError: a world became non-finite; the error names the worlds.
          InputError: shapes do not fit the scene.
        """

    def rollout(
        self,
        state: State,
        controls: Array,
        *,
        nstep: int = 1,
        sensors: bool = True,
        raise_on_divergence: bool = False,
    ) -> Trajectory:
        """Applies a sequence of controls open-loop.

        Args:
          state: initial state.
          controls: [T, nu] or [nworld, T, nu].
          nstep: steps for which each control is held.
          sensors: whether to record sensor data, where the backend reports it.
          raise_on_divergence: raise instead of returning NaN from where a world diverged.

        Raises:
          DivergedError: see `raise_on_divergence`.
          InputError: shapes do not fit the scene.
        """
        controls, nstep = self.check_rollout(state, controls, nstep)
        diverged_at = np.full(state.nworld, -1)
        records: list[State] = []
        current = state
        for t in range(controls.shape[1]):
            current, diverged_at = self._step_recording(
                current, controls[:, t], nstep, t, diverged_at
            )
            records.append(current)
        if raise_on_divergence:
            self.raise_diverged(diverged_at)
        return self._trajectory(state, controls, records, diverged_at, sensors)

    def _step_recording(
        self, state: State, control: Array, nstep: int, t: int, diverged_at: npt.NDArray[np.int64]
    ) -> tuple[State, npt.NDArray[np.int64]]:
        """One step of the worlds still alive; the others become NaN."""
        alive = np.flatnonzero(diverged_at < 0)
        while alive.size:
            try:
                part = self.step(state[alive], control[alive], nstep)
                break
            except DivergedError as error:
                if not error.worlds:
                    raise
                diverged_at = diverged_at.copy()
                diverged_at[alive[list(error.worlds)]] = t
                alive = np.flatnonzero(diverged_at < 0)
        if alive.size == state.nworld:
            return part, diverged_at
        blank = State(
            time=state.time + nstep * self.timestep,
            qpos=_nan_like(state.qpos),
            qvel=_nan_like(state.qvel),
            act=_nan_like(state.act),
            memory=state.memory,
        )
        return (_scatter(blank, part, alive) if alive.size else blank), diverged_at

    def _trajectory(
        self,
        initial: State,
        controls: Array,
        records: list[State],
        diverged_at: npt.NDArray[np.int64],
        sensors: bool,
    ) -> Trajectory:
        stack = _stack_time(records) if records else _no_steps(initial)
        sensordata = None
        if sensors and records and "sensordata" in records[0].memory:
            sensordata = _stack([r.memory["sensordata"] for r in records])
        return Trajectory(
            initial=initial,
            control=controls,
            sensordata=sensordata,
            diverged_at=diverged_at,
            final=records[-1] if records else initial,
            **stack,
        )

    def intervals(self, trajectory: Trajectory) -> Intervals | None:
        """How far off a rollout of this backend may be, by its own estimate.

        Args:
          trajectory: what `rollout` gave.

        Returns:
          None from a backend that says nothing of its errors.
        """
        return None

    def linearize(
        self, state: State, control: Array | None = None, *, eps: float | None = None
    ) -> Linearization:
        """Derivatives of one step by central differences in the tangent space.

        Args:
          state: where to linearize. control: [nu] or [nworld, nu]; None for zeros.
          eps: size of the perturbation; `self.perturbation` if None.

        Raises:
          DivergedError: a step from this state, or from one beside it, diverged.
          InputError: shapes do not fit the scene.
        """
        control, eps = self.check_linearize(state, control, eps)
        model, nworld = self.model, state.nworld
        ndx, nu = 2 * model.nv + model.na, int(control.shape[1])
        dx = np.concatenate([np.eye(ndx), np.zeros((nu, ndx))]) * eps
        du = np.concatenate([np.zeros((ndx, nu)), np.eye(nu)]) * eps
        count = len(dx)
        tiled, held = state.numpy().tile(count), np.repeat(control, count, axis=0)
        all_dx, all_du = np.tile(dx, (nworld, 1)), np.tile(du, (nworld, 1))
        after = [
            self.step(perturbed(model, tiled, sign * all_dx), held + sign * all_du).numpy()
            for sign in (1.0, -1.0)
        ]
        slopes = tangent_difference(model, after[1], after[0]) / (2 * eps)
        jacobian = slopes.reshape(nworld, count, ndx).transpose(0, 2, 1)
        return Linearization(A=jacobian[:, :, :ndx], B=jacobian[:, :, ndx:])

    def check_scene(self, scene: Scene) -> None:
        """Raises `InputError` if what `load` is given is no scene, or one without a timestep."""
        if not isinstance(scene, Scene):
            raise InputError(
                f"backend {self.name!r} loads a Scene; got {type(scene).__name__} "
                "(load_scene makes one of a file, a text or an MjModel)"
            )
        if not scene.model.opt.timestep > 0:
            raise UnsupportedSceneError(
                scene.source,
                f"timestep is {scene.model.opt.timestep:g}",
                element="<option>",
                remedy="time needs steps above 0 s",
            )

    def check_reset(self, nworld: int | None, seed: int | None = None) -> int:
        """The number of worlds that `reset` is asked for.

        Raises:
          InputError: it is no number of worlds, or the seed is none.
        """
        if seed is not None:
            whole_number("seed", seed, 0)
        return self.nworld if nworld is None else whole_number("nworld", nworld, 1)

    def check_step(self, state: State, control: Array | None, nstep: int) -> tuple[Array, int]:
        """The arguments of `step`: the control as [nworld, nu], and the number of steps.

        Raises:
          InputError: one of them is not of this scene; the message says what would be.
        """
        self.check_state(state)
        return self.check_control(state, control), whole_number("nstep", nstep, 1)

    def check_rollout(self, state: State, controls: Array, nstep: int) -> tuple[Array, int]:
        """The arguments of `rollout`: controls as [nworld, T, nu], and steps for each.

        Raises:
          InputError: one of them is not of this scene; the message says what would be.
        """
        self.check_state(state)
        return self.check_controls(state, controls), whole_number("nstep", nstep, 1)

    def check_linearize(
        self, state: State, control: Array | None, eps: float | None
    ) -> tuple[Array, float]:
        """The arguments of `linearize`: the control as [nworld, nu], and the perturbation.

        Raises:
          InputError: one of them is not of this scene; the message says what would be.
        """
        self.check_state(state)
        size = self.perturbation if eps is None else positive_number("eps", eps)
        return self.check_control(state, control), size

    def check_control(self, state: State, control: Array | None) -> Array:
        """The control as [nworld, nu].

        Raises:
          InputError: it has another shape, or is not made of finite real numbers.
        """
        nu, nworld = self.model.nu, state.nworld
        if control is None:
            return np.zeros((nworld, nu))
        expected = f"({nu},) or ({nworld}, {nu})"
        control = real_array("control", control, expected)
        if tuple(control.shape) not in ((nu,), (nworld, nu)):
            raise InputError(
                f"control has shape {tuple(control.shape)}; scene {self.scene.name!r} needs "
                f"{expected}"
            )
        check_finite("control", control)
        return control if control.ndim == 2 else _spread(control, (nworld, nu))

    def check_controls(self, state: State, controls: Array) -> Array:
        """The controls of a rollout as [nworld, T, nu].

        Raises:
          InputError: they have another shape, or are not made of finite real numbers.
        """
        nu, nworld = self.model.nu, state.nworld
        expected = f"(T, {nu}) or ({nworld}, T, {nu})"
        controls = real_array("controls", controls, expected)
        shape = tuple(controls.shape)
        if (
            shape[-1:] != (nu,)
            or len(shape) not in (2, 3)
            or (len(shape) == 3 and shape[0] not in (1, nworld))
        ):
            raise InputError(
                f"controls have shape {shape}; scene {self.scene.name!r} needs {expected}"
            )
        check_finite("controls", controls)
        return _spread(controls, (nworld, shape[-2], nu))

    def check_state(self, state: State) -> None:
        """Raises `InputError` if this is no state of this scene's sizes."""
        check_state(state, self.model, self.scene.name)

    def raise_diverged(self, diverged_at: npt.NDArray[np.int64]) -> None:
        """Raises `DivergedError` if any entry is not negative."""
        worlds = np.flatnonzero(diverged_at >= 0)
        if worlds.size:
            first = int(worlds[0])
            raise DivergedError(
                f"backend {self.name!r}: {worlds.size} of {len(diverged_at)} worlds diverged in "
                f"scene {self.scene.name!r}, world {first} at step {int(diverged_at[first])}; "
                "reduce the timestep or the controls",
                worlds.tolist(),
            )

    def close(self) -> None:  # noqa: B027 (optional)
        """Frees what the backend holds; it cannot be used afterwards."""


def _spread(array: Array, shape: tuple[int, ...]) -> Array:
    return array.expand(shape) if hasattr(array, "expand") else np.broadcast_to(array, shape)


def _nan_like(array: Array) -> Array:
    return array * np.nan


def _scatter(into: State, part: State, worlds: npt.NDArray[np.int64]) -> State:
    """`into` with some worlds taken from `part`; memory entries they share are kept."""

    def merge(full: Any, piece: Any) -> Any:
        merged = full.clone() if hasattr(full, "clone") else np.array(full)
        merged[worlds] = piece
        return merged

    shared = into.memory.keys() & part.memory.keys()
    return State(
        **{n: merge(getattr(into, n), getattr(part, n)) for n in ("time", "qpos", "qvel", "act")},
        memory={name: merge(into.memory[name], part.memory[name]) for name in shared},
    )


def _stack(arrays: list[Any]) -> Any:
    if isinstance(arrays[0], np.ndarray):
        return np.stack(arrays, axis=1)
    import torch

    return torch.stack(arrays, dim=1)


def _no_steps(initial: State) -> dict[str, Any]:
    return {n: getattr(initial, n)[:, None][:, :0] for n in ("time", "qpos", "qvel", "act")}


def _stack_time(records: list[State]) -> dict[str, Any]:
    return {
        name: _stack([getattr(r, name) for r in records])
        for name in ("time", "qpos", "qvel", "act")
    }
