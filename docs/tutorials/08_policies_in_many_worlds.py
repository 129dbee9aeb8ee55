# %% [markdown]
# # 8. Policies in many worlds at once
#
# *For whoever trains or tries policies and knows dm_control or gymnasium.* At the end you have dm_control's
# task in 256 worlds, a policy that was searched there, and it beside one that ships with OrbiSim. It
# takes about a minute and a half.
#
# ## One task, many worlds
#
# `orbisim.vector.load` takes what `orbisim.suite.load` takes, and how many worlds. Observations are
# arrays whose first axis is the world. World `i` is, to the bit, dm_control's task with seed `i`.

# %%
import matplotlib.pyplot as plt
import numpy as np

import orbisim

WORLDS = 256
environment = orbisim.vector.load("cartpole", "balance", nworld=WORLDS, seed=0)
first = environment.reset()
for name, values in first.items():
    print(name, values.shape)

# %% [markdown]
# ## Search a policy
#
# The plainest policy is linear: the action is a weighted sum of the observations. Which weights? With
# many worlds we simply try: each world gets weights of its own, the best tenth says where to look
# next, and so on (the cross-entropy method). Every world is one trial, and all of them run at once.


# %%
def returns(weights, steps=200):
    """Sum of rewards over `steps` control steps; weights [world, observation]."""
    observation = environment.reset(seed=0)
    total = np.zeros(WORLDS)
    for _ in range(steps):
        seen = np.concatenate([observation[name] for name in ("position", "velocity")], axis=1)
        action = np.clip((weights * seen).sum(axis=1, keepdims=True), -1, 1)
        observation, reward, _, _ = environment.step(action)
        total += reward
    return total


random = np.random.default_rng(0)
mean, spread, history = np.zeros(5), 2.0 * np.ones(5), []
for _ in range(8):
    weights = mean + spread * random.normal(size=(WORLDS, 5))
    scores = returns(weights)
    best = weights[np.argsort(scores)[-WORLDS // 10 :]]
    mean, spread = best.mean(axis=0), best.std(axis=0) + 0.05
    history.append(np.percentile(scores, [10, 50, 90]))
history = np.array(history)

plt.figure(figsize=(8, 2.8), layout="constrained")
plt.fill_between(range(1, 9), history[:, 0], history[:, 2], alpha=0.3, label="10 % to 90 %")
plt.plot(range(1, 9), history[:, 1], label="median of 256 worlds")
plt.axhline(200, color="0.5", ls="--", label="highest possible")
plt.xlabel("round")
plt.ylabel("return")
plt.legend()
plt.show()

# %% [markdown]
# ## Is it robust?
#
# Try the policy on carts that differ: pole and cart up to 60 % heavier or lighter, drawn anew in each
# episode. `randomize` takes any field of MuJoCo's model.

# %%
from orbisim.vector import factor

print(f"as declared: {returns(np.tile(mean, (WORLDS, 1))).mean():.1f} of 200")
environment = orbisim.vector.load(
    "cartpole", "balance", nworld=WORLDS, seed=0, randomize={"body_mass": factor(0.4, 1.6)}
)
scores = returns(np.tile(mean, (WORLDS, 1)))
print(f"randomised:  {scores.mean():.1f} of 200, the worst of {WORLDS} worlds {scores.min():.1f}")

# %% [markdown]
# ## Other libraries
#
# The same environment speaks the languages of the common libraries: `orbisim.vector.gym(environment)` is
# a gymnasium `VectorEnv`, `orbisim.vector.StableBaselinesVecEnv(environment)` goes into PPO or SAC of
# Stable-Baselines3. `backend="warp"` steps on a GPU.

# %%
vectorised = orbisim.vector.gym("cartpole", "balance", 4)
print(vectorised.single_observation_space)
print(vectorised.single_action_space)

# %% [markdown]
# ## A policy that ships
#
# Five trained policies ship: `push`, `push_ppo`, `push_pixels`, `pendulum` and `cartpole`. `orbisim eval policy` says
# how good one is: in C MuJoCo, in episodes that it has not seen, with 95 % intervals. Beside it stand
# the same episodes inside the learned model that it was trained in: where the model promises more than
# MuJoCo keeps, the policy exploits it.

# %% language="bash"
# orbisim eval policy cartpole --episodes 4 --seed 0

# %% [markdown]
# `orbisim sim TASK --policy NAME` runs it, and with `--renderer mujoco` makes a video. A policy for
# another scene is refused.

# %% language="bash"
# orbisim sim suite:cartpole-swingup --policy cartpole --renderer mujoco --duration 4 --out swingup

# %%
import imageio.v3 as iio

frames = iio.imread("swingup/video.mp4")
figure, axes = plt.subplots(1, 5, figsize=(10, 1.8), layout="constrained")
for axis, share in zip(axes, np.linspace(0, 1, 5), strict=True):
    axis.imshow(frames[round(share * (len(frames) - 1))])
    axis.set_title(f"{4 * share:.0f} s")
    axis.axis("off")
plt.show()

# %% [markdown]
# ## Train your own
#
# Each line trains one: by gradients through the learned step, which wants a GPU or patience, or by PPO
# in C MuJoCo (`pip install 'orbisim[sb3]'`), which takes minutes on any machine. Both go on after a kill
# with `--resume`, exactly where they were.
#
# ```sh
# orbisim train policy suite:cartpole-swingup --method apg --horizon 25 --rate 5e-4 --time-limit 440 --device cuda --out mine
# orbisim train policy suite:cartpole-swingup --method ppo --worlds 32 --steps 250000 --out mine_ppo
# ```
#
# **Where to go on:** [many worlds](../vector.md) for tasks of your own and other backends;
# [policies](../policies.md) for training by gradients through the learned step, and for what a
# diagnosis is worth to a policy.
