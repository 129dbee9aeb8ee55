"""`orbisim.diagnose`: from a scene and recordings to the effects that the scene lacks."""

from __future__ import annotations

import contextlib
import dataclasses
import operator
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

from orbisim.backend import Backend
from orbisim.diagnosis.alternatives import alternatives_of, candidates_of
from orbisim.diagnosis.both import Runs, by_runs, worth_in_both
from orbisim.diagnosis.checks import between_samples, disabled, doubts, restepped
from orbisim.diagnosis.combinations import combined_in_runs
from orbisim.diagnosis.conclusion import Attribution, attribute
from orbisim.diagnosis.findings import (
    effects_of,
    errors_of,
    free_run_error,
    honest,
    noise_of,
    residual_of,
    retuned_of,
    sensor_noise_of,
    verdict_of,
    verdict_with_sensors,
    with_sensors,
)
from orbisim.diagnosis.force_result import diagnose_forces
from orbisim.diagnosis.force_search import ForceAttribution
from orbisim.diagnosis.rest import learn_rest as learn
from orbisim.diagnosis.result import Diagnosis
from orbisim.diagnosis.scoring import score
from orbisim.diagnosis.sensor_faults import sensor_faults
from orbisim.diagnosis.settings import Settings
from orbisim.diagnosis.worth import independent_data
from orbisim.effects import add_effects, find
from orbisim.errors import InputError
from orbisim.evidence import NEAR, SURE
from orbisim.host.deadline import Deadline
from orbisim.host.engine_log import engine_warnings, ignore
from orbisim.host.progress import status
from orbisim.motion.samples import forces_known, prepare_all
from orbisim.recording import Recording
from orbisim.recording.derived import independent
from orbisim.recording.gaps import bridged
from orbisim.recording.split import bounded, some_of, split
from orbisim.recording.stamps import regular
from orbisim.recording.suspicious import refuse, within_range
from orbisim.recording.thinning import held_led, thinned
from orbisim.scene import Scene, load_scene
from orbisim.sensing.faults import Sensed
from orbisim.shooting.bench import Bench, Noise, make_bench
from orbisim.shooting.cutting import touches, windows_enough
from orbisim.shooting.forms import asked, read_as
from orbisim.shooting.history import history_dependent
from orbisim.shooting.horizon import telling_window
from orbisim.shooting.stepping import Stepping, stepping, with_stepping, within_samples

Source = Recording | str | Path

__all__ = ["diagnose"]


