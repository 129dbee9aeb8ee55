"""Named configurations: the paper's, the default, and the ablations of both."""

from __future__ import annotations

import dataclasses
from typing import Any

from orbisim.errors import UnknownNameError
from orbisim_world_model.config import Config, LossConfig, ModelConfig, Stage, TrainConfig

DEFAULT = Config()

PAPER = Config(
    name="paper",
    model=ModelConfig(
        width=144,
        memory="gru",
        control="action",
        extended=False,
        residual=False,
        manifold=False,
        relative=False,
        skip=False,
        contact=False,
    ),
    loss=LossConfig(scaled=False),
    train=TrainConfig(
        stages=(Stage(0.5, 16, 512), Stage(0.5, 16, 512, autoregressive=True)), noise=0.0
    ),
)


_PARTS: dict[str, dict[str, Any]] = {
    "parts": {},
    "parts_no_memory": {"memory": "none"},
    "parts_no_geometry": {"geometry": False},
    "parts_no_joints": {"joints": False},
}
_LIMBS = TrainConfig(
    stages=(
        Stage(0.3, 1, 4096),
        Stage(0.4, 8, 1024, autoregressive=True),
        Stage(0.3, 24, 512, autoregressive=True, full=True),
    ),
    noise=0.003,
    precision="fp32",
)
"""As for the suite's robots one by one: little noise, and no rounding of known dynamics."""
_LOCKS = (
    Stage(0.3, 8, 512),
    Stage(0.4, 32, 256, autoregressive=True),
    Stage(0.3, 100, 128, autoregressive=True, full=True, reach=25),
)
"""Long sequences: whether a part is locked may only show in what happened before."""


def _default_with(name: str, **model: Any) -> Config:
    return dataclasses.replace(
        DEFAULT, name=name, model=dataclasses.replace(DEFAULT.model, **model)
    )


PRESETS = {
    config.name: config
    for config in (
        DEFAULT,
        PAPER,
        _default_with("no_residual", residual=False, manifold=False),
        _default_with("no_manifold", manifold=False),
        _default_with("no_relative", relative=False, contact=False),
        _default_with("no_contact", contact=False),
        _default_with("no_extended", extended=False, control="action"),
        _default_with("no_skip", skip=False),
        _default_with("contacts", boxes=True, impulses=True, apart=True, rest=True),
        dataclasses.replace(
            _default_with("limbs", articulated=True, relative=False, contact=False, layers=3),
            loss=dataclasses.replace(DEFAULT.loss, alignment=0.0, consistency=0.0),
            train=_LIMBS,
        ),
        dataclasses.replace(
            _default_with("recurrent", memory="gru"),
            train=dataclasses.replace(DEFAULT.train, stages=PAPER.train.stages),
        ),
        *(
            dataclasses.replace(
                _default_with(name, linear=True, **{"memory": "gru"} | model),
                train=dataclasses.replace(DEFAULT.train, stages=_LOCKS),
            )
            for name, model in _PARTS.items()
        ),
        dataclasses.replace(
            DEFAULT, name="no_noise", train=dataclasses.replace(DEFAULT.train, noise=0.0)
        ),
        dataclasses.replace(
            DEFAULT,
            name="no_alignment",
            loss=dataclasses.replace(DEFAULT.loss, alignment=0.0, consistency=0.0),
        ),
        dataclasses.replace(
            _default_with("hybrid", baseline="mujoco"),
            loss=dataclasses.replace(DEFAULT.loss, alignment=0.0, consistency=0.0),
            train=dataclasses.replace(DEFAULT.train, stages=(Stage(1.0, 1, 4096),), noise=0.0),
        ),
        dataclasses.replace(
            PAPER, name="global", model=dataclasses.replace(PAPER.model, kind="global", width=192)
        ),
        dataclasses.replace(
            PAPER, name="dreamer", model=dataclasses.replace(PAPER.model, kind="dreamer")
        ),
        dataclasses.replace(
            PAPER,
            name="constant_velocity",
            model=dataclasses.replace(PAPER.model, kind="constant_velocity"),
        ),
    )
}


def preset(name: str) -> Config:
    """The configuration of this name.

    Raises:
      UnknownNameError: there is none.
    """
    if name not in PRESETS:
        raise UnknownNameError("configuration", name, PRESETS)
    return PRESETS[name]
