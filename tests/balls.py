"""A ball that is thrown beside a hinge with a servo, declared in steps that are too long."""

from __future__ import annotations

import orbisim
from orbisim.motion.samples import prepare_all
from orbisim.shooting.bench import Bench, make_bench
from orbisim.testing import inject_effect

BALL = """<mujoco><option timestep="{step}"/><worldbody>
  <geom name="floor" type="plane" size="5 5 .1"/>
  <body pos="0 0 .5"><freejoint name="free"/><geom type="sphere" size=".05" mass=".2"/></body>
  <body pos="1 0 1"><joint name="hinge" axis="0 1 0" damping=".01"/>
  <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".3"/></body></worldbody>
  <actuator><position name="servo" joint="hinge" kp="4" kv=".2"/></actuator></mujoco>"""


def in_long_steps() -> Bench:
    """Three recordings of a second in steps of 1 ms, of a scene that has 8 ms."""
    truth, scene = (orbisim.load_scene(BALL.format(step=step)) for step in (0.001, 0.008))
    runs = inject_effect(truth, [], duration=1.0, episodes=3, noise=2e-4, seed=1)
    return make_bench(scene, prepare_all(runs, scene), 0.25)
