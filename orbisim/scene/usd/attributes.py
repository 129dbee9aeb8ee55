"""Reading attributes: checked, converted, and accounted for.

Every attribute that is read is marked as used; what remains of the physical ones at the end is
reported, grouped by name, so that nothing is dropped in silence.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from orbisim.errors import SceneError
from orbisim.scene.usd.decimals import converted, unit_quaternion
from orbisim.scene.usd.flat import FlatPrim, FlatStage, FloatArray, Value

_PHYSICAL_NAMESPACES = (
    "physics", "physx", "omniphysics", "mjc", "newton", "warp", "isaac", "drive", "limit", "state",
)  # fmt: skip
"""Beginnings of the namespaces of attributes that say something about physics."""

_INFINITE = 0.5e38
"""UsdPhysics takes float32 numbers from here on as infinite."""


class Prim:
    """A prim with checked access to its attributes.

    Attributes:
      flat: the prim as dumped.
    """

    def __init__(self, flat: FlatPrim, source: str) -> None:
        self.flat = flat
        self.path = flat.path
        self._source = source
        self._used: set[str] = set()

    def has(self, schema: str) -> bool:
        """Whether an API schema is applied."""
        return self.flat.has(schema)

    def authored(self, name: str) -> bool:
        """Whether an attribute has a value."""
        return name in self.flat.attributes

    def use(self, *names: str) -> None:
        """Marks attributes and relationships as taken care of."""
        self._used.update(names)

    def number(self, name: str, factor: float = 1.0, *, infinite: bool = False) -> float | None:
        """A number times `factor`; None if it is not authored.

        Raises:
          SceneError: it is not a number, or not finite although `infinite` is not set.
        """
        values = self.numbers(name, 1, factor, infinite=infinite)
        return None if values is None else float(values[0])

    def numbers(
        self, name: str, count: int | None, factor: float = 1.0, *, infinite: bool = False
    ) -> FloatArray | None:
        """`count` numbers (any, if None) times `factor`; None if they are not authored."""
        value = self._get(name)
        if value is None:
            return None
        if isinstance(value, bool | int):
            value = np.array(float(value))
        if not isinstance(value, np.ndarray):
            raise self.error(f"{name} is {value!r}; expected a number")
        if value.dtype == np.int64:
            value = value.astype(np.float64)
        if count is not None and value.size != count:
            raise self.error(f"{name} holds {value.size} numbers; expected {count}")
        if infinite:
            value = value.copy()
            value[value >= _INFINITE], value[value <= -_INFINITE] = np.inf, -np.inf
        bad = np.isnan(value) if infinite else ~np.isfinite(value)
        if bad.any():
            shown = value.item() if value.size == 1 else value.ravel()[:10].tolist()
            raise self.error(f"{name} is {shown}; expected finite numbers")
        return converted(value, factor).ravel()  # type: ignore[arg-type]

    def rotation(self, name: str) -> FloatArray:
        """A unit quaternion (w, x, y, z); the identity if it is not authored, or zero."""
        self.numbers(name, 4)
        value = self.flat.attributes.get(name)
        if not isinstance(value, np.ndarray) or value.dtype == np.int64:
            return np.array([1.0, 0.0, 0.0, 0.0])
        return unit_quaternion(value)  # type: ignore[arg-type]

    def flag(self, name: str, otherwise: bool) -> bool:
        """A boolean."""
        value = self._get(name)
        if value is None:
            return otherwise
        if not isinstance(value, bool | int):
            raise self.error(f"{name} is {value!r}; expected true or false")
        return bool(value)

    def token(self, name: str, otherwise: str) -> str:
        """A token or string."""
        value = self._get(name)
        if value is None:
            return otherwise
        if not isinstance(value, str):
            raise self.error(f"{name} is {value!r}; expected a token")
        return value

    def choice(self, name: str, choices: Sequence[str], otherwise: str) -> str:
        """A token out of a few.

        Raises:
          SceneError: it is another one.
        """
        value = self.token(name, otherwise)
        if value not in choices:
            raise self.error(f"{name} is {value!r}; expected one of {', '.join(choices)}")
        return value

    def targets(self, name: str) -> tuple[str, ...]:
        """Paths that a relationship leads to."""
        self._used.add(name)
        return self.flat.relationships.get(name, ())

    def error(self, problem: str, remedy: str | None = None) -> SceneError:
        """An error that blames this prim."""
        return SceneError(self._source, problem, element=self.path, remedy=remedy)

    def leftovers(self) -> list[str]:
        """Names of authored physical attributes and relationships that nobody has used."""
        names = [*self.flat.attributes, *self.flat.relationships, *self.flat.omitted]
        return [name for name in names if name not in self._used and _is_physical(name)]

    def animated(self) -> list[str]:
        """Names of used attributes that vary over time."""
        return [name for name in self.flat.animated if name in self._used]

    def _get(self, name: str) -> Value | None:
        self._used.add(name)
        return self.flat.attributes.get(name)


def prims_of(stage: FlatStage, source: str) -> dict[str, Prim]:
    """The stage's prims by path, in the stage's order."""
    return {flat.path: Prim(flat, source) for flat in stage.prims}


def _is_physical(name: str) -> bool:
    namespace, colon, _ = name.partition(":")
    return bool(colon) and namespace.lower().startswith(_PHYSICAL_NAMESPACES)


def bounded(value: float) -> float:
    """A limit that MuJoCo can compute with: infinity becomes a very large number."""
    return math.copysign(1e10, value) if math.isinf(value) else value
