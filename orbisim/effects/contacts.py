"""Effects at contacts: the target is the geom."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np

from orbisim.effects.base import (
    Effect,
    EffectInstance,
    Parameter,
    Values,
    index_of,
    names_of_kind,
    spec_element,
)
from orbisim.errors import InputError


class ContactEffect(Effect):
    """An effect at a geom that can touch something and moves."""

    kind = "geom"
    needs = (mujoco.mjtDisableBit.mjDSBL_CONSTRAINT, mujoco.mjtDisableBit.mjDSBL_CONTACT)

    def possible(self, model: mujoco.MjModel, target: str) -> bool:
        """Colliding geoms of moving bodies."""
        geom = index_of(model, "geom", target)
        collides = model.geom_contype[geom] or model.geom_conaffinity[geom]
        return bool(collides and model.body_weldid[model.geom_bodyid[geom]] != 0)


class _Coefficient(ContactEffect):
    """One of MJCF's friction coefficients, set for every contact of the geom."""

    index: int
    condim: int
    unit: str
    scale: float

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        declared = _prevailing(model, target, self.index, self.condim)
        return (Parameter("coefficient", self.unit, 0.0, 100.0, self.scale, declared),)

    def trials(self, model: mujoco.MjModel, target: str) -> list[Mapping[str, float]]:
        declared = _prevailing(model, target, self.index, self.condim)
        levels = {self.scale * f for f in (0.2, 0.6, 1.5, 4.0)} | {0.7 * declared, 1.4 * declared}
        return [{"coefficient": level} for level in sorted(levels - {0.0})]

    def edit(self, spec: mujoco.MjSpec, instance: EffectInstance) -> None:
        geom = spec_element(spec, "geom", instance.target)
        geom.friction[self.index] = max(instance.values["coefficient"], 1e-5)
        geom.condim = max(int(geom.condim), self.condim)
        _prevail(spec, geom)


class SlidingFriction(_Coefficient):
    """The sliding coefficient of the geom's contacts: MJCF `friction`, with priority."""

    name = "sliding_friction"
    phrase = "another sliding friction"
    family = "slip"
    index, condim, unit, scale = 0, 3, "1", 0.3

    def generalized(
        self, model: mujoco.MjModel, special: EffectInstance, values: Values | None = None
    ) -> list[Values]:
        """The mean of both coefficients of friction that differs by direction."""
        if special.effect != AnisotropicFriction.name:
            return []
        ratio, coefficient = special.values["ratio"], special.values["coefficient"]
        return [{"coefficient": 0.5 * (1.0 + ratio) * coefficient}]


class TorsionalFriction(_Coefficient):
    """The torsional coefficient: MJCF `friction`, `condim` at least 4."""

    name = "torsional_friction"
    rarity = -1.0
    phrase = "torsional friction"
    index, condim, unit, scale = 1, 4, "m", 0.01


class RollingFriction(_Coefficient):
    """The rolling coefficient: MJCF `friction`, `condim` 6."""

    name = "rolling_friction"
    rarity = -1.0
    phrase = "rolling friction"
    index, condim, unit, scale = 2, 6, "m", 0.005


class AnisotropicFriction(ContactEffect):
    """Two sliding coefficients: an explicit contact pair.

    The ratio is that of the second tangential coefficient to the first; the first keeps its
    declared value. The directions are the contact frame's.
    """

    name = "anisotropic_friction"
    rarity = -2.0
    phrase = "anisotropic friction"
    family = "slip"

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        return (
            Parameter("ratio", "1", 0.01, 100.0, 0.5, neutral=1.0),
            Parameter("coefficient", "1", 1e-5, 100.0, 0.5, _prevailing(model, target, 0, 3)),
        )

    def trials(self, model: mujoco.MjModel, target: str) -> list[Mapping[str, float]]:
        declared = _prevailing(model, target, 0, 3)
        return [{"ratio": ratio, "coefficient": declared} for ratio in (0.3, 0.6, 1.6, 3.0)]

    def edit(self, spec: mujoco.MjSpec, instance: EffectInstance) -> None:
        model = spec.copy().compile()
        own = index_of(model, "geom", instance.target)
        first = instance.values["coefficient"]
        for other in _partners(model, own):
            _pair(spec, model, own, other, (first, first * instance.values["ratio"]))


