"""Every effect that is a force is the force that its definition says, in both engines."""

from __future__ import annotations

import numpy as np
import pytest

from orbisim import Scene
from orbisim.effects import EffectInstance, add_effects

from .arm import SPEED, generalized_force, velocities


def unit(index: int) -> np.ndarray:
    return np.eye(8)[index]


V1, V2 = SPEED[0], SPEED[1]
FORCES = {
    # effect, target, values, options: the force it adds
    "coulomb": (("coulomb_friction", "shoulder", {"torque": 0.3}), lambda m: -0.3 * unit(0)),
    "viscous": (("viscous_damping", "elbow", {"coefficient": 0.3}), lambda m: -0.3 * V2 * unit(1)),
    "quadratic": (
        ("quadratic_damping", "elbow", {"coefficient": 0.3}),
        lambda m: -0.3 * V2 * abs(V2) * unit(1),
    ),
    "spring": (
        ("joint_spring", "shoulder", {"stiffness": 4.0, "rest_position": 0.1}),
        lambda m: -4 * (0.4 - 0.1) * unit(0),
    ),
    "cogging": (
        ("cogging", "shoulder", {"amplitude": 0.2, "periods": 7.0, "phase": 0.5}),
        lambda m: 0.2 * np.sin(7 * 0.4 + 0.5) * unit(0),
    ),
    "stribeck": (
        ("stribeck_friction", "elbow", {"coulomb": 0.2, "static": 0.5, "velocity": 3.0}),
        lambda m: (0.2 + 0.3 * np.exp(-((V2 / 3) ** 2))) * unit(1),
    ),
    "load, actuator": (
        ("load_dependent_friction", "shoulder", {"coefficient": 0.2}),
        lambda m: -0.2 * abs(2 * 0.8) * unit(0),
    ),
    "coupling, torque": (
        ("joint_coupling", "elbow", {"coefficient": 0.2}, {"other": "shoulder"}),
        lambda m: 0.2 * 1.6 * unit(1),
    ),
    "coupling, position": (
        ("joint_coupling", "elbow", {"coefficient": 2.0}, {"other": "shoulder", "by": "position"}),
        lambda m: 2 * 0.4 * unit(1),
    ),
    "coupling, velocity": (
        ("joint_coupling", "elbow", {"coefficient": 0.5}, {"other": "shoulder", "by": "velocity"}),
        lambda m: 0.5 * 1.5 * unit(1),
    ),
    "gain": (("torque_gain", "m1", {"gain": 1.5}), lambda m: 0.5 * 1.6 * unit(0)),
    "gain, position": (
        ("torque_gain", "p2", {"gain": 0.5}),
        lambda m: -0.5 * (5 * (-0.45 + 0.7) - 0.1 * V2) * unit(1),
    ),
    "bias": (("torque_bias", "m1", {"offset": 0.3}), lambda m: 2 * 0.3 * unit(0)),
    "saturation": (
        ("torque_saturation", "p2", {"limit": 1.0}),
        lambda m: -(5 * (-0.45 + 0.7) - 0.1 * V2 - 1.0) * unit(1),
    ),
    "dead band": (("deadband", "m1", {"width": 0.4}), lambda m: -2 * 0.2 * unit(0)),
    "dead band, gate": (
        ("deadband", "m1", {"width": 1.8}, {"kind": "gate"}),
        lambda m: -1.6 * unit(0),
    ),
    "constant force": (
        ("constant_force", "fore", {"magnitude": 3.0, "x": 1.0, "y": 2.0, "z": -2.0}),
        lambda m: velocities(m, "fore")[2].T @ [1, 2, -2],
    ),
    "periodic, joint": (
        ("periodic_disturbance", "elbow", {"amplitude": 0.5, "frequency": 3.0, "phase": 0.2}),
        lambda m: 0.5 * np.sin(2 * np.pi * 3 * 0.1 + 0.2) * unit(1),
    ),
    "periodic, body": (
        (
            "periodic_disturbance", "ball",
            {"amplitude": 0.5, "frequency": 3.0, "phase": 0.2}, {"x": "0", "y": "2", "z": "0"},
        ),
        lambda m: velocities(m, "ball")[2].T @ [0, 0.5 * np.sin(2 * np.pi * 0.3 + 0.2), 0],
    ),
    "linear drag": (
        ("linear_drag", "fore", {"coefficient": 0.4}),
        lambda m: velocities(m, "fore")[2].T @ (-0.4 * velocities(m, "fore")[1]),
    ),
    "quadratic drag": (
        ("quadratic_drag", "ball", {"coefficient": 0.4}),
        lambda m: velocities(m, "ball")[2].T
        @ (-0.4 * velocities(m, "ball")[1] * np.linalg.norm(velocities(m, "ball")[1])),
    ),
    "magnus": (
        ("magnus", "ball", {"coefficient": 0.4}),
        lambda m: velocities(m, "ball")[2].T @ (0.4 * np.cross(*velocities(m, "ball")[:2])),
    ),
    "buoyancy": (
        ("buoyancy", "fore", {"displaced_mass": 0.3}),
        lambda m: velocities(m, "fore")[2].T @ [0, 0, 0.3 * 9.81],
    ),
}  # fmt: skip


@pytest.mark.parametrize("backend", ["mujoco", "warp"])
@pytest.mark.parametrize("case", FORCES)
def test_force(scene: Scene, case: str, backend: str) -> None:
    if backend == "warp":
        pytest.importorskip("mujoco_warp")
    arguments, law = FORCES[case]
    changed = add_effects(scene, [EffectInstance(*arguments)])
    added = generalized_force(changed, 0.1, backend) - generalized_force(scene, 0.1, backend)
    expected = law(scene.model)
    # dissipative forces are integrated implicitly: correct to first order in the timestep
    np.testing.assert_allclose(added, expected, atol=0.01 * np.abs(expected).max() + 1e-3)
