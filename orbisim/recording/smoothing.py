"""A smoothing differentiator: value, rate and second derivative of noisy samples, with errors.

The signal is modelled as a point whose jerk is white noise, measured with white noise (see
`kalman`). The noise level comes from the signal's contrasts (see `noise`), the intensity of the
jerk from maximum likelihood and then the smallest estimated risk, one for each channel. Time need
not be uniform and samples may be missing.

Impacts would force a high intensity on the whole recording, and stray measurements a rough path.
Intervals whose disturbance stands out are therefore given an intensity of their own, and stray
measurements are left out, as long as each of them raises the log likelihood enough (see `events`).

Long recordings are cut into overlapping blocks that are smoothed side by side; the overlap is twice
the longest time scale that the likelihood is searched for, 64 samples.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import numpy.typing as npt

from orbisim.errors import InputError
from orbisim.host.kept import Kept, key_of
from orbisim.recording import noise as _noise
from orbisim.recording.blocks import Blocks, Channels
from orbisim.recording.events import Events, suspects
from orbisim.recording.kalman import Posterior, run_filter, run_smoother

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

_LEVELS = 10.0 ** np.arange(-10.5, 9.6, 1.0)
_NEARBY = 10.0 ** np.arange(-6.0, 0.1, 1.0)
_SMOOTHER = 10.0 ** np.arange(0.0, -3.1, -1.0)
_BOUNDARY = 4.0
"""Time constants around a jump within which the likeliest model is taken, not the smoother one."""
_FITTED_BLOCKS = 16
"""Of a long series at most so many are fitted; the others take what these found."""
_SERIES = 2048
"""Series (blocks times channels) that are filtered at once, which bounds memory."""
_ROUNDS = 8
"""Of events and fits in turn, at most."""


@dataclasses.dataclass(frozen=True, eq=False)
class Smoothed:
    """A smoothed signal. Shapes are those of the samples, [T] or [T, C].

    NaN before a channel's first sample, after its last one, and in gaps longer than 256 intervals.

    Attributes:
      time: [T], s.
      value, rate, second: the signal and its first and second derivative in time.
      value_std, rate_std, second_std: their standard deviations.
      noise_std: [] or [C] standard deviation of the measurement noise.
      timescale: [] or [C] time over which samples are averaged, s.
      jumps: [T - 1] or [T - 1, C] whether the rate jumped between a sample and the next.
      strays: [T] or [T, C] samples that were left out because they do not fit the others.
    """

    time: Floats
    value: Floats
    rate: Floats
    second: Floats
    value_std: Floats
    rate_std: Floats
    second_std: Floats
    noise_std: Floats
    timescale: Floats
    jumps: Bools
    strays: Bools


def smooth(
    time: npt.ArrayLike,
    values: npt.ArrayLike,
    *,
    noise_std: npt.ArrayLike | None = None,
    events: bool = True,
) -> Smoothed:
    """Smooths and differentiates.

    Args:
      time: [T], s, strictly increasing, T at least 2.
      values: [T] or [T, C]; NaN marks a missing sample. Channels are independent.
      noise_std: standard deviation of the measurement noise, a number or [C]; estimated if None.
      events: whether to look for jumps of the rate and for stray samples.

    Returns:
      Estimates at every time, also where single samples are missing; all NaN for a channel with
      fewer than two samples.

    Raises:
      InputError: shapes do not fit, or time does not increase.
    """
    t, y = np.asarray(time, np.float64), np.asarray(values, np.float64)
    _check(t, y)
    columns = y.reshape(len(t), -1)
    noise = _noise_of(t, columns, noise_std)
    usable = np.flatnonzero(np.isfinite(columns).sum(axis=0) >= 2)
    channels = Channels(t, columns[:, usable], noise[usable])
    fit = _fit(channels, events)
    moments, found = _solve(channels, fit, events)
    moments[:, ~channels.bridged] = np.nan
    timescale = _timescale(fit.smooth) * channels.unit
    return _result(t, y.shape, usable, noise, timescale, moments, found)


def smoothed(time: Floats, values: Floats, noise: Floats) -> Smoothed:
    """As `smooth`; who asks again for the same gets the same, whose arrays are read-only.

    Args:
      noise: [C] standard deviation of each channel's noise.
    """

    def compute() -> Smoothed:
        found = smooth(time.copy(), values, noise_std=noise)
        parts = {f.name: getattr(found, f.name).view() for f in dataclasses.fields(found)}
        for array in parts.values():
            array.flags.writeable = False
        return Smoothed(**parts)

    return _SMOOTHED.of(key_of(time, values, noise), compute)


def _bytes(smoothed: Smoothed) -> int:
    return sum(getattr(smoothed, field.name).nbytes for field in dataclasses.fields(smoothed))


_SMOOTHED = Kept(_bytes, 2**26)
"""A diagnosis asks for the same motions with several windows, and again when it scores: 64 MB hold
an hour at 100 Hz of three channels."""


def _check(time: Floats, values: Floats) -> None:
    if time.ndim != 1 or values.shape[:1] != time.shape or values.ndim not in (1, 2):
        raise InputError(f"values {values.shape} need a row for each time {time.shape}")
    if len(time) < 2 or not (np.diff(time) > 0).all():
        raise InputError("time must have at least two samples and strictly increase")


def _noise_of(time: Floats, columns: Floats, given: npt.ArrayLike | None) -> Floats:
    if given is None:
        return np.asarray(_noise.noise_std(time, columns))
    return np.broadcast_to(np.asarray(given, np.float64), columns.shape[1:]).copy()


# -- the jerk's intensity and the events -----------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class _Found:
    """Events of a recording: jumps [T - 1, C] and stray samples [T, C]."""

    jumps: Bools
    strays: Bools


@dataclasses.dataclass(frozen=True)
class _Fit:
    """The jerk's intensity [C] of every channel, and the events found on the way.

    Attributes:
      likely: the intensity of largest likelihood. smooth: that of least risk.
      found: jumps and stray samples.
    """

    likely: Floats
    smooth: Floats
    found: _Found


def _fit(channels: Channels, search: bool) -> _Fit:
    """Maximum likelihood over some of the blocks."""
    starts, every = channels.starts, np.arange(len(channels))
    picked = np.linspace(0, len(starts) - 1, min(len(starts), _FITTED_BLOCKS)).astype(int)
    blocks = channels.blocks(starts[np.unique(picked)])
    events = Events.none(blocks)
    level, best = _likeliest(blocks, np.tile(_LEVELS, (len(channels), 1)), events)
    active = every if search else every[:0]
    for _ in range(_ROUNDS):
        chosen = np.flatnonzero(np.isin(blocks.channel, active))
        if not chosen.size:
            break
        some, known = blocks[chosen], events[chosen]
        new = suspects(_posterior(some, level, known), some, known, len(channels.time))
        price = _per_channel(new.price, some.channel, len(channels))
        level2, likelihood = _likeliest(some, _choices(level, _NEARBY), known | new)
        better = (price > 0) & (likelihood - best > price)
        level, best = np.where(better, level2, level), np.where(better, likelihood, best)
        events |= new.only(better[some.channel]).placed(chosen, len(blocks.channel))
        active = np.flatnonzero(better)
    smoother = _least_risk(blocks, _choices(level, _SMOOTHER), events)
    return _Fit(level, smoother, _spread(channels, blocks, events))


def _choices(level: Floats, factors: Floats) -> Floats:
    """[C, K]: multiples of the levels, within what the overlap of the blocks allows."""
    return np.asarray(np.maximum(level[:, None] * factors, _LEVELS[0]))


def _least_risk(blocks: Blocks, choices: Floats, events: Events) -> Floats:
    """The level [C] among [C, K] with the smallest estimated error of the smoothed values.

    Stein's unbiased estimate for a linear smoother (Annals of Statistics 9, 1981; Mallows's Cp):
    the mean squared residual less the noise, plus twice the posterior variance. Signals of machines
    are smoother than integrals of white noise, for which the likeliest level would be best.
    """
    channels, count = choices.shape
    series = np.repeat(np.arange(len(blocks.channel)), count)
    blocks = events.applied(blocks)
    many, tried = blocks[series], choices[blocks.channel].ravel()
    levels = many.levels(tried, events.jumped[:, series])
    found = run_smoother(many.step, run_filter(many.step, many.measured, levels))
    scored = many.core & np.isfinite(many.measured)
    residual = np.where(scored, many.measured - found.mean[:, 0], 0.0)
    spread = np.where(scored, found.variance[:, 0], 0.0)
    each = (residual**2 + 2.0 * spread).sum(axis=0).reshape(-1, count)
    risk = np.stack([_per_channel(each[:, k], blocks.channel, channels) for k in range(count)], 1)
    return np.asarray(choices[np.arange(channels), risk.argmin(axis=1)])


def _likeliest(blocks: Blocks, choices: Floats, events: Events) -> tuple[Floats, Floats]:
    """The best of the levels [C, K] of each channel and its log likelihood."""
    channels, count = choices.shape
    series = np.repeat(np.arange(len(blocks.channel)), count)
    blocks = events.applied(blocks)
    many, tried = blocks[series], choices[blocks.channel].ravel()
    levels = many.levels(tried, events.jumped[:, series])
    filtered = run_filter(many.step, many.measured, levels, keep=False)
    scored = np.cumsum(np.isfinite(many.measured), axis=0) > 3  # the first three place the state
    each = filtered.log_likelihood(scored).reshape(-1, count)
    total = np.stack([_per_channel(each[:, k], blocks.channel, channels) for k in range(count)], 1)
    best, every = total.argmax(axis=1), np.arange(channels)
    return choices[every, best], total[every, best]


def _per_channel(values: Floats, channel: npt.NDArray[np.int64], count: int) -> Floats:
    return np.bincount(channel, weights=values, minlength=count).astype(np.float64)


def _spread(channels: Channels, blocks: Blocks, events: Events) -> _Found:
    """Events of blocks as events of the recording."""
    jumps = np.zeros((len(channels.time), len(channels)), bool)
    strays = jumps.copy()
    padded = np.concatenate([events.jumped, np.zeros_like(events.jumped[:1])])
    rows, channel, here = channels.gather(blocks, padded)
    jumps[rows, channel] = here
    rows, channel, here = channels.gather(blocks, events.stray)
    strays[rows, channel] = here
    return _Found(jumps[:-1], strays)


# -- the estimates ---------------------------------------------------------------------------------


def _posterior(blocks: Blocks, level: Floats, events: Events) -> Posterior:
    blocks = events.applied(blocks)
    levels = blocks.levels(level[blocks.channel], events.jumped)
    return run_smoother(blocks.step, run_filter(blocks.step, blocks.measured, levels))


def _timescale(level: Floats) -> Floats:
    """Sampling intervals over which a smoother of this level averages."""
    return np.asarray(level ** (-1.0 / 6.0))


def _solve(channels: Channels, fit: _Fit, search: bool) -> tuple[Floats, _Found]:
    """Means and standard deviations [6, T, C] in the recording's units, and all events.

    The smoother of least risk is a good one away from the ends of the signal and its jumps; near
    them its bias exceeds its variance, and the likeliest one takes over.
    """
    likely = np.full((6, *channels.values.shape), np.nan)
    smoother = likely.copy()
    jumps, strays = fit.found.jumps.copy(), fit.found.strays.copy()
    padded = np.concatenate([fit.found.jumps, np.zeros_like(fit.found.jumps[:1])])
    at_once = max(1, _SERIES // max(len(channels), 1))
    for chunk in range(0, len(channels.starts), at_once):
        blocks = channels.blocks(channels.starts[chunk : chunk + at_once])
        events = Events(
            padded[blocks.rows[:-1], blocks.channel] & (blocks.step > 0),
            fit.found.strays[blocks.rows, blocks.channel] & np.isfinite(blocks.measured),
        )
        posterior = _posterior(blocks, fit.likely, events)
        if search and len(channels.starts) > _FITTED_BLOCKS:
            events = _more_events(blocks, fit.likely, posterior, events, len(channels.time))
        _store(likely, channels, blocks, posterior)
        _store(smoother, channels, blocks, _posterior(blocks, fit.smooth, events))
        here = _spread(channels, blocks, events)
        jumps |= here.jumps
        strays |= here.strays
    near = channels.edge_distance(jumps) < _BOUNDARY * _timescale(fit.smooth)
    return np.where(near, likely, smoother), _Found(jumps, strays)


def _more_events(
    blocks: Blocks, level: Floats, posterior: Posterior, events: Events, count: int
) -> Events:
    """Events of blocks that took no part in the fit; writes the result into `posterior`."""
    for _ in range(_ROUNDS):
        new = suspects(posterior, blocks, events, count)
        changed = np.flatnonzero(new.any)
        if not changed.size:
            break
        events |= new
        again = _posterior(blocks[changed], level, events[changed])
        for field in dataclasses.fields(Posterior):
            getattr(posterior, field.name)[..., changed] = getattr(again, field.name)
    return events


def _store(moments: Floats, channels: Channels, blocks: Blocks, posterior: Posterior) -> None:
    for order in range(3):
        scale = (channels.noise / channels.unit**order)[blocks.channel]
        offset = blocks.offset if order == 0 else 0.0
        mean = posterior.mean[:, order] * scale + offset
        spread = np.sqrt(posterior.variance[:, order]) * scale
        for row, values in ((order, mean), (order + 3, spread)):
            rows, channel, here = channels.gather(blocks, values)
            moments[row, rows, channel] = here


def _result(
    time: Floats,
    shape: tuple[int, ...],
    usable: npt.NDArray[np.int64],
    noise: Floats,
    timescale: Floats,
    moments: Floats,
    found: _Found,
) -> Smoothed:
    def full(part: npt.NDArray[Any], empty: float | bool) -> npt.NDArray[Any]:
        values = np.full((*part.shape[:-1], len(noise)), empty, part.dtype)
        values[..., usable] = part
        return values.reshape((*part.shape[:-1], *shape[1:]))

    value, rate, second, value_std, rate_std, second_std = full(moments, np.nan)
    return Smoothed(
        time=time,
        value=value,
        rate=rate,
        second=second,
        value_std=value_std,
        rate_std=rate_std,
        second_std=second_std,
        noise_std=noise.reshape(shape[1:]),
        timescale=full(timescale, np.nan),
        jumps=full(found.jumps, False),
        strays=full(found.strays, False),
    )
