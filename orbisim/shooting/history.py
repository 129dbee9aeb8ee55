"""Joints that what is recorded cannot explain: they stand at one moment and move at another.

A lock whose release nobody recorded holds a joint still under a pull, and lets it go under less
pull from the same place later. No force that is a function of the recorded state does that, dry
friction included: what friction holds still under a pull it holds under less. So, for each hinge
and slide and each direction, moments are compared at which all recorded joints are at the same
places and as fast:

    stands: it stays where it is for `STILL`, although by the scene its acceleration would be at
      least a at each moment of that time;
    leaves: it was at rest for `STILL` and leaves, and by the scene its acceleration there is at
      most b.

a > b is a contradiction to every function of state; `MORE` times b is asked for, as controls may
lag and positions are noisy. A delay shorter than `STILL` contradicts nothing, and where bodies
touch, whose forces have a history of their own, nothing is said.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from orbisim.host.deadline import NEVER
from orbisim.recording.joints import Joint, joints
from orbisim.shooting.bench import Bench
from orbisim.shooting.hypothesis import Hypothesis

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

STILL = 0.15
"""s. Longer than delays and lags of drives usually are; short beside a hand's pauses."""
MORE = 1.2
"""Acceleration under which a joint stands over that under which it leaves."""
_SHOWS = 10.0
"""Standard deviations of the positions by which a joint leaves, or would have left."""
_SAME, _SAME_SHARE = 4.0, 0.01
"""Places are the same within so many standard deviations, or this share of the joint's travel."""
_SAME_SPEED = 0.25
"""... and velocities within this share of their root mean square."""
_ONSET = 2
"""Samples after the last at rest whose pull may have made a joint leave: smoothing blurs when."""
_FEWEST = 2
"""Times that it leaves so: one may be a force that a log has lost."""


@dataclasses.dataclass(frozen=True)
class HistoryDependent:
    """A joint that is not explained by any function of the recorded state.

    Attributes:
      joint: its label.
      stood, left: times at which it stood and left, s, and the number of the recording.
      ratio: the pull under which it stood over that under which it left, median over what
        contradicts, at most 1,000; of what is a function of the state at most 1.
    """

    joint: str
    stood: tuple[int, float]
    left: tuple[int, float]
    ratio: float

    @property
    def told(self) -> str:
        """In words."""
        (a, stood), (b, left) = self.stood, self.left
        return (
            f"{self.joint!r} is history-dependent: with all that is recorded the same it stands at "
            f"{stood:.2f} s{_of(a)} under {self.ratio:.3g} times the pull under which it moves at "
            f"{left:.2f} s{_of(b)}; something that is not recorded, such as a lock's release, "
            "decides"
        )


def _of(recording: int) -> str:
    return f" of recording {recording + 1}" if recording else ""


@dataclasses.dataclass(frozen=True, eq=False)
class _Course:
    """One recording, interval by interval.

    Attributes:
      time: [N]. q, v: [N, nv] positions (hinges and slides) and velocities. pull: [N, nv] the
        acceleration by the scene. whole: [N] whether the interval follows the one before.
    """

    time: Floats
    q: Floats
    v: Floats
    pull: Floats
    whole: Bools


@dataclasses.dataclass(frozen=True, eq=False)
class _Moment:
    """recording, time: where. q, v: [nv]. pull: in the direction in question."""

    recording: int
    time: float
    q: Floats
    v: Floats
    pull: float


def history_dependent(bench: Bench) -> tuple[HistoryDependent, ...]:
    """Joints whose motion contradicts every function of the recorded state.

    Args:
      bench: the recordings and the declared scene. That it lacks other forces which are functions
        of the state changes nothing: at the same place they add the same to both pulls.
    """
    if bench.contacts:
        return ()
    scalar = [joint for joint in joints(bench.scene.model) if joint.scalar]
    courses = _courses(bench)
    found = (_contradiction(joint, courses, bench) for joint in scalar)
    return tuple(one for one in found if one is not None)


