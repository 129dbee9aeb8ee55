"""All figures of the blind trials, as Markdown."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from blind import matching
from blind.confusion import instead_table
from blind.outcomes import Outcome
from blind.peer_table import peer_table


def summary(outcomes: Sequence[Outcome]) -> str:
    """All figures, as Markdown."""
    singles = [o for o in outcomes if o.kind == "single"]
    parts = [
        "# Blind trials",
        "",
        f"{len(outcomes)} trials: {len(singles)} with one effect, {_count(outcomes, 'pair')} with "
        f"two, {_count(outcomes, 'none')} with none, {_count(outcomes, 'outside')} with one that "
        f"the catalogue lacks. {sum(bool(o.failure) for o in outcomes)} did not finish.",
        "",
        *_goals(outcomes),
        *_by(singles, "noise", lambda o: f"{o.noise:g}"),
        *_by(singles, "velocities", lambda o: "recorded" if o.velocities else "not recorded"),
        *_by(singles, "declared", lambda o: o.wrong),
        *_by(singles, "scene", lambda o: o.scene),
        *_by(singles, "effect", lambda o: str(o.truths[0]["effect"])),
        *peer_table(outcomes),
        *instead_table(singles),
    ]
    return "\n".join(parts) + "\n"


def _count(outcomes: Iterable[Outcome], kind: str) -> int:
    return sum(o.kind == kind for o in outcomes)


def _share(some: Iterable[bool]) -> str:
    values = list(some)
    if not values:
        return "-"
    return f"{100 * np.mean(values):.1f} % ({sum(values)} of {len(values)})"


def _median(values: Iterable[float], percent: bool = False) -> str:
    known = [v for v in values if np.isfinite(v)]
    if not known:
        return "-"
    middle = float(np.median(known))
    return f"{100 * middle:.2g} %" if percent else f"{middle:.3g}"


def _goals(outcomes: Sequence[Outcome]) -> list[str]:
    singles = [o for o in outcomes if o.kind == "single"]
    low, middle, high = ([o for o in singles if o.noise == level] for level in (1e-4, 5e-4, 2e-3))
    none = [o for o in outcomes if o.kind == "none" and o.wrong == "right"]
    misdeclared = [o for o in outcomes if o.kind == "none" and o.wrong != "right"]
    pairs = [o for o in outcomes if o.kind == "pair"]
    beyond = [o for o in outcomes if o.kind == "outside"]
    found = [o for o in singles if o.right]
    rows = [
        ("right effect and target first, low noise", _share(o.right for o in low), "95 %"),
        ("the same, middle noise", _share(o.right for o in middle), "90 %"),
        ("the same, high noise", _share(o.right for o in high), ""),
        (
            "the same, or an identity of mechanics, all levels",
            _share(o.right or o.equal for o in singles),
            "",
        ),
        (
            "nothing reported besides it",
            _share(len(o.found) == 1 for o in found),
            "",
        ),
        (
            "first parameter, median relative error",
            _median((o.relative_error for o in found), percent=True),
            "5 %",
        ),
        (
            "held-out error after over that of the true scene, median",
            _median(o.over_true for o in singles),
            "3",
        ),
        (
            "at most 3 times that of the true scene",
            _share(o.over_true <= 3 for o in singles if o.true > 0),
            "",
        ),
        (
            "the declared scene's, for comparison: median; at most 3 times",
            f"{_median(o.declared / o.true for o in singles if o.true > 0)}; "
            + _share(o.declared <= 3 * o.true for o in singles if o.true > 0),
            "",
        ),
        ("both effects of a pair found", _share(o.right for o in pairs), "80 %"),
        (
            "at least one of a pair found",
            _share(any(matching.same(f, t) for f in o.found for t in o.truths) for o in pairs),
            "",
        ),
        (
            "an effect named where there is none",
            _share(bool(o.found) for o in none),
            "at most 1 %",
        ),
        ("... where declared parameters are off", _share(bool(o.found) for o in misdeclared), ""),
        (
            "a name for an effect outside the catalogue",
            _share(bool(o.found) for o in beyond),
            "at most 5 %",
        ),
        (
            "... with the verdict that it explains everything",
            _share(bool(o.found) and o.verdict == "explained" for o in beyond),
            "",
        ),
        ("time for a trial, median, s", _median(o.seconds for o in outcomes), ""),
    ]
    return ["| what | reached | goal |", "| --- | --- | --- |"] + [
        f"| {what} | {reached} | {goal} |" for what, reached, goal in rows
    ]


def _by(outcomes: Sequence[Outcome], title: str, group: Callable[[Outcome], str]) -> list[str]:
    groups: dict[str, list[Outcome]] = {}
    for o in outcomes:
        groups.setdefault(group(o), []).append(o)
    lines = [
        "",
        f"## By {title}",
        "",
        f"| {title} | first right | or identical | first parameter | after / true | seconds |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for name, some in sorted(groups.items()):
        error = _median((o.relative_error for o in some if o.right), percent=True)
        lines.append(
            f"| {name} | {_share(o.right for o in some)} | "
            f"{_share(o.right or o.equal for o in some)} | {error} | "
            f"{_median(o.over_true for o in some)} | {_median(o.seconds for o in some)} |"
        )
    return lines
