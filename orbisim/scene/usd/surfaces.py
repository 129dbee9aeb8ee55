"""Physics materials: friction and bounce."""

from __future__ import annotations

import dataclasses
import math

from orbisim.scene.usd.attributes import Prim
from orbisim.scene.usd.context import Context

_STIFFNESS = 2500.0  # 1/s^2: that of MuJoCo's default solref, 1 / (0.02 s)^2


@dataclasses.dataclass(frozen=True)
class Surface:
    """What a physics material says about contact; None where it says nothing.

    Attributes:
      friction: sliding, torsional (m), rolling (m) coefficients.
      solref: MuJoCo's contact reference, for materials that bounce.
      density: kg/m^3.
    """

    friction: tuple[float, float, float] | None = None
    solref: tuple[float, float] | None = None
    density: float | None = None


def read_surfaces(context: Context) -> dict[str, Surface]:
    """The surfaces of all physics materials by path."""
    return {prim.path: _read(context, prim) for prim in context.with_schema("PhysicsMaterialAPI")}


def _read(context: Context, prim: Prim) -> Surface:
    density = prim.number("physics:density", context.units.density) or None
    if density is not None and density < 0:
        raise prim.error(f"physics:density is {density}; expected a positive number")
    _skip_contact_gains(context, prim)
    return Surface(_friction(context, prim), _bounce(prim), density)


def _friction(context: Context, prim: Prim) -> tuple[float, float, float]:
    """MuJoCo has one sliding coefficient, for contacts that stick and contacts that slip."""
    static = prim.number("physics:staticFriction", infinite=True)
    dynamic = prim.number("physics:dynamicFriction", infinite=True)
    sliding = dynamic if dynamic is not None else static or 0.0
    if dynamic is not None and static is not None and static != dynamic:
        context.omit(
            prim.path,
            f"physics:staticFriction {static:g} differs from physics:dynamicFriction {dynamic:g}",
            "the dynamic coefficient holds for both",
        )
    if sliding < 0 or math.isinf(sliding):
        raise prim.error(f"friction is {sliding}; expected a finite number that is not negative")
    lengths = context.units.length
    torsional = prim.number("mjc:torsionalfriction")
    rolling = prim.number("mjc:rollingfriction")
    newton_torsional = prim.number("newton:torsionalFriction", lengths)
    newton_rolling = prim.number("newton:rollingFriction", lengths)
    return (
        sliding,
        _first(torsional, newton_torsional, 0.005),
        _first(rolling, newton_rolling, 0.0001),
    )


def _first(*values: float | None) -> float:
    return next(value for value in values if value is not None)


def _bounce(prim: Prim) -> tuple[float, float] | None:
    restitution = prim.number("physics:restitution") or 0.0
    if not 0 <= restitution <= 1:
        raise prim.error(f"physics:restitution is {restitution}; expected 0 to 1")
    if restitution == 0:
        return None
    return bouncing_solref(restitution)


def bouncing_solref(restitution: float) -> tuple[float, float]:
    """`solref` (stiffness and damping form) of a contact that bounces.

    A contact in MuJoCo is a spring and damper that only pushes; `damping_ratio` says how much
    damping leaves the wanted share of the speed.
    """
    damping = 2 * damping_ratio(restitution) * math.sqrt(_STIFFNESS)
    return -_STIFFNESS, -damping


def damping_ratio(restitution: float) -> float:
    """Damping ratio of a spring and damper, not pulling, that restores a share of the speed.

    Found by bisection in (0, 1); below a share of exp(-2) the spring is critically damped, as
    MuJoCo's contacts are by default.
    """
    low, high = 0.0, 1.0 - 1e-9
    for _ in range(60):
        middle = (low + high) / 2
        if _restored(middle) > restitution:
            low = middle
        else:
            high = middle
    return (low + high) / 2


def _restored(ratio: float) -> float:
    """Share of the speed that is left when a damped spring stops pushing.

    With x'' + 2 z x' + x = 0, x(0) = 0, x'(0) = -1, the force vanishes when x = -2 z x'; its
    phase then is w t = atan2(2 z w, 2 z^2 - 1) with w = sqrt(1 - z^2), and the speed
    exp(-z t). (Schwager and Poeschel, Granular Matter 9, 2007.)
    """
    if ratio == 0:
        return 1.0
    frequency = math.sqrt(1 - ratio * ratio)
    phase = math.atan2(2 * ratio * frequency, 2 * ratio * ratio - 1)
    return math.exp(-ratio * phase / frequency)


def _skip_contact_gains(context: Context, prim: Prim) -> None:
    """Gains per unit of force: MuJoCo's are normalised by mass."""
    for name in ("newton:contactStiffness", "newton:contactDamping"):
        value = prim.number(name, infinite=True)
        if value is not None and value >= 0 and not context.for_mujoco:
            context.omit(prim.path, name, "MuJoCo's contact parameters are normalised by mass")
