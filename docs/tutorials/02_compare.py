# %% [markdown]
# # 2. Compare two engines
#
# *For whoever must know how far two physics engines, or two versions of a model, are apart.*
# At the end you have the error between two engines over time, you can tell rounding from real
# differences, and you have a report to send to somebody. It takes about a minute, most of it
# MuJoCo-Warp compiling its kernels for the first time.
#
# ## One call
#
# `compare` draws initial states and controls, runs exactly the same ones through both engines, and
# measures how far apart they are at each moment.

# %%
import matplotlib.pyplot as plt

import orbisim
from orbisim.compare import compare

result = compare("suite:cartpole-swingup", "mujoco", "warp", count=8, horizon=1.0)
summary = result.to_json()
for group, error in summary["error"].items():
    print(f"{group}: {error['median'][-1]:.2g} {error['unit']} after {result.horizon_s[-1]:.1f} s")

# %% [markdown]
# ## Is that much?
#
# C MuJoCo computes with 64 bits, MuJoCo-Warp with 32. So some difference must be there, and the
# question is whether there is *more* of it than rounding explains. For that, `compare` runs C MuJoCo
# against itself, once from the exact initial state and once from that state rounded to 32 bits. No
# 32-bit engine can be expected to do better than this.

# %%
other = compare("suite:cartpole-swingup", "mujoco", "learned", count=8, horizon=1.0)
plt.figure(figsize=(8, 3.2), layout="constrained")
for name, one in (("warp", summary), ("learned", other.to_json())):
    plt.semilogy(one["horizon_s"], one["error"]["joint_position"]["median"], label=name)
plt.semilogy(
    summary["horizon_s"],
    summary["rounding"]["joint_position"]["median"],
    color="0.5",
    ls="--",
    label="rounding alone",
)
plt.xlabel("time (s)")
plt.ylabel("median error of joints (m or rad)")
plt.legend()
plt.show()

# %% [markdown]
# MuJoCo-Warp stays near the dashed line: it computes the same physics with fewer digits. `learned` is
# a neural network that *approximates* this physics: its error is thousands of times larger, and still
# far below what one would see in a picture. Whether that is good enough depends on what you do with
# it; [the zoo](../zoo.md) says what to expect of each model.
#
# ## More than the error
#
# The result also holds the energy of both sides, the number of contacts, speeds, which episode is
# the worst, and plain words (`faults`) if an engine is wrong from the first steps on.

# %%
print("worst episode:", result.worst_episode, " diverged:", result.diverged)
print("faults:", result.faults or "none")
for side in (result.a, result.b):
    print(f"{side.backend:8} {side.control_step_s * 1e3:.0f} ms a control step")

# %% [markdown]
# ## A report
#
# `report` writes one HTML file that needs nothing else; `video=True` adds both engines side by
# side. On the command line it is
#
# ```sh
# orbisim compare suite:cartpole-swingup --a mujoco --b warp --out compare
# ```

# %%
print(result.report("compare", video=False))

# %% [markdown]
# ![A report](../images/report.png)
#
# ## A scene or a backend of your own
#
# Instead of `suite:...` name your own file. Instead of a backend's name give a checkpoint of your own
# (`learned:checkpoints/robot`) or a backend object. An object keeps the scene that it was made with, so
# that a scene can be compared with itself after a change, here a pendulum whose damping somebody got
# wrong:

# %%
PENDULUM = """
<mujoco>
  <worldbody><body>
    <joint name="hinge" axis="0 1 0" damping="{damping}"/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.02" mass="0.3"/>
  </body></worldbody>
  <actuator><motor joint="hinge" ctrlrange="-1 1" ctrllimited="true"/></actuator>
</mujoco>
"""
right = orbisim.load_scene(PENDULUM.format(damping=0.02))
wrong = orbisim.load_scene(PENDULUM.format(damping=0.03))
changed = compare(right, "mujoco", orbisim.make_backend("mujoco", wrong), horizon=2.0).to_json()
error = changed["error"]["joint_position"]
for share in (0, 99, 199):
    when = changed["horizon_s"][share]
    print(f"after {when:.2f} s: {error['median'][share]:.2g} rad (median of 16 episodes)")
