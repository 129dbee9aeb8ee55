"""Makes trials: recordings for the diagnosis, and the truth in a folder of its own."""

from __future__ import annotations

import dataclasses
import functools
import json
import shutil
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from blind.declared import alter
from blind.grid import NOISES, Wish
from blind.motion import Motion, observe
from blind.outside import Outside, outside
from blind.scenes import RIGS, Rig
from blind.sizes import sized
from orbisim import Recording, Scene, load_scene, make_backend, replay
from orbisim.diagnosis.scoring import score
from orbisim.effects import EffectInstance, add_effects, find
from orbisim.errors import OrbiSimError
from orbisim.recording import bind
from orbisim.testing import inject_effect

WINDOW = 0.5
"""Duration of the windows in which an effect must show, s."""
VISIBLE = 10.0
"""Shift over noise from which an effect counts as visible."""
TELLING = 2.0
"""... and how many times as far as the scene with it the scene without it has to miss noisy
held-out recordings: where bodies touch, free runs from noisy starts drift apart in any scene."""
TRIES, LARGER, SMALLER = 6, 1.7, 0.4
"""How often another size is tried: larger if nothing shows, smaller if the scene breaks."""


@functools.cache
def motion_of(name: str, short: bool = False) -> Motion:
    """What a scene does without effects; in a few short recordings."""
    rig = RIGS[name].shorter() if short else RIGS[name]
    return observe(rig, rig.scene(), _record(rig, rig.scene(), [], None, 0.0, 7))


def _record(
    rig: Rig,
    scene: Scene,
    effects: Sequence[EffectInstance],
    other: Outside | None,
    noise: float,
    seed: int,
    velocities: bool = True,
) -> list[Recording]:
    return inject_effect(
        scene,
        effects,
        duration=rig.duration,
        rate=rig.rate,
        episodes=rig.fit + rig.held,
        noise=noise,
        velocities=velocities,
        seed=seed,
        hooks=None if other is None else other.hooks,
    )


@dataclasses.dataclass(frozen=True, eq=False)
class Made:
    """What was injected: effects of the catalogue, another one, and how well they show."""

    effects: tuple[EffectInstance, ...]
    other: Outside | None
    shifts: tuple[float, ...]  # over the noise; of each effect
    noise: float


def size_up(wish: Wish) -> Made | None:
    """Chooses sizes at which every effect shows; at less noise if it must be; None if never."""
    rng = np.random.default_rng(wish.seed)
    motion = motion_of(wish.scene, wish.short)
    if wish.kind == "none":
        return Made((), None, (), wish.noise)
    for noise in sorted((n for n in NOISES if n <= wish.noise), reverse=True):
        if wish.outside is not None:
            one = _visible(wish, motion, wish.outside, rng, noise)
            if one is not None and isinstance(one[0], Outside):
                return Made((), one[0], (one[1] / noise,), noise)
            continue
        found = [_visible(wish, motion, one, rng, noise) for one in wish.effects]
        chosen = tuple(one[0] for one in found if one and isinstance(one[0], EffectInstance))
        if len(chosen) == len(found) and _shift(wish, motion, chosen) is not None:
            return Made(chosen, None, tuple(one[1] / noise for one in found if one), noise)
    return None


def _visible(
    wish: Wish,
    motion: Motion,
    what: tuple[str, str],
    rng: np.random.Generator,
    noise: float,
) -> tuple[EffectInstance | Outside, float] | None:
    """An effect of a size that shows, and how far it shifts the motion."""
    scale = 1.0
    for _ in range(TRIES):
        if wish.outside is None:
            one: EffectInstance | Outside = sized(what[0], motion, what[1], rng, scale)
        else:
            one = outside(what[0], motion, what[1], rng, scale)
        shift = _shift(wish, motion, one)
        if shift is not None and shift >= VISIBLE * noise and _tells(wish, motion, one, noise):
            return one, shift
        scale *= SMALLER if shift is None else LARGER
    return None


def _shift(
    wish: Wish, motion: Motion, what: EffectInstance | Outside | Sequence[EffectInstance]
) -> float | None:
    """How far the declared scene misses noise-free recordings within windows (RMS of the signal
    that is worst), rad or m; None if the scene no longer works with the effect.
    """
    other = what if isinstance(what, Outside) else None
    effects = () if other else [what] if isinstance(what, EffectInstance) else list(what)
    try:
        clean = _record(motion.rig, motion.scene, effects, other, 0.0, wish.seed)
    except OrbiSimError:
        return None
    if not _alive(motion, clean):
        return None
    found = replay(motion.scene, clean, window=WINDOW)
    positions = [e.rms for n, e in found.signals.items() if n.split("/")[0] in _POSITIONS]
    return float(max(positions)) if found.diverged == 0 else None