def _courses(bench: Bench) -> list[_Course]:
    flow = dataclasses.replace(bench, deadline=NEVER).flow(Hypothesis())
    _, after = flow.advance()
    pull = (after - flow.qvel) / flow.duration[:, None]
    courses = []
    for number, sample in enumerate(bench.samples):
        rows = flow.recording == number
        row = flow.row[rows]
        nv = bench.scene.model.nv
        courses.append(
            _Course(
                flow.start[rows], sample.absolute[row, :nv], sample.qvel[row], pull[rows],
                np.diff(row, prepend=row[:1] - 1) == 1,
            )
        )  # fmt: skip
    return courses


def _contradiction(
    joint: Joint, courses: Sequence[_Course], bench: Bench
) -> HistoryDependent | None:
    """The joint, if it stands where something else says that it leaves."""
    dof = joint.v.start
    noise = np.nan_to_num(bench.samples[0].q_noise)
    every = np.concatenate([course.q for course in courses])
    near = np.maximum(_SAME * noise, _SAME_SHARE * np.ptp(every, axis=0))
    near[dof] = _SAME * noise[dof]
    speed = np.concatenate([course.v for course in courses])
    alike = _SAME_SPEED * np.sqrt(np.mean(speed**2, axis=0))
    alike[dof] = np.inf  # it is at rest in all of them
    against: list[tuple[float, _Moment, _Moment]] = []
    for sign in (1.0, -1.0):
        moments = [list(_moments(c, n, dof, sign, noise[dof])) for n, c in enumerate(courses)]
        stands = [one for each in moments for what, one in each if what == "stands"]
        for left in (one for each in moments for what, one in each if what == "leaves"):
            same = [
                one
                for one in stands
                if (np.abs(one.q - left.q) <= near).all()
                and (np.abs(one.v - left.v) <= alike).all()
            ]
            most = max(same, key=lambda one: one.pull, default=None)
            if most is not None and most.pull > MORE * max(left.pull, 0.0):
                against.append((most.pull / max(left.pull, 1e-3 * most.pull), most, left))
    if len(against) < _FEWEST:
        return None
    against.sort(key=lambda one: one[0])
    ratio, stood, left = against[len(against) // 2]
    return HistoryDependent(
        joint.label, (stood.recording, stood.time), (left.recording, left.time), float(ratio)
    )


def _moments(
    course: _Course, number: int, dof: int, sign: float, noise: float
) -> Iterator[tuple[str, _Moment]]:
    """Moments at which a joint stands under a pull in a direction, or leaves."""
    step = float(np.median(np.diff(course.time))) if len(course.time) > 1 else np.inf
    width = int(np.ceil(STILL / step))
    if width < 3 or len(course.time) < 3 * width:
        return
    q, pull = sign * course.q[:, dof], sign * course.pull[:, dof]
    shown = _SHOWS * noise
    would = 2 * shown / STILL**2
    windows = np.lib.stride_tricks.sliding_window_view
    whole = windows(course.whole, width).all(axis=1)
    rests = (np.ptp(windows(q, width), axis=1) <= 0.5 * shown) & whole
    least = windows(pull, width).min(axis=1)

    def moment(row: int, much: float) -> _Moment:
        return _Moment(number, float(course.time[row]), course.q[row], course.v[row], much)

    last = -width
    for first in np.flatnonzero(rests & (least > would)):
        if first - last >= width:  # one for each stretch as long
            last = int(first)
            yield "stands", moment(last + width // 2, float(least[first]))
    for first in np.flatnonzero(rests[:-1] & ~rests[1:]):
        end = int(first) + width  # the first row after the rest
        ahead = slice(end, end + width)
        gone = np.flatnonzero(q[ahead] - q[end - 1] > shown)
        if not len(gone) or not course.whole[ahead].all():
            continue
        yield "leaves", moment(end - 1, float(pull[first : end + _ONSET].max()))
