"""Blind trials of the diagnosis on mechanisms: a lock, a catch, clicks, friction, a return spring.

    python tools/mechanism_trials.py generate --out trials --count 12
    python tools/blind_trials.py run --trials trials --out results.jsonl --tools diagnose
    python tools/mechanism_trials.py score --trials trials --results results.jsonl
    python tools/mechanism_trials.py history --numbers 3 11

Every trial is an instance of a family of mechanisms. A compliant hand moves each joint in turn and
all at once, forces are recorded with positions, and one property of the instance, as it was
generated, is left out of the declared scene. `--hide` leaves a lock out whose other joint is
neither declared nor recorded. `generate` writes what `run` opens apart from `truth/`. `history`
says which joints are called history-dependent before any search, of all families and kinds.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
from processes import read_lines

from orbisim import Recording, Scene, load_scene, make_backend, replay
from orbisim.effects import EffectInstance
from orbisim.effects.carry import write_carried
from orbisim.files.temporary import temporary_folder
from orbisim.motion.samples import prepare_all
from orbisim.shooting.bench import make_bench
from orbisim.shooting.history import history_dependent
from orbisim.tasks.mechanisms.catalogue import FAMILIES, INSTANCES, make
from orbisim.tasks.mechanisms.model import Joint, Mechanism
from orbisim.tasks.mechanisms.urdf import write_urdf
from orbisim.testing.excitation import glide

Floats = npt.NDArray[np.float64]
KINDS = ("detent", "coulomb_friction", "joint_spring", "latch")
WINDOW, VISIBLE = 0.5, 10.0
"""Duration of the windows in which what is left out must show, s, and how many times the noise."""
RATE, DURATION, FIT, HELD = 100.0, 12.0, 3, 2
"""Of recordings: Hz, s, to fit to, held out."""
NOISE = {"hinge": 3e-4, "slide": 3e-5}
"""Standard deviation of positions, rad and m."""


@dataclasses.dataclass(frozen=True)
class Wish:
    """A trial: a family, the number of an instance, and what is left out of it."""

    kind: str
    family: str
    number: int
    hide: bool


# -- a hand that moves the joints of a mechanism ---------------------------------------------------


def _left_out(mechanism: Mechanism, kind: str) -> list[EffectInstance]:
    """What of a kind an instance has, as the catalogue of effects names it."""
    if kind == "coulomb_friction":
        return [
            EffectInstance(kind, joint.name, {"torque": joint.friction})
            for joint in mechanism.joints
        ]
    if kind == "joint_spring":
        return [
            EffectInstance(
                kind, joint.name, {"stiffness": joint.stiffness, "rest_position": joint.rest}
            )
            for joint in mechanism.joints
            if joint.stiffness
        ]
    return [one for one in mechanism.effects if one.effect == kind and _moves(one)]


def _moves(effect: EffectInstance) -> bool:
    return effect.values.get("width", 0.0) < _PLACE


_PLACE = 0.5
"""A latch as wide as all travel is a part that does not move."""


def _true(mechanism: Mechanism) -> Scene:
    """The mechanism alone, as URDF has it, without its shapes: nothing touches."""
    with temporary_folder() as folder:
        spec = load_scene(write_urdf(mechanism, folder)).spec
    for element in (*spec.geoms, *spec.meshes, *spec.materials):
        spec.delete(element)
    return Scene.from_spec(spec, source=mechanism.name)


def _declared(mechanism: Mechanism, true: Scene, missing: EffectInstance, hide: bool) -> Scene:
    """The scene without what is missing; without the joint that releases it, too, if hidden."""
    spec = true.spec
    if missing.effect == "coulomb_friction":
        spec.joint(missing.target).frictionloss = 0.0
    elif missing.effect == "joint_spring":
        spec.joint(missing.target).stiffness[0] = 0.0
        spec.joint(missing.target).springref = 0.0
    gone = {missing.options["other"]} if hide else set()
    kept = [
        one
        for one in mechanism.effects
        if one != missing and not gone & {one.target, one.options.get("other")}
    ]
    for name in gone:
        spec.delete(spec.joint(name))
    write_carried(spec, kept)
    return Scene.from_spec(spec, source=mechanism.name)


def _targets(joints: Sequence[Joint], rng: np.random.Generator, time: Floats) -> Floats:
    """[T, J] where a hand wants the joints: gentle ways between places, also against the stops."""
    found = []
    for joint in joints:
        knots, places = [0.0], [0.0]
        span = joint.upper - joint.lower
        while knots[-1] < time[-1]:
            end = rng.choice([joint.lower - _PRESS * span, joint.upper + _PRESS * span])
            place = end if rng.random() < _ENDS else joint.lower + span * rng.uniform()
            pause, way = rng.uniform(0.1, 0.5), rng.uniform(0.4, 1.2)
            knots += [knots[-1] + pause, knots[-1] + pause + way]
            places += [places[-1], place]
        found.append(glide(time, np.array(knots), np.array(places)))
    return np.stack(found, axis=1)


_ENDS, _PRESS = 0.5, 0.15
"""Share of the ways that lead to one of the stops, and how far beyond it, by the travel."""


def _record(mechanism: Mechanism, true: Scene, seed: int, episodes: int) -> list[Recording]:
    """Positions and the forces of a hand, held from sample to sample."""
    spec, rng = true.spec, np.random.default_rng(seed)
    for joint in mechanism.joints:
        motor = spec.add_actuator(name=joint.name, target=joint.name)
        motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
    driven = Scene.from_spec(spec, source=true.source)
    model, time = driven.model, np.arange(round(DURATION * RATE) + 1) / RATE
    engine, step = make_backend("mujoco", driven, nworld=episodes), 1 / RATE
    wanted = np.stack([_targets(mechanism.joints, rng, time) for _ in range(episodes)])
    hand = Hand.of(mechanism, model)
    state, kept = engine.reset(episodes), []
    for k in range(len(time)):
        ahead = (wanted[:, min(k + 1, len(time) - 1)] - wanted[:, k]) / step
        force = hand.force(wanted[:, k], ahead, state.qpos, state.qvel)
        kept.append((np.array(state.qpos), force))
        state = engine.step(state, force, round(step / model.opt.timestep))
    qpos, force = (np.stack(part, axis=1) for part in zip(*kept, strict=True))
    found = []
    for e in range(episodes):
        signals: dict[str, Floats] = {}
        for j, joint in enumerate(mechanism.joints):
            signals[f"qpos/{joint.name}"] = qpos[e, :, model.joint(joint.name).qposadr[0]]
            signals[f"torque/{joint.name}"] = force[e, :, j]
        found.append(Recording(time, signals, source=f"{mechanism.name}-{e}"))
    return found


@dataclasses.dataclass(frozen=True, eq=False)
class Hand:
    """Impedance at each joint, with what the joint is known to need; never more than `most`.

    Attributes:
      stiffness, damping, spring, rest, friction, weight, most: [J].
    """

    stiffness: Floats
    damping: Floats
    spring: Floats
    rest: Floats
    friction: Floats
    weight: Floats
    most: Floats

    @staticmethod
    def of(mechanism: Mechanism, model: mujoco.MjModel) -> Hand:
        """A hand that just moves each joint, catches and clicks included, but no locks."""
        joints, data = mechanism.joints, mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        dofs = [int(model.joint(joint.name).dofadr[0]) for joint in joints]
        inertia, span = model.dof_M0[dofs], np.array([j.upper - j.lower for j in joints])
        friction, spring, rest = (
            np.array([getattr(j, name) for j in joints])
            for name in ("friction", "stiffness", "rest")
        )
        catch = np.zeros(len(joints))
        for one in mechanism.effects:
            if not one.options and _moves(one):
                at = [joint.name for joint in joints].index(one.target)
                catch[at] += one.values.get("force", one.values.get("amplitude", 0.0))
        stiffness = np.maximum(inertia * _PULL**2, 10 * (friction + catch) / span)
        weight = np.array(data.qfrc_bias[dofs])
        most = 2 * (friction + catch + spring * span + np.abs(weight)) + 0.2 * stiffness * span
        return Hand(
            stiffness, 2 * np.sqrt(stiffness * inertia), spring, rest, friction, weight, most
        )

    def force(self, place: Floats, speed: Floats, qpos: Floats, qvel: Floats) -> Floats:
        """[E, J] forces towards places that move."""
        wanted = self.stiffness * (place - qpos) + self.damping * (speed - qvel) + self.weight
        wanted += self.spring * (qpos - self.rest) + self.friction * np.sign(speed)
        return np.clip(wanted, -self.most, self.most)


_PULL = 20.0
"""Angular frequency of a hand's impedance where a joint's friction does not ask for more, rad/s."""


# -- trials ----------------------------------------------------------------------------------------


def wishes(seed: int, hide: bool) -> Iterator[list[Wish]]:
    """For each trial in turn what it may be, best first: kinds in turn, families and instances as
    drawn, a family again only after all others that have the kind."""
    rng, used = np.random.default_rng(seed), Counter[tuple[str, str]]()
    for number in itertools.count():
        kind = "latch" if hide else KINDS[number % len(KINDS)]
        order = [str(family) for family in rng.permutation(list(FAMILIES))]
        order.sort(key=lambda family: used[kind, family])
        every = [Wish(kind, f, int(n), hide) for f in order for n in rng.permutation(INSTANCES)[:4]]
        yield every
        used[kind, every[0].family] += 1


def trial(wish: Wish, seed: int) -> Trial | None:
    """A trial; None if the instance has nothing of that kind, or nothing that shows."""
    mechanism, rng = make(wish.family, wish.number), np.random.default_rng([seed, 1])
    some = [one for one in _left_out(mechanism, wish.kind) if one.options or not wish.hide]
    if not some:
        return None
    missing, true = some[int(rng.integers(len(some)))], _true(mechanism)
    clean = _record(mechanism, true, seed, FIT + HELD)
    joint = next(one for one in mechanism.joints if one.name == missing.target)
    blind = replay(_declared(mechanism, true, missing, False), clean, window=WINDOW)
    shows = blind.signals[f"qpos/{joint.name}"].rms / NOISE[joint.kind]
    if shows < VISIBLE:
        return None
    hidden = missing.options["other"] if wish.hide else None
    seen = []
    for one in clean:
        signals = {}
        for name, values in one.signals.items():
            kind, _, at = name.partition("/")
            level = NOISE[next(j.kind for j in mechanism.joints if j.name == at)]
            noise = level * rng.standard_normal(len(values)) if kind == "qpos" else 0.0
            signals |= {} if at == hidden else {name: values + noise}
        seen.append(one.replace(signals=signals))
    return Trial(_declared(mechanism, true, missing, wish.hide), tuple(seen), missing, float(shows))


@dataclasses.dataclass(frozen=True, eq=False)
class Trial:
    """declared: the scene. recordings: to fit to, then held out. missing: what the scene lacks.
    shows: how far the declared scene runs astray at its joint, in units of the noise."""

    declared: Scene
    recordings: tuple[Recording, ...]
    missing: EffectInstance
    shows: float


def write(made: Trial, wish: Wish, name: str, out: Path) -> None:
    """Writes a trial and, apart from it, the truth."""
    folder = made.declared.save(out / "trials" / name).parent
    for number, one in enumerate(made.recordings):
        part = f"fit_{number}" if number < FIT else f"held_{number - FIT}"
        one.save(folder / f"{part}.npz")
    truth = {"trial": name, "wish": dataclasses.asdict(wish), "effect": made.missing.to_json()}
    (out / "truth").mkdir(exist_ok=True)
    text = json.dumps(truth | {"shift_over_noise": made.shows}, indent=1)
    (out / "truth" / f"{name}.json").write_text(text)


def generate(args: argparse.Namespace) -> int:
    """Writes trials; their names say nothing."""
    names = np.random.default_rng([args.seed, 2]).permutation(args.count)
    for number, (name, every) in enumerate(zip(names, wishes(args.seed, args.hide), strict=False)):
        seed = args.seed + 100 * number
        made = ((wish, one) for wish in every if (one := trial(wish, seed)) is not None)
        wish, one = next(made)
        write(one, wish, f"t{name:02d}", Path(args.out))
    print(f"{args.count} trials in {args.out}")
    return 0


def history(args: argparse.Namespace) -> int:
    """Prints a line for each instance and kind: locks whose release is hidden, then the others."""
    found: dict[bool, list[bool]] = {True: [], False: []}
    every = itertools.product(
        [(True, "latch"), *((False, k) for k in KINDS)], args.numbers, FAMILIES
    )
    for (hide, kind), number, family in every:
        made = trial(Wish(kind, family, number, hide), 1000 + number)
        if made is None:
            continue
        samples = prepare_all(made.recordings[:FIT], made.declared)
        called = history_dependent(make_bench(made.declared, samples, WINDOW))
        found[hide].append(bool(called))
        line = {"kind": kind, "family": family, "number": number, "hidden": hide,
                "joint": made.missing.target, "called": [one.joint for one in called],
                "ratios": [round(one.ratio, 2) for one in called]}  # fmt: skip
        print(json.dumps(line), flush=True)
    for hide, said in found.items():
        print(f"{'hidden' if hide else 'recorded'}: {sum(said)} of {len(said)} history-dependent")
    return 0


# -- scores ----------------------------------------------------------------------------------------


_SAME = {"detent": ("cogging",)}
"""Names that are the same force."""


def judge(truth: dict[str, Any], report: dict[str, Any]) -> dict[str, Any]:
    """What the diagnosis of a trial is worth: `found` if what was left out is named at its joint,
    `first` if it is named first, how many effects are named besides, and which joints are said to
    depend on their history."""
    one, named = truth["effect"], report["effects"]
    names = {one["effect"], *_SAME.get(one["effect"], ())}
    right = [e["effect"] in names and e["target"] == one["target"] for e in named]
    value, at = None, right.index(True) if any(right) else None
    if at is not None:
        quoted = next(iter(named[at]["parameters"].values()))
        value = quoted["value"] / next(iter(one["parameters"].values()))
    return {
        "found": any(right),
        "first": bool(right[:1] == [True]),
        "besides": len(named) - sum(right),
        "history_dependent": [entry["joint"] for entry in report["history_dependent"]],
        "value_over_truth": value,
        "verdict": report["verdict"],
        "left": report["residual"].get("ratio_after"),
    }


def score(args: argparse.Namespace) -> int:
    """Prints a row for each trial, and counts."""
    rows = []
    for entry in read_lines(Path(args.results)):
        truth = json.loads((Path(args.trials) / "truth" / f"{entry['trial']}.json").read_text())
        report = entry["report"]
        judged: dict[str, Any] = {"found": False, "first": False, "history_dependent": []}
        if report is not None:
            judged = judge(truth, report)
        rows.append({**judged, "hide": truth["wish"]["hide"], "target": truth["effect"]["target"]})
        named = (
            "no answer"
            if report is None
            else ", ".join(f"{e['effect']}({e['target']})" for e in report["effects"])
        )
        one, wish = truth["effect"], truth["wish"]
        print(json.dumps({"trial": entry["trial"], **wish, "true": one, "named": named, **judged}))
    found, first = (sum(row[key] for row in rows) for key in ("found", "first"))
    print(f"{found} of {len(rows)} named at their joints, {first} first")
    hidden, said = [row["hide"] for row in rows], [bool(row["history_dependent"]) for row in rows]
    right = sum(row["hide"] and row["history_dependent"] == [row["target"]] for row in rows)
    wrong = sum(s and not h for s, h in zip(said, hidden, strict=True))
    print(
        f"of {sum(hidden)} locks whose release is not recorded, {right} are called "
        "history-dependent at their joints and nowhere else; of the other "
        f"{len(rows) - sum(hidden)} {wrong} are"
    )
    return 0


def main(argv: list[str] | None = None) -> int:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    making = commands.add_parser("generate", help="write trials and the truth about them")
    making.add_argument("--out", required=True)
    making.add_argument("--count", type=int, default=12)
    making.add_argument("--seed", type=int, default=1)
    making.add_argument("--hide", action="store_true", help="locks by joints that nobody sees")
    making.set_defaults(work=generate)
    looking = commands.add_parser("history", help="what depends on its history, before a search")
    looking.add_argument("--numbers", type=int, nargs="+", default=[3, 11])
    looking.set_defaults(work=history)
    scoring = commands.add_parser("score", help="open the truth and count")
    scoring.add_argument("--trials", required=True)
    scoring.add_argument("--results", required=True)
    scoring.set_defaults(work=score)
    args = parser.parse_args(argv)
    return int(args.work(args))


if __name__ == "__main__":
    raise SystemExit(main())
