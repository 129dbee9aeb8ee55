"""`orbisim eval`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from orbisim.cli.common import device_option, emit_json, json_option, print_table
from orbisim.errors import MissingDependencyError

_EXAMPLE = "Example: orbisim eval dynamics checkpoints/push held_out.h5 --json"


@click.group("eval", epilog=_EXAMPLE)
def command() -> None:
    """Measure a learned model."""


@command.command("dynamics", epilog=_EXAMPLE)
@click.argument("checkpoint", type=click.Path(path_type=Path))
@click.argument("data", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--against",
    multiple=True,
    type=click.Path(path_type=Path),
    help="Another checkpoint on the same episodes; repeatable.",
)
@click.option("--horizon", "horizons", multiple=True, type=int, help="Control steps; repeatable.")
@click.option("--burn", default=8, show_default=True, help="True states seen before predicting.")
@click.option("--episodes", default=512, show_default=True, help="At most so many.")
@click.option("--by-group", is_flag=True, help="For each subtask by itself, too.")
@device_option
@json_option
def dynamics(
    checkpoint: Path,
    data: tuple[Path, ...],
    against: tuple[Path, ...],
    horizons: tuple[int, ...],
    burn: int,
    episodes: int,
    by_group: bool,
    device: str | None,
    as_json: bool,
) -> None:
    """Open-loop errors of CHECKPOINT on episode files DATA, by horizon.

    TrajErr (the state loss), position, rotation and velocity of hand and objects, joints; beside
    constant velocity and the checkpoints given with --against.
    """
    try:
        from orbisim_world_model.comparison import compare_checkpoints
    except ImportError as error:
        raise MissingDependencyError("evaluation", "learned", str(error)) from error
    result = compare_checkpoints(
        [checkpoint, *against],
        data,
        horizons=horizons or None,
        burn=burn,
        limit=episodes,
        device=device or "cpu",
        by_group=by_group,
    )
    if as_json:
        emit_json(result)
        return
    for group, models in result["groups"].items():
        _print(group, models)


def _print(group: str, models: dict[str, Any]) -> None:
    names = list(models)
    rows = []
    for horizon, values in models[names[0]].items():
        for quantity, value in values.items():
            if isinstance(value, dict):
                each = (models[n].get(horizon, {}).get(quantity, {}).get("median") for n in names)
                rows.append((int(horizon), quantity, *("-" if v is None else v for v in each)))
    print_table(f"{group}: median over episodes", ("steps", "quantity", *names), rows)
