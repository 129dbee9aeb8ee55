"""Opens the truth and counts: what was found, how exactly, and every failure."""

from __future__ import annotations

import csv
import dataclasses
import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from blind import matching
from blind.running import read_lines, recordings_of
from orbisim import Recording, load_scene, replay
from orbisim.effects import EffectInstance
from orbisim.effects.measured import correct
from orbisim.errors import OrbiSimError


@dataclasses.dataclass(frozen=True, eq=False)
class Outcome:
    """A trial with its truth and what was reported.

    Attributes:
      trial, kind, scene: of the trial. noise, velocities, wrong: its conditions.
      truths: injected effects; `outside` is the kind of one that is not in the catalogue.
      found: reported effects. verdict, failure: of the tool. seconds: it took.
      before, after: held-out free-running error. true: of the scene with the injected effects.
      peer_before, peer_after: the peer's. equal: whether an identity makes the first effect right.
      shifts: over noise, of each injected effect. alternatives: reported ones.
    """

    trial: str
    kind: str
    scene: str
    noise: float
    velocities: bool
    wrong: str
    truths: tuple[dict[str, Any], ...]
    outside: str
    found: tuple[dict[str, Any], ...]
    verdict: str
    failure: str
    seconds: float
    before: float
    after: float
    true: float
    peer_before: float
    peer_after: float
    equal: bool
    shifts: tuple[float, ...]
    alternatives: tuple[dict[str, Any], ...]

    @property
    def first(self) -> str:
        """Name of the first reported effect; the verdict if there is none."""
        return str(self.found[0]["effect"]) if self.found else self.verdict or "failed"

    @property
    def right(self) -> bool:
        """Whether the outcome is what it should be."""
        if self.failure:
            return False
        if self.kind == "none":
            return not self.found and (self.wrong != "right" or self.verdict == "no_residual")
        if self.kind == "outside":
            return not self.found
        if self.kind == "pair":
            return matching.all_found(self.found, self.truths)
        return bool(self.found) and matching.same(self.found[0], self.truths[0])

    @property
    def relative_error(self) -> float:
        """Of the first parameter, where the effect is found."""
        for one in self.found:
            if matching.same(one, self.truths[0]):
                return matching.relative_error(one, self.truths[0])
        return float("nan")


def write_scores(trials: Path, results: Path, out: Path, peer: Path | None) -> int:
    """Writes `scores.md`, `confusion.csv`, `confusion.png`, `outcomes.csv` and `failures.md`."""
    out.mkdir(parents=True, exist_ok=True)
    outcomes = outcomes_of(trials, results, peer)
    if not outcomes:
        print("no results")
        return 1
    text = summary(outcomes)
    (out / "scores.md").write_text(text)
    (out / "failures.md").write_text(failures(outcomes))
    _write_outcomes(outcomes, out / "outcomes.csv")
    _write_confusion(outcomes, out)
    print(text)
    return 0


def outcomes_of(trials: Path, results: Path, peer: Path | None = None) -> list[Outcome]:
    """All trials that have a result, in order."""
    rivals = {entry["trial"]: entry for entry in read_lines(peer)} if peer else {}
    entries = sorted(read_lines(results), key=lambda entry: entry["trial"])
    return [_outcome(trials, entry, rivals.get(entry["trial"])) for entry in entries]


def _outcome(trials: Path, entry: dict[str, Any], rival: dict[str, Any] | None) -> Outcome:
    name = entry["trial"]
    truth = json.loads((trials / "truth" / f"{name}.json").read_text())
    report = entry["report"] or {}
    error = report.get("error", {}).get("held_out", {})
    other = ((rival or {}).get("report") or {}).get("error", {}).get("held_out", {})
    found, truths = tuple(report.get("effects", ())), tuple(truth["effects"])
    equal = bool(
        found
        and truth["wish"]["kind"] == "single"
        and matching.equivalent(found[0], truths[0], _model(trials / "trials" / name))
    )
    return Outcome(
        trial=name,
        kind=truth["wish"]["kind"],
        scene=truth["wish"]["scene"],
        noise=truth["noise"],
        velocities=truth["velocities"],
        wrong=truth["wrong"],
        truths=truths,
        outside=(truth["outside"] or {}).get("kind", ""),
        found=found,
        verdict=str(report.get("verdict", "")),
        failure=str(entry["failure"] or ""),
        seconds=float(entry["seconds"]),
        before=_number(error.get("before")),
        after=_number(error.get("after")),
        true=_true_error(trials, name, truths) if not truth["outside"] else float("nan"),
        peer_before=_number(other.get("before")),
        peer_after=_number(other.get("after")),
        equal=equal,
        shifts=tuple(truth["shift_over_noise"]),
        alternatives=tuple(report.get("alternatives", ())),
    )


def _number(value: Any) -> float:
    return float("nan") if value is None else float(value)


def _model(folder: Path) -> Any:
    return load_scene(folder / "scene.xml", trusted=True).model


def _true_error(trials: Path, name: str, truths: Sequence[dict[str, Any]]) -> float:
    """Held-out free-running error of the scene with the injected effects; NaN if it cannot run."""
    folder = trials / "trials" / name
    effects = [EffectInstance.from_json(one) for one in truths]
    try:
        scene = load_scene(trials / "truth" / f"{name}.xml", trusted=True)
        held = [Recording.load(path) for path in recordings_of(folder, "held")]
        held = [correct(one, effects, load_scene(folder / "scene.xml", trusted=True))
                for one in held]  # fmt: skip
        return float(replay(scene, held, window=0.5).rms)
    except OrbiSimError:
        return float("nan")


# -- the summary -----------------------------------------------------------------------------------


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
        *_peer_table(outcomes),
        *_confusion_table(singles),
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


