"""Makes one trial from a seed: what the tools open, and the truth in a folder of its own."""

from __future__ import annotations

import dataclasses
import json
import shutil
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from rigs import instruments
from rigs.draws import Draw
from rigs.excitation import Motion, joint_of, motion
from rigs.instruments import Chain, logged
from rigs.law import Floats, Law, Usual, index_of
from rigs.machines import MACHINES, Machine, Missing
from rigs.showing import beside, visibility
from rigs.sizing import nameless, possible
from rigs.truth import Diverged, Run, Stepping, Truth

KINDS = {"none": 0.26, "single": 0.44, "pair": 0.12, "outside": 0.18}
"""Shares of the trials: no effect, one, two that are easily confused, one without a name."""
ASKED = ("triple", "many")
"""Further kinds, which are made if they are asked for: three effects that have nothing to do with
each other, and what a real machine has at once: friction of both kinds at every joint, a mass that
is off, and one effect more."""
EVERYWHERE = ("coulomb_friction", "viscous_damping")
"""What a real machine has at every joint."""

CONFUSABLE = (
    ("coulomb_friction", "viscous_damping"),
    ("coulomb_friction", "load_dependent_friction"),
    ("viscous_damping", "quadratic_damping"),
    ("stribeck_friction", "viscous_damping"),
    ("actuator_lag", "actuator_delay"),
    ("sensor_delay", "actuator_delay"),
    ("sensor_scale", "torque_gain"),
    ("sensor_bias", "joint_spring"),
    ("payload", "torque_gain"),
    ("payload", "gravity_tilt"),
    ("armature", "payload"),
    ("backlash", "coulomb_friction"),
    ("joint_flexibility", "actuator_lag"),
    ("linear_drag", "quadratic_drag"),
    ("buoyancy", "linear_drag"),
    ("sliding_friction", "gravity_tilt"),
    ("sliding_friction", "constant_force"),
    ("restitution", "sliding_friction"),
)

TIMING = frozenset({"host_stamps", "late_commands", "slow_commands", "sensor_delays"})
"""Artefacts that a delay is a correct description of."""


class Unmakeable(Exception):
    """A trial that cannot be made, with the reason."""


@dataclasses.dataclass(frozen=True, eq=False)
class Plan:
    """What a trial is to be."""

    kind: str
    machine: Machine
    stepping: Stepping
    artefacts: tuple[str, ...]
    rate: float


@dataclasses.dataclass(frozen=True)
class Wish:
    """What is asked of all trials, instead of being drawn.

    Attributes:
      machines: to draw from; all if empty. kind: of `KINDS` or `ASKED`; of the former if empty.
      artefacts: of each trial, these alone (`()` for white noise only); drawn if None.
      louder: factor on the noise of positions.
    """

    machines: tuple[str, ...] = ()
    kind: str = ""
    artefacts: tuple[str, ...] | None = None
    louder: float = 1.0


def plan(rng: np.random.Generator, wish: Wish) -> Plan:
    """Draws machine, kind, artefacts and how the truth is stepped."""
    kind = str(rng.choice(list(KINDS), p=list(KINDS.values())))
    kind = wish.kind or kind
    machines = wish.machines or tuple(MACHINES)
    jointed = kind in ("outside", "many")
    able = [name for name in machines if not jointed or MACHINES[name].drive != "thrown"]
    if wish.artefacts:
        able = [n for n in able if all(applies(a, MACHINES[n]) for a in wish.artefacts)]
    machine = MACHINES[str(rng.choice(able or machines))]
    touches = bool(machine.contact) or machine.name in ("suite_finger", "gym_pusher")
    step = float(rng.choice([2e-4, 5e-4, 1e-3]))
    integrator = "implicitfast" if touches or rng.random() < 0.5 else "rk4"
    known = [a for a in instruments.ARTEFACTS if applies(a, machine)]
    among = rng.random()
    count = 0 if among < 0.2 else 1 if among < 0.85 else 3
    artefacts = tuple(str(a) for a in rng.choice(known, min(count, len(known)), replace=False))
    if {"filtered_velocity", "positions_only"} <= set(artefacts):
        artefacts = tuple(a for a in artefacts if a != "filtered_velocity")
    if {"jitter", "host_stamps"} <= set(artefacts):
        artefacts = tuple(a for a in artefacts if a != "jitter")
    rate = float(rng.choice([100.0, 125.0, 200.0]))
    if wish.artefacts is not None:
        artefacts = wish.artefacts
    return Plan(kind, machine, Stepping(step, integrator), artefacts, rate)


