"""dm_control's `Physics`, stepped and rendered by any backend and renderer."""

from orbisim.physics.switching import Physics, PhysicsDivergedError, adopt, hybrid

__all__ = ["Physics", "PhysicsDivergedError", "adopt", "hybrid"]