def _ratio(o: Outcome) -> float:
    return o.after / o.true if o.true > 0 else float("nan")


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
            _median(_ratio(o) for o in singles),
            "3",
        ),
        (
            "the same, at most 3",
            _share(_ratio(o) <= 3 for o in singles if np.isfinite(_ratio(o))),
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
            f"{_median(_ratio(o) for o in some)} | {_median(o.seconds for o in some)} |"
        )
    return lines


def _peer_table(outcomes: Sequence[Outcome]) -> list[str]:
    """Held-out error after over before, ours and the peer's, on trials that both have done."""
    both = [o for o in outcomes if np.isfinite(o.peer_after) and np.isfinite(o.after)]
    if not both:
        return []
    lines = [
        "",
        "## Beside mujoco.sysid with armature, friction loss, damping and stiffness of each joint",
        "",
        "Held-out error after over before (median), and how often it was raised.",
        "",
        "| trials | n | ours | ours: raised | sysid | sysid: raised |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for kind in ("single", "pair", "none", "outside"):
        some = [o for o in both if o.kind == kind and o.before > 0]
        if not some:
            continue
        ours = [o.after / o.before for o in some]
        theirs = [o.peer_after / o.peer_before for o in some]
        lines.append(
            f"| {kind} | {len(some)} | {_median(ours)} | {_share(r > 1.001 for r in ours)} | "
            f"{_median(theirs)} | {_share(r > 1.001 for r in theirs)} |"
        )
    return lines


# -- the confusion matrix --------------------------------------------------------------------------


def _confusion(outcomes: Sequence[Outcome]) -> tuple[list[str], list[str], np.ndarray]:
    """Injected (rows) against reported first (columns); `: elsewhere` is a wrong target."""
    rows = sorted({str(o.truths[0]["effect"]) for o in outcomes})
    names = {_column(o) for o in outcomes}
    columns = [name for name in rows if name in names] + sorted(names - set(rows))
    table = np.zeros((len(rows), len(columns)), int)
    for o in outcomes:
        table[rows.index(str(o.truths[0]["effect"])), columns.index(_column(o))] += 1
    return rows, columns, table


def _column(o: Outcome) -> str:
    if o.found and o.found[0]["effect"] == o.truths[0]["effect"] and not o.right:
        return f"{o.first}: elsewhere"
    return "failed" if o.failure else o.first


def _all_rows(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Single effects; no effect and effects outside the catalogue as rows of their own."""
    found = [o for o in outcomes if o.kind == "single"]
    for o in outcomes:
        if o.kind in ("none", "outside"):
            label = "(none)" if o.kind == "none" else f"(outside) {o.outside}"
            stand_in = {"effect": label, "target": "", "parameters": {}}
            found.append(dataclasses.replace(o, truths=(stand_in,)))
    return found


def _confusion_table(outcomes: Sequence[Outcome]) -> list[str]:
    """What was reported first instead, by injected effect."""
    if not outcomes:
        return []
    lines = [
        "",
        "## What was said",
        "",
        "| injected | n | right | instead |",
        "| --- | --- | --- | --- |",
    ]
    rows, columns, table = _confusion(outcomes)
    for i, name in enumerate(rows):
        instead = [
            f"{columns[j]} {table[i, j]}"
            for j in np.argsort(-table[i])
            if table[i, j] and columns[j] != name
        ]
        right = table[i, columns.index(name)] if name in columns else 0
        lines.append(f"| {name} | {table[i].sum()} | {right} | {', '.join(instead) or '-'} |")
    return lines


def _write_confusion(outcomes: Sequence[Outcome], out: Path) -> None:
    some = _all_rows(outcomes)
    if not some:
        return
    rows, columns, table = _confusion(some)
    with (out / "confusion.csv").open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["injected", *columns])
        writer.writerows([name, *map(int, row)] for name, row in zip(rows, table, strict=True))
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    size = (4 + 0.24 * len(columns), 3 + 0.22 * len(rows))
    figure, axes = pyplot.subplots(figsize=size, layout="constrained")
    shares = table / np.maximum(table.sum(axis=1, keepdims=True), 1)
    axes.imshow(shares, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    for i, j in zip(*np.nonzero(table), strict=True):
        colour = "white" if shares[i, j] > 0.6 else "black"
        axes.text(j, i, table[i, j], ha="center", va="center", fontsize=7, color=colour)
    axes.set_xticks(range(len(columns)), columns, rotation=90, fontsize=7)
    axes.set_yticks(range(len(rows)), rows, fontsize=7)
    axes.set_xlabel("reported first")
    axes.set_ylabel("injected")
    figure.savefig(out / "confusion.png", dpi=150)
    pyplot.close(figure)


# -- details ---------------------------------------------------------------------------------------


_COLUMNS = (
    "trial kind scene noise velocities declared injected reported verdict right identical "
    "first_parameter_error before after true peer_after seconds failure"
)


def _write_outcomes(outcomes: Sequence[Outcome], path: Path) -> None:
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(_COLUMNS.split(" "))
        for o in outcomes:
            said = (_injected(o), _said(o.found), o.verdict, o.right, o.equal)
            error = o.relative_error if o.truths else ""
            figures = (error, o.before, o.after, o.true, o.peer_after, o.seconds)
            failure = o.failure.replace("\n", " ")[:200]
            conditions = (o.trial, o.kind, o.scene, o.noise, o.velocities, o.wrong)
            writer.writerow([*conditions, *said, *figures, failure])


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
        f"{o.seconds:.0f} s; alternatives: {rivals or '-'}",
    ]


__all__ = ["Outcome", "failures", "outcomes_of", "summary", "write_scores"]
