"""Whether what a scene leaves of a motion is noise of sensors, white or correlated, or of drives.

Free runs are compared with the white noise of the sensors. Real chains have noise that lasts for
some samples, too, and drives push by what no log holds (a command that is logged a sample late now
and then): both leave more than white noise, and no effect explains them. Along the linear system
of `orbisim.motion.linear`, the likelihood of such noise is known exactly (Kalman filter):

    xi_{k+1} = A_k xi_k + B_k (w_k + f_k) - d_k,     y_k - C xbar_k = C xi_k + c_k + e_k,

with white noise e and correlated noise c of each signal, a white generalized force w where there is
a drive, no larger than what it gives, and, if there is one, a force f of slow course. Variances are
the likeliest. What a scene lacks is a force that follows from its motion, and as slow: what is left
is noise alone where such a force makes the likelihood no better.

The gradient of the likelihood comes from the disturbance smoother (Koopman and Shephard, Biometrika
79, 1992; Koopman, Biometrika 80, 1993).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import mujoco
import numpy as np
import numpy.typing as npt
import scipy.optimize

from orbisim.evidence import gain_of
from orbisim.host.deadline import NEVER, Deadline
from orbisim.motion.linear import Intervals
from orbisim.motion.samples import Samples
from orbisim.shooting.windows import cut_windows, evenly, start_size

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

LASTING = (2.0, 8.0)
"""Samples over which correlated noise is lost (to 1/e): a sum of a short and a long one comes close
to what lies between."""
_SLOW = 20.0
"""Samples over which a slow force is lost: longer than noise lasts, and a fifth of a stretch."""
_LENGTH, _MOST = 100, 12
"""Intervals of a stretch, and stretches: 1,200 samples tell noises to a few percent."""
_WORK = 6e6
"""Of all stretches, intervals times the cube of the size of the state: a second or two an
evaluation. A machine of many joints has as many more signals, and takes fewer stretches."""
_LEAST = 3
"""Stretches by which a gain has an error at all."""
_FEWEST = 25
"""Intervals of a stretch, at least: a slow force changes within it."""
_WANDER = 10.0
"""Noise that lasts over white noise, at most: filters and mounts make the former larger by a few
times; what wanders further is no sensor's."""
_START = 10.0
"""Standard deviation of a stretch's start, in what the noise leaves unknown of it: no limit."""
_CLOSE = 1e-6
"""Relative change of the likelihood at which the optimiser ends: about 0.01 of 10,000."""
_ROUNDS = 60
"""Steps of the optimiser at most; it needs 15 to 40."""
_NOTHING = 1e-4
"""Of its unit, a standard deviation below which a noise is none."""
_WHITE = (0.1, 1e3)
"""Of its guess, which takes unknown motion for noise, and leaves out noise that lasts."""
_FORCE = 1e5
"""Of its unit: a slow force has no bound that matters."""


@dataclasses.dataclass(frozen=True, eq=False)
class Stretches:
    """Stretches of recordings along a scene.

    Attributes:
      A: [W, K, 2 nv, 2 nv]. B: [W, K, 2 nv, nv]. defect: [W, K, 2 nv]. They are
        `orbisim.motion.linear`'s.
      y: [W, K + 1, ny] measured minus reference; NaN where there is none.
      measured: [ny] numbers of the measured coordinates. noise: [ny] their white noise, guessed.
      size: [2 nv] what the noise leaves unknown of a state.
      drive: [nv] root mean square of the forces of drives: 0 where there is none.
    """

    A: Floats
    B: Floats
    defect: Floats
    y: Floats
    measured: Ints
    noise: Floats
    size: Floats
    drive: Floats

    @property
    def unit(self) -> Floats:
        """[nv]: force that moves the state by its `size` within an interval."""
        moved = np.median(np.abs(self.B), axis=(0, 1)) / self.size[:, None]
        return np.asarray(1.0 / np.maximum(moved.max(axis=0), 1e-300))


@dataclasses.dataclass(frozen=True, eq=False)
class Disturbances:
    """Standard deviations that make data likeliest.

    Attributes:
      score: [W] log likelihood of each stretch.
      white: [ny] noise of each signal from sample to sample. lasting: [len(LASTING), ny] noise that
        is correlated over so many samples. push: [nv] white force. slow: [nv] force of slow course;
        None if there is none.
    """

    score: Floats
    white: Floats
    lasting: Floats
    push: Floats
    slow: Floats | None


