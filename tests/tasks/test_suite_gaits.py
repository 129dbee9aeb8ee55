"""Gaits: springs to targets that swing."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from dm_control import suite

from orbisim.tasks.suite_gaits import GAITS, Gait, gait_policy

MODEL = mujoco.MjModel.from_xml_string("""
<mujoco><worldbody><body><joint name="x" type="slide"/><joint name="z" type="slide" axis="0 0 1"/>
<joint name="torso" axis="0 1 0"/><geom size=".1"/>
<body><joint name="hip" axis="0 1 0"/><geom size=".1"/></body></body></worldbody>
<actuator><motor joint="hip"/></actuator></mujoco>""")


def control(time: float = 0.0, **changes: object) -> float:
    """With the hip at 0.2 rad and 3 rad/s, the torso at 0.4 rad and 5 rad/s."""
    values: dict = {
        "offset": (0.0,),
        "amplitude": (0.0,),
        "phase": (0.0,),
        "pitch": (0.0,),
        "pitch_rate": (0.0,),
        "frequency": 1.0,
        "stiffness": 0.0,
        "damping": 0.0,
    }
    data = mujoco.MjData(MODEL)
    data.time, data.qpos[2:], data.qvel[2:] = time, [0.4, 0.2], [5.0, 3.0]
    return float(gait_policy(Gait(**{**values, **changes}), MODEL)(data)[0])


def test_each_term_by_itself() -> None:
    assert control(stiffness=2.0, offset=(0.5,)) == pytest.approx(2.0 * (0.5 - 0.2))
    assert control(damping=0.1) == pytest.approx(-0.3)
    assert control(pitch=(2.0,)) == pytest.approx(0.8)
    assert control(pitch_rate=(2.0,)) == pytest.approx(10.0)
    swing = control(0.25, stiffness=1.0, amplitude=(0.7,), frequency=0.5, phase=(0.3,))
    assert swing == pytest.approx(0.7 * np.sin(2 * np.pi * 0.5 * 0.25 + 0.3) - 0.2)


@pytest.mark.parametrize(("domain", "task"), [("walker", "walk"), ("cheetah", "run"),
                                              ("finger", "spin"), ("hopper", "hop")])  # fmt: skip
def test_gaits_fit_their_machines(domain: str, task: str) -> None:
    model = suite.load(domain, task).physics.model
    gait = GAITS[domain]
    rows = (gait.offset, gait.amplitude, gait.phase, gait.pitch, gait.pitch_rate)
    assert {len(row) for row in rows} == {model.nu}