def diagnose(
    scene: str | Path | Scene,
    recordings: Source | Sequence[Source],
    held_out: Source | Sequence[Source] | None = None,
    *,
    window: float | None = None,
    residual: Literal["motion", "force"] | None = None,
    backend: str | Backend = "mujoco",
    settings: Settings | None = None,
    learn_rest: bool = False,
    out: str | Path | None = None,
    progress: bool = True,
) -> Diagnosis:
    """Finds the residual, traces it to effects, adds them, and reports the error before and after.

    Args:
      scene: a path or task name, or a scene: the system as declared.
      recordings: measurements to learn from.
      held_out: measurements that no choice and no fit may see; kept back from `recordings` if None.
      window: duration of the windows of free-running simulation, s. If None, 0.5 s or, where that
        has fewer than 30 samples, as long as 60 samples take; longer where forces do not yet
        outweigh what sensors do (`orbisim.shooting.horizon`).
      residual: what is explained: `motion`, the error of free runs over windows; or `force`, the
        generalized force that is missing along the measured motion by inverse dynamics. If None,
        the motion. Where all forces are known (torques, or controls of actuators without dynamics)
        and nothing touches, the forces in its place if what they show is surely worth more by free
        runs and forces together; and, of three joints or more, if they show as many effects as
        joints: free runs of such a machine drift off at once.
      backend: what the free-running errors are computed with; the search simulates with C MuJoCo.
      settings: of the search.
      learn_rest: where no effect explains the residual, or not all of it, whether to fit a neural
        residual force to what is left. It is never counted as an effect (`Diagnosis.rest`).
      out: folder for report.json, report.html and augmented/scene.xml.
      progress: whether to show what is going on on standard error.

    Raises:
      RecordingError: a recording cannot be read, does not fit the scene, or is clearly wrong.
      SceneError: the scene cannot be read or edited.
      InputError: the recordings are too short, or an option is out of range.
      MissingDependencyError: `learn_rest` without torch.
    """
    if window is not None and not window > 0:
        raise InputError(f"window is a duration in s, greater than 0; got {window}")
    if residual not in ("motion", "force", None):
        raise InputError(f"residual is 'motion' or 'force'; got {residual!r}")
    if residual == "force" and learn_rest:
        raise InputError("learn_rest goes with residual='motion': it is fitted to free runs")
    loaded = scene if isinstance(scene, Scene) else load_scene(scene)
    named = loaded.source if isinstance(scene, Scene) else str(scene)
    loaded.spec  # noqa: B018 (raises if the scene cannot be edited)
    notes: list[str] = []
    given, kept = _loaded(recordings), None if held_out is None else _loaded(held_out)
    for repaired in (regular, independent):  # a grid of stamps, no velocities made of positions
        given, others = repaired(given, kept or ())
        kept = None if kept is None else others
    given = [within_range(one) for one in given]
    kept = None if kept is None else [within_range(one) for one in kept]
    for one in (*given, *(kept or ())):
        notes += refuse(one, loaded)
    fit, held = _sets(given, kept)
    settings, start = settings or Settings(), time.monotonic()
    with (
        engine_warnings(ignore),  # about suspects that make the scene unstable: they just lose
        status("diagnosing") if progress else contextlib.nullcontext(lambda _: None) as say,
    ):
        say("reading the recordings")
        engine = backend if isinstance(backend, str) else backend.name
        either = residual is None and not learn_rest

        def by_forces(share: float) -> Diagnosis:
            own, limit = list(notes), Deadline(start + share * settings.patience)
            both = bounded(fit, own), bounded(held, own)
            return diagnose_forces(loaded, named, *both, settings, engine, own, say, limit)

        if residual == "force":
            result = by_forces(_SEARCH)
        else:
            forces = by_forces(_FORCES) if either and _arm(loaded, fit) else None
            chosen = telling_window(loaded, fit) if window is None else window
            result = _by_motion(
                loaded, named, fit, held, settings, chosen, backend, learn_rest, notes, say, start,
                forces,
            )  # fmt: skip
            if either and _leaves_something(result):
                if forces is None and time.monotonic() < start + _FITS * settings.patience:
                    forces = by_forces(_FITS)
                say("weighing what forces show against what free runs show")
                result = _weighed(result, forces)
        result = dataclasses.replace(result, settings=settings)
        if out is not None:
            say("writing the report")
            result.save(out)
    return result


