"""Configurations of learned cloth: frozen values, written to and read from JSON."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Literal

from orbisim.errors import InputError, UnknownNameError
from orbisim_world_model.plain import checked

Kind = Literal["graph", "shape", "ballistic", "copy", "constant_velocity"]


@dataclasses.dataclass(frozen=True)
class ClothModel:
    """What the model is.

    Attributes:
      kind: `graph`, messages among the vertices along the cloth's edges; `shape`, the paper's low
        dimensional shape feature as state (appendix B.4); or nothing learned: `ballistic` falls,
        `constant_velocity` goes on, `copy` stays.
      width, layers: of the network.
      codes: numbers of the shape feature (`shape`).
      projections: how often a step moves vertices back to where edges keep their lengths and
        nothing is inside of things; 0: the network alone decides.
    """

    kind: Kind = "graph"
    width: int = 32
    layers: int = 4
    codes: int = 96
    projections: int = 10


@dataclasses.dataclass(frozen=True)
class ClothStage:
    """A part of the training: its share of the whole, steps of a sequence, sequences at once."""

    fraction: float
    length: int
    batch: int


@dataclasses.dataclass(frozen=True)
class ClothTraining:
    """How it is trained.

    Attributes:
      stages: one after the other; every step of a sequence starts from what the model predicted.
      rate, final_rate: learning rate at the start, and at the end of the cosine decay.
      clip: largest norm of the gradient.
      noise: on the first state, in units of the root mean square change of one step beyond free
        fall.
      velocity: weight of velocities' errors beside positions', both in these units.
    """

    stages: tuple[ClothStage, ...] = (
        ClothStage(0.15, 1, 16),
        ClothStage(0.5, 6, 6),
        ClothStage(0.35, 16, 3),
    )
    rate: float = 2e-3
    final_rate: float = 2e-5
    clip: float = 1.0
    noise: float = 0.1
    velocity: float = 0.5


@dataclasses.dataclass(frozen=True)
class ClothConfig:
    """Everything that decides what is trained and how."""

    name: str = "cloth"
    model: ClothModel = ClothModel()
    train: ClothTraining = ClothTraining()

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return dataclasses.asdict(self)


CLOTH_PRESETS = {
    config.name: config
    for config in (
        ClothConfig(),
        ClothConfig("cloth_free", ClothModel(projections=0)),
        ClothConfig("cloth_shape", ClothModel(kind="shape", width=128, layers=3, projections=0)),
    )
}
"""The mesh graph; without what is known of edges and contacts; the paper's shape feature."""


def cloth_preset(name: str, assignments: Mapping[str, str] | None = None) -> ClothConfig:
    """The configuration of this name, with settings (`model.width`: `64`) changed.

    Raises:
      UnknownNameError: there is no such configuration or setting.
      InputError: a value has the wrong type.
    """
    if name not in CLOTH_PRESETS:
        raise UnknownNameError("configuration", name, CLOTH_PRESETS)
    config = CLOTH_PRESETS[name]
    for path, text in (assignments or {}).items():
        group, _, field = path.partition(".")
        part = getattr(config, group, None) if group in ("model", "train") else None
        if part is None or not hasattr(part, field):
            raise UnknownNameError("setting", path, _settings(config))
        changed = dataclasses.asdict(part) | {field: _value(path, text, getattr(part, field))}
        made = checked(type(part), changed, path)
        config = dataclasses.replace(config, **{group: made})
    return config


def _settings(config: ClothConfig) -> tuple[str, ...]:
    groups = ("model", "train")
    return tuple(f"{g}.{f.name}" for g in groups for f in dataclasses.fields(getattr(config, g)))


def _value(path: str, text: Any, like: Any) -> Any:
    if not isinstance(text, str) or isinstance(like, str):
        return text
    try:
        if isinstance(like, tuple):
            return [_stage(part) for part in text.split(",")]
        return type(like)(text)
    except ValueError:
        wanted = "0.5x1x16,0.5x4x6 (share x steps x batch)" if isinstance(like, tuple) else like
        raise InputError(f"setting {path} is {text!r}; expected something like {wanted}") from None


def _stage(text: str) -> dict[str, Any]:
    share, length, batch = text.split("x")
    return {"fraction": float(share), "length": int(length), "batch": int(batch)}
