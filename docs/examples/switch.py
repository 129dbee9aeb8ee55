"""Load a task, and switch backend and renderer in the middle of an episode."""

import numpy as np

import orbisim

environment = orbisim.suite.load("cartpole", "swingup", task_kwargs={"random": 0})
physics = environment.physics  # a dm_control Physics in every respect
action = np.array([0.3])

environment.reset()
for _ in range(50):
    environment.step(action)
kept = physics.snapshot()

ends = {}
for backend in ("mujoco", "learned"):  # C MuJoCo, then a learned model of the zoo
    physics.use_backend("mujoco")
    physics.restore(kept)
    physics.use_backend(backend)
    for _ in range(20):
        environment.step(action)
    ends[backend] = np.array(physics.data.qpos)
    print(f"{backend:8} cart {ends[backend][0]:+.4f} m, pole {ends[backend][1]:+.4f} rad")

print(f"apart by {np.abs(ends['learned'] - ends['mujoco']).max():.2g} after 20 steps")
