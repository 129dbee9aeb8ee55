"""How well the laws of a trial show in its recordings, before anything has looked at them.

Nothing here knows how a diagnosis works: the machine without a law, stepped like the truth, runs
free for half a second at a time, and is compared with what its encoders show.
"""

from __future__ import annotations

import copy
import dataclasses
import functools
from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from rigs.instruments import Chain, seen
from rigs.law import Floats, Law
from rigs.truth import Diverged, Run, Truth

WINDOW = 0.5
"""Of the free runs, s."""
_BEFORE = 0.2
"""What a machine runs ahead of a window, s: sensors that are late read what was before it."""


def visibility(
    plain: Truth, chain: Chain, runs: Sequence[Run], laws: Sequence[Law]
) -> dict[str, float]:
    """How far the machine without the laws misses noise-free recordings with them: `visibility`
    over the noise, and `distinct`, what is left of it by the best starts, over what noise and
    impacts leave unknown.

    Free runs of half a second from what the encoders show, with the truth's own step and
    integrator, so that nothing but the laws counts; the joint that shows most.
    """
    model, errors, left = plain.model, list[Floats](), list[Floats]()
    chain = dataclasses.replace(chain, delays=np.zeros(model.njnt))
    for number, run in enumerate(runs if laws else ()):
        clock = _clock(laws)
        for at in _windows(run, chain):
            qpos, qvel = seen(run, model, chain, laws, at)
            free = functools.partial(_free, plain, run, clock, chain.late, at)
            base = free(qpos[0], qvel[0])
            errors.append(_difference(model, base, qpos))
            if number == 0 or not left:  # one run is enough: 4 nv more runs for each window
                starts = _by_starts(model, free, (qpos, qvel), base, chain)
                left.append(starts.left(errors[-1]))
    if not errors:
        return {"visibility": 0.0, "distinct": 0.0}
    shows, told = (np.sqrt(np.mean(np.concatenate(some) ** 2, axis=0)) for some in (errors, left))
    return {"visibility": float(shows.max() / chain.noise), "distinct": float(told.max())}


def beside(truth: Truth, plain: Truth, chain: Chain, run: Run) -> list[float]:
    """What each of several laws leaves that neither the best starts nor other numbers of the other
    laws make, over what noise and impacts leave unknown. Empty for fewer than two laws, and where a
    machine without one of them diverges in every window.

    The truth runs once more, without each law, and with it in another way (`Law.ways`), from states
    that it had, and with what its laws remembered there. By how much that moves is what the law's
    numbers do. Laws of more numbers than `ways` knows leave more than they should.
    """
    if len(truth.laws) < 2:
        return []
    model, laws = plain.model, truth.laws
    chain = dataclasses.replace(chain, delays=np.zeros(model.njnt))
    done = 0
    kinds = [(law, number) for law in laws for number in range(-1, len(law.ways()))]
    moves: list[list[Floats]] = [[] for _ in kinds]
    for at in _windows(run, chain, _BEFORE):
        first = _row(truth, at[0] - _BEFORE)
        if first > done:  # what laws remember is then as it was
            _again(truth, run, chain, done, first - 1)
            done = first
        try:
            others = [_changed(truth, law, number, run, chain, at) for law, number in kinds]
        except Diverged:  # without a law that held it
            continue
        shown = seen(run, model, chain, laws, at)
        free = functools.partial(_free, plain, run, _clock(laws), chain.late, at)
        starts = _by_starts(model, free, shown, free(shown[0][0], shown[1][0]), chain)
        for moved, other in zip(moves, others, strict=True):
            moved.append(starts.left(_difference(model, other, shown[0])))
    if not moves[0]:
        return []
    flat = np.array([np.concatenate(one) for one in moves])  # [kinds, T, nv]
    found = []
    for law in laws:
        own = flat[next(k for k, (one, _) in enumerate(kinds) if one is law)]
        rest = flat[[one is not law for one, _ in kinds]].reshape(-1, own.size).T
        best = np.linalg.lstsq(rest, own.ravel(), rcond=None)[0]
        left = (own.ravel() - rest @ best).reshape(own.shape)
        found.append(float(np.sqrt(np.mean(left**2, axis=0)).max()))
    return found


def _windows(run: Run, chain: Chain, begin: float = 0.1) -> list[Floats]:
    """Times of the samples of each window, without the first and last moments of a run."""
    at = run.time[(run.time > begin) & (run.time < run.time[-1] - 0.01)]
    at = at[:: max(1, round(1 / chain.rate / (run.time[1] - run.time[0])))]
    width = max(2, round(WINDOW * chain.rate))
    return [at[first : first + width] for first in range(0, len(at) - width, width)]


def _clock(laws: Sequence[Law]) -> float:
    return float(np.prod([getattr(law, "clock", 1.0) for law in laws]))


def _row(truth: Truth, time: float) -> int:
    """Number of the fine step that begins at a time."""
    return round(time / truth.model.opt.timestep)


