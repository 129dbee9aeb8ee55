"""The residual in force space is the missing effect, also where MuJoCo has no such effect."""

from pathlib import Path

import numpy as np
import pytest

import orbisim
from orbisim.effects import EffectInstance, add_effects
from orbisim.motion.force import force_residual
from orbisim.motion.samples import prepare
from orbisim.testing import inject_effect

ARM = Path(__file__).parents[2] / "mjcf_assets" / "arm2" / "scene.xml"


@pytest.mark.parametrize(
    "effect",
    [
        EffectInstance("coulomb_friction", "elbow", {"torque": 0.5}),
        EffectInstance(
            "load_dependent_friction", "shoulder", {"coefficient": 0.1}, {"load": "external"}
        ),
        EffectInstance("linear_drag", "forearm", {"coefficient": 1.0}),
        EffectInstance(
            "joint_coupling", "elbow", {"coefficient": 0.3}, {"other": "shoulder", "by": "velocity"}
        ),
        EffectInstance("deadband", "elbow", {"width": 0.4}),
    ],
    ids=lambda effect: effect.effect,
)
def test_an_effect_takes_its_residual_away(effect: EffectInstance) -> None:
    declared = orbisim.load_scene(ARM)
    (run,) = inject_effect(declared, effect, duration=2.0, episodes=1, noise=0.0)
    samples = [prepare(run, declared)]
    sizes = [
        np.sqrt(np.nanmean(force_residual(samples, scene)[0].force[10:-10] ** 2))
        for scene in (declared, add_effects(declared, [effect]))
    ]
    assert sizes[1] < 0.3 * sizes[0]


def test_a_recording_is_smoothed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    # a fit asks for the forces of many hypotheses; smoothing takes far longer than they do
    declared = orbisim.load_scene(ARM)
    friction = EffectInstance("coulomb_friction", "elbow", {"torque": 0.5})
    (run,) = inject_effect(declared, friction, duration=1.0, episodes=1, noise=1e-4)
    samples = [prepare(run, declared)]
    first = force_residual(samples, declared)[0]
    monkeypatch.setattr("orbisim.motion.samples.estimate_motion", lambda _: pytest.fail("again"))
    again = force_residual(samples, add_effects(declared, [friction]))[0]
    assert np.nanmax(first.std) > 0.0
    assert again.std.shape == first.std.shape
