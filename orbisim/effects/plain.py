"""Effects that MuJoCo lacks, for plain MuJoCo: needs mujoco and numpy, nothing else.

The scene beside this file carries them as JSON in `<custom><text name="orbisim:effects">`, which
MuJoCo ignores. Here they act between time steps:

    import effects
    model = mujoco.MjModel.from_xml_path("scene.xml")
    data = mujoco.MjData(model)
    step = effects.install(model)  # mujoco.mj_step steps this model with its effects from now on
    mujoco.mj_step(model, data)    # step(model, data) is the same; other models are not affected

A trajectory is that of OrbiSim's backend `mujoco`. Controls and applied forces are left as they
were set. Programs that step in C (`mujoco.rollout`, the viewer's own loop) pass by Python and get
no effects. Effects of measurement change recordings, not the simulation, and are passed over.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

Law = Callable[[Any, Any, Any], None]
"""Adds to the forces of `data` in place, from (model, data, declared friction losses)."""
VELOCITY, ACCELERATION = 1, 2
"""What a law reads of MuJoCo's computation: up to velocities, or forces, too."""
MEASURED = ("sensor_bias", "sensor_scale", "sensor_delay", "clock_skew")

_mj_step = mujoco.mj_step


class Step:
    """Steps one model with the effects that it carries; called like `mujoco.mj_step`."""

    def __init__(self, model: Any) -> None:
        self._model, self._losses = model, np.array(model.dof_frictionloss)
        found = [_law(model, entry) for entry in _carried(model)]
        self._laws = [law for law, _ in found]
        self._reads = max((reads for _, reads in found), default=0)

    def __call__(self, model: Any, data: Any, nstep: int = 1) -> None:
        """Advances `data` by so many time steps under a constant control."""
        if model is not self._model or not self._laws:
            _mj_step(model, data, nstep)
            return
        names = ("ctrl", "qfrc_applied", "xfrc_applied")
        kept = {name: np.array(getattr(data, name)) for name in names}
        self._read(data)
        for _ in range(nstep):
            for name in names:
                getattr(data, name)[:] = kept[name]
            losses = self._losses.copy()
            for law in self._laws:
                law(model, data, losses)
            model.dof_frictionloss[:] = losses
            _mj_step(model, data)
            self._read(data)
        for name in names:
            getattr(data, name)[:] = kept[name]

    def _read(self, data: Any) -> None:
        """Computes what laws read, at the present state."""
        if self._reads == VELOCITY:
            mujoco.mj_fwdPosition(self._model, data)
            mujoco.mj_fwdVelocity(self._model, data)
        elif self._reads == ACCELERATION:
            mujoco.mj_forward(self._model, data)


def install(model: Any) -> Step:
    """Makes `mujoco.mj_step` apply the model's effects; the same as a function of its own.

    Raises:
      NotImplementedError: the model carries something that this file cannot apply.
    """
    mine, others = Step(model), mujoco.mj_step

    def mj_step(model: Any, data: Any, nstep: int = 1) -> None:
        (mine if model is mine._model else others)(model, data, nstep)

    mujoco.mj_step = mj_step
    return mine


def _carried(model: Any) -> list[dict[str, Any]]:
    """The effects in the model's text."""
    if _text(model, "orbisim:rest") is not None:
        raise NotImplementedError(
            "the scene carries a learned residual force (a neural network in the text "
            "'orbisim:rest'), which is no formula that a short file could hold: simulate it with "
            "OrbiSim's backend, or use the scene without it (augmented/scene.xml)"
        )
    entries: list[dict[str, Any]] = _text(model, "orbisim:effects") or []
    return [entry for entry in entries if entry["effect"] not in MEASURED]


def _text(model: Any, name: str) -> Any:
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TEXT, name)
    if index < 0:
        return None
    start, size = int(model.text_adr[index]), int(model.text_size[index])
    return json.loads(bytes(model.text_data[start : start + size]).split(b"\0")[0])


def _law(model: Any, entry: dict[str, Any]) -> tuple[Law, int]:
    """The law of an entry, and what it reads."""
    effect, target = entry["effect"], entry["target"]
    p, options = entry["parameters"], entry.get("options", {})
    if effect == "deadband":
        return _deadband(_id(model, "actuator", target), p["width"] / 2, options), 0
    if effect in ("stribeck_friction", "load_dependent_friction"):
        dof = int(model.jnt_dofadr[_id(model, "joint", target)])
        if effect == "stribeck_friction":
            return _stribeck(dof, p["coulomb"], p["static"], p["velocity"]), 0
        return _loaded(dof, p["coefficient"], options.get("load", "actuator")), ACCELERATION
    if effect in ("latch", "detent"):
        return (_latch if effect == "latch" else _detent)(model, target, p, options), 0
    if effect == "joint_coupling":
        joints = [_id(model, "joint", name) for name in (target, options["other"])]
        by = options.get("by", "torque")
        return _coupling(model, joints, p["coefficient"], by), ACCELERATION * (by == "torque")
    if effect == "constant_force":
        push = np.array([p["x"], p["y"], p["z"]])
        return _at_body(_id(model, "body", target), lambda time, v, w: push), 0
    if effect == "periodic_disturbance":
        return _periodic(model, target, p, options), 0
    if effect in ("linear_drag", "quadratic_drag", "magnus"):
        c, power = p["coefficient"], float(effect == "quadratic_drag")
        laws = {"magnus": lambda time, v, w: c * np.cross(w, v)}
        drag = laws.get(effect, lambda time, v, w: -c * np.linalg.norm(v) ** power * v)
        return _at_body(_id(model, "body", target), drag), VELOCITY
    raise NotImplementedError(f"{effect!r} is not an effect that this file has a formula for")


