"""When controls change between samples, and other forms of the same data along a scene."""

from __future__ import annotations

import dataclasses

import numpy as np

from orbisim.motion.linear import IntervalMap, linearize
from orbisim.recording.command_clock import Lead
from orbisim.scene import Scene
from orbisim.shooting.bench import Bench
from orbisim.shooting.cutting import wrongly_lost
from orbisim.shooting.impacts import foreseen


def asked(bench: Bench) -> Bench:
    """The same, with the question whether controls change between samples; itself where they
    change seldom: when a step comes, a window says better than a mean does."""
    for one in bench.samples:
        values = np.concatenate([one.ctrl, one.force], axis=1)
        changes = np.any(np.diff(values, axis=0) != 0, axis=1)
        if changes.mean() > _OFTEN:
            return dataclasses.replace(bench, lead=Lead())
    return bench


_OFTEN = 0.1
"""Share of the samples at which a control has changed: commands at 10 Hz in a log of 100 Hz."""


def command_clock(bench: Bench) -> Lead | None:
    """The clock that logs show of when controls change, if that is not asked already, and they do.
    When a command acts is not when it is logged. Logs of one machine have one period, and most
    follow it; in the others commands change seldom."""
    periods = [one.command_period for one in bench.samples if one.command_period is not None]
    if bench.lead is None or bench.lead or not periods:
        return None
    # as many follow an alias (rates of it and of the clock add up to the log's), with more ticks
    # at which nothing changes: so the longest
    most, period = max((sum(o.clocked(one) for o in bench.samples), one) for one in periods)
    return Lead(clock=True, period=period) if 2 * most > len(bench.samples) else None


def leading(bench: Bench, lead: Lead) -> Bench:
    """The same data with controls that lead their samples."""
    return linearized(bench.led(lead))


def in_scene(bench: Bench, scene: Scene) -> Bench:
    """The same data, along another form of the declared scene."""
    return bench if scene is bench.scene else linearized(dataclasses.replace(bench, scene=scene))


def read_as(bench: Bench, like: Bench) -> Bench:
    """Other data, in the form of a bench: its scene, and how it reads controls."""
    if like.lead and bench.lead != like.lead:
        return leading(dataclasses.replace(bench, scene=like.scene), like.lead)
    return in_scene(bench, like.scene)


def linearized(bench: Bench) -> Bench:
    """With derivatives along its scene, and what impacts leave unknown of its steps."""
    flow = IntervalMap(bench.scene, bench.samples, bench.rows, deadline=bench.deadline)
    there = dataclasses.replace(bench, intervals=linearize(flow))
    if bench.windows.scatter is None:
        return there
    shooter = there.shooter(np.ones(len(bench.windows), bool))
    windows = foreseen(shooter, there.intervals, bench.windows, bench.noise)
    return dataclasses.replace(there, windows=wrongly_lost(shooter, windows, bench.noise))
