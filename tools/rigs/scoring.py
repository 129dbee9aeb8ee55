"""Opens the truth and counts: names, false alarms, intervals, errors beside the peers'."""

from __future__ import annotations

import csv
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from rigs.outcomes import BINS, Outcome, outcomes_of, truths_of

Key = Callable[[Outcome], str]


def write_scores(trials: Path, results: Sequence[Path], out: Path) -> int:
    """Writes `scores.md` and `outcomes.csv`; prints the former."""
    outcomes = outcomes_of(trials, results)
    if not outcomes:
        print("no results")
        return 1
    out.mkdir(parents=True, exist_ok=True)
    text = "\n".join(summary(outcomes, truths_of(trials))) + "\n"
    (out / "scores.md").write_text(text)
    _write_table(outcomes, out / "outcomes.csv")
    print(text)
    return 0


def share(hits: int, count: int, method: str = "wilson") -> str:
    """`12 of 15, 80 % (55 to 93)`: with 95 % bounds (Wilson; Clopper-Pearson: `exact`)."""
    if not count:
        return "-"
    bounds = binomtest(hits, count).proportion_ci(method=method)  # type: ignore[arg-type]
    part = f"{100 * hits / count:.0f} % ({100 * bounds.low:.0f} to {100 * bounds.high:.0f})"
    return f"{hits} of {count}, {part}"


def summary(outcomes: Sequence[Outcome], truths: Sequence[dict[str, Any]]) -> list[str]:
    """The tables, as Markdown."""
    own = [o for o in outcomes if o.tool == "diagnose"]
    return [
        "# Rigs: blind trials that share no code with the search",
        "",
        *_trials(truths, own),
        *_names(own),
        *_alarms(own),
        *_table(own, "visibility (times the noise)", _bin, _shown),
        *_table(own, "artefact", _artefact, _visible),
        *_table(own, "machine", lambda o: str(o.truth["machine"]), _visible),
        *_table(own, "effect", lambda o: o.laws[0][0] if o.laws else "", _visible),
        *_coverage(own),
        *_peers(outcomes),
        *_failures(own),
    ]


def _trials(truths: Sequence[dict[str, Any]], own: Sequence[Outcome]) -> list[str]:
    dropped = Counter(f"{t['machine']}: {t['dropped']}" for t in truths if "dropped" in t)
    kept = Counter(t["kind"] for t in truths if "dropped" not in t)
    failed = [o for o in own if o.failure]
    lines = [
        f"{sum(kept.values())} trials ({', '.join(f'{k} {n}' for k, n in sorted(kept.items()))}); "
        f"{sum(dropped.values())} dropped when they were made; {len(own)} diagnosed, of these "
        f"{len(failed)} failed or took too long (counted as not found).",
        "",
    ]
    return lines + [f"- dropped: {why} ({n})" for why, n in dropped.most_common()] + [""]


def _names(own: Sequence[Outcome]) -> list[str]:
    single = [o for o in own if o.kind == "single" and o.visible]
    faint = [o for o in own if o.kind == "single" and not o.visible]
    pairs = [o for o in own if o.kind == "pair" and o.visible]
    outside = [o for o in own if o.kind == "outside" and o.visible]
    rows = [
        ("single, shows at twice the noise: right first", [o.right_first for o in single]),
        ("... right among the findings", [o.right_any for o in single]),
        ("... right and nothing needless", [o.right_first and not o.needless for o in single]),
        ("... wrong name", [o.wrong for o in single]),
        ("... nothing named", [not o.names for o in single]),
        ("... right first of those that show at twice what noise and starts leave unknown, too",
         [o.right_first for o in single if o.distinct]),
        ("single, shows less: right, or nothing named",
         [o.right_first or not o.needless for o in faint]),
        ("pair: both found", [o.all_found for o in pairs]),
        ("... one of them first", [o.right_first for o in pairs]),
        ("... wrong names only", [o.wrong for o in pairs]),
        ("... both found of those in which each shows beside the other, too",
         [o.all_found for o in pairs if o.apart]),
        ("... effects found of those that show beside the other",
         [law in o.known for o in pairs for law in o.separate]),
        ("outside the catalogue: something named", [bool(o.needless) for o in outside]),
        *_of_several("triple", own),
        *_of_several("many", own),
    ]  # fmt: skip
    lines = ["| trials | share, 95 % bounds (Wilson) |", "| --- | --- |"]
    return lines + [f"| {what} | {share(sum(hits), len(hits))} |" for what, hits in rows] + [""]


