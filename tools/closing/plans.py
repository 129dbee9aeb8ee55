"""What is scored on each measured data set: a scene, recordings, and a metric.

The diagnosis runs with the command's defaults on all of them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np

from closing.metrics import (
    Metric,
    best_start,
    end_of_run,
    free_run,
    position_after,
    torque_residual,
)
from orbisim.recording import Recording
from orbisim.scene import Scene, load_scene

ASSETS = Path(__file__).resolve().parents[2] / "mjcf_assets"
Half = Literal["developed", "judged"]


def _same(recording: Recording) -> Recording:
    return recording


@dataclasses.dataclass(frozen=True)
class Plan:
    """What is scored on a set.

    Attributes:
      name: of the set. half: whether the search was developed on it, or is only judged by it.
      literature: what the declared scene lacks, with the literature's figures.
      dominant: effect and target of what counts most of that, and what is the same physics; written
        down before a run with the defaults. Empty where there is next to nothing.
      metric: on the held-out recordings.
      only: held-out recordings whose names start so; all if empty.
      recording: what is done to each recording first.
    """

    name: str
    half: Half
    literature: str
    metric: Metric
    dominant: tuple[tuple[str, str], ...] = ()
    only: str = ""
    recording: Callable[[Recording], Recording] = _same

    def scene(self, kind: str = "scene") -> Scene:
        """The declared scene (`scene`) or the published one (`published`)."""
        return load_scene(ASSETS / self.name / f"{kind}.xml", trusted=True)

    @property
    def published(self) -> bool:
        """Whether there is a published model."""
        return (ASSETS / self.name / "published.xml").exists()


def first_flight(recording: Recording, clear: float = 0.03) -> Recording:
    """Until the ball first comes closer to the table than so many m: the spin is of this flight."""
    low = recording["xpos/ball"][:, 2] < clear
    return recording.rows(slice(0, int(np.argmax(low)) if low.any() else len(recording)))


def _declared(name: str) -> Callable[[], Scene]:
    return lambda: load_scene(ASSETS / name / "scene.xml", trusted=True)


PLANS = (
    Plan(
        "emps",
        "developed",
        literature="Coulomb 20.39 N, viscous 203.5 N·s/m, offset 3.16 N",
        dominant=(
            ("coulomb_friction", "carriage"),
            ("viscous_damping", "carriage"),
        ),
        metric=free_run(0.5, "mm", 1e3),
    ),
    Plan(
        "contactnets_cube",
        "developed",
        literature="sliding friction 0.18",
        dominant=(
            ("sliding_friction", "cube"),
            ("sliding_friction", "board"),
        ),
        metric=position_after(0.5),
    ),
    Plan(
        "dfki_simple_pendulum",
        "developed",
        literature="Coulomb 0.289 N·m, viscous 0.047 N·m·s/rad, armature 0.0022 kg·m²",
        dominant=(("coulomb_friction", "hinge"),),
        metric=free_run(1.0, velocities="smoothed"),
    ),
    Plan(
        "multiarm_pendulum_single",
        "developed",
        literature="viscous 2.24e-4 N·m·s/rad; zero offset of a few mrad",
        dominant=(
            ("viscous_damping", "arm"),
            ("linear_drag", "arm"),
        ),
        metric=free_run(5.0),
    ),
    Plan(
        "kuka_kr300",
        "developed",
        literature="payload 151 kg, counterbalance spring, friction of all six gears",
        dominant=(("payload", "link_6"),),
        metric=torque_residual(_declared("kuka_kr300"), 10.0),
    ),
    Plan(
        "airtrack_oscillator",
        "developed",
        literature="viscous 0.0137 N·s/m",
        dominant=(
            ("viscous_damping", "glider"),
            ("linear_drag", "glider"),
        ),
        metric=best_start(5.0, "mm", 1e3),
    ),
    Plan(
        "bam_xl330",
        "developed",
        literature="friction under load 0.122 (0.35 fitted), Coulomb 0.0089 N·m, "
        "viscous 0.0044 N·m·s/rad, armature 0.0019 kg·m², offset 0.029 rad",
        dominant=(("load_dependent_friction", "shaft"),),
        metric=free_run(0.5, velocities="smoothed"),
    ),
    Plan(
        "staubli_tx40",
        "judged",
        literature="viscous 8.05 5.53 1.97 1.11 1.86 0.65 N·m·s/rad, "
        "Coulomb 7.14 8.26 6.34 2.48 3.03 0.28 N·m, "
        "armature 0.36 0.36 0.10 0.03 0.05 0.01 kg·m², coupling of the wrist",
        dominant=(
            ("viscous_damping", "joint_1"),
            ("coulomb_friction", "joint_1"),
        ),
        metric=torque_residual(_declared("staubli_tx40"), 30.0),
    ),
    Plan(
        "acromonk",
        "judged",
        literature="elbow: armature 0.0055 kg·m², Coulomb 0.098 N·m, viscous 0.016 N·m·s/rad",
        dominant=(("armature", "elbow"),),
        metric=torque_residual(_declared("acromonk"), 8.0, ("elbow",)),
    ),
    Plan(
        "dfki_double_pendulum_A",
        "judged",
        only="sysid",
        literature="Coulomb 0.146 and 0.123 N·m, armature 0.0028 kg·m², viscous 0.001 N·m·s/rad",
        dominant=(
            ("coulomb_friction", "shoulder"),
            ("coulomb_friction", "elbow"),
        ),
        metric=free_run(0.5, velocities="smoothed"),
    ),
    Plan(
        "multiarm_pendulum_double",
        "judged",
        literature="viscous 2.37e-4 and 1.0e-5 N·m·s/rad",
        dominant=(("viscous_damping", "upper"),),
        metric=free_run(1.0),
    ),
    Plan(
        "table_tennis_ball",
        "judged",
        literature="quadratic drag 3.4e-4 N·s²/m² (drag coefficient 0.45), Magnus force",
        dominant=(("quadratic_drag", "ball"),),
        metric=end_of_run(),
        recording=first_flight,
    ),
    Plan(
        "rocket_coast",
        "judged",
        literature="quadratic drag 3.1e-4 N·s²/m² per kg",
        dominant=(
            ("quadratic_drag", "rocket"),
            ("quadratic_damping", "height"),
        ),
        metric=best_start(10.0, "m"),
    ),
    Plan(
        "sts3215_backlash",
        "judged",
        literature="play of the gear, dead band and softness of the control; no figures",
        dominant=(
            ("backlash", "shaft"),
            ("deadband", "servo"),
        ),
        metric=free_run(2.0),
    ),
    Plan(
        "schmidt_lipson_double_pendulum",
        "judged",
        literature="next to nothing: light bearing friction",
        metric=free_run(0.3, velocities="smoothed"),
    ),
)
