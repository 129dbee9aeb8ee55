"""Methods of dm_control's suite that cannot run over many worlds as they are written.

Each does what the original does, in words that the batched physics understands; that the numbers
are the same is checked whenever an environment is loaded.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from dm_control.suite import quadruped


def _torso_upright(physics: Any) -> Any:
    """The original makes an array of the number by `np.asarray`."""
    return physics.named.data.xmat["torso", "zz"]


def _origin_distance(physics: Any) -> Any:
    """The original makes an array of the number by `np.asarray`."""
    return np.linalg.norm(physics.named.data.site_xpos["workspace"])


PHYSICS_METHODS: dict[type, dict[str, Callable[..., Any]]] = {
    quadruped.Physics: {"torso_upright": _torso_upright, "origin_distance": _origin_distance},
}
"""By class of `Physics`: methods that take the place of its own when many worlds are evaluated."""


def methods_for(cls: type) -> dict[str, Callable[..., Any]]:
    """The methods to replace in a class of `Physics` or a subclass of one."""
    found: dict[str, Callable[..., Any]] = {}
    for base in reversed(cls.__mro__):
        found |= PHYSICS_METHODS.get(base, {})
        found = {n: f for n, f in found.items() if n not in vars(base) or base in PHYSICS_METHODS}
    return found