def _of_several(kind: str, own: Sequence[Outcome]) -> list[tuple[str, list[bool]]]:
    """Rows for trials in which more than two effects are missing."""
    some = [o for o in own if o.kind == kind and o.visible]
    if not some:
        return []
    findings = [(o, name) for o in some for name in o.names]
    return [
        (f"{kind}: all found", [o.all_found for o in some]),
        ("... one of them first", [o.right_first for o in some]),
        ("... wrong names only", [o.wrong for o in some]),
        ("... effects found, of all there are", [law in o.known for o in some for law in o.laws]),
        (
            "... effects found, of those that show beside the others",
            [law in o.known for o in some for law in o.separate],
        ),
        ("... findings that are needless", [name in o.needless for o, name in findings]),
    ]


def _alarms(own: Sequence[Outcome]) -> list[str]:
    """False alarms: findings without a law that are not correct about the chain either, of the
    diagnoses that have finished; and how many of all ended as they must."""
    every = [o for o in own if o.kind == "none"]
    rows = [("all", every)]
    for artefact in sorted({_artefact(o) for o in every}):
        rows.append((artefact, [o for o in every if _artefact(o) == artefact]))
    lines = [
        "## Without an effect",
        "",
        "| artefact | false alarms, 95 % bounds (Clopper-Pearson) | silent or right sensor finding "
        "| verdicts |",
        "| --- | --- | --- | --- |",
    ]
    for name, some in rows:
        verdicts = Counter(o.verdict or "no answer" for o in some)
        said = ", ".join(f"{v} {n}" for v, n in verdicts.most_common())
        ended = [o for o in some if not o.failure]
        alarms = share(sum(bool(o.needless) for o in ended), len(ended), "exact")
        lines.append(
            f"| {name} | {alarms} | {sum(o.quiet for o in some)} of {len(some)} | {said} |"
        )
    return [*lines, ""]


def _shown(o: Outcome) -> bool:
    return o.kind == "single"


def _visible(o: Outcome) -> bool:
    return o.kind == "single" and o.visible


def _bin(o: Outcome) -> str:
    value = float(o.truth["visibility"])
    for low, high in pairwise(BINS):
        if low <= value < high:
            return f"{low:g} to {high:g}"
    return "unknown"


def _artefact(o: Outcome) -> str:
    some = o.truth["artefacts"]
    return "several" if len(some) > 1 else some[0] if some else "(white noise only)"


