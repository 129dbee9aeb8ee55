"""The same trials diagnosed under changes that should not matter, beside the first diagnosis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from rigs.outcomes import Outcome, outcomes_of
from rigs.scoring import share


def write_table(trials: Path, first: Path, changed: Mapping[str, Path], out: Path) -> int:
    """Writes `stability.md` and prints it.

    Args:
      first: results of the run to compare with. changed: those of the others, by what was changed.
    """
    base = _diagnoses(trials, first)
    others = {words: _diagnoses(trials, path) for words, path in changed.items()}
    text = "\n".join(table(base, others)) + "\n"
    out.mkdir(parents=True, exist_ok=True)
    (out / "stability.md").write_text(text)
    print(text)
    return 0


def _diagnoses(trials: Path, results: Path) -> dict[str, Outcome]:
    found = outcomes_of(trials, [results])
    return {o.truth["trial"]: o for o in found if o.tool == "diagnose"}


def table(base: Mapping[str, Outcome], others: Mapping[str, Mapping[str, Outcome]]) -> list[str]:
    """How often the answer is the same, and which trials it is not, as Markdown."""
    lines = [
        "| changed | same names | same first name | same verdict | right first, before and after; "
        "difference in points (95 %) |",
        "| --- | --- | --- | --- | --- |",
    ]
    differ = []
    for words, other in others.items():
        common = sorted(set(base) & set(other))
        pairs = [(base[name], other[name]) for name in common]
        pairs = [(a, b) for a, b in pairs if not a.failure and not b.failure]
        lost = len(common) - len(pairs)
        cells = [
            share(sum(set(a.names) == set(b.names) for a, b in pairs), len(pairs)),
            share(sum(a.names[:1] == b.names[:1] for a, b in pairs), len(pairs)),
            share(sum(a.verdict == b.verdict for a, b in pairs), len(pairs)),
            _right(pairs),
        ]
        note = f" ({lost} without an answer left out)" if lost else ""
        lines.append(f"| {words}{note} | {' | '.join(cells)} |")
        differ += [
            f"- {words}, {a.truth['trial']} ({a.truth['machine']}, shows "
            f"{a.truth['visibility']:.3g} times): {_said(a)} -> {_said(b)}"
            for a, b in pairs
            if set(a.names) != set(b.names)
        ]
    return [*lines, "", *differ]


def _right(pairs: Sequence[tuple[Outcome, Outcome]]) -> str:
    some = [(a, b) for a, b in pairs if a.kind in ("single", "pair") and a.visible]
    if not some:
        return "-"
    before, after = (np.array([pair[k].right_first for pair in some]) for k in (0, 1))
    low, high = difference(int((~before & after).sum()), int((before & ~after).sum()), len(some))
    more = (int(after.sum()) - int(before.sum())) / len(some)
    told = f"{100 * more:+.0f} ({100 * low:+.0f} to {100 * high:+.0f})"
    return f"{before.sum()} and {after.sum()} of {len(some)}; {told}"


def difference(gained: int, lost: int, count: int) -> tuple[float, float]:
    """95 % bounds of the difference of two shares of the same trials: Wald's interval with half a
    trial more in each cell of their table (Agresti and Min, Statistics in Medicine 24, 2005).

    Args:
      gained, lost: trials that are right after and not before, and the other way round.
      count: of all trials.
    """
    more, whole = gained - lost, count + 2.0
    spread = np.sqrt(gained + lost + 1.0 - more**2 / whole) / whole
    return float(more / whole - 1.96 * spread), float(more / whole + 1.96 * spread)


def _said(o: Outcome) -> str:
    return ", ".join(f"{effect}({target})" for effect, target in o.names) or "nothing"
