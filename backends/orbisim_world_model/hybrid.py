"""`HybridBackend`: MuJoCo's step with a learned correction."""

from __future__ import annotations

from typing import Any

from orbisim_mujoco import MujocoBackend

from orbisim.backend import Backend
from orbisim.scene import Scene
from orbisim.state import Array, State
from orbisim.trajectory import Trajectory
from orbisim_world_model.arrays import like
from orbisim_world_model.backend import LearnedBackend
from orbisim_world_model.stepping import MEMORY, Steps


class HybridBackend(LearnedBackend):
    """MuJoCo advances one control step, then the learned model corrects the result.

    The correction was trained on what MuJoCo leaves over (`orbisim train dynamics --config hybrid
    --residual-on mujoco`). Works on NumPy states; gradients come by linearization.

    Args:
      **config: see `LearnedBackend`.
    """

    name = "hybrid"
    capabilities = frozenset()
    baseline = "mujoco"

    def load(self, scene: Scene) -> None:
        """Loads the scene into MuJoCo and the checkpoint that fits it."""
        super().load(scene)
        self._classical = MujocoBackend(nworld=self.nworld)
        self._classical.load(scene)
        self._substeps = round(self.timestep / self._classical.timestep)

    def step(self, state: State, control: Array | None = None, nstep: int = 1) -> State:
        """Advances every world by `nstep` control steps under a constant control."""
        control, nstep = self.check_step(state, control, nstep)
        state, control = state.numpy(), _host(control)
        for _ in range(nstep):
            predicted = self._classical.step(state, control, self._substeps)
            corrected = self.engine.corrected(state, predicted, control)
            verdict = self.watch.verdict(state, corrected, self.timestep)
            if verdict.error is not None:
                raise verdict.error
            state = self._after(predicted, corrected).with_memory(**verdict.memory)
        return state

    def rollout(self, state: State, controls: Array, **options: Any) -> Trajectory:
        """Applies a sequence of controls open-loop (see `Backend.rollout`)."""
        self.check_state(state)
        return Backend.rollout(self, state.numpy(), _host(controls), **options)

    def _after(self, predicted: State, path: Steps) -> State:
        """MuJoCo's state with the corrected numbers, and the model's memory."""
        arrays = self.engine.layout.join(path.states.at(-1))
        qpos, qvel, act = (like(array, predicted.qpos) for array in arrays)
        memory = {**predicted.memory, MEMORY: like(path.memory, predicted.qpos)}
        return State(predicted.time, qpos, qvel, act, memory)


def _host(array: Array) -> Array:
    return array.detach().cpu().numpy() if hasattr(array, "detach") else array
