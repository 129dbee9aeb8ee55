"""What the command line calls."""

from __future__ import annotations

import dataclasses
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch

from orbisim.errors import InputError, MissingDependencyError
from orbisim.files.writing import make_folder
from orbisim.host.cpus import usable_cpus
from orbisim.vector.randomization import intervals
from orbisim_policies import evaluate as evaluation
from orbisim_policies.apg import ApgConfig
from orbisim_policies.checkpoint import load_policy, read_manifest
from orbisim_policies.cloning import CloneConfig
from orbisim_policies.drawn import DrawnProblem
from orbisim_policies.dreamer import DreamerConfig, train_dreamer
from orbisim_policies.films import Films
from orbisim_policies.learned import LearnedWorlds
from orbisim_policies.problem import Problem
from orbisim_policies.problems import make_problem
from orbisim_policies.push import PushProblem
from orbisim_policies.run import Run, check_run, train_apg, train_clone, training_seeds
from orbisim_policies.zoo import resolved

_RUN = {
    "time_limit": "limit",
    **{
        name: name
        for name in ("out", "steps", "seed", "device", "demonstrations", "check", "check_every")
    },
    **{name: name for name in ("save_every", "resume", "start", "graph", "compiled")},
    "threads": "nthread",
}
"""Options of the command line, and what they are called in `Run`."""
FILMS = "films.safetensors"
"""What was read off films, in the folder of a training."""
FILMED = "filmed"
"""Folder beside it, of single films until all are there: what is killed goes on with them."""


def train(
    task: str, method: str, options: Mapping[str, Any], note: Callable[[str], None]
) -> dict[str, Any]:
    """Trains a policy as the command line says; returns its manifest."""
    problem = _drawn(make_problem(task, options["episode"]), options["randomize"], options["seed"])
    run = Run(**{_RUN[name]: value for name, value in options.items() if name in _RUN})
    if run.start is not None:
        run = dataclasses.replace(run, start=resolved(run.start))

    def report(line: dict[str, Any]) -> None:
        note(sentence(line))

    kinds = ("learned", "mujoco") if method == "apg" else ("mujoco",)
    backend = options["backend"] or kinds[0]
    kind, _, path = backend.partition(":")
    if kind not in kinds:
        raise InputError(f"--method {method} learns in {' or '.join(kinds)}; got {backend}")
    if options["observe"] != "state":
        if method not in ("apg", "bc"):
            raise InputError(
                f"--observe {options['observe']} is for --method apg and bc; {method} learns by "
                "trying, in states that are known"
            )
        if options["randomize"] is not None:
            raise InputError("--observe from films and --randomize exclude each other")
        check_run(run)
        begun = time.monotonic()
        films = _films(problem, run, options, path or None)
        left = None if run.limit is None else max(run.limit - (time.monotonic() - begun), 1.0)
        run = dataclasses.replace(run, limit=left, films=films, errors=options["errors"])
    if method == "apg":
        config = _changed(ApgConfig(), options)
        differences = kind == "mujoco"
        return train_apg(problem, config, run, path or None, report, differences=differences)
    if run.start is not None:
        raise InputError(f"--start is for --method apg; got {method}")
    if method == "bc":
        if options["randomize"] is not None:
            raise InputError("--randomize is for methods that try; --method bc imitates the script")
        if not isinstance(problem, PushProblem):
            raise InputError(f"there is no script to imitate in {problem.name}; use task:push")
        return train_clone(problem, _changed(CloneConfig(), options), run, report)
    if method == "dreamer":
        return train_dreamer(problem, _changed(DreamerConfig(), options), run, report)
    from orbisim_policies.baselines import Baseline, train_baseline

    plain = Baseline(method)
    if method == "sac" and problem.sparse:  # the best of a search on push: docs/benchmarks.md
        plain = Baseline(method, batch=8, updates=4, returns=16)
    baseline = _changed(plain, options)
    return train_baseline(problem, baseline, run, report)


def _films(problem: Problem, run: Run, options: Mapping[str, Any], checkpoint: str | None) -> Films:
    """The films that a training from pixels begins with: given, left by a killed one, or made."""
    path = options["films"] or run.out / FILMS
    if path.exists() or options["films"]:
        films = Films.load(path, problem)
        given = films.notes.get("observe"), films.notes.get("camera")
        if given != (options["observe"], options["camera"]):
            raise InputError(
                f"{path}: read by {given[0]} off camera {given[1]}; got --observe "
                f"{options['observe']} --camera {options['camera']}"
            )
        return films
    try:
        from orbisim_policies import filming, phyinf
    except ImportError as error:
        raise MissingDependencyError("--observe from frames", "vision", str(error)) from error
    kept = make_folder(make_folder(run.out) / FILMED)
    seeds = training_seeds(problem, run)[: options["episodes"]]
    films = filming.film(
        problem,
        seeds,
        camera=options["camera"],
        how=options["observe"],
        workers=run.nthread or usable_cpus(),
        device=run.device,
        kept=kept,
        limit=options["film_limit"],
    )
    films = phyinf.inferred(problem, films, checkpoint, run.device)
    films.save(path)
    shutil.rmtree(kept)
    return films


