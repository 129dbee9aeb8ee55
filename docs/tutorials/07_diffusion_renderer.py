# %% [markdown]
# # 7. The diffusion renderer, and a camera of one's own
#
# *For whoever wants images from a learned renderer, or wants one that sees as an own camera does.* At the
# end you have frames by a diffusion model beside MuJoCo's, a number for how near they are, and you know
# which files a training on your own video needs. It takes about a minute.
#
# ## An episode to look at
#
# `push` is a task: an arm pushes a cube on a table. It has a script, so that an episode is one call.
# Each episode has a scene of its own (sizes, colours, friction).

# %%
import matplotlib.pyplot as plt
import numpy as np

import orbisim
from orbisim.tasks.registry import make

task = make("push")
scene, episode = task.scene("to_hit", 7), task.episode("to_hit", 7)
print(episode.steps, "control steps;", ", ".join(sorted(episode.arrays)))


def state(t):
    """The state of the episode before control step t."""
    return orbisim.State(*(episode.arrays[n][t][None] for n in ("time", "qpos", "qvel", "act")))


# %% [markdown]
# ## Two renderers, the same states
#
# `diffusion` is a renderer like any other: a state and a camera go in, an image comes out. It learned how
# cameras see this task, and ships with OrbiSim. In a `Physics`, `physics.use_renderer("diffusion")`
# switches to it in the middle of an episode.

# %%
times = np.linspace(0, episode.steps - 1, 4).astype(int)
frames = {}
for name in ("mujoco", "diffusion"):
    renderer = orbisim.make_renderer(name, scene)
    frames[name] = [renderer.render(state(t), camera="side", height=128, width=128) for t in times]
    renderer.close()

figure, axes = plt.subplots(2, 4, figsize=(7, 3.8), layout="constrained")
for row, name in zip(axes, frames, strict=True):
    for axis, image, t in zip(row, frames[name], times, strict=True):
        axis.imshow(np.squeeze(image))
        axis.set_title(f"{name}, {episode.arrays['time'][t]:.1f} s", fontsize=9)
        axis.axis("off")
plt.show()

# %% [markdown]
# ## How near is that?
#
# The usual measure is the peak signal-to-noise ratio. 20 dB is a rough likeness; 30 dB and more is hard
# to tell apart at a glance.

# %%
for t, true, made in zip(times, *frames.values(), strict=True):
    mean_square = np.mean((true / 255 - made / 255) ** 2)
    print(f"{episode.arrays['time'][t]:4.1f} s: {-10 * np.log10(mean_square):.1f} dB")

# %% [markdown]
# ## A camera of your own
#
# To train on your own video, put these into a folder, here `kitchen`:
#
# | file | holds |
# | --- | --- |
# | `scene.xml` (or `.urdf`, `.usd`) | the scene |
# | `recording.npz` (or `.csv`) | all joints and free bodies while the video runs |
# | `video.mp4`, or a folder `images` | what the camera saw |
# | `camera.json` | where it stands (`pos`, `rot`), its `intrinsics` in pixels, `start` of the video in s |
#
# ```sh
# orbisim train vision kitchen --out look --time-limit 1500 --device cuda   # needs a GPU
# orbisim sim kitchen/scene.xml --renderer diffusion:look --out out
# ```
#
# **Where to go on:** [vision](../vision.md) has how it works, what it cannot do, and the way back from a
# video to states; [benchmarks](../benchmarks.md#vision) what was measured.
