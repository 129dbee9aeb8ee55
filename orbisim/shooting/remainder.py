"""Whether what free runs leave is noise of sensors and drives: what needs no name."""

from __future__ import annotations

import numpy as np

from orbisim.evidence import NEAR, gain_of
from orbisim.host.deadline import TimeIsUpError
from orbisim.motion.linear import linearize
from orbisim.recording.joints import joints
from orbisim.shooting.bench import Bench
from orbisim.shooting.disturbances import Remainder, remainder, stretches
from orbisim.shooting.judge import Judged, is_structural
from orbisim.shooting.timestep import typical_interval


def left_of(bench: Bench, judged: Judged) -> Remainder | None:
    """What an explanation leaves, as noise; None where that is not known: bodies touch, joints are
    added, the white noise of sensors is all or all in most windows, or what is left is much more
    in some windows than in most (noise is in all of them alike, an event is not), recordings are
    short, or the bench's time is up."""
    hypothesis = judged.hypothesis
    if judged.ratio <= NEAR or bench.contacts or is_structural(hypothesis):
        return None
    typical = float(np.median(np.concatenate([judged.fitted, judged.checked])))
    if typical <= NEAR**2 or judged.pooled**2 > NEAR**2 * typical:
        return None
    try:
        intervals = linearize(bench.flow(hypothesis))
        known = bench.known_signal(hypothesis)
        data = stretches(bench.samples, intervals, bench.noise, known)
        return None if data is None else remainder(data, bench.deadline)
    except TimeIsUpError:
        return None


def bare_is_noise(
    bench: Bench, bare: Judged, after: Judged, left: Remainder | None, prior: float
) -> Remainder | None:
    """What the bare scene leaves, where that is noise alone, as is what effects leave, and with
    these the data are not surely likelier; else None. Free runs count what they miss as white
    noise: of noise that lasts, an effect takes up a little.

    Args:
      bare, after: without and with effects. left: what the latter leaves. prior: logarithm of the
        effects' prior odds, less what their numbers cost.
    """
    if not after.hypothesis.effects or left is None or left.structured:
        return None
    found = left_of(bench, bare)
    if found is None or found.structured:
        return None
    return None if gain_of(left.noise.score - found.noise.score, prior).sure > 0 else found


def told_as_noise(bench: Bench, judged: Judged, left: Remainder | None) -> str | None:
    """A note on what is left, if it is noise."""
    if left is None or left.structured:
        return None
    names = [""] * bench.scene.model.nv
    for joint in joints(bench.scene.model):
        for number in range(joint.v.start, joint.v.stop):
            names[number] = joint.label
    return (
        f"what is left of free runs, {judged.ratio:.3g} times the white noise of sensors, shows "
        f"no force of a slow course: it is noise ({left.said(names, typical_interval(bench))})"
    )
