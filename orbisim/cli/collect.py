"""`orbisim collect`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from orbisim.cli.common import (
    emit_json,
    engine_command,
    json_option,
    note,
    print_table,
    scene_options,
    seed_option,
    warn_undriven,
)
from orbisim.errors import InputError


@click.command(
    "collect",
    epilog="Example: orbisim collect push --episodes 200 --workers 8 --out push.h5",
)
@click.argument("task", metavar="TASK-OR-SCENE")
@click.option("--episodes", type=int, default=None, help="How many. Default: as in the paper.")
@click.option(
    "--subtask",
    default=None,
    help="Only this one; of a scene a policy: held, smooth, rhythm, reach (or free). Default: all.",
)
@click.option("--workers", type=int, default=None, help="Processes. Default: all cores.")
@click.option(
    "--out", type=click.Path(path_type=Path), required=True, help="The file; it must not exist."
)
@click.option(
    "--frames",
    "camera",
    default=None,
    help="Also images from this camera; `random`: from one drawn anew for each episode.",
)
@click.option("--size", default=128, show_default=True, help="Height and width of the images.")
@click.option(
    "--buffers/--no-buffers", default=True, help="With images also depth and segmentation."
)
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="NAME=VALUE",
    help="A setting of the task: a number, or a range LOW,HIGH. May be repeated.",
)
@click.option(
    "--randomize",
    default=None,
    metavar="PERCENT|FILE",
    help="Of a scene: each episode's masses, dampings, frictions and gains differ from those "
    "declared by up to so many percent, or as a file says (mass: 20, damping/elbow: [0.5, 2]).",
)
@click.option("--ray", is_flag=True, help="Spread over a Ray cluster (RAY_ADDRESS, or local).")
@seed_option
@json_option
@scene_options("task")
@engine_command
def command(
    task: str,
    episodes: int | None,
    subtask: str | None,
    workers: int | None,
    out: Path,
    camera: str | None,
    size: int,
    buffers: bool,
    settings: tuple[str, ...],
    randomize: str | None,
    ray: bool,
    seed: int,
    as_json: bool,
) -> None:
    """Collect episodes of a task (push, ball, suite:cheetah-run ...) into an HDF5 file.

    Or of a scene (arm.xml), with the effects that it carries, under noise, rhythms and reaching.

    The same seed gives the same bytes, whatever the number of workers. If the work is interrupted,
    the same command goes on where it stopped. docs/episodes.md has the format.
    """
    from orbisim.tasks.collect import collect
    from orbisim.tasks.frames import Camera
    from orbisim.tasks.randomize import factors_of

    changes = dict(_setting(text) for text in settings)
    if randomize is not None:
        if not Path(task).suffix:
            raise InputError(
                f"--randomize is for scenes; {task} draws its own (--set changes its ranges)"
            )
        changes["randomize"] = factors_of(randomize)
    result = collect(
        task,
        out,
        episodes=episodes,
        seed=seed,
        workers=workers,
        subtask=subtask,
        camera=Camera(camera, size, buffers) if camera else None,
        changes=changes,
        ray=ray,
    )
    if Path(task).suffix and set(result.subtasks) == {"free"}:  # the policy of scenes without
        warn_undriven(0, task, "its bodies were let go and the episodes hold no controls")
    summary = {"schema": "orbisim.collect/1", "task": task, "seed": seed, **result.to_json()}
    if as_json:
        emit_json(summary)
        return
    print_table(
        f"{result.episodes} episodes, {result.steps} control steps",
        ("subtask", "episodes", "success"),
        [(name, count, result.success.get(name, "-")) for name, count in result.subtasks.items()],
    )
    note(f"{result.path}: written in {result.seconds:.1f} s")


def _setting(text: str) -> tuple[str, Any]:

    name, equals, value = text.partition("=")
    try:
        numbers = tuple(float(part) for part in value.split(","))
    except ValueError:
        numbers = ()
    if not (equals and numbers):
        raise InputError(f"--set is NAME=NUMBER or NAME=LOW,HIGH; got {text!r}")
    return name.strip(), numbers[0] if len(numbers) == 1 else numbers
