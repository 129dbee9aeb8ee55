"""Trials with their truth and what was said about them."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

from processes import read_lines

from blind import matching
from orbisim import load_scene


@dataclasses.dataclass(frozen=True, eq=False)
class Outcome:
    """A trial with its truth and what was reported.

    Attributes:
      trial, kind, scene: of the trial. noise, velocities, wrong: its conditions.
      truths: injected effects; `outside` is the kind of one that is not in the catalogue.
      found: reported effects. verdict, failure: of the tool. seconds: it took.
      before, after: held-out free-running error that the tool reports; with nothing named if it did
        not finish. declared, true: of the declared scene, and of that with the injected effects.
      peer: of the scene that the peer has fitted; NaN if it was not run or did not finish.
      peer_fits: number of its parameters. peer_verdict: how it ended; empty if it was not run.
      equal: whether an identity makes the first effect right.
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
    declared: float
    true: float
    peer: float
    peer_fits: int
    peer_verdict: str
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

    @property
    def over_true(self) -> float:
        """Held-out error after the diagnosis over that of the true scene; NaN if not known."""
        return self.after / self.true if self.true > 0 else float("nan")


def outcomes_of(trials: Path, results: Path) -> list[Outcome]:
    """All trials that the diagnosis has a result of, in order."""
    entries: dict[str, dict[str, dict[str, Any]]] = {}
    for entry in read_lines(results):
        entries.setdefault(entry["trial"], {})[entry["tool"]] = entry
    return [
        _outcome(trials, name, by_tool["diagnose"], by_tool.get("peer"))
        for name, by_tool in sorted(entries.items())
        if "diagnose" in by_tool
    ]


def _outcome(
    trials: Path, name: str, entry: dict[str, Any], rival: dict[str, Any] | None
) -> Outcome:
    truth = json.loads((trials / "truth" / f"{name}.json").read_text())
    report, peer = entry["report"] or {}, (rival or {}).get("report") or {}
    error = report.get("error", {}).get("held_out", {})
    known = truth["held_out_error"]
    found, truths = tuple(report.get("effects", ())), tuple(truth["effects"])
    single = bool(found) and truth["wish"]["kind"] == "single"
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
        before=_number(error.get("before", known["declared"])),
        after=_number(error.get("after", known["declared"])),
        declared=_number(known["declared"]),
        true=_number(known["true"]),
        peer=_number(peer.get("error", {}).get("held_out", {}).get("after")),
        peer_fits=len(peer.get("values", ())),
        peer_verdict=peer.get("verdict", "failed") if rival else "",
        equal=single and matching.equivalent(found[0], truths[0], _model(trials / "trials" / name)),
        shifts=tuple(truth["shift_over_noise"]),
        alternatives=tuple(report.get("alternatives", ())),
    )


def _number(value: Any) -> float:
    return float("nan") if value is None else float(value)


def _model(folder: Path) -> Any:
    return load_scene(folder / "scene.xml", trusted=True).model
