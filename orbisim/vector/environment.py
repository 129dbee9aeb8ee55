"""`VectorEnvironment`: one dm_control environment in many worlds."""

from __future__ import annotations

import collections
import concurrent.futures
import copy
import threading
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from dm_control.mujoco import engine
from dm_control.rl import control
from dm_control.suite import base
from dm_env import specs

from orbisim.arguments import real_array, whole_number
from orbisim.backend import Backend
from orbisim.errors import InputError, UnsupportedSceneError
from orbisim.host.cpus import usable_cpus
from orbisim.state import Array, State
from orbisim.vector.evaluation import Batched, Evaluator, Values, WorldByWorld, disagreement
from orbisim.vector.mirrored import Mirrored
from orbisim.vector.models import ModelFields
from orbisim.vector.randomization import Randomization
from orbisim.vector.simulator import Threads
from orbisim.vector.tasks import Tasks

Ids = npt.NDArray[np.int64]

_CHECKED_STEPS = 3
"""Random steps after which both ways of evaluation are compared."""

_SIMULATES = 10
"""Timesteps at the beginning of an episode that are worth a thread."""

FLAT = "observations"
"""dm_control's name of the one array of `flat_observation=True`."""


class Step(NamedTuple):
    """What a step returns.

    Attributes:
      observation: by name, each [nworld, ...].
      reward: [nworld].
      terminated: [nworld] whether the task has ended the episode with discount 0.
      truncated: [nworld] whether the episode was ended otherwise: by its time limit, by the task
        with another discount, or because the world diverged.
    """

    observation: dict[str, Array]
    reward: Array
    terminated: Array
    truncated: Array