class Restitution(ContactEffect):
    """The geom bounces: `solref` as stiffness and damping that give the coefficient.

    The damping ratio is that of a linear spring and damper that cannot pull (Schwager and Poeschel,
    Granular Matter 9, 2007: `restitution_of`); `stiffness` is that of the reference
    acceleration, 1/s^2.
    """

    name = "restitution"
    phrase = "restitution"
    family = "contact"

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        stiffness, ratio = _declared_spring(model, target)
        return (
            Parameter("coefficient", "1", 0.0, 1.2, 0.5, restitution_of(ratio)),
            Parameter("stiffness", "1/s^2", 10.0, 1e9, 1e5, stiffness),
        )

    def trials(self, model: mujoco.MjModel, target: str) -> list[Mapping[str, float]]:
        most = min(1e5, 0.1 / float(model.opt.timestep) ** 2)
        return [
            {"coefficient": coefficient, "stiffness": stiffness}
            for coefficient in (0.1, 0.4, 0.7, 0.9)
            for stiffness in (most, most / 8)
        ]

    def generalized(
        self, model: mujoco.MjModel, special: EffectInstance, values: Values | None = None
    ) -> list[Values]:
        """A softer contact that bounces a little more than declared, and much."""
        if special.effect != ContactCompliance.name:
            return []
        declared = restitution_of(special.values["damping_ratio"])
        stiffness = special.values["stiffness"]
        return [{"coefficient": max(declared, e), "stiffness": stiffness} for e in (0.2, 0.5)]

    def edit(self, spec: mujoco.MjSpec, instance: EffectInstance) -> None:
        geom = spec_element(spec, "geom", instance.target)
        stiffness = instance.values["stiffness"]
        ratio = damping_ratio_for(instance.values["coefficient"])
        geom.solref = [-stiffness, -2.0 * ratio * np.sqrt(stiffness)]
        _prevail(spec, geom)


def restitution_of(ratio: float) -> float:
    """Coefficient of restitution of a spring and damper of this damping ratio, without tension.

    The contact ends when the force is back at zero, before the deflection is. Schwager and
    Poeschel (2007), equations 20 and 21.
    """
    if ratio <= 0:
        return float(np.exp(-ratio * np.pi))
    if ratio < 1:
        swing = np.sqrt(1 - ratio**2)
        angle = np.arctan2(2 * ratio * swing, 1 - 2 * ratio**2)
        return float(np.exp(-ratio / swing * (np.pi - angle)))
    if ratio == 1:
        return float(np.exp(-2.0))
    spread = np.sqrt(ratio**2 - 1)
    return float(np.exp(-ratio / spread * np.log((ratio + spread) / (ratio - spread))))


def damping_ratio_for(coefficient: float) -> float:
    """The damping ratio that gives a coefficient of restitution (below 0: more than 1)."""
    from scipy import optimize

    low, high = -0.1, 50.0
    if coefficient >= restitution_of(low):
        return low
    if coefficient <= restitution_of(high):
        return high
    return float(optimize.brentq(lambda r: restitution_of(r) - coefficient, low, high))


class ContactCompliance(ContactEffect):
    """The geom is softer than declared, or stiffer, and bounces as declared: `solref` as stiffness
    and damping, of which the ratio stays. What bounces otherwise is `restitution`."""

    name = "contact_compliance"
    phrase = "a compliant contact"
    family = "contact"

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        stiffness, ratio = _declared_spring(model, target)
        return (
            Parameter("stiffness", "1/s^2", 10.0, 1e9, 2e3, stiffness),
            Parameter("damping_ratio", "1", 0.0, 100.0, 1.0, ratio),
        )

    def trials(self, model: mujoco.MjModel, target: str) -> list[Mapping[str, float]]:
        _, ratio = _declared_spring(model, target)
        return [{"stiffness": one, "damping_ratio": ratio} for one in (300.0, 1e3, 4e3)]

    def free_parameters(self, model: mujoco.MjModel, target: str) -> tuple[str, ...]:
        return ("stiffness",)

    def edit(self, spec: mujoco.MjSpec, instance: EffectInstance) -> None:
        geom = spec_element(spec, "geom", instance.target)
        stiffness = instance.values["stiffness"]
        ratio = instance.values["damping_ratio"]
        geom.solref = [-stiffness, -2.0 * ratio * np.sqrt(stiffness)]
        _prevail(spec, geom)