def stretches(
    samples: Sequence[Samples],
    intervals: Intervals,
    noise: tuple[Floats, Floats],
    known: Sequence[Floats] | None = None,
) -> Stretches | None:
    """Stretches to tell noises by, spread evenly; None where recordings are too short.

    Args:
      intervals: along the scene. noise: standard deviations of positions and velocities, each [nv].
      known: for each recording what measurement effects add to it, [T, 2 nv].
    """
    kept = np.flatnonzero(intervals.usable)
    length = _LENGTH
    while length >= _FEWEST:
        found = cut_windows(intervals.recording[kept], intervals.row[kept], length)
        if len(found):
            break
        length //= 2
    else:
        return None
    guess = np.concatenate(noise)
    measured = np.flatnonzero(np.isfinite(guess))
    width = 4 * len(noise[0]) + len(LASTING) * len(measured)
    most = int(np.clip(_WORK / (length * width**3), _LEAST, _MOST))
    first = kept[found.first]
    first = first[evenly(np.ones(len(first), bool), most)]
    within = first[:, None] + np.arange(length)
    both = [np.concatenate([s.dq, s.dv], axis=1) for s in samples]
    if known is not None:
        both = [seen - added for seen, added in zip(both, known, strict=True)]
    rows = [(intervals.recording[i], intervals.row[i]) for i in first]
    step = float(np.median(np.concatenate([np.diff(one.time) for one in samples])))
    return Stretches(
        intervals.A[within],
        intervals.B[within],
        intervals.defect[within],
        np.array([both[r][k : k + length + 1][:, measured] for r, k in rows]),
        measured,
        guess[measured],
        start_size(noise, step),
        _driven(samples),
    )


