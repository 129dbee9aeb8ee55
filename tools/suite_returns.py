"""Returns of the suite's feedback policies under `learned` and under `mujoco`.

    python tools/suite_returns.py --zoo ZOO --seeds 100 --seeds-of hopper=1200,acrobot=1000
        [--first-seed 1000] [--workers 16] [--rows returns.jsonl] [--json FILE]

`eval_dynamics.py --only returns` runs it, too. Episodes of a seed begin in the same state under
each backend, and the policy is the same, so that differences are paired. A domain without a
checkpoint of its own in ZOO gets `suite_one`. Finished episodes stand in the file of rows, from
which a run that was stopped goes on. `interval` is the 95 % interval of `apart`, from episodes
drawn again (2,000 times): returns of legs are far from normal.
"""

from __future__ import annotations

import argparse
import json
import sys
import warnings
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "backends"), str(ROOT / "tools")]

import from_source  # noqa: E402  (needs the path above)

from orbisim.tasks.domains import SUITE_DOMAINS  # noqa: E402

NUDGE = 1e-4
"""Standard deviation of the noise on velocities at every control step of `nudged`, m/s or rad/s."""
KINDS = ("mujoco", "nudged", "learned")
DRAWN = 2000
"""Resamples of the episodes for an interval: its ends are then known to a tenth of its width."""


def table(
    checkpoints: Mapping[str, Path],
    seeds: int | Mapping[str, int],
    workers: int,
    first: int = 0,
    rows: Path | None = None,
) -> dict[str, Any]:
    """Mean return, and its standard error, of the same episodes under each backend; `apart` is the
    mean of the paired differences over MuJoCo's mean, `apart_error` its standard error, and
    `interval` its 95 % interval. `differences` has the median, 90 % and worst of their sizes, in
    units of return. Episodes in which a backend diverges count as `diverged`, and not in the
    differences.

    `nudged` is C MuJoCo with noise on velocities: two runs of a chaotic system are no closer to
    each other than this.

    Args:
      checkpoints: of each domain.
      seeds: episodes of each domain, or of all of them.
      workers: processes.
      first: seed of the first episode.
      rows: file of finished episodes, to which others are added; only in memory if None.
    """
    counts = {d: seeds if isinstance(seeds, int) else seeds[d] for d in checkpoints}
    kept = _read(rows)
    if rows is not None:  # without a line that was cut off, to which the next would be added
        rows.write_text("".join(json.dumps(row) + "\n" for row in kept))
    # all domains come forward together, so that a run that is stopped has something of each
    order = sorted((i / counts[d], d, first + i) for d in checkpoints for i in range(counts[d]))
    known = {(row["domain"], row["seed"]) for row in kept}
    jobs = [(d, str(checkpoints[d]), s) for _, d, s in order if (d, s) not in known]
    for row in _in_processes(jobs, workers):
        kept.append(row)
        if rows is not None:
            with rows.open("a") as file:
                file.write(json.dumps(row) + "\n")
    return summary(row for row in kept if row["domain"] in counts)


