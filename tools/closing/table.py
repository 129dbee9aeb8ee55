"""One table of all measured sets and tools, and how the goals are met in both halves."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from closing.plans import PLANS, Plan

Results = Mapping[str, Mapping[str, Mapping[str, Any]]]

_COLUMNS = ("declared", "diagnosed", "published", "recipe", "sysid")


def markdown(results: Results) -> str:
    """The table, and the goals by half."""
    head = ["set", "half", "metric, held out", *_COLUMNS, "verdict", "found, 95 %", "literature",
            "s"]  # fmt: skip
    lines = [f"| {' | '.join(head)} |", f"| {' | '.join('---' for _ in head)} |"]
    plans = [plan for plan in PLANS if plan.name in results]
    lines += [_row(plan, results[plan.name]) for plan in plans]
    return "\n".join([*lines, "", *_goals(plans, results)]) + "\n"


def _row(plan: Plan, one: Mapping[str, Mapping[str, Any]]) -> str:
    cells = [plan.name, plan.half, f"{plan.metric.words}, {plan.metric.unit}"]
    cells += [_error(one.get(tool)) for tool in _COLUMNS]
    own = one.get("diagnosed", {})
    cells += [f"`{own['verdict']}`" if "verdict" in own else "", _found(own), plan.literature]
    cells.append(f"{own['search_seconds']:.0f}" if "search_seconds" in own else "")
    return f"| {' | '.join(cells)} |"


def _error(result: Mapping[str, Any] | None) -> str:
    if result is None:
        return "-"
    value = error_of(result)
    if math.isfinite(value):
        return f"{value:.3g}"
    return str(result.get("failure", "infinite")).strip().splitlines()[-1][:80].replace("|", " ")


def error_of(result: Mapping[str, Any] | None) -> float:
    """The headline's error on held-out recordings; infinite without one."""
    value = next(iter((result or {}).get("held_out", {}).values()), None)
    return math.inf if value is None or math.isnan(value) else float(value)


def _found(own: Mapping[str, Any]) -> str:
    words = [_words(effect) for effect in own.get("effects", ())]
    words += [f"{r['label']} times {r['factor']:.3g}" for r in own.get("retuned", ())]
    return "; ".join(words) or ("nothing" if "verdict" in own else "")


def _words(effect: Mapping[str, Any]) -> str:
    numbers = []
    for name, value in effect["parameters"].items():
        low, high = (math.nan if bound is None else bound for bound in value["ci95"])
        half = (high - low) / 2
        width = f" ± {half:.2g}" if math.isfinite(half) and half > 0 else ""
        numbers.append(f"{name} {value['value']:.3g}{width} {value['unit']}".strip())
    return f"{effect['effect']} at {effect['target']} ({', '.join(numbers)})"


# -- goals -----------------------------------------------------------------------------------------

GOALS = (
    "at or below 1.05 times the published model",
    "below the plain recipe",
    "below sysid",
    "the literature's dominant effect is among those named",
    "not silent where the published model removes a third",
)


def reached(plan: Plan, one: Mapping[str, Mapping[str, Any]]) -> dict[str, bool]:
    """Which goals a set that was run reaches; those that do not apply are left out."""
    own = error_of(one.get("diagnosed"))
    found: dict[str, bool] = {}
    if "published" in one:
        found[GOALS[0]] = own <= 1.05 * error_of(one["published"])
    for goal, tool in ((GOALS[1], "recipe"), (GOALS[2], "sysid")):
        if math.isfinite(error_of(one.get(tool))):
            # 1 %: where a tool has nothing to fit, both are the declared scene
            found[goal] = own <= 1.01 * error_of(one[tool])
    names = {(e["effect"], e["target"]) for e in one.get("diagnosed", {}).get("effects", ())}
    if plan.dominant:
        found[GOALS[3]] = bool(names & set(plan.dominant))
    if error_of(one.get("published")) < 2 / 3 * error_of(one.get("declared")):
        silent = one.get("diagnosed", {}).get("verdict", "") in ("", "unexplained", "no_residual")
        found[GOALS[4]] = not silent
    return found


def _goals(plans: Sequence[Plan], results: Results) -> list[str]:
    lines = ["| goal | developed | judged | missed by |", "| --- | --- | --- | --- |"]
    met = {plan: reached(plan, results[plan.name]) for plan in plans
           if "diagnosed" in results[plan.name]}  # fmt: skip
    for goal in GOALS:
        cells = []
        for half in ("developed", "judged"):
            some = [met[plan][goal] for plan in met if plan.half == half and goal in met[plan]]
            cells.append(f"{sum(some)} of {len(some)}")
        missed = [plan.name for plan in met if not met[plan].get(goal, True)]
        lines.append(f"| {goal} | {' | '.join(cells)} | {', '.join(missed) or '-'} |")
    return lines
