"""A trial's truth beside what a tool said about it, and how that is judged."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from processes import read_lines

VISIBLE = 2.0
"""Times the noise from which on a law must be found; below it, silence is right, too."""
BINS = (0.0, 2.0, 5.0, 20.0, 100.0, math.inf)
"""Of visibility."""
DECLARED_AS = {
    "armature": "armature",
    "damping": "viscous_damping",
    "frictionloss": "coulomb_friction",
    "gain": "torque_gain",
}
"""What a declared parameter that is off is called as an effect: the same physics exactly, as both
change the same number of the model."""


@dataclasses.dataclass(frozen=True, eq=False)
class Outcome:
    """What a tool said about a trial.

    Attributes:
      truth: the trial's file. tool, verdict: words. found: effects, the first one first.
      retuned: declared parameters that are said to be off, as the report calls them.
      failure: why there is no report. before, after: held-out error. seconds: it took.
    """

    truth: dict[str, Any]
    tool: str
    verdict: str
    found: tuple[dict[str, Any], ...]
    retuned: tuple[str, ...]
    failure: str
    before: float
    after: float
    seconds: float

    @property
    def kind(self) -> str:
        """none, single, pair, outside, triple or many."""
        return str(self.truth["kind"])

    @property
    def visible(self) -> bool:
        """Whether the truth shows at twice the noise."""
        return bool(self.truth["visibility"] >= VISIBLE)

    @property
    def distinct(self) -> bool:
        """Whether the truth shows at twice what noise and starts leave unknown."""
        return bool(self.truth.get("distinct", self.truth["visibility"]) >= VISIBLE)

    @property
    def apart(self) -> bool:
        """Whether each of several laws shows at twice what all else leaves unknown of it."""
        beside = self.truth.get("beside", [])
        return bool(beside) and min(beside) >= VISIBLE

    @property
    def separate(self) -> list[tuple[str, str]]:
        """Of several laws those that show so much beside the others."""
        beside = self.truth.get("beside", [])
        every = zip(self.truth["laws"], beside, strict=True) if beside else ()
        return [
            (x["effect"], x["target"]) for x, shows in every if x["effect"] and shows >= VISIBLE
        ]

    @property
    def names(self) -> list[tuple[str, str]]:
        """What was reported. Declared parameters that are off are findings where there are no
        others; beside effects, they are what no scene is exact in."""
        if not self.found:
            return [_named(label) for label in self.retuned]
        return [(str(one["effect"]), str(one["target"])) for one in self.found]

    @property
    def laws(self) -> list[tuple[str, str]]:
        """What was injected and has a name."""
        return [(x["effect"], x["target"]) for x in self.truth["laws"] if x["effect"]]

    def stands_for(self, name: tuple[str, str]) -> tuple[str, str] | None:
        """The injected law that a reported name is, or is the same physics as."""
        if name in self.laws:
            return name
        for effect, target, *law in self.truth["same"]:
            if (effect, target) == name and self.laws:
                return (law[0], law[1]) if law else self.laws[0]
        return None

    def allowed(self, name: tuple[str, str]) -> bool:
        """Whether the measuring chain makes a finding correct that is no law."""
        return name[0] in self.truth["allowed"]

    @property
    def right_first(self) -> bool:
        """The first finding (that is no correct finding about the chain) is an injected law."""
        rest = [n for n in self.names if self.stands_for(n) or not self.allowed(n)]
        return bool(rest) and self.stands_for(rest[0]) is not None

    @property
    def right_any(self) -> bool:
        """Some finding is an injected law."""
        return bool(self.known)

    @property
    def known(self) -> set[tuple[str, str]]:
        """The injected laws that are among the findings: of several laws also declared parameters
        that are off beside effects, where they are no more than there are laws. A dozen would
        always hit one."""
        few = 1 < len(self.laws) >= len(self.retuned)
        off = [_named(label) for label in self.retuned] if few else []
        return {law for name in (*self.names, *off) if (law := self.stands_for(name)) is not None}

    @property
    def all_found(self) -> bool:
        """Every injected law is among the findings."""
        return set(self.laws) <= self.known

    @property
    def needless(self) -> list[tuple[str, str]]:
        """Findings that are neither injected nor correct about the chain."""
        return [n for n in self.names if not self.stands_for(n) and not self.allowed(n)]

    @property
    def quiet(self) -> bool:
        """Nothing is said to be missing or off, but for what is correct about the chain."""
        said_right = self.verdict == "no_residual" or bool(self.names)
        return said_right and not self.retuned and all(self.allowed(n) for n in self.names)

    @property
    def wrong(self) -> bool:
        """Something is named, and nothing of it is injected or correct about the chain."""
        return bool(self.needless) and not self.right_any

    @property
    def interval(self) -> tuple[float, float, float] | None:
        """Low, high and the true value of the first parameter, where a law is named as it is."""
        for one in self.found:
            for law in self.truth["laws"]:
                same = (one["effect"], one["target"]) == (law["effect"], law["target"])
                if same and law["value"] is not None:
                    first = next(iter(one["parameters"].values()))
                    low, high = first["ci95"]
                    if low is not None and high is not None:
                        return float(low), float(high), float(law["value"])
        return None


def truths_of(trials: Path) -> list[dict[str, Any]]:
    """All trials' truths, dropped ones too, in order."""
    return [json.loads(path.read_text()) for path in sorted((trials / "truth").glob("*.json"))]


def outcomes_of(trials: Path, results: Sequence[Path]) -> list[Outcome]:
    """All trials and tools that have a result, in order."""
    truths = {one["trial"]: one for one in truths_of(trials) if "dropped" not in one}
    entries = [entry for path in results for entry in read_lines(path)]
    return [
        _outcome(truths[e["trial"]], e)
        for e in sorted(entries, key=lambda e: (e["trial"], e["tool"]))
        if e["trial"] in truths
    ]


def _outcome(truth: dict[str, Any], entry: dict[str, Any]) -> Outcome:
    report = entry["report"] or {}
    error = report.get("error", {}).get("held_out", {})
    return Outcome(
        truth=truth,
        tool=entry["tool"],
        verdict=str(report.get("verdict", "")),
        found=tuple(report.get("effects", ())),
        retuned=tuple(str(one["label"]) for one in report.get("retuned", ())),
        failure=str(entry["failure"] or ""),
        before=_number(error.get("before")),
        after=_number(error.get("after")),
        seconds=float(entry["seconds"]),
    )


def _named(label: str) -> tuple[str, str]:
    """The effect and the target of a declared parameter, as in `gain of elbow_motor`."""
    kind, _, target = label.partition(" of ")
    return DECLARED_AS.get(kind, f"declared {kind}"), target


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)
