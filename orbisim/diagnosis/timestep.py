"""The integration step as part of what is compared.

A machine has no timestep; a scene's is a choice of who declared it. One that is too long bends free
runs as a fast clock, a damping or a late sensor would, and these would be named for it. So half
the step is a move like any other: it takes no parameter, and the odds that a declared step is too
long are those of an effect. As long as an effect is missing, a finer step may stand in for a little
of it: it is made if no effect does more, and unmade where a coarser one is worth no less. Where
bodies touch it is not tried: a contact depends on the step by its definition.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from orbisim.diagnosis.context import Context
from orbisim.diagnosis.worth import worth
from orbisim.evidence import EFFECT
from orbisim.motion.linear import IntervalMap, linearize
from orbisim.motion.samples import substeps
from orbisim.scene import Scene
from orbisim.shooting.bench import Bench
from orbisim.shooting.judge import Judged


def finer(context: Context, judged: Judged) -> tuple[Context, Judged] | None:
    """The same explanation with half the step, as often as that surely predicts better; None if it
    does not."""
    found = None
    while not context.bench.contacts:
        other = _again(context, judged, taken(context.bench) / 2)
        if other is None or not worth(context.bench, judged, other[1]).sure + EFFECT > 0:
            break
        found = context, judged = other
    return found


def coarser(context: Context, judged: Judged, declared: float) -> tuple[Context, Judged] | None:
    """The same explanation with twice the step, as often as that is worth no less and the step no
    longer than declared; None if it does not.

    Args:
      declared: the timestep of the scene as it was given, s.
    """
    found = None
    while 2 * taken(context.bench) <= _SLACK * taken(context.bench, declared):
        other = _again(context, judged, 2 * taken(context.bench))
        if other is None or not worth(context.bench, judged, other[1]).total - EFFECT > 0:
            break
        found = context, judged = other
    return found


def _again(context: Context, judged: Judged, timestep: float) -> tuple[Context, Judged] | None:
    """An explanation, fitted again with another step."""
    context.say(f"trying a timestep of {timestep:.3g} s")
    bench = context.bench
    other = context.on(along(bench, with_timestep(bench.scene, timestep)))
    again = other.judge.judge(judged.hypothesis, begin=other.judge.begin(judged))
    return None if again is None else (other, again)


_SLACK = 1.01
"""Of rounding, in a comparison of steps."""


def taken(bench: Bench, timestep: float | None = None) -> float:
    """The step that a timestep means (the scene's if None), s: a typical sampling interval has a
    whole number of them."""
    timestep = float(bench.scene.model.opt.timestep) if timestep is None else timestep
    interval = float(np.median(np.concatenate([np.diff(one.time) for one in bench.samples])))
    return interval / int(substeps(interval, timestep))


def along(bench: Bench, scene: Scene) -> Bench:
    """The same data, along another form of the declared scene."""
    if scene is bench.scene:
        return bench
    flow = IntervalMap(scene, bench.samples, bench.rows, deadline=bench.deadline)
    return dataclasses.replace(bench, scene=scene, intervals=linearize(flow))


def with_timestep(scene: Scene, timestep: float) -> Scene:
    """The scene with another timestep, s."""
    spec = scene.spec
    spec.option.timestep = timestep
    return Scene.from_spec(spec, source=scene.source, unsupported=scene.unsupported)
