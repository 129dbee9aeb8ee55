# %% [markdown]
# # 3. From your robot's log to what your scene lacks
#
# *For whoever has a log of a real machine and a scene that does not move as the machine does.*
# At the end you have the physical effect that the scene lacks, with its size and how sure that is,
# and the line to change in your own file. It takes about a minute.
#
# ## A scene and a log
#
# This is the scene: an arm of two joints, as its drawings say.

# %%
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import orbisim

Path("arm.xml").write_text("""\
<mujoco model="arm">
  <!-- masses weighed on Monday -->
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

# %% [markdown]
# And these are four logs of the machine. You have yours; here we make them. The "machine" has an elbow
# that rubs, which the scene says nothing of, and a logger with habits of its own: milliseconds since
# 1970, degrees, milli-newton-metres, its own names, and a shoulder that counts the other way round.

# %%
from orbisim.effects import EffectInstance
from orbisim.testing import inject_effect

rubbing = EffectInstance("coulomb_friction", "elbow", {"torque": 0.12})
measured = inject_effect(
    orbisim.load_scene("arm.xml"), rubbing, noise=2e-4, duration=6.0, velocities=False, seed=7
)
HEADER = "timestamp [ms],j1_pos [deg],j2_pos [deg],j1_cmd [mNm],j2_cmd [mNm]"
for number, one in enumerate(measured):
    columns = [
        1_700_000_000_000 + 1e3 * one.time,
        -np.degrees(one["qpos/shoulder"]),
        np.degrees(one["qpos/elbow"]),
        -1e3 * one["ctrl/shoulder"],
        1e3 * one["ctrl/elbow"],
    ]
    formats = ["%.0f", "%.5f", "%.5f", "%.2f", "%.2f"]
    np.savetxt(f"log{number}.csv", np.transpose(columns), formats, ",", header=HEADER, comments="")
print(Path("log0.csv").read_text()[:200], "...")

# %% [markdown]
# ## What is in the log?
#
# `orbisim recording info` looks into any log (CSV, Parquet, HDF5, ROS bags, MCAP, LeRobot).

# %% language="bash"
# orbisim recording info log0.csv --scene arm.xml

# %% [markdown]
# ## Say which column is what
#
# `orbisim recording init log0.csv --scene arm.xml --out map.yaml` writes a first guess, by likeness of
# names and by units. Check every line of it. Here the names say little, so we write the map ourselves.
# Units stand in the headers already; the map adds the names and the sign of the first joint.

# %%
Path("map.yaml").write_text("""\
columns:
  "timestamp [ms]": time
  "j1_pos [deg]": {signal: qpos/shoulder, sign: -1}
  "j2_pos [deg]": qpos/elbow
  "j1_cmd [mNm]": {signal: ctrl/shoulder, sign: -1}
  "j2_cmd [mNm]": ctrl/elbow
""")
recordings = [orbisim.Recording.load(f"log{k}.csv", "map.yaml") for k in range(4)]
print(recordings[0])

# %% [markdown]
# ## How wrong is the scene?
#
# `replay` starts the simulation from a recorded state, gives it the recorded controls, and lets it run
# free for half a second; then again from the next state on. The error is what builds up in that time.

# %%
before = orbisim.replay("arm.xml", recordings)
print(f"error {before.rms:.3f} rad; the sensor's noise is {before.signals['qpos/elbow'].noise:.1g}")

# %% [markdown]
# ## Why?
#
# `diagnose` searches a catalogue of effects at every joint, actuator, body and sensor. It keeps some
# data aside that nothing is fitted to, and reports the error on these.

# %%
found = orbisim.diagnose("arm.xml", recordings, out="diagnosis", progress=False)
print(found.verdict)
print(found.sentence)

# %% [markdown]
# The verdict `explained` means that nothing but the sensor's noise is left. Had no effect helped, it
# would have said `unexplained` and named suspects; had the scene been right, `no_residual`.
#
# What to change in *your* file stands in `diagnosis/augmented/patch.diff`; formatting and comments
# stay as they are. `patch -p1 < diagnosis/augmented/patch.diff` applies it.

# %%
print(found.patch.text)

# %% [markdown]
# ## Before and after

# %%
after = orbisim.replay(found.augmented_scene, recordings)
print(f"error {before.rms:.3f} -> {after.rms:.5f} rad")
figure, axes = plt.subplots(1, 2, figsize=(10, 3), sharey=True, layout="constrained")
for axis, result, title in zip(
    axes, (before, after), ("as declared", "with friction"), strict=True
):
    for window in result.windows[:6]:  # the first three seconds of the first log
        axis.plot(window.time, window.measured["qpos/elbow"], color="0.6", lw=4)
        axis.plot(window.time, window.simulated["qpos/elbow"], color="tab:red", lw=1)
    axis.set(title=title, xlabel="time (s)")
axes[0].set_ylabel("elbow (rad): measured, simulated")
plt.show()

# %% [markdown]
# What is left, a thousandth of a radian, comes from the starts: the log has no velocities, so each
# window starts with one that is estimated from noisy positions. The true scene leaves just as much.
#
# The report, `diagnosis/report.html`, has all of this and what else was tried, each with the reason
# why it was not taken.
#
# **On the command line** the whole tutorial is
#
# ```sh
# orbisim recording init log0.csv --scene arm.xml --out map.yaml   # check map.yaml
# orbisim diagnose arm.xml log*.csv --map map.yaml --out diagnosis
# ```
#
# **Where to go on:** [recordings](../recordings.md) for other formats and for what may go wrong in a
# log; [diagnosis](../diagnosis.md) for how the search decides; [a fleet](04_fleet.ipynb) if you have
# many robots of one kind; [measured machines](../closing-the-loop.md) for how well it does on real data.