class VectorEnvironment:
    """Many worlds of one dm_control task, each as dm_control's own `Environment`.

    Autoreset is that of dm_env (gymnasium's `AutoresetMode.NEXT_STEP`): the step after the last one
    of an episode ignores the action, resets the world and returns the first observation with
    reward 0.

    A world that diverges is put back by the next step, too: its last step is truncated, with reward
    0 and the observation before it, and counted in `diverged`; the other worlds go on.

    Use `orbisim.vector.load` or `orbisim.vector.from_environment` to make one.

    Args:
      environments: dm_control's environments, one; or one for each world if they differ in more
        than their random numbers.
      tasks: a task for each world.
      name: used in messages.
      backend: what steps, with the scene loaded; None for C MuJoCo in threads.
      randomization: draws what differs in the models of the worlds, with each episode.
      nthread: number of threads; 0 for one per usable core.
      arrays: `numpy` or `torch` (tensors that share the arrays' memory).
      check: whether to compare both ways of evaluation first; it draws random numbers.

    Attributes:
      nworld: number of worlds.
      arrays: `numpy` or `torch`.
      diverged: [nworld] how often each world has diverged.
      evaluation: `batched` if the task's functions run once for all worlds, otherwise `world by
        world`; `on the device` if they run where the backend steps. `reason` says why not there.
    """

    def __init__(
        self,
        environments: Sequence[control.Environment],
        tasks: Sequence[Any],
        *,
        name: str,
        backend: Backend | None = None,
        randomization: Randomization | None = None,
        nthread: int = 0,
        arrays: Literal["numpy", "torch"] = "numpy",
        check: bool = False,
    ) -> None:
        first = environments[0]
        self.name, self.nworld = name, len(tasks)
        self.arrays = _known_arrays(arrays)
        self._steps, self._limit = first._n_sub_steps, first._step_limit
        self._flat = first._flat_observation
        self._pristine: engine.Physics = first.physics
        self._physics: engine.Physics = first.physics.copy()
        self._tasks, self._randomization = Tasks(tasks), randomization
        self._nthread = nthread or usable_cpus()
        self._starters: list[tuple[engine.Physics, ModelFields]] = []
        self._action_spec = first.action_spec()
        model = self._pristine.model.ptr
        self._fields = ModelFields(model, self._physics.model.ptr, self.nworld)
        legacy = self._physics.legacy_step = bool(first.physics.legacy_step)
        self._simulator = (
            Threads(model, self._fields, self.nworld, legacy_step=legacy, nthread=nthread)
            if backend is None
            else Mirrored(backend, model, self._fields, self.nworld, exact=check)
        )
        self._take_models(environments)
        self._exact = WorldByWorld(self._physics, self._simulator, self._fields, self._tasks)
        self._acts_before, self._acts_after = _hooks(type(tasks[0]), type(first.physics))
        self._count = np.zeros(self.nworld, int)
        self._over = np.ones(self.nworld, bool)
        self.diverged: npt.NDArray[np.int64] = np.zeros(self.nworld, int)
        self._last: dict[str, npt.NDArray[Any]] | None = None
        self._spec = self._first_spec()
        self._evaluator, self.reason = self._evaluated(check)

    # -- what it is ------------------------------------------------------------------------------

    @property
    def evaluation(self) -> str:
        """`batched` or `world by world`."""
        return "batched" if isinstance(self._evaluator, Batched) else "world by world"

    @property
    def state(self) -> State:
        """The state of all worlds."""
        return self._simulator.state

    def action_spec(self) -> specs.BoundedArray:
        """Of one world's action [nu]."""
        return self._action_spec

    def observation_spec(self) -> dict[str, specs.Array]:
        """Of one world's observation, by name."""
        return {n: specs.Array(s, d, name=n) for n, (s, d) in self._spec.items()}

    def control_timestep(self) -> float:
        """Duration of a step, s."""
        return float(self._pristine.timestep() * self._steps)

    # -- what it does ----------------------------------------------------------------------------

    def reset(self, seed: int | Sequence[int | None] | None = None) -> dict[str, Array]:
        """Starts an episode in every world.

        Args:
          seed: world i goes on with the random numbers of `seed + i`, or of the i-th of a
            sequence; None: with its own.

        Returns:
          The first observation by name, each [nworld, ...].

        Raises:
          InputError: the seeds are none, or not one for each world.
        """
        for world, one in enumerate(_seeds(seed, self.nworld)):
            if one is not None:
                self._tasks.seed(world, one)
                if self._randomization is not None:
                    self._randomization.seed(world, one)
        observation = self._blank()
        self._begin(np.arange(self.nworld), observation)
        self._last = observation
        return {name: self._out(rows) for name, rows in observation.items()}

    def step(self, action: Array) -> Step:
        """One control step in every world; in those whose episode is over, a reset.

        Args:
          action: [nworld, nu].

        Raises:
          InputError: the action has another shape.
        """
        action = self._checked(action)
        if self._last is None:
            self.reset()
            over = np.arange(self.nworld)
            alive = over[:0]
            observation = self._blank() | (self._last or {})
        else:
            over, alive = np.flatnonzero(self._over), np.flatnonzero(~self._over)
            observation = self._blank()
            self._begin(over, observation)
        reward, discount = np.zeros(self.nworld), np.full(self.nworld, np.nan)
        lost = self._advance(alive, action, observation, reward, discount)
        return self._finish(alive, lost, observation, reward, discount)

    def restart(self, worlds: npt.ArrayLike) -> dict[str, Array]:
        """Starts an episode in some worlds at once, instead of with the next step.

        Args:
          worlds: their numbers [n], or which they are [nworld] (booleans).

        Returns:
          All observations by name, each [nworld, ...]: those worlds' first ones, and the others'
          last ones.

        Raises:
          InputError: there are no such worlds, or none was ever reset.
        """
        ids = world_numbers(worlds, self.nworld)
        if self._last is None:
            raise InputError("restart of some worlds comes after a reset of all")
        observation = {name: rows.copy() for name, rows in self._last.items()}
        self._begin(ids, observation)
        self._last = observation
        return {name: self._out(rows) for name, rows in observation.items()}

    def close(self) -> None:
        """Frees the worlds."""
        self._simulator.close()

    def evaluate_as(self, other: VectorEnvironment) -> None:
        """Evaluates in the way that another one of the same task has been found to need."""
        if not isinstance(other._evaluator, Batched):
            self._evaluator, self.reason = self._exact, other.reason

    # -- inner workings --------------------------------------------------------------------------

    def _begin(self, worlds: Ids, observation: dict[str, npt.NDArray[Any]]) -> None:
        """Starts an episode in some worlds, each with its own task on a dm_control physics."""
        alike = self._randomization is None and not self._fields.varied
        if self._simulates and alike and len(worlds) > self._nthread > 1:
            self._begin_side_by_side(worlds, observation)
            return
        physics = self._physics
        for world in worlds:
            task = self._tasks.each[world]
            self._fields.place(world)
            if self._randomization is not None:
                self._randomization.apply(world, physics.model.ptr)
            with physics.reset_context():
                task.initialize_episode(physics)
            first = self._flattened(task.get_observation(physics))
            self._tasks.note(world)
            self._fields.take(world)
            self._simulator.set_world(world, physics.data.ptr)
            for name, value in first.items():
                observation[name][world] = value
        self._have_begun(worlds)

    def _have_begun(self, worlds: Ids) -> None:
        if self._fields.varied and len(worlds):
            self._simulator.set_models(worlds)
        self._count[worlds] = 0
        self._over[worlds] = False

    def _begin_side_by_side(self, worlds: Ids, observation: dict[str, npt.NDArray[Any]]) -> None:
        """The same in threads, for tasks that simulate when an episode begins: MuJoCo runs in all
        of them at once."""
        while len(self._starters) < self._nthread:
            physics = self._pristine.copy()
            physics.legacy_step = self._physics.legacy_step
            fields = ModelFields(self._pristine.model.ptr, physics.model.ptr, 1)
            self._starters.append((physics, fields))
        changing = threading.Lock()

        def begin(starter: tuple[engine.Physics, ModelFields], mine: Ids) -> None:
            physics, fields = starter
            for world in mine:
                task = self._tasks.each[world]
                with physics.reset_context():
                    task.initialize_episode(physics)
                first = self._flattened(task.get_observation(physics))
                self._simulator.set_world(world, physics.data.ptr)
                for name, value in first.items():
                    observation[name][world] = value
                if fields.changed():
                    with changing:
                        self._fields.copy_from(physics.model.ptr, int(world))
                    fields.forget()

        shares = np.array_split(worlds, self._nthread)
        with concurrent.futures.ThreadPoolExecutor(self._nthread) as pool:
            list(pool.map(begin, self._starters, shares))
        for world in worlds:
            self._tasks.note(world)
        self._have_begun(worlds)

    def _advance(
        self,
        alive: Ids,
        action: npt.NDArray[np.float64],
        observation: dict[str, npt.NDArray[Any]],
        reward: npt.NDArray[np.float64],
        discount: npt.NDArray[np.float64],
    ) -> Ids:
        """Steps the worlds that are in an episode; returns those that diverged."""
        if not len(alive):
            return alive
        self._act(alive, action)
        failed = self._simulator.step(alive, self._steps)
        well = alive[~failed]
        if len(well):
            values = self._values(well)
            for name, rows in self._flattened_rows(values.observation).items():
                observation[name][well] = rows
            reward[well], discount[well] = values.reward, values.discount
        lost = np.union1d(alive[failed], well[~np.isfinite(reward[well])])
        for name, rows in observation.items():
            rows[lost] = (self._last or {})[name][lost]
        reward[lost] = 0.0
        return lost

    def _finish(
        self,
        alive: Ids,
        lost: Ids,
        observation: dict[str, npt.NDArray[Any]],
        reward: npt.NDArray[np.float64],
        discount: npt.NDArray[np.float64],
    ) -> Step:
        self._count[alive] += 1
        late = np.zeros(self.nworld, bool)
        late[alive] = self._count[alive] >= self._limit
        ended = ~np.isnan(discount) & ~late
        terminated = ended & (discount == 0.0)
        truncated = late | (ended & ~terminated)
        terminated[lost], truncated[lost] = False, True
        self.diverged[lost] += 1
        self._over |= terminated | truncated
        self._last = observation
        return Step(
            {name: self._out(rows) for name, rows in observation.items()},
            *(self._out(rows) for rows in (reward, terminated, truncated)),
        )

    def _act(self, alive: Ids, action: npt.NDArray[np.float64]) -> None:
        """dm_control's `before_step`."""
        if not self._acts_before:
            self._simulator.ctrl[alive] = action[alive]
            return
        for world in alive:
            physics = self._exact.at(world)
            self._tasks.each[world].before_step(action[world], physics)
            self._keep(world)

    def _values(self, worlds: Ids) -> Values:
        """dm_control's `after_step`, reward, observation and end of the episode."""
        if self._acts_after:
            for world in worlds:
                self._tasks.each[world].after_step(self._exact.at(world))
                self._keep(world)
        if len(worlds) == 1:  # the same bits, in a fifth of the time
            return self._exact.values(worlds)
        try:
            return self._evaluator.values(worlds)
        except Exception:  # in a branch that was not taken before; the task's own are raised here:
            return self._exact.values(worlds)

    def _keep(self, world: int) -> None:
        """Gives a world what its task has made of the physics."""
        self._simulator.set_world(world, self._physics.data.ptr)
        self._tasks.note(world)
        self._fields.take(world)
        if self._fields.varied:
            self._simulator.set_models(np.array([world]))

    def _checked(self, action: Array) -> npt.NDArray[np.float64]:
        shape = (self.nworld, *self._action_spec.shape)
        action = real_array("action", action, str(shape))
        self._check_shape(tuple(action.shape), shape)
        host = action.detach().cpu().numpy() if hasattr(action, "detach") else action
        return np.asarray(host, np.float64)

    def _check_shape(self, given: tuple[int, ...], shape: tuple[int, ...]) -> None:
        if given != shape:
            raise InputError(
                f"action has shape {given}; {self.name} in {self.nworld} worlds needs {shape}"
            )

    def _flattened(self, observation: Mapping[str, Any]) -> Mapping[str, Any]:
        return control.flatten_observation(observation) if self._flat else observation

    def _flattened_rows(
        self, observation: Mapping[str, npt.NDArray[Any]]
    ) -> Mapping[str, npt.NDArray[Any]]:
        if not self._flat:
            return observation
        rows = [np.reshape(observation[n], (len(observation[n]), -1)) for n in self._order]
        return {FLAT: np.concatenate(rows, axis=1)}

    def _blank(self) -> dict[str, npt.NDArray[Any]]:
        return {n: np.zeros((self.nworld, *s), d) for n, (s, d) in self._spec.items()}

    def _out(self, rows: npt.NDArray[Any]) -> Array:
        if self.arrays == "numpy":
            return rows
        import torch

        return torch.from_numpy(rows)

    def _take_models(self, environments: Sequence[control.Environment]) -> None:
        """What environments that were made one by one have in different models."""
        if len(environments) == 1:
            return
        for world, environment in enumerate(environments):
            self._fields.copy_from(environment.physics.model.ptr, world)
        if self._fields.varied:
            self._simulator.set_models(np.arange(self.nworld))

    def _first_spec(self) -> dict[str, tuple[tuple[int, ...], Any]]:
        """Shapes and types of the observations, from a first one of a copy of the first world."""
        physics, task = self._physics, copy.deepcopy(self._tasks.each[0])
        simulated: list[int] = []

        def step(nstep: int = 1) -> None:
            simulated.append(nstep)
            type(physics).step(physics, nstep)

        physics.step = step
        with physics.reset_context():
            task.initialize_episode(physics)
        del physics.step
        self._simulates = sum(simulated) >= _SIMULATES
        found = task.get_observation(physics)
        self._order = list(found) if isinstance(found, collections.OrderedDict) else sorted(found)
        self._fields.forget()
        arrays = {n: np.asarray(v) for n, v in self._flattened(found).items()}
        return {n: (a.shape, a.dtype) for n, a in arrays.items()}

    def _evaluated(self, check: bool) -> tuple[Evaluator, str]:
        """The evaluator that can be used, and the reason if it is the slow one."""
        if check and isinstance(self._simulator, Mirrored):
            self._check_reported(self._simulator.backend.name)
        if self._acts_before or self._acts_after:
            return self._exact, "the task acts on the physics before or after a step"
        batched = Batched(self._pristine, self._simulator, self._fields, self._tasks)
        reason = self._disagreement(batched) if check else ""
        return (self._exact, reason) if reason else (batched, "")

    def _check_reported(self, backend: str) -> None:
        """Raises `UnsupportedSceneError` if the task reads what a backend does not report."""
        self.reset()
        worlds = np.arange(self.nworld)
        well = worlds[~self._simulator.step(worlds, self._steps)]
        if not len(well):
            return
        values = self._exact.values(well)
        for name, rows in {**values.observation, "reward": values.reward}.items():
            if rows.dtype.kind == "f" and np.isnan(rows).any():
                raise UnsupportedSceneError(
                    self.name,
                    f"{name!r} reads what backend {backend!r} does not report (accelerations, "
                    "contact forces, or sensors of them)",
                    remedy="use 'mujoco'",
                )

    def _disagreement(self, batched: Batched) -> str:
        """Why the batched evaluation cannot be used; empty if it gives dm_control's own bits."""
        random, worlds = np.random.RandomState(0), np.arange(self.nworld)
        low, high = finite_bounds(self._action_spec)
        self.reset()
        for _ in range(_CHECKED_STEPS):
            self._simulator.ctrl[worlds] = random.uniform(low, high, (len(worlds), len(low)))
            worlds = worlds[~self._simulator.step(worlds, self._steps)]
            try:
                reason = disagreement(batched, self._exact, worlds)
            except Exception as error:  # of a task's code, over arrays that it was not written for
                reason = f"{type(error).__name__}: {error}"
            if reason:
                return reason
        return ""


