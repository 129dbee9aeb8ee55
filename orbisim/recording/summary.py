"""What a log holds and what looks odd in it: `orbisim recording info`."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.errors import InputError, RecordingError
from orbisim.recording import clocks, degrees
from orbisim.recording.binding import bind
from orbisim.recording.clocks import Clock
from orbisim.recording.conversion import contents_of
from orbisim.recording.formats import labels
from orbisim.recording.formats.log import Array, Column, Log
from orbisim.recording.mapping import SignalMap
from orbisim.recording.matching import matches
from orbisim.recording.noise import lattice_step, noise_std
from orbisim.recording.recording import Recording
from orbisim.scene import Scene

Floats = npt.NDArray[np.float64]

SCHEMA = "orbisim.recording.info/1"
_GAP = 2.5
"""Times the median interval from which on an interval counts as a gap: one sample or more lost."""
_COARSE = 20
"""Steps of a quantised signal, below which it is worth a word."""
_STALE = 0.3
"""Share of samples that repeat the one before, from which on a signal was sampled more slowly."""


@dataclasses.dataclass(frozen=True)
class ClockFacts:
    """The times of a group of columns.

    Attributes:
      group: its name. column: that holds the times, None if the format has clocks of its own.
      samples, duration_s, rate_hz: how many, how long, from the median interval.
      gaps, longest_s: intervals of more than 2.5 times the median; the longest interval.
    """

    group: str
    column: str | None
    samples: int
    duration_s: float
    rate_hz: float
    gaps: int
    longest_s: float


@dataclasses.dataclass(frozen=True)
class ColumnFacts:
    """A column, or a signal of a recording.

    Attributes:
      name: its name. unit: as stated, None if it is not.
      signal: of the scene that it is, or may be ("qpos/yaw?"); None if there is no scene.
      shape: of its samples. lowest, highest, noise, step: in its unit; the standard deviation of
        the noise, and the step of a quantised signal (0 if it is not).
      missing: share of the samples.
    """

    name: str
    unit: str | None
    signal: str | None
    shape: tuple[int, ...]
    lowest: float
    highest: float
    noise: float
    step: float
    missing: float


@dataclasses.dataclass(frozen=True)
class Summary:
    """What `summarize` found. unreadable: columns that hold no numbers."""

    source: str
    clocks: tuple[ClockFacts, ...]
    columns: tuple[ColumnFacts, ...]
    unreadable: tuple[str, ...]
    suspicions: tuple[str, ...]
    notes: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """As JSON values."""
        return {"schema": SCHEMA, **dataclasses.asdict(self)}


def summarize(log: Log, scene: Scene | None = None, mapping: SignalMap | None = None) -> Summary:
    """What a log holds.

    Args:
      log: the log. scene: what its columns may belong to. mapping: says so; then the facts are
        those of the signals in SI.

    Raises:
      RecordingError: the map does not fit the log.
    """
    if mapping is not None:
        return _of_recording(log, scene, mapping)
    model = None if scene is None else scene.model
    facts, columns, unreadable, odd = (
        list[ClockFacts](),
        list[ColumnFacts](),
        list[str](),
        list[str](),
    )
    likely = _likely(log, model)
    for group in dict.fromkeys(column.group for column in log.columns):
        mine = [column for column in log.columns if column.group == group]
        arrays = _readable(log, [column.name for column in mine])
        unreadable += [column.name for column in mine if column.name not in arrays]
        clock, time = _time(log, group, arrays, odd)
        if time is not None and group not in [fact.group for fact in facts]:
            facts.append(_clock_facts(group, clock, time))
            odd += _odd_times(time, clock)
        for column in mine:
            if column.name in arrays and (clock is None or clock.column is not column):
                fact = _facts(column, arrays[column.name], time, likely.get(column.name))
                columns.append(fact)
                odd += _odd_values(fact, arrays[column.name], time)
    if scene is not None:
        odd += _odd_in_scene(log, scene, None)
    return Summary(
        log.source, tuple(facts), tuple(columns), tuple(unreadable), tuple(odd), log.notes
    )


def _of_recording(log: Log, scene: Scene | None, mapping: SignalMap) -> Summary:
    recording = _recording(log, mapping)
    odd = _odd_times(recording.time, None)
    columns = []
    for name, values in recording.signals.items():
        column = Column(name, values.shape, recording.units.get(name))
        columns.append(_facts(column, values, recording.time, name))
        odd += _odd_values(columns[-1], values, recording.time)
    if scene is not None:
        odd += _odd_in_scene(log, scene, mapping)
    facts = (_clock_facts("", None, recording.time),)
    return Summary(log.source, facts, tuple(columns), (), tuple(odd), recording.notes)


def _recording(log: Log, mapping: SignalMap | None) -> Recording:
    contents = contents_of(log, mapping)
    return Recording(**{f.name: getattr(contents, f.name) for f in dataclasses.fields(contents)})


# -- reading -----------------------------------------------------------------------------------


def _likely(log: Log, model: mujoco.MjModel | None) -> dict[str, str]:
    """The signals that columns may be; with a question mark unless they bear its name."""
    if model is None:
        return {c.name: c.signal for c in log.columns if c.signal}
    return {
        match.column.name: match.signal + ("" if match.likeness == 1.0 and not match.why else "?")
        for match in matches(log.columns, model, log.table)
    }


def _readable(log: Log, wanted: Sequence[str]) -> Mapping[str, Array]:
    """The columns that hold numbers. Those that do not are found by halving, as a format reads
    several columns at once."""
    if not wanted:
        return {}
    try:
        found = log.read(wanted)
        return {n: np.asarray(v) for n, v in found.items() if np.asarray(v).dtype.kind in "fiubmM"}
    except RecordingError:
        half = len(wanted) // 2
        if not half:
            return {}
        return {**_readable(log, wanted[:half]), **_readable(log, wanted[half:])}


def _time(
    log: Log, group: str, arrays: Mapping[str, Array], odd: list[str]
) -> tuple[Clock | None, Floats | None]:
    """The clock and the times of a group; what is wrong with it goes to `odd`."""
    try:
        clock = clocks.clock_of(log, group)
        if clock.column is None:
            return clock, log.clocks[group]
        raw = arrays.get(clock.column.name)
        if raw is None:
            raw = log.read([clock.column.name])[clock.column.name]
        time, _ = clocks.seconds(raw, clock.unit, log.source, clock.column.name)
        if time.ndim != 1 or time.dtype.kind != "f" or not len(time):
            return clock, None
    except RecordingError as error:
        text = error.problem + (f"; {error.remedy}" if error.remedy else "")
        if text not in odd:
            odd.append(text)
        return None, None
    if clock.note and clock.note not in odd:
        odd.append(clock.note)
    return clock, time


# -- facts -------------------------------------------------------------------------------------


def _clock_facts(group: str, clock: Clock | None, time: Floats) -> ClockFacts:
    steps = np.diff(time[np.isfinite(time)])
    median = float(np.median(steps)) if len(steps) else 0.0
    column = clock.column.name if clock is not None and clock.column is not None else None
    return ClockFacts(
        group=group,
        column=column,
        samples=len(time),
        duration_s=float(time[-1] - time[0]),
        rate_hz=1.0 / median if median > 0 else float("nan"),
        gaps=int((steps > _GAP * median).sum()),
        longest_s=float(steps.max()) if len(steps) else 0.0,
    )


def _facts(column: Column, values: Array, time: Floats | None, signal: str | None) -> ColumnFacts:
    numbers = np.asarray(values, np.float64) if values.dtype.kind in "fiub" else np.zeros(0)
    seen = numbers[np.isfinite(numbers)]
    noise = _noise(time, numbers)
    steps = [lattice_step(c) for c in numbers.reshape(len(numbers), -1).T] if seen.size else [0.0]
    return ColumnFacts(
        name=column.name,
        unit=column.unit or labels.parse(column.name).unit,
        signal=signal,
        shape=tuple(values.shape),
        lowest=float(seen.min()) if seen.size else float("nan"),
        highest=float(seen.max()) if seen.size else float("nan"),
        noise=noise,
        step=float(max(steps, default=0.0)),
        missing=1.0 - seen.size / max(numbers.size, 1),
    )


def _noise(time: Floats | None, numbers: Floats) -> float:
    """Standard deviation of the noise of a column (of its components, the mean square)."""
    if time is None or len(time) != len(numbers) or not numbers.size:
        return float("nan")
    if not (np.diff(time) > 0).all():
        return float("nan")
    return float(np.sqrt(np.mean(noise_std(time, numbers) ** 2)))


# -- suspicions --------------------------------------------------------------------------------


def _odd_times(time: Floats, clock: Clock | None) -> list[str]:
    name = "time" if clock is None or clock.column is None else clock.column.name
    found = []
    back = int((np.diff(time) <= 0).sum())
    if back:
        found.append(f"{name!r} does not increase at {back} of {len(time)} rows")
    slow = clocks.slow(time)
    if slow is not None:
        found.append(f"{name!r}: {slow}")
    return found


def _odd_values(fact: ColumnFacts, values: Array, time: Floats | None) -> Iterator[str]:
    if values.dtype.kind not in "fiub" or not np.isfinite(fact.lowest):
        if values.dtype.kind in "fiub":
            yield f"{fact.name!r} has no values"
        return
    if fact.lowest == fact.highest and values.ndim == 1:
        yield f"{fact.name!r} stays at {fact.lowest:.6g}"
        return
    if fact.missing > 0.05:
        yield f"{fact.name!r}: {fact.missing:.0%} of its samples are missing"
    if fact.step and fact.highest - fact.lowest < _COARSE * fact.step:
        yield f"{fact.name!r} moves in {(fact.highest - fact.lowest) / fact.step:.0f} steps only"
    angle = (fact.signal or "").startswith("qpos/") and values.ndim == 1
    if angle and fact.unit is None and max(-fact.lowest, fact.highest) > degrees.MOST:
        yield (
            f"{fact.name!r} goes from {fact.lowest:.4g} to {fact.highest:.4g} and names no unit: "
            "are these degrees?"
        )
    yield from _stale(fact, values, time)


def _stale(fact: ColumnFacts, values: Array, time: Floats | None) -> Iterator[str]:
    """A signal that keeps its value over several samples: it was sampled more slowly."""
    if time is None or values.ndim != 1 or len(time) != len(values) or len(values) < _COARSE:
        return
    same = float((np.diff(values) == 0).mean())
    if same > _STALE and (not fact.step or fact.highest - fact.lowest > 1000 * fact.step):
        rate = (1.0 - same) * (len(time) - 1) / max(float(time[-1] - time[0]), 1e-300)
        yield (
            f"{fact.name!r} repeats itself in {same:.0%} of the samples: it seems to be sampled "
            f"at {rate:.3g} Hz"
        )


def _odd_in_scene(log: Log, scene: Scene, mapping: SignalMap | None) -> list[str]:
    """What binding to the scene says."""
    try:
        bound = bind(_recording(log, mapping), scene)
    except InputError as error:
        text = str(error).removeprefix(f"{log.source}: ")
        return [f"does not fit {scene.name!r} as it is: {text}"]
    return [suspicion.text for suspicion in bound.suspicions]
