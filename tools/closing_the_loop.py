"""Diagnoses the measured data sets and compares with what was published about them.

    python tools/closing_the_loop.py DATA OUT [--set emps ...] [--half judged] [--images FOLDER]

DATA holds one folder for each data set (see tools/import_measured.py). For each set the declared
scene of mjcf_assets/ is diagnosed from the recordings for fitting; then the declared, the diagnosed
and the published scene are scored on the held-out recordings by the same code. OUT gets the
recordings, a folder with the report of each diagnosis, results.json and table.md; --images gets
one plot for each set. The diagnosis runs with the command's defaults; the metric of each set, and
whether the search was developed on it or is judged by it (--half), stand in tools/closing/plans.py.

The recordings are data of others: OUT must not lie inside this repository.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np

_ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(_ROOT / "tools"), str(_ROOT), str(_ROOT / "backends")]

from closing.metrics import Scored  # noqa: E402
from closing.plans import PLANS, Plan  # noqa: E402
from closing.plots import draw  # noqa: E402
from import_measured import DATA_SETS, import_set  # noqa: E402

import orbisim  # noqa: E402
from orbisim.effects import EffectInstance  # noqa: E402
from orbisim.recording import Recording  # noqa: E402
from orbisim.scene import load_scene  # noqa: E402


@click.command()
@click.argument("data", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.argument("out", type=click.Path(file_okay=False, path_type=Path))
@click.option("--set", "wanted", multiple=True, type=click.Choice([p.name for p in PLANS]))
@click.option("--half", type=click.Choice(["developed", "judged"]), help="Only these sets.")
@click.option("--images", type=click.Path(file_okay=False, path_type=Path), help="For plots.")
@click.option("--reuse", is_flag=True, help="Score the diagnoses that OUT already holds.")
def main(
    data: Path,
    out: Path,
    wanted: tuple[str, ...],
    half: str | None,
    images: Path | None,
    reuse: bool,
) -> None:
    """Diagnoses the measured data sets and compares with what was published about them."""
    if out.resolve().is_relative_to(_ROOT):
        raise click.UsageError(f"{out} lies inside the repository; choose a folder elsewhere")
    table = out / "results.json"
    results: dict[str, Any] = json.loads(table.read_text()) if table.exists() else {}
    for plan in PLANS:
        if (wanted and plan.name not in wanted) or half not in (None, plan.half):
            continue
        own = next(one for one in DATA_SETS if one.name == plan.name)
        import_set(own, data, out / "recordings")
        results[plan.name] = close(plan, out, images or out / "images", reuse)
        table.write_text(json.dumps(results, indent=1) + "\n")
        (out / "table.md").write_text(markdown(results))
        click.echo(markdown({plan.name: results[plan.name]}))


def close(plan: Plan, out: Path, images: Path, reuse: bool) -> dict[str, Any]:
    """Diagnoses one set, scores the scenes, draws; returns what there is to say about it."""
    folder = out / "recordings" / plan.name
    split = json.loads((folder / "split.json").read_text())
    fit = _load(plan, folder, split["fit"])
    held = _load(plan, folder, [n for n in split["held_out"] if n.startswith(plan.only)])
    found = out / "diagnoses" / plan.name
    if not (reuse and (found / "report.json").exists()):
        diagnose(plan, fit, held, found)
    report = json.loads((found / "report.json").read_text())
    effects = [_instance(one) for one in report["effects"]]
    scored: dict[str, Scored] = {"declared": plan.metric.measure(plan.scene(), held, ())}
    augmented = load_scene(found / "augmented" / "scene.xml")
    scored["diagnosed"] = plan.metric.measure(augmented, held, effects)
    if plan.published:
        scored["published"] = plan.metric.measure(plan.scene("published"), held, ())
    draw(plan.name, plan.metric, scored, images / f"{plan.name}.png")
    told = ("verdict", "sentence", "effects", "retuned", "alternatives", "residual", "error")
    return {
        "half": plan.half,
        "left_out": plan.left_out,
        "metric": plan.metric.words,
        "unit": plan.metric.unit,
        "reference": plan.reference,
        "held_out": {
            kind: {name: plan.metric.factor * value for name, value in one.figures.items()}
            for kind, one in scored.items()
        },
        "recordings": {"fit": len(fit), "held_out": len(held)},
        "seconds": json.loads((found / "seconds.json").read_text()),
        **{key: report[key] for key in told},
        "notes": report["notes"][:8],
    }


def diagnose(plan: Plan, fit: list[Recording], held: list[Recording], found: Path) -> None:
    """Runs the diagnosis as the command does, and keeps its report and how long it took."""
    start = time.perf_counter()
    orbisim.diagnose(plan.scene(), fit, held, out=found, progress=True)
    seconds = time.perf_counter() - start
    (found / "seconds.json").write_text(json.dumps(round(seconds)))


def _load(plan: Plan, folder: Path, names: Sequence[str]) -> list[Recording]:
    return [plan.recording(Recording.load(folder / name)).replace(source=name) for name in names]


def _instance(found: dict[str, Any]) -> EffectInstance:
    values = {name: one["value"] for name, one in found["parameters"].items()}
    return EffectInstance(found["effect"], found["target"], values, found["options"])


# -- the table -------------------------------------------------------------------------------------

_HEAD = (
    "| set | metric, held out | declared | diagnosed | published | verdict | found | s |\n"
    "| --- | --- | --- | --- | --- | --- | --- | --- |\n"
)


def markdown(results: dict[str, Any]) -> str:
    """The table of results."""
    return _HEAD + "".join(_row(name, one) for name, one in results.items())


def _row(name: str, one: dict[str, Any]) -> str:
    kinds = ("declared", "diagnosed", "published")
    heads = [next(iter(one["held_out"].get(kind, {"": None}).values())) for kind in kinds]
    cells = ["none" if value is None else f"{value:.3g} {one['unit']}" for value in heads]
    found = "; ".join(
        [_words(effect) for effect in one["effects"]]
        + [f"{r['label']} times {r['factor']:.3g}" for r in one["retuned"]]
    )
    cells += [f"`{one['verdict']}`", found or "nothing", str(one["seconds"])]
    return f"| {name} | {one['metric']} | {' | '.join(cells)} |\n"


def _words(effect: dict[str, Any]) -> str:
    numbers = []
    for name, value in effect["parameters"].items():
        low, high = (np.nan if bound is None else bound for bound in value["ci95"])
        half = (high - low) / 2
        width = f" ± {half:.2g}" if np.isfinite(half) and half > 0 else ""
        numbers.append(f"{name} {value['value']:.3g}{width} {value['unit']}".strip())
    return f"{effect['effect']} at {effect['target']} ({', '.join(numbers)})"


if __name__ == "__main__":
    main()