def summary(rows: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """What `table` gives, from an episode's `domain`, `seed` and returns by kind each."""
    by_domain: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        by_domain.setdefault(row["domain"], []).append(row)
    found: dict[str, Any] = {}
    for domain, episodes in by_domain.items():
        totals = {k: np.array([row[k] for row in episodes], float) for k in KINDS}
        entry: dict[str, Any] = {"episodes": len(episodes)}
        for kind, values in totals.items():
            whole = values[np.isfinite(values)]
            entry[kind] = {
                "mean": float(whole.mean()),
                "standard_error": _error(whole),
                "diverged": len(values) - len(whole),
            }
        entry |= {"apart": {}, "apart_error": {}, "interval": {}, "differences": {}}
        for kind in KINDS[1:]:
            pair = np.stack([totals["mujoco"], totals[kind]])
            pair = pair[:, np.isfinite(pair).all(0)]
            apart = pair[1] - pair[0]
            mean = abs(float(pair[0].mean())) or float("nan")  # nothing is a share of 0
            entry["apart"][kind] = float(apart.mean()) / mean
            entry["apart_error"][kind] = _error(apart) / mean
            entry["interval"][kind] = _interval(pair)
            sizes = np.abs(apart)
            entry["differences"][kind] = {
                "median": float(np.median(sizes)),
                "p90": float(np.quantile(sizes, 0.9)),
                "worst": float(sizes.max()),
            }
        found[domain] = entry
        print(json.dumps({domain: entry}), flush=True)
    return found


def _error(values: Any) -> float:
    """Standard error of a mean; NaN of one value."""
    return float(np.std(values, ddof=1)) / len(values) ** 0.5 if len(values) > 1 else float("nan")


def _interval(pair: Any) -> list[float]:
    """95 % interval of the mean difference over the first's mean, of returns [2, N]."""
    rng = np.random.default_rng(0)
    means = pair[:, rng.integers(pair.shape[1], size=(DRAWN, pair.shape[1]))].mean(-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = (means[1] - means[0]) / np.abs(means[0])
        return [float(v) for v in np.quantile(ratios, [0.025, 0.975])]


def _read(rows: Path | None) -> list[Any]:
    """Episodes that a run before has finished; the last line may be cut off."""
    found = []
    for line in rows.read_text().splitlines() if rows is not None and rows.exists() else ():
        try:
            found.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return found


def _in_processes(jobs: list[tuple[str, str, int]], workers: int) -> Iterable[dict[str, Any]]:
    """A row for each job, as they come."""
    if workers < 2:
        yield from map(episode, jobs)
        return
    from multiprocessing import get_context

    with get_context("spawn").Pool(workers) as pool:
        yield from pool.imap_unordered(episode, jobs)


def episode(job: tuple[str, str, int]) -> dict[str, Any]:
    """The returns of one seed of a domain with a checkpoint, by kind."""
    domain, checkpoint, seed = job
    kinds = {"mujoco": ("mujoco", 0.0), "nudged": ("mujoco", NUDGE)}
    kinds["learned"] = (f"learned:{checkpoint}", 0.0)
    returns = {name: episode_return(domain, *kind, seed) for name, kind in kinds.items()}
    return {"domain": domain, "seed": seed, **returns}


def episode_return(domain: str, backend: str, nudge: float, seed: int) -> float:
    """Return of an episode of the domain's feedback policy (a rhythm, where it has none); NaN where
    the backend diverges."""
    import torch

    from_source.register("mujoco", "learned", "null")
    from orbisim import suite
    from orbisim.errors import DivergedError
    from orbisim.tasks.suite_feedback import feedback, has_feedback
    from orbisim.tasks.suite_policies import rhythm

    warnings.simplefilter("ignore")
    torch.set_num_threads(1)
    environment = suite.load(domain, SUITE_DOMAINS[domain], task_kwargs={"random": seed})
    step = environment.reset()
    physics, rng = environment.physics, np.random.default_rng(seed)
    physics.use_backend(backend)
    model, period = physics.model.ptr, environment.control_timestep()
    known = has_feedback(domain)
    policy = feedback(domain, model, period) if known else rhythm(model, rng, period)
    total = 0.0
    while not step.last():
        if nudge:
            physics.data.ptr.qvel[:] += nudge * rng.standard_normal(model.nv)
        try:
            step = environment.step(policy(physics.data.ptr))
        except DivergedError:
            return float("nan")
        total += step.reward or 0.0
    return total


def chosen(zoo: Path, only: Iterable[str] = ()) -> dict[str, Path]:
    """The checkpoint of each domain: its own, or the one model of them; of `only`, if any."""
    there = {path.parent.name for path in zoo.glob("*/manifest.json")}
    there &= set(only) or there
    own = {d: d if d in there else "suite_one" for d in SUITE_DOMAINS}
    return {d: zoo / name for d, name in own.items() if name in there}


def main() -> None:
    """Runs what is not there yet; prints a line for each domain."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--zoo", type=Path, required=True)
    parser.add_argument("--domains", default=",".join(SUITE_DOMAINS))
    parser.add_argument("--seeds", type=int, default=100, help="episodes of each domain")
    parser.add_argument("--seeds-of", default="", help="DOMAIN=EPISODES,... instead")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--rows", type=Path, help="file of finished episodes")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    wanted = options.domains.split(",")
    checkpoints = {d: path for d, path in chosen(options.zoo).items() if d in wanted}
    own = dict(text.split("=") for text in options.seeds_of.split(",") if text)
    counts = {d: int(own.get(d, options.seeds)) for d in checkpoints}
    found = table(checkpoints, counts, options.workers, options.first_seed, options.rows)
    if options.json:
        options.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    sys.exit(main())
