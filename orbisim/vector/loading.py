"""Makes vector environments of dm_control's tasks."""

from __future__ import annotations

import copy
import secrets
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

from dm_control.mujoco import engine
from dm_control.rl import control

from orbisim import suite
from orbisim.arguments import whole_number
from orbisim.backend import Backend, InPlace
from orbisim.errors import InputError
from orbisim.registry import make_backend
from orbisim.scene import Scene
from orbisim.scene.texts import acts_between_timesteps
from orbisim.vector.environment import VectorEnvironment
from orbisim.vector.randomization import Draw, Randomization
from orbisim.vector.tasks import copies, untouched

_SEEDS = 2**31
"""Seeds that are drawn from: each fits an int32, as other libraries take them."""

_CHECKED_WORLDS = 6
"""Worlds that are evaluated in both ways at load."""


def load(
    domain: str,
    task: str,
    nworld: int,
    backend: str | Backend = "mujoco",
    device: str | None = None,
    *,
    seed: int | None = None,
    task_kwargs: Mapping[str, Any] | None = None,
    environment_kwargs: Mapping[str, Any] | None = None,
    randomize: Mapping[str, Draw] | None = None,
    nthread: int = 0,
    arrays: Literal["numpy", "torch"] = "numpy",
) -> VectorEnvironment:
    """Loads a task of dm_control's suite in many worlds.

    World `i` is what `dm_control.suite.load(domain, task, task_kwargs={"random": seed + i})` is.

    Args:
      domain: a domain of the suite (`cheetah`).
      task: one of its tasks (`run`).
      nworld: number of worlds.
      backend: what steps, by name (`mujoco`, `warp`, `learned`) or an object. Episodes begin in C
        MuJoCo whatever it is, and what tasks read goes through MuJoCo's position and velocity
        stages on the host (see `orbisim.Physics`).
      device: where the backend computes.
      seed: of the first world's random numbers; None for one that nobody knows.
      task_kwargs: passed to the task, except `random`.
      environment_kwargs: passed to the environment (`{"flat_observation": True}`).
      randomize: fields of the model that are drawn for each episode of each world, by name
        (`geom_friction`) or name and element (`body_mass/torso`): `factor(low, high)` of the
        declared numbers, `between(low, high)`, or a function of a `numpy.random.Generator` and the
        declared numbers. What MuJoCo derives from them follows (`mj_setConst`).
      nthread: number of threads; 0 for one per usable core.
      arrays: `numpy`, or `torch` for tensors that share the arrays' memory, with backend `warp` on
        its device (see docs/vector.md).

    Raises:
      InputError: the number of worlds, the seed, the backend or the device is none.
      UnknownNameError: no such domain, task or backend.
      UnsupportedSceneError: the backend cannot simulate the scene, does not report what the task
        reads, or simulates one model where the task changes it from world to world.
    """
    suite.check_name(domain, task)
    if "random" in (task_kwargs or {}):
        raise InputError("task_kwargs has 'random'; pass seed=... (world i draws from seed + i)")

    def make_environment(random: int) -> control.Environment:
        return suite.make_environment(
            domain,
            task,
            task_kwargs={**(task_kwargs or {}), "random": random},
            environment_kwargs=dict(environment_kwargs or {}),
        )

    return from_environment(
        make_environment,
        nworld,
        backend,
        device,
        seed=seed,
        name=f"{domain}-{task}",
        randomize=randomize,
        nthread=nthread,
        arrays=arrays,
    )


def from_environment(
    make_environment: Callable[[int], control.Environment],
    nworld: int,
    backend: str | Backend = "mujoco",
    device: str | None = None,
    *,
    seed: int | None = None,
    name: str = "task",
    randomize: Mapping[str, Draw] | None = None,
    one_by_one: bool = False,
    nthread: int = 0,
    arrays: Literal["numpy", "torch"] = "numpy",
) -> VectorEnvironment:
    """Runs an environment of your own in many worlds.

    Args:
      make_environment: makes a `dm_control.rl.control.Environment` whose task draws its random
        numbers from the seed that is given. It is called once if the task keeps a RandomState of
        this seed that it has not drawn from yet (world i then has a copy of the task and the
        numbers of `seed + i`), and once for each world otherwise.
      nworld: number of worlds.
      backend, device, seed, randomize, nthread, arrays: see `load`.
      name: used in messages.
      one_by_one: whether worlds differ in more than random numbers, so that each is made.

    Raises:
      InputError: no such environment can be run in many worlds; the message says why.
    """
    count, first = whole_number("nworld", nworld, 1), _first_seed(seed)
    environments = [make_environment(first)]
    _check_environment(environments[0])
    task = environments[0].task
    if untouched(task, first) and not one_by_one:
        tasks = copies(task, first, count)
    else:
        environments += [make_environment(first + world) for world in range(1, count)]
        for environment in environments:
            _check_environment(environment)
        tasks = [environment.task for environment in environments]
    physics = environments[0].physics
    return _made(
        environments,
        tasks,
        None if randomize is None else lambda n: Randomization(physics, randomize, n, first),
        name=name,
        backend=_stepper(backend, device, environments[0], count, name),
        nthread=nthread,
        arrays=arrays,
    )


