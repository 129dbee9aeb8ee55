"""What a scene and a recording leave open between samples, as part of what is compared.

A machine has no timestep; a scene's is a choice of who declared it. One that is too long bends free
runs as a fast clock, a damping or a late sensor would. And a log says what a control was when the
samples were taken, not when it changed: a controller that runs at a slower rate, or beside the
logger, changes it somewhere between two samples, half an interval before the log shows it on
average, and a delay less than nothing would be named for that.

So half the step, and controls that are the mean of two samples between these, are moves like any
other: they take no parameter, and their odds are those of an effect. As long as an effect is
missing, they may stand in for a little of it: they are made if no effect does more, and unmade
where the scene or the log as it was is worth no less. Where bodies touch the step is not tried: a
contact depends on it by its definition.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from orbisim.diagnosis.context import Context
from orbisim.diagnosis.worth import worth
from orbisim.evidence import EFFECT
from orbisim.motion.linear import IntervalMap, linearize
from orbisim.motion.samples import substeps
from orbisim.scene import Scene
from orbisim.shooting.bench import Bench
from orbisim.shooting.judge import Judged

Other = tuple[Context, Judged]


def other(context: Context, judged: Judged) -> Other | None:
    """The same explanation with half the step, or controls that change between samples, or both,
    as often as that surely predicts better; None if it does not."""
    found = None
    while True:
        tried = [_again(context, judged, change) for change in (_halved, _midway)]
        known = [(worth(context.bench, judged, one[1]).sure, one) for one in tried if one]
        best = max(known, key=lambda one: one[0], default=None)
        if best is None or not best[0] + EFFECT > 0:
            return found
        found = context, judged = best[1]


def as_declared(context: Context, judged: Judged, declared: float) -> Other | None:
    """The same explanation with controls as they were logged, or twice the step, as often as that
    is worth no less and the step no longer than declared; None if it does not.

    Args:
      declared: the timestep of the scene as it was given, s.
    """

    def doubled(bench: Bench) -> Bench | None:
        if bench.contacts or 2 * taken(bench) > _SLACK * taken(bench, declared):
            return None
        return along(bench, with_timestep(bench.scene, 2 * taken(bench)))

    found = None
    for change in (_logged, doubled):
        while (one := _again(context, judged, change)) is not None:
            if not worth(context.bench, judged, one[1]).total - EFFECT > 0:
                break
            found = context, judged = one
    return found


def _again(
    context: Context, judged: Judged, change: Callable[[Bench], Bench | None]
) -> Other | None:
    """An explanation, fitted again with another form of the data; None where there is none."""
    bench = change(context.bench)
    if bench is None:
        return None
    there = context.on(bench)
    again = there.judge.judge(judged.hypothesis, begin=there.judge.begin(judged))
    return None if again is None else (there, again)


def _halved(bench: Bench) -> Bench | None:
    if bench.contacts:
        return None
    return along(bench, with_timestep(bench.scene, taken(bench) / 2))


def _midway(bench: Bench) -> Bench | None:
    if bench.midway is not False:
        return None
    return _read(dataclasses.replace(bench, midway=True))


def _logged(bench: Bench) -> Bench | None:
    if not bench.midway:
        return None
    return _read(dataclasses.replace(bench, midway=False))


def _read(bench: Bench) -> Bench:
    """With controls and forces as the bench says that they are read."""
    samples = tuple(one.as_logged() for one in bench.samples)
    samples = tuple(one.midway() for one in samples) if bench.midway else samples
    return _linearized(dataclasses.replace(bench, samples=samples))


def asked(bench: Bench) -> Bench:
    """The same, with the question whether controls change between samples; itself where they
    change seldom: when a step comes, a window says better than a mean does."""
    for one in bench.samples:
        values = np.concatenate([one.ctrl, one.force], axis=1)
        changes = np.any(np.diff(values, axis=0) != 0, axis=1)
        if changes.mean() > _OFTEN:
            return dataclasses.replace(bench, midway=False)
    return bench


_SLACK = 1.01
"""Of rounding, in a comparison of steps."""
_OFTEN = 0.1
"""Share of the samples at which a control has changed: commands at 10 Hz in a log of 100 Hz."""


def taken(bench: Bench, timestep: float | None = None) -> float:
    """The step that a timestep means (the scene's if None), s: a typical sampling interval has a
    whole number of them."""
    timestep = float(bench.scene.model.opt.timestep) if timestep is None else timestep
    interval = float(np.median(np.concatenate([np.diff(one.time) for one in bench.samples])))
    return interval / int(substeps(interval, timestep))


def along(bench: Bench, scene: Scene) -> Bench:
    """The same data, along another form of the declared scene."""
    return bench if scene is bench.scene else _linearized(dataclasses.replace(bench, scene=scene))


def read_as(bench: Bench, like: Bench) -> Bench:
    """Other data, in the form of a bench: its scene, and how it reads controls."""
    if like.midway and not bench.midway:
        bench = dataclasses.replace(
            bench, midway=True, samples=tuple(one.midway() for one in bench.samples)
        )
        return _linearized(dataclasses.replace(bench, scene=like.scene))
    return along(bench, like.scene)


def _linearized(bench: Bench) -> Bench:
    flow = IntervalMap(bench.scene, bench.samples, bench.rows, deadline=bench.deadline)
    return dataclasses.replace(bench, intervals=linearize(flow))


def with_timestep(scene: Scene, timestep: float) -> Scene:
    """The scene with another timestep, s."""
    spec = scene.spec
    spec.option.timestep = timestep
    return Scene.from_spec(spec, source=scene.source, unsupported=scene.unsupported)
