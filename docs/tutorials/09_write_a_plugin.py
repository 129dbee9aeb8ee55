# %% [markdown]
# # 9. Write a plug-in: an effect, a scene format, an engine
#
# *For whoever misses something in OrbiSim and can write a class in Python.* At the end you have added a
# physical effect that `diagnose` finds in data, a scene format that `load_scene` reads, and an engine
# that everything else works with. It takes about half a minute.
#
# ## An effect
#
# An effect is a class that says which parameters it has, how it is simulated (a *hook* adds forces
# before each timestep), and which force it exerts along a measured motion, so that a search can propose
# it. This one is a magnetic brake at a joint: a torque that is strongest at some speed and fades beyond
# it, c·v / (1 + (v / v₀)²). No catalogue has it.

# %%
import matplotlib.pyplot as plt
import mujoco
import numpy as np

import orbisim
from orbisim.diagnosis import Settings
from orbisim.effects import Effect, EffectInstance, Hook, Parameter, register
from orbisim.effects.screening import Candidate, Column
from orbisim.testing import inject_effect


def brake(speed, coefficient, fastest):
    return -coefficient * speed / (1 + (speed / fastest) ** 2)


class BrakeHook(Hook):
    def __init__(self, values, dof):
        super().__init__(values)
        self.dof = dof

    def force(self, inputs):  # arrays with a row for each world
        speed = inputs.qvel[:, self.dof]
        inputs.qfrc[:, self.dof] += brake(speed, self.value("coefficient"), self.value("speed"))


class MagneticBrake(Effect):
    name = "magnetic_brake"
    kind = "joint"
    phrase = "a magnetic brake"
    native = False  # MJCF cannot express it: it travels in <custom>, and the hook applies it

    def parameters(self, model, target):
        return (
            Parameter("coefficient", "N*m*s/rad", 0.0, 1e3, 0.1),
            Parameter("speed", "rad/s", 1e-2, 1e3, 2.0),
        )

    def hook(self, model, instance):
        return BrakeHook(instance.values, model.joint(instance.target).dofadr[0])

    def screen(self, view, target):
        dof = view.model.joint(target).dofadr[0]
        for speed in np.geomspace(0.3, 10, 8):  # enters nonlinearly: some values are tried
            force = np.zeros_like(view.qvel)
            force[:, dof] = brake(view.qvel[:, dof], 1.0, speed)
            yield Candidate(self.name, target, (Column("force", force),), solve(speed), shape=1)


def solve(speed):
    """Parameters from the coefficient that a regression gives the column."""
    return lambda c: {"coefficient": float(c[0]), "speed": speed} if c[0] > 0 else None


register(MagneticBrake())

# %% [markdown]
# Now it is an effect like any other. We give it to a simulated machine, record that, and ask what the
# scene lacks. The other candidates are the usual suspects for a joint that loses energy.

# %%
PENDULUM = """
<mujoco model="pendulum">
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody><body name="rod">
    <joint name="hinge" axis="0 1 0" damping="0.01"/>
    <geom type="capsule" fromto="0 0 0 0 0 -{length}" size="0.02" mass="0.5"/>
  </body></worldbody>
  <actuator><motor name="motor" joint="hinge" ctrlrange="-2 2" ctrllimited="true"/></actuator>
</mujoco>"""
scene = orbisim.load_scene(PENDULUM.format(length=0.5))
hidden = EffectInstance("magnetic_brake", "hinge", {"coefficient": 0.3, "speed": 1.5})
recordings = inject_effect(scene, hidden, noise=2e-4, duration=5.0, seed=3)

usual = ("viscous_damping", "coulomb_friction", "quadratic_damping", "stribeck_friction")
found = orbisim.diagnose(
    scene, recordings, settings=Settings(effects=("magnetic_brake", *usual)), progress=False
)
print(found.sentence)

# %%
effect = found.effects[0]
values = {name: estimate.value for name, estimate in effect.parameters.items()}
speed = np.linspace(-8, 8, 200)
plt.figure(figsize=(7, 2.6), layout="constrained")
plt.plot(speed, brake(speed, 0.3, 1.5), lw=5, color="0.8", label="the machine's")
plt.plot(speed, brake(speed, values["coefficient"], values["speed"]), label="found")
plt.xlabel("speed (rad/s)")
plt.ylabel("torque (N·m)")
plt.legend()
plt.show()

# %% [markdown]
# ## A scene format
#
# A reader has one method, which returns a `mujoco.MjSpec`. This one reads files that hold nothing but
# the length of a pendulum.

# %%
from pathlib import Path

from orbisim.scene import Reader, ReadResult
from orbisim.scene.readers import register_reader


class PendulumReader(Reader):
    format, suffix, root = "pendulum", ".pendulum", ""

    def read(self, path, **options):
        text = PENDULUM.format(length=float(Path(path).read_text()))
        return ReadResult(mujoco.MjSpec.from_string(text), ())


register_reader(".pendulum", PendulumReader)
Path("long.pendulum").write_text("0.8")
print(orbisim.load_scene("long.pendulum").model.geom_size)

# %% [markdown]
# ## An engine
#
# A backend has three methods: `load`, `reset` and `step`. States are values: a step returns a new one.
# This engine knows a single thing, a pendulum, and integrates it by the explicit midpoint rule.

# %%
from orbisim import Backend, Capability, State, register_backend
from orbisim.compare import compare


class MidpointBackend(Backend):
    name = "midpoint"
    capabilities = frozenset({Capability.CLASSICAL, Capability.DETERMINISTIC})

    def load(self, scene):
        self.check_scene(scene)
        self._scene = scene
        model, data = scene.model, mujoco.MjData(scene.model)
        mujoco.mj_forward(model, data)
        self.inertia = data.M[0]
        self.weight = 9.81 * model.body_mass[1] * -model.body_ipos[1, 2]
        self.damping = model.dof_damping[0]

    def reset(self, nworld=None, seed=None):
        zero = np.zeros((self.check_reset(nworld, seed), 1))
        return State(time=zero[:, 0], qpos=zero, qvel=zero, act=zero[:, :0])

    def step(self, state, control=None, nstep=1):
        control, nstep = self.check_step(state, control, nstep)
        q, v, h = state.qpos, state.qvel, self.timestep
        for _ in range(nstep):
            half = v + 0.5 * h * self.acceleration(q, v, control)
            v = v + h * self.acceleration(q + 0.5 * h * v, half, control)
            q = q + h * half
        return State(state.time + nstep * h, q, v, state.act)

    def acceleration(self, q, v, torque):
        torque = np.clip(torque, -2, 2)
        return (torque - self.damping * v - self.weight * np.sin(q)) / self.inertia


register_backend("midpoint", MidpointBackend)
result = compare(scene, "mujoco", "midpoint", horizon=1.0).to_json()
error = result["error"]["joint_position"]
print(f"{error['median'][-1]:.2g} rad from MuJoCo after 1 s (median of 16 episodes)")

# %% [markdown]
# ## Does it keep to the rules?
#
# OrbiSim has tests that every plug-in must pass. Inherit `BackendConformance`, `ReaderConformance` or
# `RendererConformance` from `orbisim.testing` and run pytest: they try what a user will try.
#
# In a package of your own an entry point takes the place of `register`: then everybody who installs it
# has your plug-in. The groups are `orbisim.effects`, `orbisim.readers`, `orbisim.backends`,
# `orbisim.renderers` and `orbisim.recordings`.
#
# **Where to go on:** [a scene format of your own](../readers.md) reads SDFormat in sixty lines;
# `backends/README.md` in the repository has a complete engine and the contract in short.
