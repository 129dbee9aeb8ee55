# %% [markdown]
# # 5. Your own robot, from URDF to a learned model
#
# *For whoever has a URDF and wants to simulate it, and then a neural network that has learned its
# motion.* At the end your robot runs, you have a model of it that is a backend like any other, and
# you know how good it is. It takes about two minutes.
#
# ## A URDF
#
# Yours is a file already. This one has two links and, as all URDF, says nothing of motors.

# %%
from pathlib import Path

import matplotlib.pyplot as plt

import orbisim
from orbisim.compare import compare

LINK = """
  <link name="{name}">
    <inertial><origin xyz="0 0 {com}"/><mass value="{mass}"/>
      <inertia ixx="{i}" iyy="{i}" izz="0.0005" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><origin xyz="0 0 {com}"/><geometry><cylinder radius="0.03" length="{length}"/></geometry>
      <material name="{name}"><color rgba="{rgba}"/></material></visual>
  </link>"""
JOINT = """
  <joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>
    <origin xyz="0 0 {z}"/><axis xyz="0 1 0"/><dynamics damping="0.5"/>
    <limit lower="-2" upper="2" effort="20" velocity="6"/></joint>"""
Path("robot.urdf").write_text(
    '<robot name="robot">\n  <link name="base"/>'
    + LINK.format(name="upper", com=0.2, length=0.4, mass=1.0, i=0.0134, rgba="0.2 0.4 0.8 1")
    + LINK.format(name="lower", com=0.15, length=0.3, mass=0.5, i=0.0038, rgba="0.9 0.5 0.1 1")
    + JOINT.format(name="shoulder", parent="base", child="upper", z=0.2)
    + JOINT.format(name="elbow", parent="upper", child="lower", z=0.4)
    + "\n</robot>\n"
)

# %% [markdown]
# ## Does it load?
#
# `orbisim info` prints what was read. The lines to read first are those that say what was left out or
# assumed. `--actuators position` puts a position servo at every joint that moves; without actuators
# nothing can be controlled.

# %% language="bash"
# orbisim info robot.urdf --actuators position

# %% [markdown]
# ## Does it move?

# %%
scene = orbisim.load_scene("robot.urdf", actuators="position", actuate="all")
physics = orbisim.Physics.from_scene(scene)
camera = {"lookat": [0, 0, 0.4], "distance": 2.0, "azimuth": 90.0, "elevation": -10.0}
figure, axes = plt.subplots(1, 4, figsize=(10, 2.6), layout="constrained")
for axis in axes:
    axis.imshow(physics.render(200, 200))
    axis.set_title(f"{physics.data.time:.2f} s")
    axis.axis("off")
    physics.set_control([1.0, -1.5])  # where the servos are to go, rad
    physics.step(100)
plt.show()

# %% [markdown]
# ## Collect motion to learn from
#
# `collect` moves the robot in four ways (random controls that are held, smooth noise, sums of sines,
# reaching for random poses) and writes what happens into a file. 60 episodes are enough to see how it
# works; take thousands for a model that you will use.

# %% language="bash"
# orbisim collect robot.urdf --actuators position --episodes 60 --out robot.h5

# %% [markdown]
# ## Train
#
# 50 seconds of two CPU cores here, with a small network and small batches (`--set`). On a GPU leave
# out `--set` and take `--device cuda --time-limit 1200`. If the result
# predicts worse than the plainest guess (that velocities stay as they are), a warning says: do not use
# it.

# %% language="bash"
# orbisim train dynamics robot.h5 --scene robot.urdf --actuators position \
#   --set model.width=64 --set model.layers=2 \
#   --set train.stages=0.6x1x1024,0.4x8x128ar --time-limit 50 --out checkpoints/robot

# %% [markdown]
# ## Use it
#
# The model is a backend: `learned:` and its folder. Here it drives the same robot, beside C MuJoCo.

# %%
result = compare(scene, "mujoco", "learned:checkpoints/robot", count=8, horizon=1.0).to_json()
error = result["error"]["joint_position"]
plt.figure(figsize=(8, 2.8), layout="constrained")
plt.plot(result["horizon_s"], error["median"], label="median of 8 episodes")
plt.plot(result["horizon_s"], error["p95"], color="0.6", label="95 %")
plt.xlabel("time (s)")
plt.ylabel("error of joints (rad)")
plt.legend()
plt.show()

# %% [markdown]
# After so short a training this is a model to look at, not one to use. What it would be good for, once
# trained longer: gradients ([tutorial 6](06_gradients_and_identification.ipynb)), thousands of worlds
# on a GPU, and policies.
#
# **Where to go on:** [your own robot](../own-robot.md) has the options of URDF and `--randomize`, by
# which the model learns what masses and dampings do; [learned dynamics](../dynamics.md) what it can and
# cannot do; [trainings](../trainings.md) how the shipped models were trained.