def _hooks(task: Any, physics: Any) -> tuple[bool, bool]:
    """Whether a task does more before and after a step than to set controls."""
    plain = physics.set_control is engine.Physics.set_control
    before = task.before_step is not base.Task.before_step or not plain
    return before, task.after_step not in (base.Task.after_step, control.Task.after_step)


def _seeds(seed: int | Sequence[int | None] | None, nworld: int) -> Sequence[int | None]:
    """A seed for each world."""
    if seed is None:
        return [None] * nworld
    if isinstance(seed, Sequence) and not isinstance(seed, str):
        if len(seed) != nworld:
            raise InputError(f"{len(seed)} seeds for {nworld} worlds")
        return [None if one is None else whole_number("seed", one, 0) for one in seed]
    first = whole_number("seed", seed, 0)
    return range(first, first + nworld)


def world_numbers(worlds: npt.ArrayLike, nworld: int) -> Ids:
    """The numbers of worlds that are given by their numbers [n] or as booleans [nworld].

    Raises:
      InputError: there are no such worlds.
    """
    given = np.asarray(worlds)
    if given.dtype == bool and given.shape == (nworld,):
        return np.flatnonzero(given)
    if given.dtype.kind not in "iu" or given.ndim != 1 or not np.isin(given, range(nworld)).all():
        raise InputError(f"worlds are numbers from 0 to {nworld - 1}; got {worlds!r}")
    return np.unique(given)


def finite_bounds(spec: specs.BoundedArray) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Between which numbers [nu] random actions are drawn."""
    low = np.broadcast_to(np.where(np.isfinite(spec.minimum), spec.minimum, -1.0), spec.shape)
    high = np.broadcast_to(np.where(np.isfinite(spec.maximum), spec.maximum, 1.0), spec.shape)
    return low, high


def _known_arrays(arrays: str) -> str:
    if arrays not in ("numpy", "torch"):
        raise InputError(f"arrays is 'numpy' or 'torch'; got {arrays!r}")
    return arrays
