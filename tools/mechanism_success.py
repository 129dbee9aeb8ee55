"""How often the scripted hand succeeds with each family of mechanisms.

    python tools/mechanism_success.py --poses 2 --families door,safe

All instances of a family, each in so many poses; the table is that of docs/mechanisms.md.
"""

from __future__ import annotations

import argparse
import concurrent.futures
from collections.abc import Iterator

import numpy as np

from orbisim import tasks
from orbisim.host.cpus import usable_cpus
from orbisim.tasks.domains import MECHANISMS
from orbisim.tasks.mechanisms.catalogue import HELD_OUT, INSTANCES


def succeeds(job: tuple[str, int, int]) -> bool:
    """Whether an episode of (family, instance, seed) does."""
    family, instance, seed = job
    return bool(tasks.make(f"mechanism:{family}", instance=instance).episode("train", seed).success)


def row(family: str, results: np.ndarray) -> str:
    """A line of the table, from results [instances, poses]."""
    rates = results.mean(axis=1)
    trained, held_out = rates[: INSTANCES - HELD_OUT], rates[INSTANCES - HELD_OUT :]
    return (
        f"| {family} | {100 * trained.mean():.0f} % | {100 * held_out.mean():.0f} % | "
        f"{100 * rates.min():.0f} % | {results.size} |"
    )


def table(families: list[str], poses: int, workers: int) -> Iterator[str]:
    """The table's lines."""
    yield "| family | instances 0 to 19 | 20 to 23 | worst instance | episodes |"
    yield "| --- | --- | --- | --- | --- |"
    with concurrent.futures.ProcessPoolExecutor(workers) as pool:
        for family in families:
            jobs = [(family, i, 1000 * i + k) for i in range(INSTANCES) for k in range(poses)]
            found = list(pool.map(succeeds, jobs, chunksize=poses))
            yield row(family, np.array(found).reshape(INSTANCES, poses))


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--families", default=",".join(MECHANISMS))
    parser.add_argument("--poses", type=int, default=2)
    parser.add_argument("--workers", type=int, default=usable_cpus())
    options = parser.parse_args()
    for line in table(options.families.split(","), options.poses, options.workers):
        print(line, flush=True)


if __name__ == "__main__":
    main()
