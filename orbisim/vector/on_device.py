"""`DeviceVectorEnvironment`: worlds that stay on the backend's device, tensors in and out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from orbisim.arguments import real_array
from orbisim.backend import InPlace
from orbisim.errors import CapacityError, InputError
from orbisim.state import MEMORY, Array, State
from orbisim.vector.device_evaluation import DeviceEvaluator, DeviceFields, HostFields, differences
from orbisim.vector.environment import (
    FLAT,
    Ids,
    Step,
    VectorEnvironment,
    finite_bounds,
    world_numbers,
)
from orbisim.vector.evaluation import Batched
from orbisim.vector.mirrored import Mirrored
from orbisim.vector.program import Program
from orbisim.vector.tensor_worlds import torch_dtype
from orbisim.vector.worlds import NotBatchedError

_CHECKED_STEPS = 4
"""Random steps after which the device's values are compared with the host's."""
_REPAIRS = 6
"""Times that buffers may be enlarged for one step."""
_PHYSICAL = ("time", "qpos", "qvel", "act")
_STATE = (*_PHYSICAL, *MEMORY)


class DeviceVectorEnvironment(VectorEnvironment):
    """A `VectorEnvironment` whose steps never leave the device.

    Actions, observations, rewards and ends of episodes are tensors there. In a step in which no
    episode ends, the host reads three flags. Episodes begin on the host, in the worlds whose
    episode is over. What cannot be computed on the device, or not surely the same there, is
    computed on the host as for other backends; `reason` says why, and tensors still come and go on
    the device.

    Args:
      See `VectorEnvironment`; the backend has worlds in place.
    """

    def __init__(self, *args: Any, **options: Any) -> None:
        self._worlds: InPlace | None = None
        self._device = torch.device("cpu")
        super().__init__(*args, **options)
        assert isinstance(self._simulator, Mirrored)
        self._mirrored: Mirrored = self._simulator

    # -- what it is ------------------------------------------------------------------------------

    @property
    def evaluation(self) -> str:
        """`on the device`, `batched` or `world by world`."""
        return super().evaluation if self._worlds is None else "on the device"

    @property
    def state(self) -> State:
        """The state of all worlds, on the host."""
        if self._worlds is None:
            return super().state
        return self._state_of(_STATE)

    def use(self, worlds: InPlace, reason: str = "") -> None:
        """Steps these worlds from now on.

        Args:
          worlds: as many as there are.
          reason: why the task's functions cannot run on their device; then they are not kept, and
            only the tensors are there.
        """
        self._device = torch.device(worlds.device)
        if reason or super().evaluation != "batched":
            self.reason = self.reason or reason
            worlds.close()
            return
        self._worlds = worlds
        self._time = torch.zeros(self.nworld, dtype=torch.float64, device=self._device)
        self._time_before = self._time.clone()
        self._ctrl = torch.zeros_like(worlds.field("ctrl"), dtype=torch.float64)
        self._fields_there = DeviceFields(
            worlds, self._mirrored.model, {"time": self._time, "ctrl": self._ctrl}
        )
        self._evaluator_there = DeviceEvaluator(
            self._pristine, self._fields_there, self._fields, self._tasks, self._device
        )
        kinds = {n: (shape, torch_dtype(dtype)) for n, (shape, dtype) in self._spec.items()}
        order = self._order if self._flat else None
        self._program = Program(
            worlds, self._evaluator_there, kinds, self.nworld, flat=FLAT, order=order
        )
        self._all_alive = True

    def disagreement(self) -> str:
        """Why the task's functions cannot run on the device; nothing if they can."""
        if self._worlds is None:
            return self.reason
        host = Batched(
            self._pristine,
            HostFields(self._fields_there, self.nworld),
            self._fields,
            self._tasks,
        )
        random, (low, high) = np.random.RandomState(0), finite_bounds(self._action_spec)
        try:
            self.reset()
            for _ in range(_CHECKED_STEPS):
                if self._worlds is None:
                    return self.reason
                action = random.uniform(low, high, (self.nworld, len(low)))
                _, lost, _ = self._advance_there(torch.as_tensor(action))
                kept = np.ones(self.nworld, bool)
                if lost:
                    kept = ~self._program.lost.cpu().numpy()
                well = np.flatnonzero(kept)
                expected = host.values(well)
                found = {**self._program.raw, "discount": self._program.discount}
                if reason := differences(found, expected, well):
                    return reason
        except CapacityError:
            raise
        except Exception as error:  # of a task's code, over values that it was not written for
            return f"{type(error).__name__}: {error}"
        return ""

    # -- what it does ----------------------------------------------------------------------------

    def reset(self, seed: int | Sequence[int | None] | None = None) -> dict[str, Array]:
        """See `VectorEnvironment.reset`."""
        observation = super().reset(seed)
        if self._worlds is None:
            return observation
        self._moved_in(np.arange(self.nworld), self._last or {})
        return self._observed() if self._worlds is not None else observation

    def restart(self, worlds: npt.ArrayLike) -> dict[str, Array]:
        """See `VectorEnvironment.restart`."""
        if hasattr(worlds, "detach"):
            worlds = worlds.detach().cpu().numpy()
        if self._worlds is None:
            return super().restart(worlds)
        ids = world_numbers(worlds, self.nworld)
        if self._last is None:
            raise InputError("restart of some worlds comes after a reset of all")
        first = self._blank()
        self._begin(ids, first)
        self._moved_in(ids, first)
        if self._worlds is None:  # they have left for the host with this reset
            return {name: self._out(rows.copy()) for name, rows in self._last.items()}
        return self._observed()

    def step(self, action: Array) -> Step:
        """See `VectorEnvironment.step`; `action` may be a tensor on any device."""
        if self._worlds is None:
            return super().step(action)
        action = self._action_there(action)
        over = np.flatnonzero(self._over)
        first: dict[str, npt.NDArray[Any]] = {}
        if self._last is None:
            self.reset()
            over, first = np.arange(self.nworld), self._last or {}
            if self._worlds is None:
                return self._on_host(over, action, first)
        elif over.size:
            first = self._blank()
            self._begin(over, first)
            self._moved_in(over, first)
            if self._worlds is None:
                return self._on_host(over, action, first)
        worlds = self._worlds
        alive = np.ones(self.nworld, bool)
        alive[over] = False
        if not alive.any():
            return self._begun(over)
        self._live(alive)
        try:
            _, lost, ended = self._advance_there(action)
        except CapacityError:
            raise
        except Exception as error:  # in a branch, or of a value, that was not there before
            worlds.take_back()
            self._time.copy_(self._time_before)
            self._program.go_back()
            self._leave(f"{type(error).__name__}: {error}", over, first)
            return self._on_host(over, action, first)
        if over.size:  # these have waited for the others
            self._moved_in(over, first)
        return self._ended(alive, lost, ended)

    def close(self) -> None:
        """Frees the worlds."""
        if self._worlds is not None:
            self._worlds.close()
        super().close()

    # -- inner workings --------------------------------------------------------------------------

    def _advance_there(self, action: torch.Tensor) -> tuple[bool, bool, bool]:
        """One control step of all worlds and what the task says of it; the flags of `Program`."""
        worlds, program = self._worlds, self._program
        assert worlds is not None
        self._evaluator_there.prepare()
        self._ctrl.copy_(action)
        worlds.field("ctrl").copy_(self._ctrl)
        self._time_before.copy_(self._time)
        self._time.add_(self.control_timestep())
        program.keep()
        steps = self._mirrored.backend_steps(self._steps)
        for _ in range(_REPAIRS):
            worlds.field("time").copy_(self._time_before)
            worlds.step(steps)
            program.run()
            flags = program.flags()
            if not flags[0]:
                return flags
            worlds.repair()
        raise CapacityError(
            f"{self.name}: contacts or constraints of {self.nworld} worlds still do not fit after "
            f"{_REPAIRS} enlargements; pass nconmax and njmax to the backend"
        )

    def _ended(self, alive: npt.NDArray[np.bool_], lost: bool, ended: bool) -> Step:
        """Counts steps, and notes which episodes are over."""
        program = self._program
        self._count[alive] += 1
        late = alive & (self._count >= self._limit)
        terminated, truncated = program.terminated.clone(), program.truncated.clone()
        if late.any():
            there = torch.from_numpy(late).to(self._device)
            terminated &= ~there
            truncated |= there
        self._over = late
        if lost or ended:
            over = torch.stack([program.lost, terminated | truncated]).cpu().numpy()
            self.diverged += over[0]
            self._over = late | over[1]
        return Step(self._observed(), program.reward.clone(), terminated, truncated)

    def _begun(self, worlds: Ids) -> Step:
        """The step in which every world has begun an episode."""
        nothing = torch.zeros(self.nworld, dtype=torch.bool, device=self._device)
        reward = torch.zeros(self.nworld, dtype=torch.float64, device=self._device)
        return Step(self._observed(), reward, nothing, nothing.clone())

    def _observed(self) -> dict[str, Array]:
        return {name: rows.clone() for name, rows in self._program.observation.items()}

    def _live(self, alive: npt.NDArray[np.bool_]) -> None:
        """Says on the device which worlds are in an episode."""
        everywhere = bool(alive.all())
        if everywhere and self._all_alive:
            return
        self._program.alive.copy_(torch.from_numpy(alive))
        self._all_alive = everywhere

    def _moved_in(self, ids: Ids, first: dict[str, npt.NDArray[Any]]) -> None:
        """Takes episodes that have begun on the host to the device, in one copy."""
        worlds = self._worlds
        assert worlds is not None
        try:
            self._evaluator_there.prepare()
        except NotBatchedError as error:
            self._leave(str(error), ids, first)
            return
        named = {n: self._mirrored.rows(n, ids) for n in _STATE}
        state = {n: rows for n, rows in named.items() if rows.size and n in worlds.names}
        seen = {f"observation/{n}": rows[ids] for n, rows in first.items()}
        parts = {"ids": ids, **state, **seen}
        flat = {n: np.reshape(p, (len(ids), -1)).astype(np.float64) for n, p in parts.items()}
        packed = torch.from_numpy(np.concatenate(list(flat.values()), axis=1)).to(self._device)
        widths = [p.shape[1] for p in flat.values()]
        there = dict(zip(flat, packed.split(widths, dim=1), strict=True))
        places = there.pop("ids")[:, 0].long()
        for name, rows in self._program.observation.items():
            values = there.pop(f"observation/{name}").to(rows.dtype)
            rows[places] = values.reshape(len(ids), *rows.shape[1:])
        self._time[places] = there["time"][:, 0]
        worlds.write(places, there)
        worlds.refresh()

    def _state_of(self, names: tuple[str, ...]) -> State:
        worlds = self._worlds
        assert worlds is not None
        found = {
            n: worlds.field(n).detach().cpu().numpy().astype(np.float64)
            for n in names
            if n in worlds.names
        }
        found["time"] = self._time.cpu().numpy().copy()
        physical = {n: found.pop(n) for n in _PHYSICAL}
        return State(**physical, memory={n: rows for n, rows in found.items() if rows.size})

    def _leave(self, reason: str, begun: Ids, first: dict[str, npt.NDArray[Any]]) -> None:
        """Goes on on the host.

        Args:
          reason: why.
          begun: worlds whose episode has begun there just now, with their first observations
            `first`, by name [nworld, ...].
        """
        worlds = self._worlds
        assert worlds is not None
        fresh = self._mirrored.physics[begun]
        reported = self._mirrored.backend.report & worlds.names
        self._mirrored.take_over(self._state_of((*_STATE, *sorted(reported))))
        rows = self._mirrored.physics
        rows[begun] = fresh
        self._mirrored.physics = rows
        self._last = {n: np.array(o.cpu().numpy()) for n, o in self._program.observation.items()}
        for name, values in first.items():
            self._last[name][begun] = values[begun]
        self.reason = reason
        self._worlds = None
        worlds.close()

    def _on_host(self, over: Ids, action: Any, first: dict[str, npt.NDArray[Any]]) -> Step:
        """The rest of a step whose episodes have begun already."""
        alive = np.setdiff1d(np.arange(self.nworld), over)
        observation = self._blank()
        for name, rows in first.items():
            observation[name][over] = rows[over]
        reward, discount = np.zeros(self.nworld), np.full(self.nworld, np.nan)
        host = action.detach().cpu().numpy().astype(np.float64)
        lost = self._advance(alive, host, observation, reward, discount)
        return self._finish(alive, lost, observation, reward, discount)

    def _action_there(self, action: Array) -> torch.Tensor:
        shape = (self.nworld, *self._action_spec.shape)
        action = real_array("action", action, str(shape))
        self._check_shape(tuple(action.shape), shape)
        return torch.as_tensor(action, device=self._device)

    def _out(self, rows: npt.NDArray[Any]) -> Array:
        return torch.from_numpy(rows).to(self._device)
