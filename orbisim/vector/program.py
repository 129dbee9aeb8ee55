"""What follows a step on the device: the task's values and the ends of episodes, in one CUDA graph.

Nothing here looks at a number on the host but `Program.flags`.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import torch

from orbisim.backend import InPlace
from orbisim.vector.device_evaluation import DeviceEvaluator


class Program:
    """Computes what a step returns into memory that stays where it is.

    On a GPU the operations are recorded the second time that they are asked for, and replayed from
    then on; anew after fields have moved or the task's functions may do something else.

    Args:
      worlds: that are stepped.
      evaluator: of the task's functions.
      kinds: by name of an observation its shape in one world, and type.
      nworld: number of worlds.
      flat: the name of the one observation if all are put into one array.
      order: of the parts of it; None if they are not.

    Attributes:
      observation: by name, each [nworld, ...]; of worlds that were lost, the one before.
      reward: [nworld] float64; 0 in worlds that were lost or are not in an episode.
      discount: [nworld] float64, NaN where the episode goes on.
      raw: the task's observations by name and `reward`, as its functions gave them.
      alive: [nworld] which worlds are in an episode; to be written.
      lost, terminated, truncated: [nworld] which of them diverged, or have ended.
      recorded: whether a CUDA graph is replayed. unrecordable: why that cannot be.
    """

    def __init__(
        self,
        worlds: InPlace,
        evaluator: DeviceEvaluator,
        kinds: Mapping[str, tuple[tuple[int, ...], torch.dtype]],
        nworld: int,
        *,
        flat: str = "",
        order: Sequence[str] | None = None,
    ) -> None:
        self._worlds, self._evaluator = worlds, evaluator
        self._flat, self._order = flat, order
        device = self._device = torch.device(worlds.device)

        def flags() -> torch.Tensor:
            return torch.zeros(nworld, dtype=torch.bool, device=device)

        self.observation = {
            name: torch.zeros((nworld, *shape), dtype=dtype, device=device)
            for name, (shape, dtype) in kinds.items()
        }
        self._before = {name: rows.clone() for name, rows in self.observation.items()}
        self.reward = torch.zeros(nworld, dtype=torch.float64, device=device)
        self.discount = torch.full_like(self.reward, torch.nan)
        self.raw: dict[str, torch.Tensor] = {}
        self.alive = torch.ones(nworld, dtype=torch.bool, device=device)
        self.lost, self.terminated, self.truncated = flags(), flags(), flags()
        self._flags = torch.zeros(3, dtype=torch.bool, device=device)
        self._graph: Any = None
        self._recorded_for: tuple[int, int] | None = None
        self.unrecordable = "" if device.type == "cuda" else "a CPU has no graphs"

    @property
    def recorded(self) -> bool:
        """See the class."""
        return self._graph is not None

    def keep(self) -> None:
        """Keeps the observations for worlds that the next step loses."""
        torch._foreach_copy_(list(self._before.values()), list(self.observation.values()))

    def go_back(self) -> None:
        """The observations that were kept."""
        torch._foreach_copy_(list(self.observation.values()), list(self._before.values()))

    def run(self) -> None:
        """Computes everything, of the fields that there are now.

        Raises:
          NotBatchedError: the task's functions cannot run on the device.
        """
        version = (self._worlds.generation, self._evaluator.version)
        if self._recorded_for != version:
            self._graph = None
            with self._beside():
                self._compute()  # makes constants and loads kernels, which a recording cannot
            self._recorded_for = version
        elif self._graph is not None:
            self._graph.replay()
        elif self.unrecordable:
            self._compute()
        else:
            self._record()

    def flags(self) -> tuple[bool, bool, bool]:
        """Whether a buffer overflowed, a world was lost, an episode ended; waits for the device."""
        overflowed, lost, ended = self._flags.tolist()
        return overflowed, lost, ended

    def _record(self) -> None:
        graph = torch.cuda.CUDAGraph()
        try:
            with torch.cuda.graph(graph, capture_error_mode="thread_local"):
                self._compute()
        except RuntimeError as error:
            self.unrecordable = f"{type(error).__name__}: {error}"
            torch.cuda.synchronize(self._device)
            self._compute()
            return
        self._graph = graph
        graph.replay()

    @contextlib.contextmanager
    def _beside(self) -> Iterator[None]:
        """On a stream of its own, as recordings want it the first time."""
        if self._device.type != "cuda":
            yield
            return
        stream, here = torch.cuda.Stream(self._device), torch.cuda.current_stream(self._device)
        stream.wait_stream(here)
        with torch.cuda.stream(stream):
            yield
        here.wait_stream(stream)

    def _compute(self) -> None:
        """May be repeated: reads nothing that it writes."""
        values = self._evaluator.values()
        self.raw = {**values.observation, "reward": values.reward}
        self.discount.copy_(values.discount)
        found = self._arranged(values.observation)
        alive = self.alive
        lost = alive & (self._worlds.lost | ~torch.isfinite(values.reward))
        well = alive & ~lost
        for name, rows in self.observation.items():
            chosen = well.reshape(-1, *(1,) * (rows.ndim - 1))
            rows.copy_(torch.where(chosen, found[name].to(rows.dtype), self._before[name]))
        self.lost.copy_(lost)
        self.reward.copy_(torch.where(well, values.reward, 0.0))
        ended = well & ~torch.isnan(values.discount)
        terminated = ended & (values.discount == 0.0)
        self.terminated.copy_(terminated)
        self.truncated.copy_((ended & ~terminated) | lost)
        flags = [self._worlds.overflowed, lost.any(), ended.any()]
        self._flags.copy_(torch.stack(flags))

    def _arranged(self, observation: Mapping[str, torch.Tensor]) -> Mapping[str, torch.Tensor]:
        """As the environment gives it."""
        if self._order is None:
            return observation
        rows = [observation[n].reshape(len(self.alive), -1) for n in self._order]
        kind = self.observation[self._flat].dtype
        return {self._flat: torch.cat([part.to(kind) for part in rows], dim=1)}
