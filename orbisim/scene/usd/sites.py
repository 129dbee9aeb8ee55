"""Sites that the reader itself adds, to hold constraints."""

from __future__ import annotations

from orbisim.scene.usd.pose import Pose
from orbisim.scene.usd.registry import Registry

_MARKER_GROUP = 4
"""A group that viewers hide: these sites are places, not things."""
_MARKER_SIZE = 0.005  # m


def add_marker(registry: Registry, body: str | None, pose: Pose, wanted: str) -> str:
    """Adds a small hidden site to a body (the world for None); returns its name."""
    name = registry.site_names(wanted)
    site = registry.body(body).add_site(name=name, pos=pose.pos, quat=pose.quat)
    site.size = [_MARKER_SIZE] * 3
    site.group = _MARKER_GROUP
    return name
