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
      left_out: what the declared scene lacks, by the set's publication.
      metric: on the held-out recordings. reference: figures known from elsewhere, in words.
      only: held-out recordings whose names start so; all if empty.
      recording: what is done to each recording first.
    """

    name: str
    half: Half
    left_out: str
    metric: Metric
    reference: str
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
        left_out="Coulomb and viscous friction, offset",
        metric=free_run(0.5, "mm", 1e3),
        reference="force residual 70 % to 3.6 % of the force",
    ),
    Plan(
        "contactnets_cube",
        "developed",
        left_out="sliding friction of the board (declared: MuJoCo's default, 1)",
        metric=position_after(0.5),
        reference="166 mm to 44 mm with the published friction",
    ),
    Plan(
        "dfki_simple_pendulum",
        "developed",
        left_out="Coulomb and viscous friction, reflected rotor inertia",
        metric=free_run(1.0, velocities="smoothed"),
        reference="energy_shaping 0.168 to 0.065 rad, ddp 0.185 to 0.078 rad",
    ),
    Plan(
        "multiarm_pendulum_single",
        "developed",
        left_out="bearing damping, zero offset of the encoder",
        metric=free_run(5.0),
        reference="0.196 to 0.054 rad over 5 s",
    ),
    Plan(
        "kuka_kr300",
        "developed",
        left_out="payload, counterbalance spring, gear friction",
        metric=torque_residual(_declared("kuka_kr300"), 10.0),
        reference="799/1191/2236/167/510/226 to 178/360/383/61/52/42 N·m",
    ),
    Plan(
        "airtrack_oscillator",
        "developed",
        left_out="damping by the air film",
        metric=best_start(5.0, "mm", 1e3),
        reference="3.85 to 0.41 pixels over the whole run, of which 0.29 are rounding",
    ),
    Plan(
        "bam_xl330",
        "developed",
        left_out="friction, also under load, reflected rotor inertia, mounting offset",
        metric=free_run(0.5, velocities="smoothed"),
        reference="0.39 to 0.29 rad (M1), 0.24 rad (M3); fitted with friction under load 0.048",
    ),
    Plan(
        "staubli_tx40",
        "judged",
        left_out="friction and rotor inertia of all axes, coupling of the wrist",
        metric=torque_residual(_declared("staubli_tx40"), 30.0),
        reference="23.9/18.1/8.2/5.0/4.07/3.32 to 3.7/3.3/1.2/0.60/0.96/0.96 N·m",
    ),
    Plan(
        "acromonk",
        "judged",
        left_out="joint damping; Coulomb friction and rotor inertia at the elbow",
        metric=torque_residual(_declared("acromonk"), 8.0, ("elbow",)),
        reference="0.288 to 0.134 N·m with friction and armature fitted",
    ),
    Plan(
        "dfki_double_pendulum_A",
        "judged",
        left_out="Coulomb and viscous friction, reflected rotor inertia, torque lag",
        only="sysid",
        metric=free_run(0.5, velocities="smoothed"),
        reference="shoulder 0.100 to 0.025 rad, elbow 0.342 to 0.081 rad",
    ),
    Plan(
        "multiarm_pendulum_double",
        "judged",
        left_out="bearing damping, zero offset of the encoders",
        metric=free_run(1.0),
        reference="none",
    ),
    Plan(
        "table_tennis_ball",
        "judged",
        left_out="air drag, Magnus force",
        metric=end_of_run(),
        reference="317 mm to 83 mm with the literature's coefficients",
        recording=first_flight,
    ),
    Plan(
        "rocket_coast",
        "judged",
        left_out="air drag",
        metric=best_start(10.0, "m"),
        reference="ballistic from the best start 7.9 to 57 m, with drag 3.2 to 10.8 m",
    ),
    Plan(
        "sts3215_backlash",
        "judged",
        left_out="play in the gear, dead band and softness of the position control",
        metric=free_run(2.0),
        reference="none published",
    ),
    Plan(
        "schmidt_lipson_double_pendulum",
        "judged",
        left_out="next to nothing: light bearing friction",
        metric=free_run(0.3, velocities="smoothed"),
        reference="0.0096 rad frictionless, 0.0091 with viscous friction",
    ),
)
