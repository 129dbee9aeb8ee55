"""Which trials there are: effects, targets, noise, and what is declared wrongly."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Sequence

import numpy as np

from blind.motion import Motion, targets
from blind.outside import PLACES
from blind.scenes import RIGS
from blind.sizes import SIZES

NOISES = (1e-4, 5e-4, 2e-3)
"""Low, middle and high: standard deviation of positions, rad or m."""

MOST_TARGETS = {"arm6": 2, "leg": 2, "drone": 1, "gripper_push": 2}
"""How many targets of an effect are tried in scenes with many."""

NO_EFFECT = 8
"""Trials without an effect for each scene, all declared rightly."""

PAIRS = {
    "arm2": 12,
    "arm6": 9,
    "cart_pole": 8,
    "servo_pendulum": 6,
    "drone": 5,
    "bouncing_ball": 6,
    "leg": 4,
}
"""Trials with two effects."""

TOGETHER_UNCLEAR = (
    frozenset({"sensor_bias", "sensor_scale", "sensor_delay", "clock_skew"}),
    frozenset({"actuator_lag", "actuator_delay", "sensor_delay"}),
    frozenset({"backlash", "joint_flexibility"}),
    frozenset({"restitution", "contact_compliance"}),
    frozenset({"coulomb_friction", "stribeck_friction", "load_dependent_friction"}),
)
"""Of each of these, a pair has one at most: their sum is like one of another size."""

MEANS_THE_SAME = {
    ("torque_gain", "gains"): "mass",
    ("viscous_damping", "damping"): "mass",
    ("payload", "mass"): "damping",
}
"""What is declared wrongly instead where the effect is just that parameter: which part of the
difference is the effect could not be said."""


@dataclasses.dataclass(frozen=True)
class Wish:
    """A trial to be made.

    Attributes:
      kind: single, pair, none or outside. scene: name of the rig.
      effects: (effect, target) of the catalogue; one or two.
      outside: (kind, target) of an effect that is not in the catalogue.
      noise: rad or m. velocities: whether they are recorded.
      wrong: which declared parameters are off: mass, damping, gains; or right.
      seed: of sizes, excitation and noise.
      short: whether a few short recordings must do.
    """

    kind: str
    scene: str
    effects: tuple[tuple[str, str], ...] = ()
    outside: tuple[str, str] | None = None
    noise: float = NOISES[0]
    velocities: bool = True
    wrong: str = "right"
    seed: int = 0
    short: bool = False


def every(motions: dict[str, Motion], seed: int) -> list[Wish]:
    """All trials of the grid, in random order."""
    rng = np.random.default_rng(seed)
    conditions = _conditions(rng)
    wishes = [
        *singles(motions, rng),
        *pairs(motions, rng),
        *(Wish("outside", scene, outside=(kind, target)) for kind, scene, target in PLACES),
    ]
    wishes = [
        dataclasses.replace(wish, **condition)
        for wish, condition in zip(wishes, conditions, strict=False)
    ]
    wishes = [_untangled(wish) for wish in wishes] + without(rng)
    order = rng.permutation(len(wishes))
    return [dataclasses.replace(wishes[i], seed=int(rng.integers(2**31))) for i in order]


def _untangled(wish: Wish) -> Wish:
    if wish.kind == "outside":
        return dataclasses.replace(wish, wrong="right")
    for effect, _ in wish.effects:
        wrong = MEANS_THE_SAME.get((effect, wish.wrong), wish.wrong)
        wish = dataclasses.replace(wish, wrong=wrong)
    return wish


def singles(motions: dict[str, Motion], rng: np.random.Generator) -> list[Wish]:
    """Every effect at every target, at some of them where there are many."""
    found = []
    for effect, scene in itertools.product(SIZES, motions):
        possible = list(targets(effect, motions[scene]))
        most = MOST_TARGETS.get(scene, 3)
        if effect in ("sensor_scale", "sensor_delay", "sensor_bias", "joint_coupling"):
            most = min(most, 2)
        if len(possible) > most:
            possible = [possible[i] for i in rng.choice(len(possible), most, replace=False)]
        found += [Wish("single", scene, ((effect, target),)) for target in possible]
    return found


def pairs(motions: dict[str, Motion], rng: np.random.Generator) -> list[Wish]:
    """Two effects at different targets, or of different kinds at the same."""
    found = []
    for scene, count in PAIRS.items():
        if scene not in motions:
            continue
        pool = [(e, t) for e in SIZES for t in targets(e, motions[scene])]
        for _ in range(count):
            while True:
                i, j = rng.choice(len(pool), 2, replace=False)
                if _clear((pool[i], pool[j])):
                    break
            found.append(Wish("pair", scene, (pool[i], pool[j])))
    return found


def _clear(two: Sequence[tuple[str, str]]) -> bool:
    names = {effect for effect, _ in two}
    return len(names) == 2 and not any(len(names & group) > 1 for group in TOGETHER_UNCLEAR)


def without(rng: np.random.Generator) -> list[Wish]:
    """No effect: declared rightly at all levels of noise, and a few declared wrongly."""
    found = []
    for scene in RIGS:
        for i in range(NO_EFFECT):
            found.append(
                Wish("none", scene, noise=NOISES[i % 3], velocities=bool((i // 3) % 2 == 0))
            )
        for i, wrong in enumerate(("mass", "damping", "gains")):
            noise = NOISES[(i + len(found)) % 2]
            found.append(Wish("none", scene, noise=noise, wrong=wrong, velocities=i != 1))
    return found


def _conditions(rng: np.random.Generator) -> Iterable[dict[str, object]]:
    """Noise, velocities and what is wrong: all combinations equally often, in random order."""
    block = list(
        itertools.product(
            NOISES, (True, False), ("right", "mass", "right", "damping", "right", "gains")
        )
    )
    while True:
        for i in rng.permutation(len(block)):
            noise, velocities, wrong = block[i]
            yield {"noise": noise, "velocities": velocities, "wrong": wrong}


def _one(effect: str, scene: str, target: str, **more: object) -> Wish:
    return Wish("single", scene, ((effect, target),), **more)  # type: ignore[arg-type]


_SAMPLE = (
    Wish("none", "arm2", noise=5e-4, seed=101),
    _one("coulomb_friction", "arm2", "elbow", velocities=False, seed=103),
    _one("torque_gain", "arm2", "shoulder", noise=5e-4, seed=105),
    _one("viscous_damping", "cart_pole", "cart", noise=5e-4, wrong="mass", seed=104),
    _one("clock_skew", "cart_pole", "recording", seed=110),
    _one("actuator_lag", "servo_pendulum", "servo", seed=106),
    _one("payload", "servo_pendulum", "rod", velocities=False, seed=109),
    _one("quadratic_drag", "bouncing_ball", "ball", seed=113),
    Wish(
        "pair",
        "arm2",
        (("coulomb_friction", "shoulder"), ("joint_spring", "elbow")),
        seed=111,
    ),
    Wish("outside", "servo_pendulum", outside=("RandomForce", "servo"), seed=112),
)

SAMPLE: tuple[Wish, ...] = tuple(dataclasses.replace(wish, short=True) for wish in _SAMPLE)
"""A fixed few that run with the tests."""