def _stepper(
    backend: str | Backend, device: str | None, environment: Any, nworld: int, name: str
) -> Backend | None:
    """The backend with the environment's scene loaded; None for C MuJoCo in threads."""
    model = environment.physics.model.ptr
    native = backend == "mujoco" and not acts_between_timesteps(model)
    if native and device in (None, "cpu"):
        return None
    scene = Scene.from_model(model, source=name)
    if isinstance(backend, Backend):
        backend.load(scene)
        return backend
    return make_backend(backend, scene, nworld=nworld, device=device)


def _first_seed(seed: int | None) -> int:
    return secrets.randbelow(_SEEDS) if seed is None else whole_number("seed", seed, 0)


def _made(
    environments: Sequence[control.Environment],
    tasks: Sequence[Any],
    randomization: Callable[[int], Randomization] | None,
    **options: Any,
) -> VectorEnvironment:
    """A `VectorEnvironment` (see there) whose evaluation was tried on copies of its tasks."""
    few = copy.deepcopy(list(tasks[:_CHECKED_WORLDS]))
    draws = [None if randomization is None else randomization(n) for n in (len(few), len(tasks))]
    options_of_probe = {**options, "randomization": draws[0], "check": True}
    probe = VectorEnvironment(environments[: len(few)], few, **options_of_probe)
    backend: Backend | None = options["backend"]
    worlds = None
    if options["arrays"] == "torch" and backend is not None:
        worlds = backend.in_place(len(tasks))
    if worlds is None:
        made = VectorEnvironment(environments, tasks, **options, randomization=draws[1])
        made.evaluate_as(probe)
        probe.close()
        return made
    return _on_device(environments, tasks, worlds, probe, draws[1], options)


def _on_device(
    environments: Sequence[control.Environment],
    tasks: Sequence[Any],
    worlds: InPlace,
    probe: VectorEnvironment,
    randomization: Randomization | None,
    options: Mapping[str, Any],
) -> VectorEnvironment:
    """An environment whose worlds stay on the device, if the task allows it."""
    from orbisim.vector.on_device import DeviceVectorEnvironment

    made = DeviceVectorEnvironment(environments, tasks, **options, randomization=randomization)
    made.evaluate_as(probe)
    probe.close()
    reason = made.reason
    if not reason and randomization is not None:
        reason = "models that differ from world to world"
    if not reason:
        few = copy.deepcopy(list(tasks[:_CHECKED_WORLDS]))
        there = options["backend"].in_place(len(few))
        tried = DeviceVectorEnvironment(environments[: len(few)], few, **options)
        tried.evaluate_as(probe)
        tried.use(there)
        reason = tried.disagreement()
        tried.close()
    made.use(worlds, reason)
    return made


def _check_environment(environment: Any) -> None:
    """Raises `InputError` unless this is an environment that can be run in many worlds."""
    if type(environment) is not control.Environment:
        raise InputError(
            "many worlds are made of a dm_control.rl.control.Environment; got "
            f"{type(environment).__module__}.{type(environment).__name__}"
        )
    physics = environment.physics
    if not isinstance(physics, engine.Physics):
        raise InputError(
            f"the environment's physics is a {type(physics).__name__}; expected a "
            "dm_control.mujoco.Physics"
        )
    if getattr(physics, "backend", "mujoco") != "mujoco":
        raise InputError(
            f"the environment's physics uses backend {physics.backend!r}; make it with 'mujoco', "
            "and name the backend of all worlds here"
        )
    own = type(physics).step
    if own.__module__ not in (engine.__name__, "orbisim.physics.switching"):
        raise InputError(
            f"{type(physics).__name__}.step is its own; many worlds are stepped by dm_control's"
        )