def evaluate(
    folder: Path,
    task: str | None,
    *,
    randomize: Path | None,
    episodes: int,
    seeds: Sequence[int],
    model: str,
    threads: int,
    device: str,
    observe: str = "state",
    camera: str = "side",
    out: Path | None = None,
) -> dict[str, Any]:
    """Evaluates a policy as the command line says."""
    folder = resolved(folder)
    manifest = read_manifest(folder)
    steps = int(manifest.get("steps", 0)) or None
    plain = make_problem(task or str(manifest.get("task")), steps)
    policy, problem = load_policy(folder, plain), _drawn(plain, randomize, min(seeds))
    if observe not in ("state", "nominal"):
        return _from_pixels(
            folder,
            manifest,
            policy,
            problem,
            episodes,
            seeds,
            observe,
            camera,
            threads,
            device,
            out,
        )
    # a policy that has been trained from films has never seen other than nominal values
    nominal = observe == "nominal" or "films" in manifest
    alone = nominal or model == "none"
    worlds = None if alone else _model(model, problem, torch.device(device))
    how: Any = {"episodes": episodes, "seeds": seeds, "worlds": worlds, "nthread": threads}
    result = evaluation.evaluate(problem, policy, **how, nominal=nominal)
    known: dict[str, Any] = {"observe": "nominal" if nominal else observe}
    known |= {name: manifest[name] for name in ("method", "true_steps") if name in manifest}
    return {**result, **known, **problem.conditions, "policy": str(folder)}


def _from_pixels(
    folder: Path,
    manifest: Mapping[str, Any],
    policy: Any,
    problem: Problem,
    episodes: int,
    seeds: Sequence[int],
    observe: str,
    camera: str,
    threads: int,
    device: str,
    out: Path | None,
) -> dict[str, Any]:
    """Evaluates a policy that sees frames alone."""
    try:
        from orbisim_policies.pixels import evaluate_pixels
    except ImportError as error:
        raise MissingDependencyError("--observe from frames", "vision", str(error)) from error
    every = [number for seed in seeds for number in evaluation.seeds_of(problem, episodes, seed)]
    found = evaluate_pixels(
        problem,
        policy,
        every,
        camera=camera,
        how=observe,
        workers=threads or usable_cpus(),
        device=device,
        kept=None if out is None else make_folder(out),
        label=folder.name,
    )
    return {
        "schema": "orbisim.eval_policy/1",
        "task": problem.name,
        "seeds": list(seeds),
        "episodes_per_seed": episodes,
        "observe": observe,
        "diverged": found.pop("diverged"),
        "mujoco": found,
        "method": manifest.get("method"),
        "policy": str(folder),
    }


def _drawn(problem: Problem, report: Path | None, seed: int) -> Problem:
    """The problem in scenes drawn from a diagnosis, if one is given."""
    return problem if report is None else DrawnProblem(problem, intervals(report), seed)


def sentence(line: Mapping[str, Any]) -> str:
    """A line of metrics for people."""
    head = f"step {line['step']:>7}  {line['seconds']:8.1f} s"
    rest = [f"{k} {v:.3g}" for k, v in line.items() if k not in ("step", "seconds", "skipped")]
    return "  ".join([head, *rest])


def _model(name: str, problem: Problem, device: torch.device) -> LearnedWorlds:
    kind, _, path = name.partition(":")
    if kind != "learned":
        raise InputError(
            f"--model is learned, learned:PATH, learned:NAME of the zoo or none; got {name!r}"
        )
    return LearnedWorlds(problem.to(device), path or None, device)


def _changed(config: Any, options: Mapping[str, Any]) -> Any:
    """A configuration with what the command line says of it."""
    given = {"batch": options["worlds"], "rate": options["rate"], "noise": options["noise"]}
    given["horizon"] = options["horizon"] or None
    names = {field.name for field in dataclasses.fields(config)}
    wrong = [name for name, value in given.items() if value is not None and name not in names]
    if wrong:
        option = {"batch": "worlds"}.get(wrong[0], wrong[0])
        raise InputError(f"--{option} means nothing to this method")
    if given["rate"] is not None and "final_rate" in names:
        given["final_rate"] = given["rate"] / 10
    kept = {name: value for name, value in given.items() if value is not None and name in names}
    return dataclasses.replace(config, **kept)
