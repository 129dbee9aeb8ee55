"""OrbiSim: a hybrid robot simulator.

Classical and learned physics behind one dm_control-style `Physics`, renderers that can be
swapped in the middle of an episode, and a loop that is closed with measured data.

Names are imported when they are first used: `import orbisim` loads neither MuJoCo nor torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from orbisim.host import gl as _gl
from orbisim.host.lazy import lazy
from orbisim.version import VERSION

if TYPE_CHECKING:
    from orbisim.backend import Backend as Backend
    from orbisim.backend import Capability as Capability
    from orbisim.diagnosis import Diagnosis as Diagnosis
    from orbisim.diagnosis import diagnose as diagnose
    from orbisim.errors import OrbiSimError as OrbiSimError
    from orbisim.fleet import Fleet as Fleet
    from orbisim.fleet import diagnose_fleet as diagnose_fleet
    from orbisim.identification import identify as identify
    from orbisim.physics import Physics as Physics
    from orbisim.physics import hybrid as hybrid
    from orbisim.recording import Recording as Recording
    from orbisim.registry import available_backends as available_backends
    from orbisim.registry import available_renderers as available_renderers
    from orbisim.registry import make_backend as make_backend
    from orbisim.registry import make_renderer as make_renderer
    from orbisim.registry import register_backend as register_backend
    from orbisim.registry import register_renderer as register_renderer
    from orbisim.renderer import Renderer as Renderer
    from orbisim.replay import Replay as Replay
    from orbisim.replay import replay as replay
    from orbisim.scene import Scene as Scene
    from orbisim.scene import SceneDescriptor as SceneDescriptor
    from orbisim.scene import load_scene as load_scene
    from orbisim.state import State as State
    from orbisim.trajectory import Trajectory as Trajectory

__version__ = VERSION

_gl.configure()  # before anything imports MuJoCo

_HOMES = {
    "Backend": "orbisim.backend",
    "Capability": "orbisim.backend",
    "Diagnosis": "orbisim.diagnosis",
    "Fleet": "orbisim.fleet",
    "OrbiSimError": "orbisim.errors",
    "Physics": "orbisim.physics",
    "Recording": "orbisim.recording",
    "Renderer": "orbisim.renderer",
    "Replay": "orbisim.replay",
    "State": "orbisim.state",
    "Trajectory": "orbisim.trajectory",
    "diagnose": "orbisim.diagnosis",
    "diagnose_fleet": "orbisim.fleet",
    "available_backends": "orbisim.registry",
    "available_renderers": "orbisim.registry",
    "hybrid": "orbisim.physics",
    "make_backend": "orbisim.registry",
    "make_renderer": "orbisim.registry",
    "register_backend": "orbisim.registry",
    "register_renderer": "orbisim.registry",
    "identify": "orbisim.identification",
    "replay": "orbisim.replay",
    "Scene": "orbisim.scene",
    "SceneDescriptor": "orbisim.scene",
    "load_scene": "orbisim.scene",
}
"""Public names and the modules that define them."""

_MODULES = ("compare", "gradients", "recording", "suite", "tasks", "testing", "vector")

__all__ = [*_HOMES, *_MODULES]


__getattr__, __dir__ = lazy(__name__, _HOMES, _MODULES)
