"""dm_control's environments in many worlds at once (docs/vector.md)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from orbisim.host.lazy import lazy

if TYPE_CHECKING:
    from orbisim.vector.environment import Step as Step
    from orbisim.vector.environment import VectorEnvironment as VectorEnvironment
    from orbisim.vector.gymnasium_adapter import gym as gym
    from orbisim.vector.loading import from_environment as from_environment
    from orbisim.vector.loading import load as load
    from orbisim.vector.randomization import between as between
    from orbisim.vector.randomization import factor as factor
    from orbisim.vector.randomization import intervals as intervals
    from orbisim.vector.scenes import from_scene as from_scene
    from orbisim.vector.stable_baselines import StableBaselinesVecEnv as StableBaselinesVecEnv
    from orbisim.vector.tensors import TensorEnvironment as TensorEnvironment
    from orbisim.vector.worlds import NotBatchedError as NotBatchedError
    from orbisim.vector.worlds import Worlds as Worlds

_HOMES = {
    "TensorEnvironment": "orbisim.vector.tensors",
    "StableBaselinesVecEnv": "orbisim.vector.stable_baselines",
    "from_scene": "orbisim.vector.scenes",
    "intervals": "orbisim.vector.randomization",
    "factor": "orbisim.vector.randomization",
    "between": "orbisim.vector.randomization",
    "NotBatchedError": "orbisim.vector.worlds",
    "Step": "orbisim.vector.environment",
    "VectorEnvironment": "orbisim.vector.environment",
    "Worlds": "orbisim.vector.worlds",
    "from_environment": "orbisim.vector.loading",
    "gym": "orbisim.vector.gymnasium_adapter",
    "load": "orbisim.vector.loading",
}
"""Public names and the modules that define them: adapters import their library when used."""

__all__ = [*_HOMES]

__getattr__, __dir__ = lazy(__name__, _HOMES)
