"""What is run for each measured data set, and why."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np

from closing.metrics import Metric, end_of_run, free_run, position_after, torque_residual
from orbisim.recording import Recording
from orbisim.scene import Scene, load_scene

ASSETS = Path(__file__).resolve().parents[2] / "mjcf_assets"


def _same(recording: Recording) -> Recording:
    return recording


@dataclasses.dataclass(frozen=True)
class Plan:
    """How a set is diagnosed and scored.

    Attributes:
      name: of the set. left_out: what the declared scene lacks, by the set's publication.
      window: of the diagnosis, s. why: of this window and these options.
      metric: on the held-out recordings. reference: figures known from elsewhere, in words.
      fit, held_out: at most so many recordings, evenly spread; None for all.
      settings: other than the defaults. residual: what is explained.
      only: held-out recordings whose names start so; all if empty.
      recording: what is done to each recording first.
      shortest: samples that a recording needs for the diagnosis; shorter ones are only scored.
    """

    name: str
    left_out: str
    window: float
    why: str
    metric: Metric
    reference: str
    fit: int | None = None
    held_out: int | None = None
    settings: dict[str, Any] = dataclasses.field(default_factory=dict)
    residual: Literal["motion", "force"] = "motion"
    only: str = ""
    recording: Callable[[Recording], Recording] = _same
    shortest: int = 3

    def scene(self, kind: str = "scene") -> Scene:
        """The declared scene (`scene`) or the published one (`published`)."""
        return load_scene(ASSETS / self.name / f"{kind}.xml", trusted=True)

    @property
    def published(self) -> bool:
        """Whether there is a published model."""
        return (ASSETS / self.name / "published.xml").exists()


def pose_as_joint(recording: Recording) -> Recording:
    """The pose of the cube as the position of its free joint [T, 7], which sensors can distort."""
    signals = dict(recording.signals)
    pose = np.concatenate([signals.pop("xpos/cube"), signals.pop("xquat/cube")], axis=1)
    return recording.replace(signals={**signals, "qpos/cube": pose})


def first_flight(recording: Recording, clear: float = 0.03) -> Recording:
    """Until the ball first comes closer to the table than so many m: the spin is of this flight."""
    low = recording["xpos/ball"][:, 2] < clear
    return recording.rows(slice(0, int(np.argmax(low)) if low.any() else len(recording)))


def _kuka() -> Scene:
    return load_scene(ASSETS / "kuka_kr300" / "scene.xml", trusted=True)


_REAL = 0.95
"""Share of the residual's amplitude that an explanation may leave. On a real machine every model
leaves much more than the noise of an encoder, the published ones too; with the default of 0.35 the
diagnosis says `unexplained` and names nothing. Held-out data still has to confirm what is found."""

_BEARING = (
    "coulomb_friction",
    "viscous_damping",
    "quadratic_damping",
    "quadratic_drag",
    "sensor_bias",
    "gravity_tilt",
)
"""What a bearing, the air, an encoder and a frame that is not level can do."""

PLANS = (
    Plan(
        "emps",
        left_out="Coulomb and viscous friction, offset",
        window=1.0,
        why="a stroke takes a few seconds; friction acts within one",
        metric=free_run(0.5, "mm", 1e3),
        reference="force residual 70 % to 3.6 % of the force",
    ),
    Plan(
        "contactnets_cube",
        left_out="sliding friction of the board (declared: MuJoCo's default, 1)",
        window=0.2,
        why="short enough for windows between the impacts, which cannot be predicted through",
        metric=position_after(0.5),
        reference="166 mm to 44 mm with the published friction",
        fit=24,
        settings={
            "most_effects": 4,
            "most_left": _REAL,
            "tolerance": 0.5,  # friction shows in windows with contact only, the later ones
            "windows": 24,
            # what contacts and cameras do
            "effects": (
                "sliding_friction",
                "torsional_friction",
                "contact_compliance",
                "restitution",
                "sensor_scale",
                "clock_skew",
            ),
        },
        recording=pose_as_joint,
    ),
    Plan(
        "table_tennis_ball",
        left_out="air drag, Magnus force",
        window=0.2,
        why="cut 3 cm above the table: the spin is known until the first bounce only",
        metric=end_of_run(),
        reference="317 mm to 83 mm with the literature's coefficients",
        settings={
            "most_effects": 2,
            "most_left": _REAL,
            "robust": 4.0,  # stray positions of the cameras
            # what acts on a ball in the air; all flights go the same way, so that a constant
            # force, or tilted gravity, looks like drag
            "effects": ("quadratic_drag", "linear_drag", "magnus", "buoyancy"),
        },
        recording=first_flight,
        shortest=32,
    ),
    Plan(
        "dfki_simple_pendulum",
        left_out="Coulomb and viscous friction, reflected rotor inertia",
        window=0.5,
        why="balancing upright is unstable: over 1 s errors grow beyond what can be fitted",
        metric=free_run(1.0, velocities="smoothed"),
        reference="energy_shaping 0.168 to 0.065 rad, ddp 0.185 to 0.078 rad",
    ),
    Plan(
        "dfki_double_pendulum_A",
        left_out="Coulomb and viscous friction, reflected rotor inertia, torque lag",
        window=0.5,
        why="the window of the reference; the swing-ups of the pendubot, which balance upright, "
        "are left out: a free run there is unstable",
        only="sysid",
        metric=free_run(0.5, velocities="smoothed"),
        reference="shoulder 0.100 to 0.025 rad, elbow 0.342 to 0.081 rad",
        settings={"most_effects": 6},
    ),
    Plan(
        "multiarm_pendulum_single",
        left_out="bearing damping, zero offset of the encoder",
        window=2.0,
        why="the decay is slow; two swings show it",
        metric=free_run(5.0),
        reference="0.196 to 0.054 rad over 5 s",
    ),
    Plan(
        "multiarm_pendulum_double",
        left_out="bearing damping, zero offset of the encoders",
        window=1.0,
        why="chaotic over longer windows",
        metric=free_run(1.0),
        reference="none",
        fit=5,
        settings={"most_left": _REAL, "windows": 24, "effects": _BEARING},
    ),
    Plan(
        "kuka_kr300",
        left_out="payload, counterbalance spring, gear friction",
        window=0.4,
        why="the torques are the controller's answer to the motion, so that what is explained is "
        "the torque by inverse dynamics; windows play no part",
        metric=torque_residual(_kuka),
        reference="799/1191/2236/167/510/226 to 178/360/383/61/52/42 N·m",
        residual="force",
        settings={
            # what a heavy arm of slow joints can have: no medium drags on it, and nothing floats
            "effects": (
                "coulomb_friction",
                "viscous_damping",
                "quadratic_damping",
                "joint_spring",
                "armature",
                "payload",
                "com_offset",
                "torque_bias",
            ),
        },
    ),
    Plan(
        "sts3215_backlash",
        left_out="play in the gear, dead band and softness of the position control",
        window=2.0,
        why="ten samples a second: only steady states mean something",
        metric=free_run(2.0),
        reference="none published",
        settings={"most_left": _REAL, "windows": 24},
    ),
)
