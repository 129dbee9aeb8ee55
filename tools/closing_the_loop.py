"""Diagnoses the measured data sets and compares with what was published about them.

    python tools/closing_the_loop.py DATA OUT [--set emps ...] [--half judged] [--workers 4]

DATA holds one folder for each data set (see tools/import_measured.py). For each set the declared
scene of mjcf_assets/ is diagnosed from the recordings for fitting with the command's defaults; two
peers fit it, too (tools/closing/scoring.py). The declared, diagnosed, published and fitted scenes
are then scored on the held-out recordings by the same code. OUT gets the recordings, a folder with
the report of each diagnosis, a file for each result, and table.md; --images gets one plot for each
set. Each tool works on each set in a process of its own; what has a result is not run again. The
metric of each set, and whether the search was developed on it or is judged by it (--half), stand in
tools/closing/plans.py.

The recordings are data of others: OUT must not lie inside this repository.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import click

_ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(_ROOT / "tools"), str(_ROOT), str(_ROOT / "backends")]

from closing.plans import PLANS  # noqa: E402
from closing.running import Job, path_of, results_of, run_all  # noqa: E402
from closing.scoring import TOOLS, picture, result_of, tools_of  # noqa: E402
from closing.table import markdown  # noqa: E402
from from_source import register  # noqa: E402
from import_measured import DATA_SETS, import_set  # noqa: E402


@click.command()
@click.argument("data", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.argument("out", type=click.Path(file_okay=False, path_type=Path))
@click.option("--set", "wanted", multiple=True, type=click.Choice([p.name for p in PLANS]))
@click.option("--half", type=click.Choice(["developed", "judged"]), help="Only these sets.")
@click.option("--tool", "tools", multiple=True, type=click.Choice(TOOLS), help="Only these.")
@click.option("--workers", default=1, show_default=True, help="Processes at a time.")
@click.option("--patience", default=600.0, show_default=True, help="Of each fit, s.")
@click.option("--time-limit", default=0.0, help="For all, s; the next run goes on.")
@click.option("--images", type=click.Path(file_okay=False, path_type=Path), help="For plots.")
@click.option("--again", is_flag=True, help="Also what has failed.")
@click.option("--only", type=click.Choice(TOOLS), hidden=True, help="In this process; of one set.")
def main(
    data: Path,
    out: Path,
    wanted: tuple[str, ...],
    half: str | None,
    tools: tuple[str, ...],
    workers: int,
    patience: float,
    time_limit: float,
    images: Path | None,
    again: bool,
    only: str | None,
) -> None:
    """Diagnoses the measured data sets and compares with what was published about them."""
    if out.resolve().is_relative_to(_ROOT):
        raise click.UsageError(f"{out} lies inside the repository; choose a folder elsewhere")
    plans = [p for p in PLANS if (not wanted or p.name in wanted) and half in (None, p.half)]
    if only:
        register("mujoco")
        print(json.dumps(result_of(plans[0], only, out, patience)))
        return
    for plan in plans:
        if not (out / "recordings" / plan.name / "split.json").exists():
            own = next(one for one in DATA_SETS if one.name == plan.name)
            import_set(own, data, out / "recordings")
    # the longest first
    jobs = [
        Job(plan.name, tool, patience)
        for tool in tools or TOOLS
        for plan in plans
        if tool in tools_of(plan)
    ]
    if again:
        for name, results in results_of(out).items():
            for tool in [t for t, one in results.items() if "failure" in one]:
                path_of(out, name, tool).unlink()
    for job, result in run_all(jobs, data, out, workers, time_limit):
        words = result.get("failure") or next(iter(result["held_out"].items()))
        click.echo(f"{job.name} {job.tool} {result.get('seconds', 0):.0f} s: {words}", err=True)
        (out / "table.md").write_text(markdown(results_of(out)))
    text = markdown(results_of(out))
    (out / "table.md").write_text(text)
    click.echo(text)
    for plan in plans:
        if images and "held_out" in results_of(out).get(plan.name, {}).get("diagnosed", {}):
            picture(plan, out, images)


if __name__ == "__main__":
    main()
