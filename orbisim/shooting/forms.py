"""When controls change between samples, and other forms of the same data along a scene."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from orbisim.effects import find
from orbisim.motion.linear import IntervalMap, linearize
from orbisim.recording.command_clock import Lead, common_period
from orbisim.scene import Scene
from orbisim.shooting.bench import Bench
from orbisim.shooting.cutting import wrongly_lost
from orbisim.shooting.impacts import foreseen
from orbisim.shooting.judge import Judged
from orbisim.shooting.timestep import typical_interval


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
    every = [one.command_periods for one in bench.samples if one.command_periods is not None]
    if bench.lead is None or bench.lead or not every:
        return None
    periods = [common_period(one, every) for one in every]
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
    """With derivatives along its scene."""
    flow = IntervalMap(bench.scene, bench.samples, bench.rows, deadline=bench.deadline)
    return dataclasses.replace(bench, intervals=linearize(flow))


def foreseen_anew(bench: Bench) -> Bench:
    """With what impacts leave unknown of its windows as its scene is stepped now, and with how far
    these can be predicted; itself where nothing touches."""
    if bench.windows.scatter is None:
        return bench
    whole = dataclasses.replace(bench.windows, horizon=None, scatter=None)
    every = np.ones(len(whole), bool)
    shooter = dataclasses.replace(bench, windows=whole).shooter(every)
    windows = foreseen(shooter, bench.intervals, whole, bench.noise)
    return dataclasses.replace(bench, windows=wrongly_lost(shooter, windows, bench.noise))


def untimed(bench: Bench, judged: Judged) -> Iterator[tuple[Judged, Sequence[float]]]:
    """Without the effects that change when things are seen or done, if there are some, and the
    share that their mean delay makes. All else is as it is: fitted without them, before commands
    have moved, others would go where they do that."""
    every = judged.hypothesis.effects
    delays = [one.values["delay"] for one in every if find(one.effect).timing]
    if delays:
        kept = tuple(one for one in every if not find(one.effect).timing)
        fewer = dataclasses.replace(judged.hypothesis, effects=kept, frozen=frozenset())
        share = -float(np.mean(delays)) / typical_interval(bench)
        yield dataclasses.replace(judged, hypothesis=fewer), [share]