def applies(artefact: str, machine: Machine) -> bool:
    """Whether a machine's recordings can have an artefact."""
    if machine.drive == "thrown":
        return artefact not in (
            "filtered_velocity", "late_commands", "slow_commands", "current_torque",
            "sensor_delays", "encoder", "host_stamps",
        )  # fmt: skip
    return True


def name_of(number: int) -> str:
    """Of a trial; it says nothing."""
    return f"r{number:05d}"


def make(number: int, seed: int, out: Path, asked: Wish = Wish()) -> dict[str, Any]:
    """Writes a trial, unless it is there; one that cannot be made says why under `dropped`.

    Plan, measuring chain, motions and laws are drawn from streams of their own: a number is the
    same machine with the same law along the same motion whatever its artefacts and noise are.
    """
    name = name_of(number)
    path = out / "truth" / f"{name}.json"
    if path.exists():
        known: dict[str, Any] = json.loads(path.read_text())
        if "dropped" in known or (out / "trials" / name).exists():
            return known
    wish = plan(np.random.default_rng([seed, number, 0]), asked)
    started = time.perf_counter()
    entry: dict[str, Any] = {
        "trial": name,
        "seed": seed,
        "kind": wish.kind,
        "machine": wish.machine.name,
        "artefacts": list(wish.artefacts),
        "step": wish.stepping.step,
        "integrator": wish.stepping.integrator,
    }
    try:
        entry |= _written(wish, name, (seed, number), out, asked.louder)
    except (Unmakeable, Diverged, Missing) as error:
        entry["dropped"] = str(error)
    entry["seconds"] = round(time.perf_counter() - started, 1)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.with_suffix(".part").write_text(json.dumps(entry, indent=1))
    path.with_suffix(".part").replace(path)
    return entry


def _written(
    wish: Plan, name: str, seeds: tuple[int, int], out: Path, louder: float
) -> dict[str, Any]:
    machine, text = wish.machine, wish.machine.text()
    plain = Truth(machine, text, wish.stepping, ())
    of_chain, of_motions, of_laws = (np.random.default_rng([*seeds, k]) for k in (1, 2, 3))
    chain = instruments.drawn(plain.model, wish.rate, wish.artefacts, of_chain)
    count = machine.fit + machine.held
    motions = [motion(machine, plain, of_motions, chain.noise) for _ in range(count)]
    chain = dataclasses.replace(chain, noise=louder * chain.noise)
    usual = _usual(plain, _run(plain, motions[0], chain, 0))
    laws = _laws(wish, usual, of_laws)
    truth = Truth(machine, text, wish.stepping, laws)
    runs = [_run(truth, one, chain, i) for i, one in enumerate(motions)]
    folder = out / "trials" / name
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    (folder / f"scene{machine.suffix}").write_text(text)
    for i, run in enumerate(runs):
        part = f"fit_{i}" if i < machine.fit else f"held_{i - machine.fit}"
        signals = logged(run, plain.model, chain, laws, i, truth.applied)
        np.savez_compressed(folder / f"{part}.npz", **signals)
    return {
        "laws": [as_read(law, plain.model, chain) for law in laws],
        "same": [
            [*other, law.effect, law.target]
            for law in laws
            for one, other in machine.same
            if one == (law.effect, law.target)
        ],
        **visibility(plain, chain, runs[:2], laws),
        "beside": beside(truth, plain, chain, runs[0]),
        "noise": chain.noise,
        "rate": chain.rate,
        "velocities": chain.velocities,
        "allowed": _allowed(wish),
    }


def as_read(law: Law, model: mujoco.MjModel, chain: Chain) -> dict[str, Any]:
    """A law for the truth's file; a sensor that the chain delays, too, is late by the sum."""
    told = law.to_json()
    if law.effect == "sensor_delay":
        told["value"] += float(chain.delays[index_of(model, "joint", law.target)])
    return told


def _allowed(wish: Plan) -> list[str]:
    """Findings that are correct beside the laws: delays where the chain has some."""
    if set(wish.artefacts) & TIMING:
        return ["sensor_delay", "actuator_delay"]
    return ["sensor_delay"] if "filtered_velocity" in wish.artefacts else []


def _run(truth: Truth, one: Motion, chain: Chain, number: int) -> Run:
    ticks = chain.ticks(truth.machine.duration, np.random.default_rng([chain.seed, 7, number]))
    return truth.run(one.qpos, one.qvel, truth.machine.duration, one.controller, ticks, chain.late)


