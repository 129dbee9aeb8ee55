"""Which suspects of a round are simulated, and from which values."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import orbisim
from orbisim.diagnosis.bench import Hypothesis
from orbisim.diagnosis.glances import Candidate, usual, varied
from orbisim.diagnosis.rounds import _earlier, _turns, distinct, stops
from orbisim.diagnosis.settings import Settings
from orbisim.diagnosis.state import Rival
from orbisim.effects import EffectInstance

SCENE = """
<mujoco model="box">
  <worldbody>
    <geom name="floor" type="plane" size="1 1 .1" friction=".5"/>
    <body name="box" pos="0 0 .1">
      <freejoint/>
      <geom name="shell" type="box" size=".1 .1 .1" mass="2" friction=".5"/>
    </body>
  </worldbody>
</mujoco>
"""


def friction(coefficient: float) -> EffectInstance:
    return EffectInstance("sliding_friction", "shell", {"coefficient": coefficient})


def payload(mass: float) -> EffectInstance:
    place = {"com_x": 0.0, "com_y": 0.0, "com_z": 9.0}
    return EffectInstance("payload", "box", {"mass": mass, **place})


def test_effects_are_also_tried_at_sizes_that_fit_the_scene() -> None:
    bench = SimpleNamespace(scene=orbisim.load_scene(SCENE))
    state: Any = SimpleNamespace(bench=bench, settings=Settings())
    bias = EffectInstance("sensor_bias", "box", {"offset": 0.1})
    candidates = usual(state, [payload(77.0), friction(50.0), payload(88.0), bias])
    found = [one.instance for one in candidates]
    masses = [e.values["mass"] for e in found if e.effect == "payload"]
    assert masses == pytest.approx([0.2, 0.6])
    assert all(e.values["com_z"] == 0 for e in found if e.effect == "payload")
    (offset,) = (e for e in found if e.effect == "com_offset")
    share = 77 / (77 + bench.scene.model.body("box").mass[0])
    assert offset.values["z"] == pytest.approx(9 * share)
    twice = candidates[0].sized(2.0)
    assert twice is not None
    assert (twice.values["mass"], twice.values["com_z"]) == pytest.approx((2 * masses[0], 0.0))
    offset = EffectInstance("com_offset", "box", {"offset": 0.1, "x": 0.0, "y": 0.0, "z": 0.1})
    more = [one.instance for one in usual(state, [offset])]
    assert [e.values["com_z"] > 0.1 for e in more if e.effect == "payload"] == [True] * 4


def test_few_forms_of_an_effect_and_the_better_of_two_fits() -> None:
    forms = [friction(0.1), payload(1.0), friction(0.2), friction(0.3)]
    starts = [Candidate(one) for one in forms]
    assert varied(starts, 1) == starts[:2]
    assert varied(starts, 2) == starts[:3]
    fits: list[Any] = [SimpleNamespace(hypothesis=Hypothesis((one,))) for one in forms]
    assert distinct(fits) == fits[:2]
    other = EffectInstance("sliding_friction", "shell", {"coefficient": 1.0}, {"side": "left"})
    assert len(distinct([*fits, SimpleNamespace(hypothesis=Hypothesis((other,)))])) == 3


HINGED = """
<mujoco>
  <worldbody>
    <body><joint name="first" axis="0 1 0"/><geom size=".1"/>
      <body pos="1 0 0"><joint name="second" axis="0 1 0"/><geom size=".1"/></body>
    </body>
  </worldbody>
</mujoco>
"""


def test_stops_are_tried_near_both_ends_of_the_travel() -> None:
    """At joints at which something is left, where simulation likes them best."""
    travel = np.linspace(-0.5, 1.5, 201)
    absolute = np.stack([travel, 0 * travel, 0 * travel, 0 * travel], axis=1)
    samples = SimpleNamespace(absolute=absolute, usable=np.ones(201, bool))
    bench = SimpleNamespace(scene=orbisim.load_scene(HINGED), contacts=False, samples=[samples])

    def glance(hypothesis: Hypothesis) -> float:
        return abs(hypothesis.effects[-1].values["position"] - 1.44)

    state: Any = SimpleNamespace(
        bench=bench, settings=Settings(), judge=SimpleNamespace(glance=glance)
    )
    shares = np.array([0.9, 0.01])
    upper, lower = stops(state, Hypothesis(), shares)
    assert upper.target == lower.target == "first"
    assert upper.values == pytest.approx({"position": 1.44, "side": 1.0})  # 3 % of the travel
    assert lower.values == pytest.approx({"position": -0.34, "side": -1.0})
    assert list(stops(state, Hypothesis((upper,)), shares)) == []
    state.settings = Settings(effects=("torque_bias",))
    assert list(stops(state, Hypothesis(), shares)) == []
    state.settings, bench.contacts = Settings(), True
    state.judge.glance_at_all = lambda tried: glance(tried) if tried.effects else 1.0
    assert [one.values for one in stops(state, Hypothesis(), shares)] == [upper.values]


def test_motion_that_begins_beyond_a_stop_shows_it_where_it_turns() -> None:
    begins = np.array([0.9, 0.6, 0.2, 0.5, 0.7, 0.3])  # at 0.9, and never again
    swings = np.array([0.0, 0.4, 0.71, 0.2, 0.69, 0.1])
    assert _turns([begins, swings], 0.05) == [0.9, 0.71]
    assert _turns([begins, swings], 0.005) == [0.9, 0.71, 0.7]
    assert _turns([np.array([0.1, 0.2])], 0.01) == [0.2]


def test_beside_an_added_joint_the_best_of_the_first_round_are_tried() -> None:
    """No regression sees them any more."""
    play = EffectInstance("backlash", "first", {"width": 0.02})
    damping = EffectInstance("viscous_damping", "first", {"coefficient": 0.1})
    soft = EffectInstance("joint_flexibility", "first", {"stiffness": 9.0, "damping": 0.1})
    rivals = [
        Rival(damping.replace(coefficient=0.2), 9.0, 2.0, 2),
        Rival(soft, 1.0, 2.0, 1),
        Rival(payload(0.1), 5.0, 2.0, 1),
        Rival(damping, 2.0, 2.0, 1),
        Rival(play, 0.0, 2.0, 1),
    ]
    state: Any = SimpleNamespace(rivals=rivals)
    found = [one.instance for one in _earlier(state, Hypothesis((play,)))]
    assert [one.effect for one in found] == ["viscous_damping", "payload"]
    assert found[0].values["coefficient"] == 0.1