def _driven(samples: Sequence[Samples]) -> Floats:
    """[nv]: root mean square of the forces of actuators, and of recorded ones, along the motion."""
    model = samples[0].bound.model
    data, squares, count = mujoco.MjData(model), np.zeros(model.nv), 0
    for one in samples:
        rows = np.flatnonzero(one.usable)
        for row in rows[:: max(len(rows) // _LOOKED_AT, 1)]:
            data.qpos[:], data.qvel[:], data.act[:] = one.qpos[row], one.qvel[row], one.act[row]
            data.ctrl[:] = one.ctrl[row]
            mujoco.mj_forward(model, data)
            squares += (data.qfrc_actuator + one.force[row]) ** 2
            count += 1
    return np.asarray(np.sqrt(squares / max(count, 1)))


_LOOKED_AT = 100
"""Samples of each recording that tell how large forces are."""


@dataclasses.dataclass(frozen=True, eq=False)
class Remainder:
    """What a scene leaves of a motion, as noise.

    Attributes:
      data: what it was told by. noise: without a force of slow course. structured: whether such a
        force makes the data surely likelier.
    """

    data: Stretches
    noise: Disturbances
    structured: bool

    def said(self, names: Sequence[str], step: float) -> str:
        """The noises that are more than white noise of sensors, in words.

        Args:
          names: [nv] of the degrees of freedom. step: typical time between samples, s.
        """
        lasting = np.sqrt((self.noise.lasting**2).sum(axis=0))
        nv, parts = len(names), []
        for k in np.flatnonzero(lasting > self.noise.white):
            number = int(self.data.measured[k])
            weight = self.noise.lasting[:, k] ** 2
            time = float(weight @ np.array(LASTING)) / float(weight.sum()) * step
            kind = "qpos" if number < nv else "qvel"
            parts.append(
                f"noise of {kind}/{names[number % nv]} of {lasting[k]:.2g} that lasts some "
                f"{1e3 * time:.2g} ms"
            )
        pushed = np.flatnonzero(self.noise.push > _SHOWS * self.data.unit)
        parts += [
            f"random forces at {names[int(j)]} of {self.noise.push[j]:.2g} over a sample"
            for j in pushed
        ]
        return ", ".join(parts) or "noise"


_SHOWS = 0.3
"""Of a force that moves a state by what is unknown of it, within an interval: one that is said."""


def remainder(data: Stretches, deadline: Deadline = NEVER) -> Remainder:
    """What is left along a scene, as noise.

    Raises:
      TimeIsUpError: the deadline has passed.
    """
    noise = likeliest(data, deadline=deadline)
    slow = likeliest(data, noise, deadline)
    numbers = 0.5 * data.B.shape[3] * float(np.log(np.isfinite(data.y).sum()))
    return Remainder(data, noise, gain_of(slow.score - noise.score, -numbers).sure > 0)


def likeliest(
    data: Stretches, beside: Disturbances | None = None, deadline: Deadline = NEVER
) -> Disturbances:
    """Noises that make data likeliest.

    Args:
      beside: those without a force of slow course, where there is to be one besides.

    Raises:
      TimeIsUpError: the deadline has passed.
    """
    slow = beside is not None
    model = _Model(data, slow)
    unit = np.concatenate([data.noise, *[data.noise] * len(LASTING), data.unit])
    unit = np.concatenate([unit, data.unit]) if slow else unit

    def loss(logs: Floats) -> tuple[float, Floats]:
        deadline.check()
        variances = (unit * np.exp(logs)) ** 2
        score, slope = model.score(variances)
        if not np.isfinite(score).all():
            return np.inf, np.zeros_like(logs)
        return -float(score.sum()), -2.0 * slope * variances

    bounds = np.log(_limits(data, slow))
    start = _begun(data, unit, beside, loss)
    start = np.clip(start, *bounds.T)
    found = scipy.optimize.minimize(
        loss,
        start,
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        options={"maxiter": _ROUNDS, "ftol": _CLOSE},
    ).x
    score = model.score((unit * np.exp(found)) ** 2)[0]
    return model.told(score, unit * np.exp(found))


def _limits(data: Stretches, slow: bool) -> Floats:
    """[P, 2]: least and most of each standard deviation, in its unit."""
    ny, nv = len(data.noise), data.B.shape[3]
    white = [_WHITE] * ny
    lasting = [(_NOTHING, _WANDER)] * (ny * len(LASTING))
    # a drive errs by no more than what it gives
    push = [(_NOTHING, float(max(one, _NOTHING))) for one in data.drive / data.unit]
    return np.array(white + lasting + push + ([(_NOTHING, _FORCE)] * nv if slow else []))


def _begun(
    data: Stretches,
    unit: Floats,
    beside: Disturbances | None,
    loss: Callable[[Floats], tuple[float, Floats]],
) -> Floats:
    """Logarithms of standard deviations, in their units, to begin with: a tenth of the noise is
    correlated, and of pushes of several sizes the likeliest. A slow force takes the place of white
    ones, else the likelihood has a maximum where there is none."""
    ny, nv = len(data.noise), data.B.shape[3]
    if beside is not None:
        parts = [beside.white, beside.lasting.ravel(), 0.1 * beside.push, beside.push]
        return np.asarray(np.log(np.maximum(np.concatenate(parts), _NOTHING * unit) / unit))
    tried = []
    for size in (0.01, 1.0, 100.0):
        logs = np.concatenate([np.zeros(ny), np.full(len(unit) - ny, np.log(0.1))])
        logs[ny * (1 + len(LASTING)) :][:nv] = np.log(size)
        tried.append(logs)
    return min(tried, key=lambda logs: loss(logs)[0])


_Passed = tuple[Floats, Floats, Floats, Floats, Floats, npt.NDArray[np.bool_]]


class _Model:
    """The linear system with its noises as first-order autoregressions in its state."""

    def __init__(self, data: Stretches, slow: bool) -> None:
        windows, length, n2, nv = data.B.shape
        self.data, self.ny, self.n2 = data, len(data.measured), n2
        decays = [np.full(self.ny, np.exp(-1.0 / one)) for one in LASTING] + [np.zeros(nv)]
        decays += [np.full(nv, np.exp(-1.0 / _SLOW))] if slow else []
        self.decay = np.concatenate(decays)
        self.n = n2 + len(self.decay)
        forces = n2 + len(LASTING) * self.ny
        self.step = np.zeros((windows, length, self.n, self.n))
        self.step[:, :, :n2, :n2] = data.A
        self.step[:, :, range(n2, self.n), range(n2, self.n)] = self.decay
        for first in range(forces, self.n, nv):
            self.step[:, :, :n2, first : first + nv] = data.B
        self.read = np.zeros((self.ny, self.n))
        self.read[np.arange(self.ny), data.measured] = 1.0
        for number in range(len(LASTING)):
            first = n2 + number * self.ny
            self.read[np.arange(self.ny), first + np.arange(self.ny)] = 1.0
        self.seen = np.isfinite(data.y)

    def told(self, score: Floats, deviations: Floats) -> Disturbances:
        """Standard deviations by what they are of."""
        ny, nv = self.ny, self.data.B.shape[3]
        lasting, rest = np.split(deviations[ny:], [len(LASTING) * ny])
        slow = rest[nv:] if len(rest) > nv else None
        return Disturbances(score, deviations[:ny], lasting.reshape(-1, ny), rest[:nv], slow)

    def score(self, variances: Floats) -> tuple[Floats, Floats]:
        """[W] log likelihood, and the gradient of its sum by variances.

        Args:
          variances: of the white noise of each signal, then of each autoregression.
        """
        white, driven = variances[: self.ny], variances[self.ny :]
        passed, score = self._filtered(white, driven)
        by_white, by_fresh, by_start = self._smoothed(passed)
        return score, np.concatenate([by_white, (1.0 - self.decay**2) * by_fresh + by_start])

    def _filtered(self, white: Floats, driven: Floats) -> tuple[list[_Passed], Floats]:
        """The Kalman filter: of each sample what its smoother needs, and [W] the likelihood."""
        data, n, n2, ny = self.data, self.n, self.n2, self.ny
        windows, length = data.defect.shape[:2]
        own = np.arange(ny)
        fresh = np.zeros(n)
        fresh[n2:] = (1.0 - self.decay**2) * driven
        mean, spread = np.zeros((windows, n)), np.zeros((windows, n, n))
        variance = np.concatenate([(_START * data.size) ** 2, driven])
        spread[:, range(n), range(n)] = variance
        score, passed = np.zeros(windows), list[_Passed]()
        for k in range(length + 1):
            seen = self.seen[:, k]
            read = self.read[None] * seen[:, :, None]
            new = np.where(seen, np.nan_to_num(data.y[:, k]) - mean @ self.read.T, 0.0)
            cross = spread @ read.transpose(0, 2, 1)
            total = read @ cross
            total[:, own, own] += np.where(seen, white, 1.0)
            inverse = np.linalg.inv(total)
            weighed = (inverse @ new[..., None])[..., 0]
            volume = np.linalg.slogdet(total)[1] + seen.sum(axis=1) * np.log(2 * np.pi)
            score -= 0.5 * (volume + (new * weighed).sum(axis=1))
            step = self.step[:, k] if k < length else np.zeros((windows, n, n))
            gain = step @ cross @ inverse
            passed.append((read, weighed, inverse, gain, step, seen))
            if k == length:
                break
            mean = (step @ mean[..., None] + gain @ new[..., None])[..., 0]
            mean[:, :n2] -= data.defect[:, k]
            spread = step @ (spread - cross @ inverse @ cross.transpose(0, 2, 1))
            spread = spread @ step.transpose(0, 2, 1)
            spread = 0.5 * (spread + spread.transpose(0, 2, 1))
            spread[:, range(n), range(n)] += fresh
        return passed, score

    def _smoothed(self, passed: list[_Passed]) -> tuple[Floats, Floats, Floats]:
        """Slopes of the likelihood by the variances of white noise [ny], of what drives each
        autoregression, and of its start, both [n - 2 nv]."""
        ny, n, n2 = self.ny, self.n, self.n2
        windows = len(self.data.defect)
        by_white, by_fresh = np.zeros(ny), np.zeros(n)
        r, information = np.zeros((windows, n)), np.zeros((windows, n, n))
        diagonal = np.arange(n)
        for k, (read, weighed, inverse, gain, step, seen) in reversed(list(enumerate(passed))):
            if k + 1 < len(passed):
                by_fresh += 0.5 * (r**2 - information[:, diagonal, diagonal]).sum(axis=0)
            back = gain.transpose(0, 2, 1)
            u = weighed - (back @ r[..., None])[..., 0]
            doubt = (inverse + back @ information @ gain)[:, np.arange(ny), np.arange(ny)]
            by_white += 0.5 * ((u**2 - doubt) * seen).sum(axis=0)
            left = step - gain @ read
            turned = read.transpose(0, 2, 1)
            r = (turned @ weighed[..., None] + left.transpose(0, 2, 1) @ r[..., None])[..., 0]
            information = turned @ inverse @ read + left.transpose(0, 2, 1) @ information @ left
        by_start = 0.5 * (r**2 - information[:, diagonal, diagonal]).sum(axis=0)
        return by_white, by_fresh[n2:], by_start[n2:]
