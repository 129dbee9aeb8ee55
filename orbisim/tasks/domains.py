"""The tasks of dm_control's suite on which learned dynamics are trained and measured, and the
families of mechanisms."""

from __future__ import annotations

SUITE_TASKS = (
    "pendulum-swingup",
    "cartpole-swingup",
    "acrobot-swingup",
    "point_mass-easy",
    "reacher-easy",
    "finger-spin",
    "cheetah-run",
    "hopper-hop",
    "walker-walk",
)
"""One task for each domain, as `suite:` names them."""

SUITE_DOMAINS = {name.partition("-")[0]: name.partition("-")[2] for name in SUITE_TASKS}
"""The task of each domain."""

SUBSTEPS = {"finger": 2, "hopper": 4, "walker": 5}
"""Parts of a control step that the model takes one at a time, where contacts come and go within."""

MECHANISMS = (
    "bottle",
    "coffee_machine",
    "door",
    "lamp",
    "microwave",
    "pen",
    "pressure_cooker",
    "safe",
    "window",
)
"""Families, as `task:mechanism:` names them."""

HELD_OUT_MECHANISMS = ("coffee_machine", "window")
"""Families that no model is trained on."""