def _usual(truth: Truth, run: Run) -> Usual:
    """What is typical of the machine without a law."""
    model = truth.model
    step = float(run.time[1] - run.time[0])
    inertial = model.dof_M0 * np.gradient(run.rate, step, axis=0)
    force = np.maximum(_rms(run.drive), _rms(np.clip(inertial, -1e3, 1e3)))
    travel, middle = np.full(model.nv, 0.1), np.zeros(model.nv)
    for joint in range(model.njnt):
        q, v = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
        if int(model.jnt_type[joint]) >= 2:
            low, high = np.quantile(run.body[:, q], [0.01, 0.99])
            travel[v], middle[v] = max((high - low) / 2, 1e-6), (high + low) / 2
    drive = np.zeros(model.nu)
    for a in range(model.nu):
        joint = joint_of(model, a)
        if joint is not None:
            dof = int(model.jnt_dofadr[joint])
            drive[a] = _rms(run.drive)[dof] / abs(float(model.actuator_gear[a, 0]))
    command = np.zeros(model.nu) if truth.applied else _rms(run.sent)
    return Usual(model, force + 1e-9, _rms(run.rate) + 1e-9, travel, middle, command, drive)


def _rms(values: Floats) -> Floats:
    """Root mean square over rows."""
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def _laws(wish: Plan, usual: Usual, rng: np.random.Generator) -> list[Law]:
    if wish.kind == "none":
        return []
    table = (nameless if wish.kind == "outside" else possible)(wish.machine, usual)
    if not table:
        raise Unmakeable(f"nothing of kind {wish.kind} fits {wish.machine.name}")
    if wish.kind == "pair":
        return _pair(wish.machine, usual, table, rng)
    if wish.kind == "many":
        return _many(usual, table, rng)
    return _apart(usual, table, 3 if wish.kind == "triple" else 1, rng)


Table = Mapping[tuple[str, str], Draw]


def _apart(usual: Usual, table: Table, count: int, rng: np.random.Generator) -> list[Law]:
    """So many effects, no one of them twice: an effect first, then its place, as seven joints do
    not make an effect more frequent."""
    laws: list[Law] = []
    for _ in range(count):
        effects = sorted({effect for effect, _ in table} - {law.effect for law in laws})
        if not effects:
            raise Unmakeable(f"fewer than {count} effects fit {usual.model.nbody - 1} bodies")
        effect = effects[int(rng.integers(len(effects)))]
        places = sorted(target for e, target in table if e == effect)
        target = places[int(rng.integers(len(places)))]
        laws.append(table[effect, target](usual, target, rng))
    return laws


def _many(usual: Usual, table: Table, rng: np.random.Generator) -> list[Law]:
    """Friction at every joint, a payload, and one effect more."""
    everywhere = sorted(key for key in table if key[0] in EVERYWHERE)
    loaded = sorted(key for key in table if key[0] == "payload")
    if not everywhere or not loaded:
        raise Unmakeable("nothing moves at joints")
    laws = [table[key](usual, key[1], rng) for key in everywhere]
    load = loaded[int(rng.integers(len(loaded)))]
    laws.append(table[load](usual, load[1], rng))
    rest = {key: draw for key, draw in table.items() if key[0] not in (*EVERYWHERE, "payload")}
    return laws + _apart(usual, rest, 1, rng)


def _pair(machine: Machine, usual: Usual, table: Table, rng: np.random.Generator) -> list[Law]:
    """Two effects that are easily confused, beside each other where that is possible."""
    pairs = [pair for pair in CONFUSABLE if all(any(e == n for e, _ in table) for n in pair)]
    if not pairs:
        raise Unmakeable(f"no pair that is easily confused fits {machine.name}")
    first, second = pairs[int(rng.integers(len(pairs)))]
    places = sorted(target for e, target in table if e == first)
    target = places[int(rng.integers(len(places)))]
    others = sorted(t for e, t in table if e == second)
    beside = _beside(usual, target, others) or others[int(rng.integers(len(others)))]
    return [
        table[first, target](usual, target, rng),
        table[second, beside](usual, beside, rng),
    ]


def _beside(usual: Usual, target: str, others: list[str]) -> str:
    """Of the places of a second effect the one that is at the first: the same joint or drive."""
    if target in others:
        return target
    model = usual.model
    for a in range(model.nu):
        joint = joint_of(model, a)
        if joint is None:
            continue
        names = {model.actuator(a).name or f"actuator{a}", model.joint(joint).name,
                 model.body(int(model.jnt_bodyid[joint])).name}  # fmt: skip
        if target in names and names & set(others):
            return sorted(names & set(others))[0]
    return ""
