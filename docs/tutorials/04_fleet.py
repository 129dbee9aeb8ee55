# %% [markdown]
# # 4. A fleet: which robot is unlike the others?
#
# *For whoever has several robots of one kind and recordings of each.* At the end you have one table
# of robots by physical effects, in which the robots that differ are marked. It takes about a minute
# and a half.
#
# ## Recordings: a folder for each robot
#
# You have `fleet/arm1/*.csv`, `fleet/arm2/*.csv` and so on. Here we make such folders for five arms.
# All of them rub a little at the shoulder, each a little differently, and the scene does not say so:
# that is how this kind of robot *is*. One of them, `arm3`, also has a worn gear at the elbow.

# %%
import csv
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import orbisim
from orbisim.effects import EffectInstance
from orbisim.testing import inject_effect

Path("two_joints.xml").write_text("""\
<mujoco model="arm">
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="upper_arm">
      <joint name="shoulder" axis="0 1 0" damping="0.15"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.025" mass="1.2" contype="0" conaffinity="0"/>
      <body name="forearm" pos="0 0 -0.3">
        <joint name="elbow" axis="0 1 0" damping="0.06"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.02" mass="0.7" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="shoulder" joint="shoulder" ctrlrange="-5 5" ctrllimited="true"/>
    <motor name="elbow" joint="elbow" ctrlrange="-1.5 1.5" ctrllimited="true"/>
  </actuator>
</mujoco>
""")  # fmt: skip

scene = orbisim.load_scene("two_joints.xml")
random = np.random.default_rng(0)
for number in range(1, 6):
    friction = 0.1 * random.uniform(0.95, 1.05)
    effects = [EffectInstance("coulomb_friction", "shoulder", {"torque": friction})]
    if number == 3:
        effects.append(EffectInstance("coulomb_friction", "elbow", {"torque": 0.12}))
    folder = Path("fleet", f"arm{number}")
    folder.mkdir(parents=True, exist_ok=True)
    for run, one in enumerate(inject_effect(scene, effects, duration=3.0, seed=number)):
        one.save(folder / f"run{run}.csv")
print(*sorted(str(path) for path in Path("fleet").glob("*/*0.csv")), sep="\n")

# %% [markdown]
# ## One command
#
# Each robot is diagnosed on its own, in a process of its own. `--effect` restricts the search to a few
# effects, which keeps this tutorial short; leave it out to search the whole catalogue. If the command
# is stopped, the same command goes on where it was.

# %% language="bash"
# orbisim diagnose two_joints.xml --fleet fleet --out fleet-diagnosis \
#   --effect coulomb_friction --effect viscous_damping --effect payload --effect sensor_bias

# %% [markdown]
# A number is marked with `!` if it is farther from the fleet's median than the scatter of the fleet
# and its own uncertainty explain. So the shoulder's friction, which *all* arms have, is no alarm, though
# the scene lacks it; the elbow of `arm3` is.
#
# ## The same as data
#
# `fleet-diagnosis/report.html` is the page to look at, `fleet.csv` has one line for each robot and
# number, and each robot's own report stands in `fleet-diagnosis/robots`.

# %%
rows = list(csv.DictReader(Path("fleet-diagnosis/fleet.csv").open()))
effects = sorted({(row["effect"], row["target"]) for row in rows if row["unit"] == "N*m"})
figure, axis = plt.subplots(figsize=(8, 2.8), layout="constrained")
for place, (effect, target) in enumerate(effects):
    own = [row for row in rows if (row["effect"], row["target"]) == (effect, target)]
    at = place * 6 + np.arange(len(own))
    unlike = [row["outlier"] == "1" for row in own]
    axis.bar(at, [float(row["value"]) for row in own], color=["C3" if u else "C0" for u in unlike])
    axis.text(at.mean(), 0.13, f"{effect} {target}", ha="center")
axis.set_xticks([0, 1, 2, 3, 4, 6, 7, 8, 9, 10], 2 * [f"arm{k}" for k in range(1, 6)])
axis.set(ylabel="N·m", ylim=(0, 0.145))
plt.show()

# %% [markdown]
# **Where to go on:** [fleets](../fleet.md) has the rule, an example of twelve arms with three kinds of
# fault, and how to spread the work over a cluster with `--ray`.
