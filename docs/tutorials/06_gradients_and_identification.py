# %% [markdown]
# # 6. Gradients and identification
#
# *For whoever wants to optimise something through a simulator: controls, a design, or the numbers of a
# scene.* At the end you have gradients of a rollout in PyTorch, through C MuJoCo as well as through a
# learned model, controls that were found with them, and a scene whose damping and friction were fitted
# to recordings. It takes about a minute.
#
# ## A gradient through any backend
#
# `orbisim.gradients.rollout` is the differentiable `backend.rollout`. A network is differentiated by
# PyTorch. An engine that knows no gradients, as C MuJoCo, is linearized at each step. Either way what
# you get is a list of states with tensors that you can build a loss from.
#
# How far does the pendulum get in one second, and how does that depend on each of 50 controls?

# %%
import matplotlib.pyplot as plt
import numpy as np
import torch

import orbisim
from orbisim.gradients import rollout
from orbisim.testing import inject_effect

scene = orbisim.load_scene("suite:pendulum-swingup")
learned = orbisim.make_backend("learned", scene)
nstep = round(learned.timestep / scene.model.opt.timestep)
ENGINES = {"mujoco": (orbisim.make_backend("mujoco", scene), nstep), "learned": (learned, 1)}


def end(name, controls):
    """The pendulum's angle after all controls, rad."""
    backend, steps = ENGINES[name]
    return rollout(backend, backend.reset(), controls, nstep=steps)[-1].qpos[0, 0]


gradients = {}
for name in ENGINES:
    controls = torch.full((1, 50, 1), 0.1, dtype=torch.float64, requires_grad=True)
    end(name, controls).backward()
    gradients[name] = controls.grad[0, :, 0].numpy()

# %% [markdown]
# Are they right? A gradient can always be checked against finite differences: change one control a
# little, simulate again, and see what became of the result.

# %%
with torch.no_grad():
    differences = []
    for k in range(0, 50, 7):
        up, down = torch.full((2, 1, 50, 1), 0.1, dtype=torch.float64)
        up[0, k], down[0, k] = 0.101, 0.099
        differences.append((end("mujoco", up) - end("mujoco", down)).item() / 0.002)

time = np.arange(50) * learned.timestep
plt.figure(figsize=(8, 3), layout="constrained")
for name, gradient in gradients.items():
    plt.plot(time, gradient, label=f"gradient through {name}")
plt.plot(time[::7], differences, "o", color="0.3", mfc="none", label="finite differences, mujoco")
plt.xlabel("when the control acts (s)")
plt.ylabel("d angle / d control (rad)")
plt.legend()
plt.show()

# %% [markdown]
# ## Find controls
#
# Gradient descent: which controls bring the pendulum 0.5 rad to the side within a second, and with as
# little effort as possible? `tanh` keeps them within the motor's range of -1 to 1.

# %%
start = float(ENGINES["mujoco"][0].reset().qpos[0, 0])
free = torch.zeros(1, 50, 1, dtype=torch.float64, requires_grad=True)
optimizer = torch.optim.Adam([free], lr=0.2)
for iteration in range(30):
    controls = torch.tanh(free)
    missed = end("mujoco", controls) - start - 0.5
    loss = missed.square() + 1e-3 * controls.square().mean()
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
    if iteration % 6 == 5:
        print(f"iteration {iteration + 1:2}: missed by {abs(missed.item()):.4f} rad")

# %% [markdown]
# ## Identification: which numbers does the scene have?
#
# If you know *what* is uncertain, `identify` fits it to recordings and gives an interval for each
# number. (If you do not know, that is [diagnosis](03_log_to_diagnosis.ipynb).) Here is a hinge whose
# damping and dry friction were guessed, and two recordings of a machine in which they are larger.

# %%
HINGE = """
<mujoco model="hinge">
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody><body name="rod">
    <joint name="hinge" axis="0 1 0" damping="{damping}" frictionloss="{friction}"/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.02" mass="0.5" contype="0" conaffinity="0"/>
  </body></worldbody>
  <actuator><motor name="motor" joint="hinge" ctrlrange="-2 2" ctrllimited="true"/></actuator>
</mujoco>"""
declared = orbisim.load_scene(HINGE.format(damping=0.02, friction=0.005))
machine = orbisim.load_scene(HINGE.format(damping=0.05, friction=0.03))

recordings = inject_effect(machine, [], episodes=2, duration=5.0, noise=3e-4, seed=1)
found = orbisim.identify(declared, recordings, "damping:hinge,frictionloss:hinge", backend="mujoco")
print("                    declared   found    95 % interval")
for p, value, low, high in zip(found.parameters, found.values, found.low, found.high, strict=True):
    print(f"{p.label:19} {p.declared:8.4f} {value:8.4f}   {low:.4f} to {high:.4f} {p.unit}")
print(f"error of free runs over 1 s: {found.before:.4f} -> {found.after:.4f} rad")

# %% [markdown]
# The values that the machine has, 0.05 and 0.03, lie in the intervals. `found.augmented` is the scene
# with the values found.
#
# **Where to go on:** [identification](../identification.md), also through a learned model that knows
# friction and density of what a robot pushes; [learned dynamics](../dynamics.md).
