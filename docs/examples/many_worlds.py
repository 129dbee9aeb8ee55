"""dm_control's task in many worlds at once, and a fleet of robots that differ."""

import numpy as np

import orbisim

environment = orbisim.vector.load("cartpole", "swingup", nworld=16)
step = environment.reset(seed=0)
random, returns = np.random.default_rng(0), np.zeros(16)
for _ in range(50):
    action = random.uniform(-1, 1, (16, 1))
    step = environment.step(action)
    returns += step.reward
print(f"returns of a random policy over 50 steps: {returns.mean():.2f} +- {returns.std():.2f}")

scene = orbisim.load_scene("suite:cartpole-swingup")
backend = orbisim.make_backend("mujoco", scene, nworld=16)
controls = random.uniform(-1, 1, (16, 100, scene.model.nu))
trajectory = backend.rollout(backend.reset(), controls)  # all cores
print(
    "rollout of 16 worlds:", trajectory.qpos.shape, "diverged:", trajectory.diverged_at.max() >= 0
)
