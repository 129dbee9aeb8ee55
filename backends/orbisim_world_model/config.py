"""Configurations: frozen values, written to and read from JSON."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from typing import Any, Literal

from orbisim.errors import InputError, UnknownNameError

Kind = Literal["objects", "global", "dreamer", "constant_velocity"]


@dataclasses.dataclass(frozen=True)
class ModelConfig:
    """What the network is.

    Attributes:
      kind: `objects` for one token an entity (the paper); `global` for one vector of everything
        (the paper's ablation); `dreamer` for a DreamerV3-style RSSM; `constant_velocity`.
      width, layers, heads: of tokens and coupling module.
      expansion: width of the feed-forward layers over the tokens' width.
      memory: recurrent memory of each entity; `none` makes the model a function of x_{t-1} alone.
      control: whether the control is the actuators' (`ctrl`) or the task's own (`action`).
      extended: the state has angular velocities and joint coordinates (the paper's has not).
      residual: predict changes instead of absolute values.
      manifold: integrate rotations on SO(3) (else components are added and normalised).
      relative: see positions and velocities relative to each other, in each entity's own frame.
      skip: the transition also sees e_t directly, not only through the memory.
      baseline: `mujoco` for a correction of MuJoCo's own step (the backend `hybrid`).
      contact: see the heights of the corners of boxes over the ground, on a logarithmic scale.
      touch: see where the robot's capsules are, how they move, how far they are from the floor and
        from each other, and how far joints are from their limits.
      rest: boxes that lie flat and hardly move stay where they are (see `rest`).
      boxes: see the geometry of candidate contacts between boxes (see `contacts`).
      impulses: predict impulses within the friction cone at these contacts, beside the rest.
      apart: undo overlaps of boxes beyond those of the training data.
      geometry: parts of mechanisms are known by the tokens of their shapes.
      joints: ... and by the metadata of their joints (see `parts.JOINT`).
      articulated: every joint of a robot is a token, and nothing belongs to one robot alone (see
        `articulation`); for scenes without free bodies.
      mixed: objects and parts of mechanisms in one model, each robot with either (see `pairs` of
        `features`); a model of one kind has no room for the other's relations.
      linear: the robot's change is a linear function of what is seen of it and of the control,
        fitted to the data by least squares, and what the network adds to it.
    """

    kind: Kind = "objects"
    width: int = 128
    layers: int = 4
    heads: int = 4
    expansion: int = 4
    memory: Literal["gru", "none"] = "none"
    control: Literal["ctrl", "action"] = "ctrl"
    extended: bool = True
    residual: bool = True
    manifold: bool = True
    relative: bool = True
    skip: bool = True
    contact: bool = True
    touch: bool = False
    rest: bool = False
    boxes: bool = False
    impulses: bool = False
    apart: bool = False
    geometry: bool = True
    joints: bool = True
    linear: bool = False
    articulated: bool = False
    mixed: bool = False
    baseline: Literal["none", "mujoco"] = "none"


@dataclasses.dataclass(frozen=True)
class LossConfig:
    """Weights of the losses.

    Attributes:
      alignment: of L_tra. consistency: of L_enc.
      scaled: measure errors in units of the typical change of one step, instead of SI units.
      beta: scaled errors below it count quadratically, above it linearly.
    """

    alignment: float = 0.5
    consistency: float = 0.1
    scaled: bool = True
    beta: float = 0.3


@dataclasses.dataclass(frozen=True)
class Stage:
    """A part of the training.

    Attributes:
      fraction: of the whole training.
      length: steps of a training sequence.
      batch: sequences in a batch.
      autoregressive: whether ground truth is replaced by predictions, with a ratio that rises from
        0 to 1 on a cosine schedule over the stage; False is teacher forcing.
      warm: steps at the beginning of a sequence that always see ground truth.
      full: the ratio is 1 from the start of the stage.
      reach: steps after which gradients through predictions are cut; 0: they reach to the start.
    """

    fraction: float
    length: int
    batch: int
    autoregressive: bool = False
    warm: int = 1
    full: bool = False
    reach: int = 0


@dataclasses.dataclass(frozen=True)
class TrainConfig:
    """How the network is trained.

    Attributes:
      stages: one after the other.
      rate, final_rate: learning rate after warm-up, and at the end of the cosine decay.
      warmup: fraction of the training over which the rate rises.
      decay: AdamW's weight decay.
      clip: largest norm of the gradient.
      noise: standard deviation of the noise on inputs, in units of the change of one step.
      precision: of matrix products on a GPU.
    """

    stages: tuple[Stage, ...] = (
        Stage(0.4, 1, 8192),
        Stage(0.4, 8, 1024, autoregressive=True),
        Stage(0.2, 24, 512, autoregressive=True, full=True),
    )
    rate: float = 1e-3
    final_rate: float = 1e-6
    warmup: float = 0.02
    decay: float = 1e-4
    clip: float = 1.0
    noise: float = 0.03
    precision: Literal["tf32", "fp32"] = "tf32"


@dataclasses.dataclass(frozen=True)
class Config:
    """Everything that decides what is trained and how."""

    name: str = "default"
    model: ModelConfig = ModelConfig()
    loss: LossConfig = LossConfig()
    train: TrainConfig = TrainConfig()

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return dataclasses.asdict(self)

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> Config:
        """From JSON."""
        train = dict(values["train"])
        if train.get("precision") == "bf16":  # said so until 0.1, and computed in TF32
            train["precision"] = "tf32"
        train["stages"] = tuple(Stage(**stage) for stage in train["stages"])
        return Config(
            name=values["name"],
            model=ModelConfig(**values["model"]),
            loss=LossConfig(**values["loss"]),
            train=TrainConfig(**train),
        )


def replaced(config: Config, assignments: Mapping[str, Any]) -> Config:
    """The configuration with single settings changed: `{"model.width": 64, "train.rate": 1e-4}`.

    Raises:
      UnknownNameError: there is no such setting.
      InputError: the value has the wrong type.
    """
    for path, value in assignments.items():
        group, _, field = path.partition(".")
        part = getattr(config, group, None) if group in ("model", "loss", "train") else None
        if part is None or not hasattr(part, field):
            raise UnknownNameError("setting", path, settings(config))
        value = _converted(path, value, getattr(part, field))
        config = dataclasses.replace(config, **{group: dataclasses.replace(part, **{field: value})})
    return config


def settings(config: Config) -> tuple[str, ...]:
    """Names of all settings."""
    groups = ("model", "loss", "train")
    return tuple(f"{g}.{f.name}" for g in groups for f in dataclasses.fields(getattr(config, g)))


def _converted(path: str, value: Any, like: Any) -> Any:
    if not isinstance(value, str) or isinstance(like, str):
        return value
    words = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
    try:
        if isinstance(like, bool):
            return words[value.lower()]
        if isinstance(like, (int, float)):
            return type(like)(value)
        if path == "train.stages":
            return _stages(value)
    except (KeyError, ValueError, TypeError):
        pass
    raise InputError(f"setting {path} is {value!r}; expected something like {like!r}")


_STAGE = re.compile(r"([\d.]+)x(\d+)x(\d+)(ar)?(f)?(?:w(\d+))?(?:/(\d+))?")


def _stages(text: str) -> tuple[Stage, ...]:
    """`0.4x4x2048,0.6x16x512ar`: fraction x length x batch, `ar` for autoregressive.

    `arf` has a ratio of 1 from the start; in `0.2x100x256arw8/10` the first 8 steps of a sequence
    see ground truth and gradients are cut every 10 steps.
    """
    stages = []
    for part in text.split(","):
        found = _STAGE.fullmatch(part.strip())
        if found is None:
            raise ValueError(part)
        fraction, length, batch, auto, full, warm, reach = found.groups()
        stages.append(
            Stage(
                float(fraction),
                int(length),
                int(batch),
                autoregressive=auto is not None,
                warm=int(warm or 1),
                full=full is not None,
                reach=int(reach or 0),
            )
        )
    return tuple(stages)