def _by_motion(
    scene: Scene,
    named: str,
    fit: list[Recording],
    held: list[Recording],
    settings: Settings,
    window: float,
    backend: str | Backend,
    rest: bool,
    notes: list[str],
    say: Callable[[str], None],
    start: float,
    forces: Diagnosis | None,
) -> Diagnosis:
    """Explains the error of free runs over windows, unless what explains the forces settles it."""
    enough = windows_enough(scene, fit, window)
    fit = some_of(fit, window, enough, notes)
    held = some_of(held, window, enough, notes)
    fit, held = bridged(fit, window, notes), bridged(held, window, [])
    fewer = thinned(fit, window, notes)
    bare = within_samples(scene.without_images(), fit, notes)  # compiled thousands of times
    bench = make_bench(bare, prepare_all(bounded(fewer, notes), bare), window)
    if bench.looked_at < 1:
        notes.append(
            "bodies touch, and steps through contacts take long: windows from "
            f"{bench.looked_at:.0%} of the recordings are looked at, spread evenly; what acts in "
            "the rest alone is not seen"
        )
    if forces is not None and _settled(bench, forces):
        return forces
    if all(map(operator.is_, fewer, fit)):  # else samples are close, and controls are means already
        bench = asked(bench)
    notes += disabled(scene)
    limit = Deadline(start + _SEARCH * settings.patience)
    bench = dataclasses.replace(bench, deadline=limit)
    unseen = _held_back(bare, bounded(thinned(held, window, notes), notes), window, bench.noise)
    found = attribute(bench, settings, say, Deadline(start + _FITS * settings.patience))
    if found.cut_short:
        notes.append(f"the search was ended after {settings.patience:g} s; more may be found")
    say("checking on held-out data")
    unseen = read_as(unseen.whole(found.bench.noise), found.bench)
    forms = restepped(bare, found.bench.scene), between_samples(found.bench)
    notes += [*(note for note in forms if note is not None), *doubts(found)]
    sensed = sensor_faults(found, unseen, notes, say)
    result = _result(
        scene, named, found, settings, fit, held, window, backend, notes, sensed, stepping(bare)
    )
    if result.verdict in ("partly_explained", "unexplained"):
        result = dataclasses.replace(result, history=history_dependent(found.bench))
    if rest:
        motion, augmented = verdict_of(found, settings), result.augmented_scene
        learned = learn(
            found, motion, augmented, fit, held, window, backend,
            unseen=unseen, seed=settings.seed, say=say,
        )  # fmt: skip
        result = dataclasses.replace(result, rest=learned)
    return result


_FORCES, _SEARCH, _FITS = 0.35, 0.75, 0.95
"""Shares of the patience until which a search of forces goes on that may be followed by one of the
motion, a search, and the final fits."""


def _leaves_something(motion: Diagnosis) -> bool:
    """Whether more than noise is left of free runs, no law without a name accounts for it, and the
    forces at all joints are known, where nothing touches."""
    found, model = motion.attribution, motion.scene.model
    if not isinstance(found, Attribution) or found.law or found.bench.contacts:
        return False
    left = motion.verdict in ("partly_explained", "unexplained")
    return left and model.nq == model.nv and forces_known(motion.scene, found.samples)


def _weighed(motion: Diagnosis, forces: Diagnosis | None) -> Diagnosis:
    """What explains forces, if there was time to look, in the place of what explains free runs if
    that is surely worth it by both kinds of evidence. Evidence of one kind must not outweigh that
    the other contradicts: what predicts free runs surely worse than the declared scene is no
    answer, and what leaves more than noise of them does not explain everything."""
    if forces is None:
        late = "the time was up before the forces at the joints could be looked at, too"
        return dataclasses.replace(motion, notes=(*motion.notes, late))
    runs, pushed = motion.attribution, forces.attribution
    assert isinstance(runs, Attribution) and isinstance(pushed, ForceAttribution)
    if not pushed.hypothesis.effects:
        return motion
    alone = by_runs(runs.bench, pushed.hypothesis)
    if _contradicted(alone):
        told = "what explains the forces predicts free runs worse than the declared scene does"
        return dataclasses.replace(motion, notes=tuple(dict.fromkeys([*motion.notes, told])))
    worth = worth_in_both(runs.bench, pushed.data, runs.hypothesis, pushed.hypothesis)
    told = (
        f"by free runs and by forces together, what explains the forces is worth {worth.total:.3g} "
        f"+- {worth.error:.2g} more in the logarithm of the odds than what explains free runs"
    )
    better = motion
    if worth.sure > 0:
        whole = forces.verdict != "explained" or alone.left <= NEAR
        better = forces if whole else dataclasses.replace(forces, verdict="partly_explained")
        if better.verdict != "explained":
            better = dataclasses.replace(better, history=motion.history)
    return dataclasses.replace(better, notes=tuple(dict.fromkeys([*better.notes, told])))


def _settled(bench: Bench, forces: Diagnosis) -> bool:
    """Whether what explains forces is the answer at once: many effects, to find which one by one
    takes long, that free runs do not contradict. Where forces reach their noise, which is large,
    free runs may still say more."""
    many = len(forces.effects) >= forces.scene.model.nv and forces.verdict != "explained"
    return many and not _contradicted(by_runs(bench, forces.attribution.hypothesis))


