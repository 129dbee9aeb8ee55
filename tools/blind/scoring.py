"""Opens the truth and counts: what was found, how exactly, and every failure."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from blind import matching
from blind.confusion import write_confusion
from blind.outcomes import Outcome, outcomes_of
from blind.summary import summary


def write_scores(trials: Path, results: Path, out: Path) -> int:
    """Writes `scores.md`, `confusion.csv`, `confusion.png`, `outcomes.csv` and `failures.md`."""
    out.mkdir(parents=True, exist_ok=True)
    outcomes = outcomes_of(trials, results)
    if not outcomes:
        print("no results")
        return 1
    text = summary(outcomes)
    (out / "scores.md").write_text(text)
    (out / "failures.md").write_text(failures(outcomes))
    _write_outcomes(outcomes, out / "outcomes.csv")
    write_confusion(outcomes, out)
    print(text)
    return 0


_COLUMNS = (
    "trial kind scene noise velocities declared injected reported verdict right identical "
    "first_parameter_error declared_error after true after_over_true peer peer_verdict seconds "
    "failure"
)


def _write_outcomes(outcomes: Sequence[Outcome], path: Path) -> None:
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(_COLUMNS.split(" "))
        for o in outcomes:
            said = (_injected(o), _said(o.found), o.verdict, o.right, o.equal)
            error = o.relative_error if o.truths else ""
            errors = (error, o.declared, o.after, o.true, o.over_true, o.peer, o.peer_verdict)
            failure = o.failure.replace("\n", " ")[:200]
            conditions = (o.trial, o.kind, o.scene, o.noise, o.velocities, o.wrong)
            writer.writerow([*conditions, *said, *errors, o.seconds, failure])


def _injected(o: Outcome) -> str:
    return o.outside or _said(o.truths)


def _said(effects: Iterable[dict[str, Any]]) -> str:
    return "; ".join(_one(effect) for effect in effects)


def _one(effect: dict[str, Any]) -> str:
    numbers = ", ".join(
        f"{name}={matching._number(value):.4g}" for name, value in effect["parameters"].items()
    )
    chosen = ", ".join(f"{k}={v}" for k, v in (effect.get("options") or {}).items())
    return f"{effect['effect']}({effect['target']}: {numbers}{'; ' + chosen if chosen else ''})"


def failures(outcomes: Sequence[Outcome]) -> str:
    """Every trial that went wrong, with what was injected and what was said."""
    wrong = [o for o in outcomes if not o.right]
    lines = [f"# {len(wrong)} of {len(outcomes)} trials went wrong", ""]
    for kind in ("single", "pair", "none", "outside"):
        some = [o for o in wrong if o.kind == kind]
        if some:
            lines += [f"## {kind}", "", *(line for o in some for line in _failure(o))]
    return "\n".join(lines) + "\n"


def _failure(o: Outcome) -> list[str]:
    shifts = ", ".join(f"{s:.3g}" for s in o.shifts)
    rivals = "; ".join(
        f"{a['effect']}({a['target']}, {a['delta_bic']:.3g})" if a.get("delta_bic") is not None
        else f"{a['effect']}({a['target']})"
        for a in o.alternatives[:4]
    )  # fmt: skip
    return [
        f"- **{o.trial}** {o.scene}, noise {o.noise:g}, velocities "
        f"{'yes' if o.velocities else 'no'}, declared {o.wrong}, shift over noise {shifts or '-'}",
        f"  - injected: {_injected(o) or 'nothing'}",
        f"  - reported: {_said(o.found) or 'nothing'} ({o.verdict or o.failure[:300]})"
        + (" - identical by mechanics" if o.equal else ""),
        f"  - held-out error {o.before:.3g} -> {o.after:.3g}, true scene {o.true:.3g}, "
        f"peer {o.peer:.3g}, {o.seconds:.0f} s; alternatives: {rivals or '-'}",
    ]