def _id(model: Any, kind: str, name: str) -> int:
    """By name, or by the number of an element without a name (`joint3`)."""
    found = mujoco.mj_name2id(model, getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), name)
    if found < 0 and re.fullmatch(rf"{kind}\d+", name):
        found = int(name.removeprefix(kind))
    if found < 0:
        raise ValueError(f"the model has no {kind} {name!r}: is it the scene beside this file?")
    return int(found)


def _deadband(actuator: int, half: float, options: dict[str, str]) -> Law:
    gate = options.get("kind", "shift") == "gate"

    def law(model: Any, data: Any, losses: Any) -> None:
        index = int(model.actuator_ctrladr[actuator])
        u = data.ctrl[index]
        beyond = u if gate else u - np.sign(u) * half
        data.ctrl[index] = beyond if abs(u) > half else 0.0

    return law


def _stribeck(dof: int, coulomb: float, static: float, velocity: float) -> Law:
    def law(model: Any, data: Any, losses: Any) -> None:
        fall = np.exp(-((data.qvel[dof] / velocity) ** 2))
        losses[dof] += coulomb + (static - coulomb) * fall

    return law


def _loaded(dof: int, coefficient: float, load: str) -> Law:
    def law(model: Any, data: Any, losses: Any) -> None:
        external = data.qfrc_constraint[dof] - data.qfrc_bias[dof]
        carried = data.qfrc_actuator[dof] if load == "actuator" else external
        losses[dof] += coefficient * abs(carried)

    return law


def _latch(model: Any, target: str, p: dict[str, float], options: dict[str, str]) -> Law:
    joint = _id(model, "joint", target)
    q, dof = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
    other = options.get("other")
    by = None if other is None else int(model.jnt_qposadr[_id(model, "joint", other)])
    side = -1.0 if options.get("side") == "below" else 1.0

    def law(model: Any, data: Any, losses: Any) -> None:
        released = by is not None and side * (data.qpos[by] - p["threshold"]) > 0
        if abs(data.qpos[q] - p["position"]) <= p["width"] and not released:
            losses[dof] += p["force"]

    return law


def _detent(model: Any, target: str, p: dict[str, float], options: dict[str, str]) -> Law:
    joint = _id(model, "joint", target)
    q, dof = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])

    def law(model: Any, data: Any, losses: Any) -> None:
        wave = np.sin(2 * np.pi * (data.qpos[q] - p["position"]) / p["pitch"])
        data.qfrc_applied[dof] -= p["amplitude"] * wave

    return law


def _coupling(model: Any, joints: list[int], coefficient: float, by: str) -> Law:
    dof, other = (int(model.jnt_dofadr[joint]) for joint in joints)
    adr = int(model.jnt_qposadr[joints[1]])

    def law(model: Any, data: Any, losses: Any) -> None:
        sources = {"position": data.qpos[adr], "velocity": data.qvel[other]}
        data.qfrc_applied[dof] += coefficient * sources.get(by, data.qfrc_actuator[other])

    return law


def _periodic(model: Any, target: str, p: dict[str, float], options: dict[str, str]) -> Law:
    joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, target)
    if joint < 0 and re.fullmatch(r"joint\d+", target):
        joint = int(target.removeprefix("joint"))

    def wave(time: float) -> float:
        phase = 2 * np.pi * p["frequency"] * time + p["phase"]
        return float(p["amplitude"] * np.sin(phase))

    if joint < 0:
        way = np.array([float(options.get(axis, "0")) for axis in "xyz"])
        way = way / np.linalg.norm(way) if way.any() else np.array([0.0, 0.0, 1.0])
        return _at_body(_id(model, "body", target), lambda time, v, w: wave(time) * way)
    dof = int(model.jnt_dofadr[joint])

    def law(model: Any, data: Any, losses: Any) -> None:
        data.qfrc_applied[dof] += wave(data.time)

    return law


def _at_body(body: int, force: Callable[[float, Any, Any], Any]) -> Law:
    """A force [3] at the centre of mass, from time, velocity and spin in the world's frame."""

    def law(model: Any, data: Any, losses: Any) -> None:
        spin, moving = np.split(data.cvel[body], 2)
        arm = data.xipos[body] - data.subtree_com[model.body_rootid[body]]
        data.xfrc_applied[body, :3] += force(data.time, moving + np.cross(spin, arm), spin)

    return law