class Adhesion(ContactEffect):
    """A force that holds the geom to what it touches: MJCF `adhesion`."""

    name = "adhesion"
    rarity = -3.0
    phrase = "adhesion"

    def parameters(self, model: mujoco.MjModel, target: str) -> tuple[Parameter, ...]:
        return (Parameter("force", "N", 0.0, 1e6, 1.0),)

    def trials(self, model: mujoco.MjModel, target: str) -> list[Mapping[str, float]]:
        body = int(model.geom_bodyid[index_of(model, "geom", target)])
        weight = float(model.body_subtreemass[body]) * float(np.linalg.norm(model.opt.gravity))
        return [{"force": f * max(weight, 0.1)} for f in (0.1, 0.4, 1.5)]

    def equivalents(self, model: mujoco.MjModel, instance: EffectInstance) -> list[EffectInstance]:
        """More friction of a free body: what holds it down is seen where it slides alone."""
        body = int(model.geom_bodyid[index_of(model, "geom", instance.target)])
        name = names_of_kind(model, "body")[body]
        same = pressed(model, name, instance.values["force"])
        return [one for one in same if one.target == instance.target]

    def edit(self, spec: mujoco.MjSpec, instance: EffectInstance) -> None:
        spec_element(spec, "geom", instance.target).adhesion = instance.values["force"]


def pressed(model: mujoco.MjModel, body: str, force: float) -> list[EffectInstance]:
    """Sliding friction that does nearly the same to a free body as one more force along gravity
    (negative: against it): what slides under its own weight shows friction times load alone.

    Args:
      body: its name. force: N.
    """
    number = index_of(model, "body", body)
    joint = int(model.body_jntadr[number])
    weight = float(model.body_subtreemass[number] * np.linalg.norm(model.opt.gravity))
    if joint < 0 or model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE or not weight > 0:
        return []
    friction, found = SlidingFriction(), []
    own = np.flatnonzero(model.body_weldid[model.geom_bodyid] == model.body_weldid[number])
    for geom in map(int, own):
        name = names_of_kind(model, "geom")[geom]
        coefficient = _prevailing(model, name, 0, 3) * (1.0 + force / weight)
        if friction.possible(model, name) and coefficient > 0:
            found.append(EffectInstance(friction.name, name, {"coefficient": coefficient}))
    return found


def _prevail(spec: mujoco.MjSpec, geom: Any) -> None:
    """Makes the geom's contact parameters win over its partners'."""
    geom.priority = max((int(g.priority) for g in spec.geoms), default=0) + 1


def _prevailing(model: mujoco.MjModel, target: str, index: int, condim: int) -> float:
    """A friction coefficient as declared: the larger of the geom's own and its partners', or that
    of the higher priority; 0 if no contact has the dimension in which it acts."""
    own = index_of(model, "geom", target)
    geoms = [own, *_partners(model, own)]
    first = max(int(model.geom_priority[g]) for g in geoms)
    ruling = [g for g in geoms if model.geom_priority[g] == first]
    if max(int(model.geom_condim[g]) for g in ruling) < condim:
        return 0.0
    return max(float(model.geom_friction[g, index]) for g in ruling)


def _declared_spring(model: mujoco.MjModel, target: str) -> tuple[float, float]:
    """Stiffness, 1/s^2, and damping ratio of the geom's `solref` in its direct form; `solimp`
    scales both forms alike."""
    first, second = map(float, model.geom_solref[index_of(model, "geom", target)])
    if first > 0:
        return 1 / max(first * second, 1e-9) ** 2, second
    return -first, -second / (2 * np.sqrt(max(-first, 1e-12)))


def _partners(model: mujoco.MjModel, own: int) -> list[int]:
    """Geoms of other bodies that can touch the geom."""
    bits = model.geom_contype[own], model.geom_conaffinity[own]
    return [
        other
        for other in range(model.ngeom)
        if model.geom_bodyid[other] != model.geom_bodyid[own]
        and (bits[0] & model.geom_conaffinity[other] or bits[1] & model.geom_contype[other])
    ]


def _pair(
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    own: int,
    other: int,
    sliding: tuple[float, float],
) -> None:
    names = [model.geom(i).name for i in (own, other)]
    if not all(names):
        raise InputError("anisotropic_friction needs named geoms on both sides of the contact")
    friction = np.maximum(model.geom_friction[own], model.geom_friction[other])
    spec.add_pair(
        geomname1=names[0],
        geomname2=names[1],
        condim=max(int(model.geom_condim[own]), 3),
        friction=[*sliding, friction[1], friction[2], friction[2]],
        solref=list(model.geom_solref[own]),
        solimp=list(model.geom_solimp[own]),
    )
