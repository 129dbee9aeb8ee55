"""Models that differ from world to world: drawn anew for each episode, or from a diagnosis."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeAlias

import mujoco
import numpy as np
import numpy.typing as npt
from dm_control.mujoco import engine

from orbisim.effects.base import EffectInstance
from orbisim.effects.carry import edited
from orbisim.effects.catalogue import find
from orbisim.errors import InputError, UnknownNameError
from orbisim.files.reading import read_json
from orbisim.scene import Scene
from orbisim.vector.models import numbers

Floats = npt.NDArray[np.float64]
Draw: TypeAlias = Callable[[np.random.Generator, Floats], npt.ArrayLike]
"""From random numbers and the declared values to an episode's values, of the same shape."""

_APART = 0x7EC70
"""Keeps the numbers of a world's randomisation apart from those of its task."""


def factor(low: float, high: float) -> Draw:
    """Each declared number times one drawn evenly between two."""
    _check_range("factor", low, high)
    return lambda random, values: values * random.uniform(low, high, values.shape)


def between(low: float, high: float) -> Draw:
    """Each number drawn evenly between two, in the field's own unit."""
    _check_range("between", low, high)
    return lambda random, values: random.uniform(low, high, values.shape)


class Randomization:
    """Draws fields of a model for each episode of each world.

    Args:
      physics: of one world, with the declared model.
      draws: by field (`geom_friction`) or field and element (`body_mass/torso`), in the order in
        which they are applied.
      nworld: number of worlds.
      seed: of the first world.

    Raises:
      UnknownNameError: there is no such field or element.
      InputError: what should draw is neither `factor`, `between` nor a function.
    """

    def __init__(
        self, physics: engine.Physics, draws: Mapping[str, Draw], nworld: int, seed: int
    ) -> None:
        self._declared = {n: np.array(v) for n, v in numbers(physics.model.ptr).items()}
        self._draws = [(*self._place(physics, name), name, d) for name, d in draws.items()]
        for name, draw in draws.items():
            if not callable(draw):
                raise InputError(
                    f"randomize[{name!r}] is {draw!r}; expected factor(low, high), between(low, "
                    "high) or a function of random numbers and the declared values"
                )
        self._data = mujoco.MjData(physics.model.ptr)
        self._random = [_generator(seed + world) for world in range(nworld)]

    def seed(self, world: int, seed: int) -> None:
        """Gives a world the random numbers of a seed."""
        self._random[world] = _generator(seed)

    def apply(self, world: int, model: mujoco.MjModel) -> None:
        """Draws a world's next values into a model, and what MuJoCo derives from them.

        Raises:
          InputError: a function gave other than finite numbers of the declared shape.
        """
        views = numbers(model)
        for field, key, name, draw in self._draws:
            declared = self._declared[field][key]
            drawn = np.asarray(draw(self._random[world], np.array(declared)), np.float64)
            if drawn.shape != declared.shape or not np.isfinite(drawn).all():
                raise InputError(
                    f"randomize[{name!r}] gave {drawn}; expected finite numbers of shape "
                    f"{declared.shape}"
                )
            views[field][key] = drawn
        mujoco.mj_setConst(model, self._data)

    def _place(self, physics: engine.Physics, name: str) -> tuple[str, Any]:
        """A field and the index of an element in it."""
        field, _, element = name.partition("/")
        if field not in self._declared or self._declared[field].dtype.kind != "f":
            known = [n for n, v in self._declared.items() if v.dtype.kind == "f"]
            raise UnknownNameError("field of the model to randomize", field, known)
        if not element:
            return field, slice(None)
        try:
            return field, getattr(physics.named.model, field)._convert_key(element)
        except (KeyError, AttributeError, IndexError):
            raise UnknownNameError(f"element of {field!r}", element, []) from None


@dataclasses.dataclass(frozen=True)
class Intervals:
    """Effects whose parameters are known up to intervals, as a diagnosis finds them.

    Attributes:
      effects: each with the middle of its intervals. ranges: by parameter, of each effect.
    """

    effects: tuple[EffectInstance, ...]
    ranges: tuple[Mapping[str, tuple[float, float]], ...]

    def draw(self, scene: Scene, seed: int) -> Scene:
        """The scene with the effects, their parameters drawn evenly from the intervals.

        Raises:
          InputError: an effect does not fit the scene.
        """
        random = _generator(seed)
        drawn = [
            effect.replace(**{n: float(random.uniform(*span)) for n, span in spans.items()})
            for effect, spans in zip(self.effects, self.ranges, strict=True)
        ]
        upper = [
            effect.replace(**{n: high for n, (_, high) in spans.items()})
            for effect, spans in zip(self.effects, self.ranges, strict=True)
        ]
        spec, longest = edited(scene, drawn), edited(scene, upper)
        for actuator, other in zip(spec.actuators, longest.actuators, strict=True):
            # what is remembered of late controls: states of all worlds are of one size
            actuator.nsample = max(actuator.nsample, other.nsample)
        return Scene.from_spec(spec, source=scene.source, unsupported=scene.unsupported)


def intervals(report: str | Path | Mapping[str, Any]) -> Intervals:
    """The intervals of a diagnosis, to draw the worlds of `from_scene` from.

    Args:
      report: `report.json` of `orbisim diagnose`, or what is in it.

    Raises:
      InputError: it is no such report, it names no effect, or an effect acts between timesteps
        (those are of one scene; add them with `orbisim diagnose` and use the augmented scene).
    """
    source = "report" if isinstance(report, Mapping) else str(report)
    content = report if isinstance(report, Mapping) else read_json(report)
    if content.get("schema") != "orbisim.diagnosis/1":
        raise InputError(f"{source}: not a diagnosis (schema {content.get('schema')!r})")
    found = [_effect(one, source) for one in content.get("effects") or ()]
    if not found:
        raise InputError(
            f"{source}: the diagnosis names no effect to draw (verdict {content.get('verdict')!r})"
        )
    return Intervals(tuple(e for e, _ in found), tuple(s for _, s in found))


def _effect(one: Any, source: str) -> tuple[EffectInstance, dict[str, tuple[float, float]]]:
    try:
        parameters = one["parameters"]
        values = {name: float(p["value"]) for name, p in parameters.items()}
        spans = {}
        for name, p in parameters.items():
            low, high = p["ci95"]
            fitted = low is not None and high is not None  # what was not keeps its value
            spans[name] = (float(low), float(high)) if fitted else (values[name], values[name])
        instance = EffectInstance(one["effect"], one["target"], values, one.get("options") or {})
    except (KeyError, TypeError, ValueError, IndexError, AttributeError):
        raise InputError(
            f"{source}: an effect needs 'effect', 'target' and 'parameters' with 'value' and "
            f"'ci95'; got {one!r}"
        ) from None
    effect = find(instance.effect)
    if not effect.native or effect.measurement:
        raise InputError(
            f"{source}: {instance.effect} at {instance.target!r} is not part of the model, and "
            "cannot differ from world to world"
        )
    for name, (low, high) in spans.items():
        _check_range(f"{instance.effect}, {name!r}", low, high)
    return instance, spans


def _check_range(what: str, low: float, high: float) -> None:
    if not (np.isfinite([low, high]).all() and low <= high):
        raise InputError(f"{what}: a range goes from a lower to a higher number; got {low}, {high}")


def _generator(seed: int) -> np.random.Generator:
    return np.random.default_rng((seed, _APART))