_POSITIONS = ("qpos", "xpos", "xquat")


def _tells(wish: Wish, motion: Motion, what: EffectInstance | Outside, noise: float) -> bool:
    """Whether the effect is seen in held-out recordings with their noise."""
    other = what if isinstance(what, Outside) else None
    made = Made(() if isinstance(what, Outside) else (what,), other, (), noise)
    rig, scene = motion.rig, motion.scene
    recordings = _record(rig, scene, made.effects, other, noise, wish.seed, wish.velocities)
    held = recordings[rig.fit :]
    true = _true_error(rig, made, held)
    return true is None or score(scene, held, WINDOW).rms >= TELLING * true


def _alive(motion: Motion, clean: Iterable[Recording]) -> bool:
    """Whether all that moved still moves, and stays within reach."""
    bound = [bind(one, motion.scene) for one in clean]
    qvel = np.concatenate([one.qvel for one in bound])
    qpos = np.concatenate([one.qpos for one in bound])
    before, now = np.std(motion.qvel, axis=0), np.std(qvel, axis=0)
    reach = 4 * np.abs(motion.qpos).max(axis=0) + 1.0
    return bool((now >= 0.15 * before).all() and (np.abs(qpos).max(axis=0) <= reach).all())


def make(wish: Wish, name: str, out: Path) -> dict[str, Any]:
    """Writes a trial, unless it is there; returns what happened (nothing of it is for the
    diagnosis). A trial that cannot be made says why under `skipped`.
    """
    entry: dict[str, Any] = {"trial": name, "wish": dataclasses.asdict(wish)}
    path = out / "truth" / f"{name}.json"
    if path.exists():
        known: dict[str, Any] = json.loads(path.read_text())
        if known["wish"] == json.loads(json.dumps(entry["wish"])):
            return known
    try:
        made = size_up(wish)
        if made is None:
            return entry | {"skipped": "not visible"}
        return _write(wish, made, out, entry)
    except Exception as error:  # one trial that cannot be made must not end all others
        return entry | {"skipped": repr(error)}


def _write(wish: Wish, made: Made, out: Path, entry: dict[str, Any]) -> dict[str, Any]:
    """Writes what the tools open, and then the truth about it."""
    started, name = time.perf_counter(), entry["trial"]
    rig = motion_of(wish.scene, wish.short).rig
    recordings = _record(
        rig, rig.scene(), made.effects, made.other, made.noise, wish.seed, wish.velocities
    )
    declared, factors = rig.path.read_text(), {}
    if wish.wrong != "right":
        declared, factors = alter(declared, wish.wrong, np.random.default_rng([wish.seed, 9]))
    folder = out / "trials" / name
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    (folder / "scene.xml").write_text(declared)
    for i, one in enumerate(recordings):
        part, number = ("fit", i) if i < rig.fit else ("held", i - rig.fit)
        one.save(folder / f"{part}_{number}.npz")
    truth = entry | {
        "effects": [one.to_json() for one in made.effects],
        "outside": made.other.to_json() if made.other else None,
        "shift_over_noise": list(made.shifts),
        "noise": made.noise,
        "velocities": wish.velocities,
        "wrong": wish.wrong if factors else "right",
        "declared_over_true": factors,
        "held_out_error": held_out_error(folder / "scene.xml", rig, made, recordings[rig.fit :]),
        "seconds": round(time.perf_counter() - started, 2),
    }
    (out / "truth").mkdir(parents=True, exist_ok=True)
    (out / "truth" / f"{name}.json").write_text(json.dumps(truth, indent=1))
    return truth


def held_out_error(
    declared: Path, rig: Rig, made: Made, held: Sequence[Recording]
) -> dict[str, float | None]:
    """Free-running error of the declared and of the true scene on held-out recordings.

    As the diagnosis reports its own, before and after. None where an effect outside the catalogue
    is random or has a state that no recording tells.
    """
    before = score(load_scene(declared, trusted=True), held, WINDOW).rms
    return {"declared": before, "true": _true_error(rig, made, held)}


def _true_error(rig: Rig, made: Made, held: Sequence[Recording]) -> float | None:
    """Free-running error of the true scene on recordings; None if it cannot be repeated."""
    if made.other is None:
        simulated = [one for one in made.effects if not find(one.effect).measurement]
        true = add_effects(rig.scene(), simulated)
        return score(true, held, WINDOW, made.effects).rms
    if not made.other.repeatable:
        return None
    backend = make_backend("mujoco", rig.scene(), hooks=made.other.hooks)
    return score(rig.scene(), held, WINDOW, (), backend).rms
