"""One tool on one measured set: fits, scores on held-out recordings, says what it found."""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from blind.peer import fitted_scene
from rigs.peers import plain_recipe

import orbisim
from closing.metrics import Scored
from closing.plans import Plan
from closing.plots import draw
from orbisim.diagnosis import Settings
from orbisim.effects import EffectInstance
from orbisim.recording import Recording
from orbisim.scene import Scene, load_scene

TOOLS = ("diagnosed", "recipe", "sysid", "declared", "published")
"""The search; least squares of Coulomb and viscous friction, armature and an offset at every joint;
`mujoco.sysid` with four parameters a joint, begun at the declared values; the scene as declared;
the scene with the effects of the set's publication."""

_TOLD = ("verdict", "sentence", "effects", "retuned", "alternatives", "residual", "error")


@dataclasses.dataclass(frozen=True, eq=False)
class Sets:
    """Recordings of a set, for fitting and held out."""

    fit: Sequence[Recording]
    held: Sequence[Recording]


def tools_of(plan: Plan) -> tuple[str, ...]:
    """Those that there are for a set."""
    return tuple(one for one in TOOLS if one != "published" or plan.published)


def recordings_of(plan: Plan, out: Path) -> Sets:
    """What tools/import_measured.py has written below OUT, as the plan takes it."""
    folder = out / "recordings" / plan.name
    split = json.loads((folder / "split.json").read_text())

    def load(names: Sequence[str]) -> list[Recording]:
        return [plan.recording(Recording.load(folder / n)).replace(source=n) for n in names]

    return Sets(load(split["fit"]), load([n for n in split["held_out"] if n.startswith(plan.only)]))


def result_of(plan: Plan, tool: str, out: Path, patience: float) -> dict[str, Any]:
    """What a tool makes of a set: its error on the held-out recordings, seconds, and its words.

    A diagnosis whose report is there already is scored only.
    """
    sets, started = recordings_of(plan, out), time.perf_counter()
    told: dict[str, Any] = {}
    effects: Sequence[EffectInstance] = ()
    if tool == "diagnosed":
        scene, effects, told = _diagnosed(plan, sets, out / "diagnoses" / plan.name, patience)
    elif tool == "recipe":
        scene, found = plain_recipe(plan.scene(), sets.fit)
        told = {"numbers": found}
    elif tool == "sysid":
        scene, values, verdict = fitted_scene(plan.scene(), sets.fit, patience, declared_start=True)
        told = {"numbers": values, "verdict": verdict}
    else:
        scene = plan.scene("scene" if tool == "declared" else tool)
    seconds = time.perf_counter() - started
    scored = plan.metric.measure(scene, sets.held, effects)
    figures = {name: plan.metric.factor * value for name, value in scored.figures.items()}
    return {"seconds": round(seconds, 1), "recordings": [len(sets.fit), len(sets.held)],
            "held_out": figures, **told}  # fmt: skip


def picture(plan: Plan, out: Path, images: Path) -> None:
    """Draws a set that has been diagnosed."""
    sets, found = recordings_of(plan, out), out / "diagnoses" / plan.name
    scored: dict[str, Scored] = {"declared": plan.metric.measure(plan.scene(), sets.held, ())}
    scene, effects, _ = _read(found)
    scored["diagnosed"] = plan.metric.measure(scene, sets.held, effects)
    if plan.published:
        scored["published"] = plan.metric.measure(plan.scene("published"), sets.held, ())
    draw(plan.name, plan.metric, scored, images / f"{plan.name}.png")


def _diagnosed(
    plan: Plan, sets: Sets, found: Path, patience: float
) -> tuple[Scene, Sequence[EffectInstance], dict[str, Any]]:
    """As the command does with its defaults."""
    if not (found / "seconds.json").exists():
        start = time.perf_counter()
        settings = Settings(patience=patience)
        orbisim.diagnose(plan.scene(), sets.fit, sets.held, settings=settings, out=found)
        seconds = time.perf_counter() - start
        (found / "seconds.json").write_text(json.dumps(round(seconds, 1)))
    return _read(found)


def _read(found: Path) -> tuple[Scene, Sequence[EffectInstance], dict[str, Any]]:
    report = json.loads((found / "report.json").read_text())
    told = {key: report[key] for key in _TOLD} | {"notes": report["notes"][:8]}
    told["search_seconds"] = json.loads((found / "seconds.json").read_text())
    return (
        load_scene(found / "augmented" / "scene.xml"),
        [_instance(one) for one in report["effects"]],
        told,
    )


def _instance(found: dict[str, Any]) -> EffectInstance:
    values = {name: one["value"] for name, one in found["parameters"].items()}
    return EffectInstance(found["effect"], found["target"], values, found["options"])
