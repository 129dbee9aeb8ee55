# %% [markdown]
# # 1. Load a scene, switch the engine
#
# *For whoever writes dm_control code, or has a robot's scene, and wants another physics engine
# behind it.* At the end you have stepped one episode with two engines, changed the engine in the
# middle of it, and seen how far apart they are. It takes about ten seconds.
#
# ## A task of dm_control
#
# `orbisim.suite.load` takes what `dm_control.suite.load` takes and gives the same environment.
# Everything that you know of it works: `reset`, `step`, `physics.named`, wrappers.

# %%
import matplotlib.pyplot as plt
import numpy as np

import orbisim

environment = orbisim.suite.load("cartpole", "swingup", task_kwargs={"random": 0})
physics = environment.physics
environment.reset()
for _ in range(50):
    environment.step([0.4])  # push the cart to the right for half a second

plt.figure(figsize=(4, 2.5))
plt.imshow(physics.render(height=180, width=320, camera_id="fixed"))
plt.axis("off")
plt.title(f"after {physics.data.time:.2f} s")
plt.show()

# %% [markdown]
# ## Keep the state
#
# A *snapshot* is the whole state of the episode as one value. Keeping it is saving it, and
# `restore` brings it back, exactly, as often as you like.

# %%
kept = physics.snapshot()
for name in ("time", "qpos", "qvel"):
    print(f"{name:5} {np.round(getattr(kept, name), 4)}")

# %% [markdown]
# ## Switch the engine in the middle of the episode
#
# `use_backend` puts another engine behind the same `physics`. Here that is `learned`: a neural
# network that was trained on this task and ships with OrbiSim. The positions and velocities carry
# over exactly; only what happens next is up to the other engine.

# %%
paths = {}
for backend in ("mujoco", "learned"):
    physics.use_backend("mujoco")
    physics.restore(kept)
    physics.use_backend(backend)
    path = []
    for step in range(200):
        environment.step([0.4 * np.sin(0.1 * step)])
        path.append(np.array(physics.data.qpos))
    paths[backend] = np.array(path)

time = np.arange(1, 201) * environment.control_timestep()
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3), layout="constrained")
for backend, style in (("mujoco", "-"), ("learned", "--")):
    left.plot(time, paths[backend][:, 1], style, label=backend)
left.set(xlabel="time after the switch (s)", ylabel="angle of the pole (rad)")
left.legend()
right.semilogy(time, np.abs(paths["learned"] - paths["mujoco"]).max(axis=1), color="0.3")
right.set(xlabel="time after the switch (s)", ylabel="difference (m or rad)")
plt.show()

# %% [markdown]
# The curves lie on each other at first. The picture on the right shows how the difference grows:
# a pole that swings is chaotic, so that any two engines part in the end.
#
# ## Which engines are there?

# %%
print("backends: ", ", ".join(orbisim.available_backends()))
print("renderers:", ", ".join(orbisim.available_renderers()))

# %% [markdown]
# `mujoco` is C MuJoCo, `warp` is MuJoCo-Warp (made for thousands of worlds on a GPU; it compiles its
# kernels for about half a minute when it is first used), `learned` is the network, `hybrid` is
# MuJoCo with a learned correction. `physics.use_renderer("null")` switches rendering off.
#
# ## A scene of your own
#
# A scene can be a path to MJCF, URDF or USD, a task's name, or MJCF as text.
# `scene.descriptor` has every body, joint and actuator with units, and `scene.unsupported`
# lists what a file said and OrbiSim cannot do. Nothing is dropped in silence.

# %%
scene = orbisim.load_scene("""
<mujoco model="pendulum">
  <worldbody>
    <body name="rod" pos="0 0 1">
      <joint name="hinge" axis="0 1 0" damping="0.02"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.02" mass="0.3"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="hinge" ctrlrange="-2 2" ctrllimited="true"/></actuator>
</mujoco>
""")
print(scene.unsupported)
physics = orbisim.Physics.from_scene(scene)
with physics.reset_context():
    physics.named.data.qpos["hinge"] = 1.0
for _ in range(500):
    physics.step()
print(f"after {physics.data.time:.1f} s the hinge is at {physics.data.qpos[0]:+.3f} rad")

# %% [markdown]
# ## Many worlds at once
#
# Below `Physics` there is the backend itself. It takes a state and controls and gives a trajectory,
# for as many worlds as you ask for. States are values, too: nothing is ever changed in place.

# %%
backend = orbisim.make_backend("mujoco", scene, nworld=100)
start = backend.reset()
start = start.replace(qpos=np.linspace(-2, 2, 100)[:, None])  # another angle in each world
trajectory = backend.rollout(start, np.zeros((100, 1500, 1)))  # [world, step, actuator]
plt.figure(figsize=(10, 2.6), layout="constrained")
plt.plot(trajectory.time[0, ::5], trajectory.qpos[::20, ::5, 0].T, color="tab:blue", lw=0.8)
plt.xlabel("time (s)")
plt.ylabel("hinge (rad)")
plt.show()

# %% [markdown]
# **Where to go on:** [compare two engines](02_compare.ipynb) with numbers that say what is rounding
# and what is not; [the suite](../suite.md); [your own robot](../own-robot.md).
