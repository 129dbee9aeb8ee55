"""`orbisim eval`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import click

from orbisim.cli.common import (
    device_option,
    emit_json,
    json_option,
    note,
    print_table,
    randomize_option,
    scene_options,
    seed_option,
    torch_device,
    writable_folder,
)
from orbisim.errors import InputError, MissingDependencyError
from orbisim.tasks.dataset import EpisodeFile

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
@click.option("--scene", default=None, help="Scene of episodes of a scene's file.")
@device_option
@json_option
@scene_options()
def dynamics(
    checkpoint: Path,
    data: tuple[Path, ...],
    against: tuple[Path, ...],
    horizons: tuple[int, ...],
    burn: int,
    episodes: int,
    by_group: bool,
    scene: str | None,
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
        device=torch_device(device or "cpu"),
        by_group=by_group,
        scene=scene,
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


_VISION = "Example: orbisim eval vision checkpoints/look test_push.h5 --steps 1 --steps 4 --json"


@command.command("vision", epilog=_VISION)
@click.argument("checkpoint", type=click.Path(path_type=Path))
@click.argument("data", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--episodes", default=200, show_default=True, help="At most so many of each file.")
@click.option(
    "--workflow",
    "workflows",
    multiple=True,
    type=click.Choice(["GT-first", "GT-state", "Recon-first", "Recon-all"]),
    help="Which rollouts; repeatable. Default: all.",
)
@click.option("--steps", multiple=True, type=int, help="Of the sampler; repeatable. Default: 1.")
@click.option("--horizon", "horizons", multiple=True, type=int, help="Frames. Default: 10 and 100.")
@click.option("--backend", default="learned", show_default=True, help="What predicts the states.")
@click.option("--features/--no-features", default=True, help="EffNet-PD and EffNet-FVD.")
@click.option(
    "--weights",
    default=None,
    type=click.Path(path_type=Path),
    help="Weights of EfficientNet-Lite0 (default: those of the package), or a folder with those of "
    "LPIPS and FVD.",
)
@click.option(
    "--mujoco", is_flag=True, help="MuJoCo's images of the predicted states as a row, too."
)
@click.option(
    "--predictions",
    default=None,
    type=click.Path(path_type=Path),
    help="An .npz file of predicted states: read if it is there, else made. For one file of DATA.",
)
@click.option(
    "--state-noise",
    nargs=2,
    default=None,
    type=click.FloatRange(min=0.0),
    metavar="MM DEGREES",
    help="Noise on states: on the first, and on each that GT-state and Recon-all show.",
)
@click.option("--workers", type=click.IntRange(min=1), default=1, help="Processes.")
@device_option
@seed_option
@json_option
def vision(
    checkpoint: Path,
    data: tuple[Path, ...],
    episodes: int,
    workflows: tuple[Any, ...],
    steps: tuple[int, ...],
    horizons: tuple[int, ...],
    backend: str,
    features: bool,
    weights: Path | None,
    mujoco: bool,
    predictions: Path | None,
    state_noise: tuple[float, float] | None,
    workers: int,
    device: str | None,
    seed: int,
    as_json: bool,
) -> None:
    """Images of rollouts against the true ones: PSNR, SSIM, EffNet-PD, EffNet-FVD, with the weights
    for them LPIPS and FVD, and, of a checkpoint with StaInf, TrajErr.

    DATA are episode files with images. GT-first and Recon-first use states that the backend
    predicts from the first one, GT-state and Recon-all the true states.
    """
    if state_noise is not None and predictions is not None:
        raise InputError("--state-noise: makes predictions of its own; leave --predictions out")
    noise = None if state_noise is None else (1e-3 * state_noise[0], math.radians(state_noise[1]))
    try:
        import torch
        from orbisim_diffusion import evaluate as evaluation
        from orbisim_diffusion.estimate import load_with_inference
        from orbisim_diffusion.features import Features
        from orbisim_diffusion.model import Painter
        from orbisim_diffusion.predictions import predict, read_predictions, save_predictions
        from orbisim_diffusion.pretrained import load_pretrained
    except ImportError as error:
        raise MissingDependencyError("evaluation", "learned", str(error)) from error
    on = torch.device(torch_device(device))
    point, inference = load_with_inference(checkpoint)
    painter = Painter.of(point, on)
    folder = weights if weights is not None and weights.is_dir() else None
    seen = Features(on, None if folder else weights) if features else None
    pretrained = load_pretrained(folder, on) if folder else None
    known = []
    if predictions is not None:
        if len(data) != 1:
            raise InputError(f"--predictions are of one file; got {len(data)}")
        if not predictions.exists():
            with EpisodeFile(data[0]) as file:
                count = min(len(file), episodes)
            save_predictions(predictions, predict(data[0], range(count), workers, backend, mujoco))
        known = read_predictions(predictions)
    tables = [
        evaluation.evaluate(
            painter,
            path,
            episodes=episodes,
            workflows=workflows or evaluation.WORKFLOWS,
            steps=steps or (1,),
            horizons=horizons or evaluation.HORIZONS,
            features=seen,
            pretrained=pretrained,
            inference=inference and inference.to(on),
            mujoco=mujoco,
            predictions=known,
            workers=workers,
            backend=backend,
            noise=noise,
            seed=seed,
            report=note,
        )
        for path in data
    ]
    if as_json:
        emit_json({"schema": "orbisim.eval_vision/1", "tables": tables})
        return
    for table in tables:
        _print_vision(table)


def _print_vision(table: dict[str, Any]) -> None:
    names = list(dict.fromkeys(name for row in table["rows"].values() for name in row))
    rows = [(key, *(row.get(name, "-") for name in names)) for key, row in table["rows"].items()]
    title = f"{table['file']}: means over {table['episodes']} episodes"
    print_table(title, ("workflow", *names), rows)


_POLICY = "Example: orbisim eval policy policies/push --episodes 200 --json"

_FROM_FRAMES = ("infer", "objects", "stainf")
"""What is observed by images."""


@command.command("policy", epilog=_POLICY)
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--task", default=None, help="Default: the one that the policy was trained for.")
@click.option("--episodes", default=200, show_default=True, help="Of each seed.")
@click.option(
    "--seed", "seeds", multiple=True, type=click.IntRange(min=0), help="Repeatable. Default: 0 1 2."
)
@click.option(
    "--model",
    default="learned",
    show_default=True,
    help="Inside which model to evaluate as well: learned, learned:PATH, learned:NAME of the zoo, "
    "or none.",
)
@randomize_option
@click.option(
    "--observe",
    type=click.Choice(["state", "nominal", *_FROM_FRAMES]),
    default="state",
    show_default=True,
    help="What the policy sees: the true state, that with nominal values of what no image shows "
    "(densities, friction), or the one that is read off a camera's frames, by a network and a fit "
    "(infer), with joints as measured (objects), or by the network alone (stainf).",
)
@click.option("--camera", default="side", show_default=True, help="Of --observe.")
@click.option("--threads", default=0, help="Of MuJoCo; 0 for all cores.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=None,
    callback=writable_folder,
    help="Of --observe from frames: folder for each episode once it has been played; those that it "
    "has are not played again.",
)
@device_option
@json_option
def policy(
    folder: Path,
    task: str | None,
    episodes: int,
    seeds: tuple[int, ...],
    model: str,
    randomize: Path | None,
    observe: str,
    camera: str,
    threads: int,
    out: Path | None,
    device: str | None,
    as_json: bool,
) -> None:
    """Success and reward of the policy in FOLDER (or a name of the zoo: push), in C MuJoCo.

    By each definition of success, with 95 % intervals; beside it the same episodes inside the
    learned model. Where the model promises more than MuJoCo keeps, the policy exploits it.
    """
    asked = click.get_current_context().get_parameter_source("model")
    if (
        observe in _FROM_FRAMES
        and model != "none"
        and asked == click.core.ParameterSource.COMMANDLINE
    ):
        raise InputError(
            f"--model {model} with --observe {observe}: a learned step has no frames to read "
            "states off; leave --model out, or use --observe state or nominal"
        )
    try:
        from orbisim_policies import workflows
    except ImportError as error:
        raise MissingDependencyError("evaluation", "learned", str(error)) from error
    result = workflows.evaluate(
        folder,
        task,
        episodes=episodes,
        seeds=seeds or (0, 1, 2),
        model=model,
        randomize=randomize,
        threads=threads,
        device=torch_device(device or "cpu"),
        observe=observe,
        camera=camera,
        out=out,
    )
    if as_json:
        emit_json(result)
        return
    _print_policy(result)


def _print_policy(result: dict[str, Any]) -> None:
    sides = [name for name in ("mujoco", "model") if name in result]
    rows = []
    for group, cell in (("success", _share), ("reward", _mean)):
        for name in result["mujoco"][group]:
            rows.append((group, name, *(cell(result[side][group][name]) for side in sides)))
    title = f"{result['task']}: {result['mujoco']['episodes']} episodes, 95 % intervals"
    print_table(title, ("", "", *sides), rows)


def _share(value: dict[str, Any]) -> str:
    low, high = value["ci95"]
    return f"{100 * value['share']:.1f} % ({100 * low:.1f} to {100 * high:.1f})"


def _mean(value: dict[str, Any]) -> str:
    return f"{value['mean']:.3f} +- {value['ci95_half']:.3f}"