def _again(
    truth: Truth, run: Run, chain: Chain, first: int, last: int, gone: Sequence[Law] = ()
) -> Run:
    """Steps `first` to `last` once more, from the state that a run had, with the commands that
    arrived then, and with what its laws remember of the step before.

    Args:
      gone: laws that the machine has no longer; where one has moved a joint beside its encoder, the
        joint is where the encoder was.
    """
    step, start = truth.model.opt.timestep, float(run.time[first])
    slower = _clock(gone)  # true seconds to one of the log

    def arrived(now: float, *_: Floats) -> Floats:
        when = start + (now - start) / slower - chain.late
        row = min(int(when / step + 1e-6), len(run.sent) - 1)
        return np.asarray(run.sent[row]) if when > -1e-9 else np.zeros(run.sent.shape[1])

    lasts = (last - first) * step * slower
    ticks = start + step * np.arange(round(lasts / step) + 1)
    state = run.body[first].copy(), run.rate[first].copy()
    for law in gone:
        law.shown(*state)
    return truth.run(*state, lasts, arrived, ticks, 0.0, begin=start, fresh=first == 0)


def _changed(truth: Truth, law: Law, number: int, run: Run, chain: Chain, at: Floats) -> Floats:
    """[T, nq]: what encoders show of the machine with one of its laws in another way.

    Args:
      number: of the way; -1 for without the law.
    """
    kept = [copy.deepcopy(one) for one in truth.laws if one is not law]
    gone, way = ([law], []) if number < 0 else ([], [law.ways()[number]])
    first, last = _row(truth, at[0] - _BEFORE), _row(truth, at[-1]) + 2
    again = _again(truth.having([*kept, *way]), run, chain, first, last, gone)
    start = float(again.time[0])
    return seen(again, truth.model, chain, [*kept, *way], start + (at - start) * _clock(gone))[0]


@dataclasses.dataclass(frozen=True, eq=False)
class _Starts:
    """What the start of a window does to it.

    Attributes:
      slopes: [T nv, 2 nv], over what is unknown. weight: [T, nv], one over that.
    """

    slopes: Floats
    weight: Floats

    def left(self, error: Floats) -> Floats:
        """[T, nv]: what the best start leaves of an error, over what is unknown."""
        target = (error * self.weight).ravel()
        best = np.linalg.lstsq(self.slopes, target, rcond=None)[0]
        return np.asarray((target - self.slopes @ best).reshape(error.shape))


def _by_starts(
    model: mujoco.MjModel,
    free: Callable[[Floats, Floats], Floats],
    shown: tuple[Floats, Floats],
    base: Floats,
    chain: Chain,
) -> _Starts:
    """In linear approximation. Unknown is what the chain leaves unknown, and what runs from starts
    to either side, off by half of what one sample leaves unknown of them, bend (of speeds, the
    noise over four sampling intervals: one is not told from two positions).

    Args:
      free: a run from a start. shown: positions [T, nq] and velocities [T, nv] that encoders show.
      base: [T, nq] the run from the first of them.
    """
    nv, size = model.nv, chain.noise * np.array([1.0, chain.rate / 4.0]) / 2.0
    slopes, bends = list[Floats](), (chain.unknown(shown[1]) / chain.noise) ** 2
    for move in np.kron(np.diag(size), np.eye(nv)):
        sides = []
        for sign in (1.0, -1.0):
            q = shown[0][0].copy()
            mujoco.mj_integratePos(model, q, sign * move[:nv], 1.0)
            sides.append(_difference(model, free(q, shown[1][0] + sign * move[nv:]), base))
        slopes.append((sides[1] - sides[0]) / 2.0)
        bends += ((sides[0] + sides[1]) / 2.0 / chain.noise) ** 2
    weight = 1.0 / (chain.noise * np.sqrt(bends))
    return _Starts((np.array(slopes) * weight).reshape(2 * nv, -1).T, weight)


def _free(
    plain: Truth, run: Run, clock: float, late: float, at: Floats, qpos: Floats, qvel: Floats
) -> Floats:
    """Positions at times, free from a start at the first with the commands that arrived.

    Args:
      clock: a fast one says that more time passes between samples than did. late: of commands, s.
    """
    model, data = plain.model, mujoco.MjData(plain.model)
    data.qpos[:], data.qvel[:] = qpos, qvel
    step, found, done = float(model.opt.timestep), [], 0
    for elapsed in (at - at[0]) * clock:
        steps = int(elapsed / step + 1e-6)
        for number in range(done, steps):
            true = at[0] + number * step / clock - late
            row = min(max(int(true / step + 1e-6), 0), len(run.sent) - 1)
            (data.qfrc_applied if plain.applied else data.ctrl)[:] = run.sent[row]
            mujoco.mj_step(model, data)
        done, here = steps, data.qpos.copy()
        mujoco.mj_integratePos(model, here, data.qvel, max(elapsed - steps * step, 0.0))
        found.append(here)
    return np.array(found)


def _difference(model: mujoco.MjModel, found: Floats, wanted: Floats) -> Floats:
    """[T, nv] as tangents."""
    gap = np.empty((len(found), model.nv))
    for k in range(len(found)):
        mujoco.mj_differentiatePos(model, gap[k], 1.0, wanted[k], found[k])
    return gap
