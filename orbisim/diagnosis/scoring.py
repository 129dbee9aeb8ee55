"""Free-running error of a scene on recordings: the number that is reported before and after."""

from __future__ import annotations

from collections.abc import Sequence

from orbisim.backend import Backend
from orbisim.effects import EffectInstance, find
from orbisim.effects.measured import correct
from orbisim.recording import Recording
from orbisim.replay import Replay, replay
from orbisim.scene import Scene


def score(
    scene: Scene,
    recordings: Sequence[Recording],
    window: float,
    effects: Sequence[EffectInstance] = (),
    backend: str | Backend = "mujoco",
) -> Replay:
    """Replays recordings; effects on the measurement are taken out of them first."""
    distorting = [e for e in effects if find(e.effect).measurement]
    if distorting:
        recordings = [correct(one, distorting, scene) for one in recordings]
    return replay(scene, list(recordings), backend=backend, window=window)
