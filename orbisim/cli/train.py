"""`orbisim train`."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any, Literal

import click

from orbisim.cli.common import (
    device_option,
    emit_json,
    json_option,
    note,
    randomize_option,
    scene_options,
    seed_option,
    torch_device,
)
from orbisim.errors import InputError, MissingDependencyError

_EXAMPLE = (
    "Example: orbisim train dynamics push.h5 --config default --out checkpoints/push "
    "--time-limit 300 --device cuda"
)


@click.group("train", epilog=f"{_EXAMPLE} --json")
def command() -> None:
    """Train a learned model."""


@command.command("dynamics", epilog=_EXAMPLE)
@click.argument("data", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--config", "name", default="default", show_default=True, help="Configuration.")
@click.option(
    "--set",
    "assignments",
    multiple=True,
    metavar="NAME=VALUE",
    help="Change a setting of the configuration, such as model.width=64; repeatable.",
)
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder to write to.")
@click.option("--steps", type=click.IntRange(min=1), default=None, help="Training steps.")
@click.option(
    "--time-limit",
    type=click.FloatRange(min=0, min_open=True),
    default=None,
    help="Seconds for all of it: reading, training and measuring.",
)
@click.option("--held-out", default=0.1, show_default=True, help="Share of the episodes.")
@click.option(
    "--held-out-data",
    multiple=True,
    type=click.Path(path_type=Path),
    help="Evaluate on these episodes instead of a share of DATA; repeatable.",
)
@click.option("--save-every", default=60.0, show_default=True, help="Seconds between saves.")
@click.option("--resume", is_flag=True, help="Go on with the training that stands in --out.")
@click.option(
    "--start",
    type=click.Path(path_type=Path),
    default=None,
    help="Checkpoint to fine-tune, with its scales.",
)
@click.option(
    "--scene",
    default=None,
    help="Scene of recordings, of episodes of a scene's file, and of --residual-on.",
)
@click.option("--control-timestep", type=float, default=None, help="Control step of recordings, s.")
@click.option(
    "--residual-on",
    type=click.Choice(["mujoco"]),
    default=None,
    help="Learn what MuJoCo's step leaves over (backend hybrid).",
)
@click.option("--graph/--no-graph", default=True, help="CUDA graphs, on a GPU.")
@device_option
@seed_option
@json_option
@scene_options()
def dynamics(
    data: tuple[Path, ...],
    name: str,
    assignments: tuple[str, ...],
    out: Path,
    steps: int | None,
    time_limit: float | None,
    held_out: float,
    held_out_data: tuple[Path, ...],
    save_every: float,
    resume: bool,
    start: Path | None,
    scene: str | None,
    control_timestep: float | None,
    residual_on: str | None,
    graph: bool,
    device: str | None,
    seed: int,
    as_json: bool,
) -> None:
    """Train OrbiSim-Dynamics on episode files (orbisim collect), packs of them, or recordings.

    Leaves a checkpoint in --out (model.safetensors, manifest.json) with a model card, metrics and
    curves. Under torchrun the batch is shared among the processes. A training that was killed goes
    on with --resume as if nothing had happened.
    """
    began = time.monotonic()
    training = _training()
    settings = dict(map(_assignment, assignments))
    run = training.Run(
        out=out,
        steps=steps,
        limit=time_limit,
        seed=seed,
        device=torch_device(device),
        held_out=held_out,
        save_every=save_every,
        resume=resume,
        start=start,
        graph=graph,
        began=began,
    )
    training.check_run(run)
    from orbisim_world_model.cloth.config import CLOTH_PRESETS

    if name in CLOTH_PRESETS:
        if residual_on:
            raise InputError(f"--residual-on {residual_on} needs --config hybrid; got {name}")
        _cloth(data, held_out_data, scene, name, settings, run, as_json)
        return
    from orbisim_world_model.config import replaced
    from orbisim_world_model.packing import limb_groups, read_groups
    from orbisim_world_model.presets import preset

    config = replaced(preset(name), settings)
    if residual_on and config.model.baseline != residual_on:
        raise InputError(f"--residual-on {residual_on} needs --config hybrid; got {name}")
    how: Any = {"baseline": config.model.baseline, "scene": scene, "timestep": control_timestep}
    packs = read_groups(data, **how)
    held = read_groups(held_out_data, **how) if held_out_data else None
    if config.model.articulated:
        packs = limb_groups(packs, scene)
        held = limb_groups(held, scene) if held else None
    manifest = training.train(packs, config, run, report=_report, held=held)
    if not manifest:
        return  # another process of the group writes
    from orbisim_world_model.card import metric_lines, worse_than_constant_velocity

    if lost := worse_than_constant_velocity(manifest["metrics"]):
        note(
            f"warning: after {' and '.join(lost)} control steps its predictions are worse than if "
            "everything went on at constant velocity: do not use it; train longer (--time-limit, "
            "--resume), on a GPU, or on more episodes"
        )
    if as_json:
        emit_json({"schema": "orbisim.train/1", "checkpoint": str(out), **manifest})
        return
    click.echo("\n".join(metric_lines(manifest["metrics"])))
    note(f"checkpoint: {out}")


def _cloth(
    data: tuple[Path, ...],
    held_out_data: tuple[Path, ...],
    scene: str | None,
    name: str,
    settings: dict[str, str],
    run: Any,
    as_json: bool,
) -> None:
    """`dynamics` of a cloth."""
    from orbisim_world_model.cloth.card import cloth_lines, worse_than_known
    from orbisim_world_model.cloth.config import cloth_preset
    from orbisim_world_model.cloth.data import read_falls
    from orbisim_world_model.cloth.run import train_cloth

    config = cloth_preset(name, settings)
    held = read_falls(held_out_data, scene) if held_out_data else None
    manifest = train_cloth(read_falls(data, scene), config, run, report=_report, held=held)
    if lost := worse_than_known(manifest["metrics"]):
        note(
            f"warning: after {' and '.join(lost)} control steps its predictions are worse than if "
            "nothing had been learned: train longer (--time-limit, --resume) or on more episodes"
        )
    if as_json:
        emit_json({"schema": "orbisim.train/1", "checkpoint": str(run.out), **manifest})
        return
    click.echo("\n".join(cloth_lines(manifest["metrics"])))
    note(f"checkpoint: {run.out}")


_INFERENCE = (
    "Example: orbisim train inference checkpoints/look push.h5 --held-out-data test.h5 "
    "--time-limit 300 --device cuda"
)


@command.command("inference", epilog=_INFERENCE)
@click.argument("checkpoint", type=click.Path(path_type=Path))
@click.argument("data", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--time-limit",
    type=click.FloatRange(min=0, min_open=True),
    default=300.0,
    show_default=True,
    help="Seconds.",
)
@click.option("--steps", type=click.IntRange(min=1), default=None, help="At most so many.")
@click.option(
    "--held-out-data",
    multiple=True,
    type=click.Path(path_type=Path),
    help="Measure on these episodes; repeatable. Default: on DATA themselves.",
)
@click.option(
    "--start",
    default=None,
    type=click.Path(path_type=Path),
    help="Checkpoint whose StaInf, of the same encoder, or PhyInf to begin from.",
)
@click.option("--workers", type=click.IntRange(min=1), default=1, help="Processes that read.")
@click.option(
    "--physics",
    is_flag=True,
    help="Train PhyInf instead: densities and friction from states; DATA need no images.",
)
@click.option(
    "--objective",
    type=click.Choice(["rollout", "values"]),
    default=None,
    help="Of --physics: errors of the frozen dynamics' rollouts (default), or the true values.",
)
@click.option(
    "--dynamics",
    default=None,
    help="Of --physics: learned:PATH or learned:NAME of the zoo. Default: the one for DATA's task.",
)
@click.option("--graph/--no-graph", default=True, help="Of --physics: CUDA graphs, on a GPU.")
@device_option
@seed_option
@json_option
def inference(
    checkpoint: Path,
    data: tuple[Path, ...],
    time_limit: float,
    steps: int | None,
    held_out_data: tuple[Path, ...],
    start: Path | None,
    workers: int,
    physics: bool,
    objective: Literal["rollout", "values"] | None,
    dynamics: str | None,
    graph: bool,
    device: str | None,
    seed: int,
    as_json: bool,
) -> None:
    """Train StaInf, which reads states off frames, for a vision checkpoint; or PhyInf.

    DATA are episode files with images of a robot's task (orbisim collect --frames). It becomes a
    part of CHECKPOINT; `orbisim infer` uses it.

    With `--physics` PhyInf is trained, which reads densities of objects and friction of the table
    off windows of 64 frames of states: what it infers goes into the frozen learned dynamics, whose
    rollouts are held against the episodes.
    """
    try:
        from orbisim_diffusion.train_inference import tune
        from orbisim_diffusion.train_physics import Task, tune_physics
        from orbisim_diffusion.training import Run
    except ImportError as error:
        raise MissingDependencyError("training", "learned", str(error)) from error
    run, on = Run(time_limit, steps, None, seed), torch_device(device)
    if physics:
        task = Task(data, held_out_data, objective or "rollout", dynamics, graph, start)
        metrics = tune_physics(checkpoint, task, run, device=on, report=note)
    elif objective or dynamics:
        raise InputError("--objective and --dynamics are of --physics")
    else:
        metrics = tune(
            checkpoint,
            data,
            held_out_data,
            run,
            device=on,
            workers=workers,
            start=start,
            report=note,
        )
    if as_json:
        emit_json({"schema": "orbisim.train_inference/1", "metrics": metrics})
        return
    rows = ((n, f"{v:g}" if isinstance(v, int | float) else v) for n, v in metrics.items())
    click.echo("\n".join(f"{name}: {value}" for name, value in rows))
    note(f"checkpoint: {checkpoint}")


def _training() -> Any:
    try:
        from orbisim_world_model import run
    except ImportError as error:
        raise MissingDependencyError("training", "learned", str(error)) from error
    return run


def _assignment(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals:
        raise InputError(f"--set {text}: expected NAME=VALUE, such as model.width=64")
    return name, value


def _report(line: dict[str, Any]) -> None:
    more = ""
    if "state_loss" in line:
        more = f"  L_state {line['state_loss']:.4g}  AR ratio {line['ratio']:.2f}"
    note(f"step {line['step']:>7}  {line['seconds']:8.1f} s  loss {line['loss']:.4g}{more}")


_VISION = (
    "Example: orbisim train vision push.h5 --held-out-data test.h5 --out checkpoints/look "
    "--time-limit 1500 --device cuda"
)


@command.command("vision", epilog=_VISION)
@click.argument("data", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--config", "name", default="default", show_default=True, help="Configuration.")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder to write to.")
@click.option(
    "--time-limit",
    type=click.FloatRange(min=0, min_open=True),
    default=1500.0,
    show_default=True,
    help="Seconds, with what earlier runs took.",
)
@click.option(
    "--shares",
    nargs=3,
    type=click.FloatRange(0, 1),
    default=(0.3, 0.5, 0.2),
    show_default=True,
    help="Of the time: for autoencoder, denoiser, one-step model. 0 leaves a part as in --start.",
)
@click.option(
    "--start",
    default=None,
    type=click.Path(path_type=Path),
    help="Checkpoint to begin from; its configuration is used.",
)
@click.option(
    "--compile",
    "compiled",
    multiple=True,
    type=click.Choice(["rays", "autoencoder", "denoiser"]),
    help="Compile this; repeatable. Takes a minute, and is faster then.",
)
@click.option("--steps", type=click.IntRange(min=1), default=None, help="At most, of each part.")
@click.option(
    "--held-out-data",
    multiple=True,
    type=click.Path(path_type=Path),
    help="Measure on these episodes; repeatable. Default: on DATA themselves.",
)
@click.option("--workers", type=click.IntRange(min=1), default=1, help="Processes that read.")
@click.option("--resume", is_flag=True, help="Go on with the training that stands in --out.")
@device_option
@seed_option
@json_option
def vision(
    data: tuple[Path, ...],
    name: str,
    out: Path,
    time_limit: float,
    shares: tuple[float, float, float],
    start: Path | None,
    compiled: tuple[str, ...],
    steps: int | None,
    held_out_data: tuple[Path, ...],
    workers: int,
    resume: bool,
    device: str | None,
    seed: int,
    as_json: bool,
) -> None:
    """Train OrbiSim-Vision on episodes with images.

    DATA are episode files (orbisim collect --frames) or folders of your own recordings, each with
    scene.xml, recording.npz (or .csv), camera.json, and video.mp4 or a folder of images
    (docs/vision.md). Leaves a checkpoint in --out for the renderer diffusion:OUT.
    """
    try:
        from orbisim_diffusion import run
        from orbisim_diffusion.config import preset
    except ImportError as error:
        raise MissingDependencyError("training", "learned", str(error)) from error
    job = run.Job(
        data=data,
        held=held_out_data,
        out=out,
        limits=(time_limit * shares[0], time_limit * shares[1], time_limit * shares[2]),
        device=torch_device(device),
        seed=seed,
        workers=workers,
        steps=steps,
        resume=resume,
        start=start,
        compiled=frozenset(compiled),
    )
    metrics = run.train(preset(name), job, note)
    if as_json:
        emit_json({"schema": "orbisim.train_vision/1", "checkpoint": str(out), "metrics": metrics})
        return
    for part, values in metrics.items():
        click.echo(f"{part}: " + ", ".join(f"{k} {v:g}" for k, v in values.items()))
    note(f"checkpoint: {out}")


_POLICY = "Example: orbisim train policy push --method apg --out policies/push --time-limit 300"


@command.command("policy", epilog=_POLICY)
@click.argument("task")
@click.option(
    "--method",
    type=click.Choice(["apg", "bc", "sac", "ppo", "ppo_rnd", "dreamer"]),
    default="apg",
    show_default=True,
    help="Analytic gradients, behaviour cloning, or reinforcement learning.",
)
@click.option(
    "--backend",
    default=None,
    help="What the policy learns in: learned, learned:PATH or learned:NAME of the zoo (apg), "
    "mujoco (all others; apg by finite differences).",
)
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder to write to.")
@click.option("--steps", type=click.IntRange(min=1), default=None, help="Iterations; env steps.")
@click.option(
    "--time-limit", type=click.FloatRange(min=0, min_open=True), default=None, help="Seconds."
)
@click.option("--worlds", type=click.IntRange(min=1), default=None, help="Worlds at once.")
@click.option(
    "--horizon",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Steps to differentiate before a value function takes over; 0: the whole episode.",
)
@click.option("--rate", type=click.FloatRange(min=0, min_open=True), default=None, help="Of Adam.")
@click.option("--noise", type=click.FloatRange(min=0), default=None, help="On actions (apg).")
@click.option("--demonstrations", default=500, show_default=True, help="Episodes to imitate (bc).")
@click.option("--episode", type=click.IntRange(min=1), default=None, help="Steps of an episode.")
@click.option(
    "--observe",
    type=click.Choice(["state", "stainf", "objects", "infer"]),
    default="state",
    show_default=True,
    help="Where states come from (apg, bc): they are known, or read off films of the task's script "
    "by a network (stainf), with joints as measured and objects fitted (objects), or all fitted "
    "(infer); densities and friction are then inferred from the films' motion.",
)
@click.option("--camera", default="side", show_default=True, help="Of --observe.")
@click.option(
    "--episodes",
    type=click.IntRange(min=1),
    default=256,
    show_default=True,
    help="To film, for --observe.",
)
@click.option(
    "--film-limit",
    type=click.FloatRange(min=0, min_open=True),
    default=None,
    help="Seconds, for --observe: the training begins with the films that are ready by then.",
)
@click.option(
    "--films",
    type=click.Path(path_type=Path, dir_okay=False),
    default=None,
    help="Of --observe: films that another training has read (its films.safetensors).",
)
@click.option(
    "--errors/--no-errors",
    default=True,
    help="Of --observe: whether the policy sees the model's states with the errors that the films' "
    "readings had, or exact ones once an episode has begun, as in the paper (apg).",
)
@randomize_option
@click.option("--check", default=64, show_default=True, help="Episodes of a live estimate.")
@click.option("--check-every", default=60.0, show_default=True, help="Seconds between estimates.")
@click.option("--save-every", default=60.0, show_default=True, help="Seconds between saves.")
@click.option("--resume", is_flag=True, help="Go on with the training that stands in --out.")
@click.option(
    "--start", type=click.Path(path_type=Path), default=None, help="Policy to begin with (apg)."
)
@click.option("--graph/--no-graph", default=True, help="CUDA graphs, on a GPU.")
@click.option("--compiled", is_flag=True, help="Have torch compile a control step (apg).")
@click.option("--threads", default=0, help="Of MuJoCo; 0 for all cores.")
@device_option
@seed_option
@json_option
def policy(task: str, method: str, as_json: bool, **options: Any) -> None:
    """Train a policy for TASK (task:push, suite:cartpole-swingup, suite:cheetah-run ...).

    apg differentiates the reward through the learned step; the others learn in C MuJoCo. Leaves a
    policy in --out (policy.safetensors, manifest.json) with metrics and curves; success is
    estimated in MuJoCo on the way. With --resume a training goes on exactly where it was last
    saved.
    """
    try:
        from orbisim_policies import workflows
    except ImportError as error:
        raise MissingDependencyError("training", "learned", str(error)) from error
    options["device"] = torch_device(options["device"])
    manifest = workflows.train(task, method, options, note)
    if as_json:
        emit_json({"schema": "orbisim.train_policy/1", "policy": str(options["out"]), **manifest})
        return
    note(f"policy: {options['out']}")
