"""What several of these tests diagnose."""

from pathlib import Path

import pytest

import orbisim
from orbisim.effects import EffectInstance


@pytest.fixture(scope="package")
def arm() -> orbisim.Scene:
    """The arm with two joints."""
    return orbisim.load_scene(Path(__file__).parents[2] / "mjcf_assets" / "arm2" / "scene.xml")


@pytest.fixture(scope="package")
def several() -> tuple[EffectInstance, ...]:
    """Effects that the arm can have at once."""
    return (
        EffectInstance("coulomb_friction", "shoulder", {"torque": 0.3}),
        EffectInstance("viscous_damping", "elbow", {"coefficient": 0.08}),
        EffectInstance("torque_bias", "elbow", {"offset": 0.15}),
    )