def _table(
    own: Sequence[Outcome], what: str, key: Key, which: Callable[[Outcome], bool]
) -> list[str]:
    """Single effects by some property."""
    groups: dict[str, list[Outcome]] = defaultdict(list)
    for o in own:
        if which(o):
            groups[key(o)].append(o)
    lines = [
        f"## Single effects by {what}",
        "",
        f"| {what.partition(' (')[0]} | right first (Wilson) | any | wrong | nothing | needless |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for name in sorted(groups, key=_order):
        some = groups[name]
        counts = [
            sum(o.right_any for o in some),
            sum(o.wrong for o in some),
            sum(not o.names for o in some),
            sum(bool(o.needless) and o.right_any for o in some),
        ]
        first = share(sum(o.right_first for o in some), len(some))
        lines.append(f"| {name} | {first} | {' | '.join(map(str, counts))} |")
    return [*lines, ""]


def _order(name: str) -> tuple[float, str]:
    head = name.split(" ")[0]
    return (float(head), name) if head.replace(".", "", 1).isdigit() else (0.0, name)


def _coverage(own: Sequence[Outcome]) -> list[str]:
    """How often the 95 % interval of the first parameter has the truth in it."""
    groups: dict[str, list[bool]] = defaultdict(list)
    for o in own:
        found = o.interval
        if found is not None:
            low, high, true = found
            groups[o.laws[0][0]].append(low <= true <= high)
    every = [hit for hits in groups.values() for hit in hits]
    lines = ["## 95 % intervals", "", "| effect | contain the truth |", "| --- | --- |"]
    lines.append(f"| all | {share(sum(every), len(every))} |")
    return lines + [f"| {n} | {share(sum(h), len(h))} |" for n, h in sorted(groups.items())] + [""]


def _peers(outcomes: Sequence[Outcome]) -> list[str]:
    """Held-out error of all tools on the trials that all have finished."""
    by_trial: dict[str, dict[str, Outcome]] = defaultdict(dict)
    for o in outcomes:
        if not o.failure and np.isfinite(o.after):
            by_trial[o.truth["trial"]][o.tool] = o
    tools = sorted({o.tool for o in outcomes})
    common = [t for t in by_trial.values() if set(t) == set(tools)]
    there = {o.kind for o in outcomes}
    kinds = [k for k in ("single", "pair", "triple", "many", "none", "outside") if k in there]
    lines = [
        "## Beside the peers",
        "",
        f"Held-out error over that of the declared scene, {len(common)} trials that all tools have "
        "finished: median, and share of the trials in which it is the lowest (within 1 %).",
        "",
        f"| tool | {' | '.join(kinds)} | lowest | names, visible singles: right first |",
        f"| --- |{' --- |' * len(kinds)} --- | --- |",
    ]
    for tool in tools:
        cells = []
        for kind in kinds:
            ratios = [t[tool].after / t[tool].before for t in common
                      if t[tool].kind == kind and t[tool].before > 0]  # fmt: skip
            cells.append(f"{np.median(ratios):.2f}" if ratios else "-")
        best = sum(t[tool].after <= 1.01 * min(o.after for o in t.values()) for t in common)
        some = [o for o in outcomes if o.tool == tool and _visible(o)]
        named = share(sum(o.right_first for o in some), len(some)) if tool != "sysid" else "-"
        lines.append(f"| {tool} | {' | '.join(cells)} | {share(best, len(common))} | {named} |")
    return [*lines, ""]


def _failures(own: Sequence[Outcome]) -> list[str]:
    """Every trial that went wrong."""
    lines = ["## What went wrong", ""]
    for o in own:
        t = o.truth
        bad = o.failure or (
            (o.laws and o.visible and not o.right_first)
            or o.needless
            or (o.kind == "none" and not o.quiet)
        )
        if not bad:
            continue
        laws = ", ".join(
            f"{x['effect'] or x['kind']}({x['target']}, {x['size']:.2g})" for x in t["laws"]
        )
        said = ", ".join(f"{e}({x})" for e, x in o.names) or "nothing"
        said += f" and off: {', '.join(o.retuned)}" if o.retuned else ""
        where = f"{t['machine']}, {'+'.join(t['artefacts']) or 'white'}, "
        shows = f"shows {t['visibility']:.3g} times, {o.seconds:.0f} s"
        lines.append(
            f"- {t['trial']} {where}{shows}: {laws or 'no effect'} -> {said} "
            f"({o.verdict or o.failure[:160]})"
        )
    return [*lines, ""]


_COLUMNS = (
    "trial tool kind machine artefacts noise visibility distinct beside laws reported verdict "
    "right_first right_any all_found needless wrong before after seconds failure"
)


def _write_table(outcomes: Sequence[Outcome], path: Path) -> None:
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(_COLUMNS.split())
        for o in outcomes:
            t = o.truth
            laws = "; ".join(f"{x['effect'] or x['kind']}({x['target']})" for x in t["laws"])
            names = ["; ".join(f"{e}({x})" for e, x in some) for some in (o.names, o.needless)]
            writer.writerow(
                [t["trial"], o.tool, o.kind, t["machine"], "+".join(t["artefacts"]), t["noise"],
                 t["visibility"], t.get("distinct", ""),
                 "; ".join(f"{shows:.3g}" for shows in t.get("beside", ())), laws, names[0],
                 o.verdict, o.right_first, o.right_any, o.all_found, names[1], o.wrong,
                 o.before, o.after, o.seconds,
                 o.failure.replace("\n", " ")[:300]]
            )  # fmt: skip
