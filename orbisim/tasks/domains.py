"""The tasks of dm_control's suite on which learned dynamics are trained and measured."""

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