def _contradicted(runs: Runs) -> bool:
    """Whether an explanation predicts free runs surely worse than the declared scene does."""
    return runs.gain.mean + SURE * runs.gain.error < 0


def _arm(scene: Scene, recordings: Sequence[Recording]) -> bool:
    """Whether the forces at all of several joints are known, and nothing touches."""
    if scene.model.nv < _ARM or scene.model.nq != scene.model.nv:
        return False
    samples = prepare_all([recordings[0]], scene)
    return forces_known(scene, samples) and not touches(scene, samples)


_ARM = 3
"""Joints from which on forces are looked at first: what they show is known at once, where to
simulate many effects one by one takes long."""


def _sets(
    given: list[Recording], kept: list[Recording] | None
) -> tuple[list[Recording], list[Recording]]:
    if not given:
        raise InputError("diagnose needs at least one recording")
    if kept is None:
        return split(given)
    if not kept:
        raise InputError("held_out is empty; leave it out to have some data kept back")
    return given, kept


def _loaded(recordings: Any) -> list[Recording]:
    every = [recordings] if isinstance(recordings, (Recording, str, Path)) else list(recordings)
    return [one if isinstance(one, Recording) else Recording.load(one) for one in every]


def _held_back(scene: Scene, held: Sequence[Recording], window: float, noise: Noise) -> Bench:
    """The held-out data, looked at before a long search: it may be too short to judge by."""
    try:
        return make_bench(scene, prepare_all(held, scene), window, noise=noise)
    except InputError as error:
        raise InputError(f"held-out data ({', '.join(o.source for o in held)}): {error}") from None


def _result(
    scene: Scene,
    named: str,
    found: Attribution,
    settings: Settings,
    fit: list[Recording],
    held: list[Recording],
    window: float,
    backend: str | Backend,
    notes: list[str],
    sensed: Sensed,
    begun: Stepping,
) -> Diagnosis:
    hypothesis, taken = found.after.hypothesis, stepping(found.bench.scene)
    changed = bool(hypothesis.effects or hypothesis.factors or found.bench.lead) or taken != begun
    stepped = with_stepping(scene, taken) if changed and taken != stepping(scene) else scene
    augmented = hypothesis.scene(stepped)
    measuring = [*(e for e in hypothesis.effects if find(e.effect).measurement), *sensed.instances]
    if measuring:
        augmented = add_effects(augmented, measuring)
    data = {"fit": fit, "held_out": held}
    before = {part: score(scene, own, window, (), backend) for part, own in data.items()}
    if lead := found.bench.lead:
        data = {part: held_led(own, lead) for part, own in data.items()}
    after, effects = before, hypothesis.effects
    if changed:
        after = {part: score(augmented, data[part], window, effects, backend) for part in data}
    error = errors_of(before, after, found.bench, window)
    verdict = honest(verdict_with_sensors(verdict_of(found, settings), sensed), error, notes)
    return Diagnosis(
        scene=scene,
        source=named,
        backend=backend if isinstance(backend, str) else backend.name,
        fit=tuple(data["fit"]),
        held_out=tuple(data["held_out"]),
        noise={**noise_of(scene, found.bench.noise), **sensor_noise_of(sensed)},
        residual=with_sensors(residual_of(found, settings), sensed),
        verdict=verdict,
        effects=(
            *effects_of(
                scene,
                hypothesis,
                found.after.fit,
                found.evidence,
                free_run_error(stepped, data["held_out"], window, backend),
                settings.seed,
                independent_data(found.after),
            ),
            *sensed.effects,
        ),
        sensors=sensed,
        alternatives=alternatives_of(found),
        candidates=candidates_of(found),
        retuned=retuned_of(scene, found),
        error=error,
        augmented_scene=augmented,
        notes=tuple(dict.fromkeys([*notes, *before["fit"].notes, *before["held_out"].notes])),
        attribution=found,
        combinations=combined_in_runs(found, settings),
    )
