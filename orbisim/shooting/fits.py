"""What a fit is told and what it finds."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Fit:
    """A fit of parameters and starts.

    Attributes:
      values: the parameters. start: [W, 2 nv] deviations at the windows' starts.
      square: sum of squared weighted residuals, large ones limited if the fit is robust.
      count: data minus fitted numbers.
      covariance: [P, P] of the parameters, by the Jacobian.
      residual: [W, data] weighted. per_window: [W] its parts.
      information: [W, P, P] and score [W, P]: each window's share, for the bootstrap.
      prior: [P, P] what priors say of the parameters, in the units of information; zero if None.
      recording: [W] the number of the recording that each window lies in; None if not known.
    """

    values: Floats
    start: Floats
    square: float
    count: int
    covariance: Floats
    residual: Floats
    per_window: Floats
    information: Floats
    score: Floats
    recording: npt.NDArray[np.int64] | None = None
    prior: Floats | None = None

    def courses(self, length: int) -> list[Floats]:
        """What is left of each signal in each window of so many intervals."""
        course = self.residual.reshape(len(self.residual), length + 1, -1)
        return [one for window in course for one in window.T]

    def held(self, own: Sequence[int], neutral: Sequence[float], gone: Sequence[int]) -> Fit:
        """With some numbers at given values, the others moved as the covariance tells.

        Args:
          own: which numbers. neutral: their values. gone: numbers that are not there then.
        """
        c, index = np.nan_to_num(self.covariance), list(own)
        moved = c[:, index] @ np.linalg.pinv(c[np.ix_(index, index)], rcond=1e-12, hermitian=True)
        kept = np.setdiff1d(np.arange(len(self.values)), gone)
        both = np.ix_(kept, kept)
        return dataclasses.replace(
            self,
            values=(self.values - moved @ (self.values[index] - np.array(neutral)))[kept],
            covariance=(c - moved @ c[index])[both],
            information=self.information[:, both[0], both[1]],
            score=self.score[:, kept],
            prior=None if self.prior is None else self.prior[both],
        )


def data_in(fits: Sequence[Fit]) -> Floats:
    """[B]: number of data of each window of some fits."""
    return np.concatenate([(fit.residual != 0).sum(axis=1) for fit in fits]).astype(np.float64)


@dataclasses.dataclass(frozen=True)
class Unknown:
    """One fitted number.

    Attributes:
      name: for messages. start: where to begin. low, high: bounds. step: for differences.
      widest: for differences where impacts leave less known; the step if None.
      centre, precision: of a Gaussian prior; precision 0 for none.
      stepwise: see `Effect.stepwise`: derivatives say nothing of another place.
    """

    name: str
    start: float
    low: float
    high: float
    step: float
    centre: float = 0.0
    precision: float = 0.0
    widest: float | None = None
    stepwise: bool = False

    def step_from(self, value: float, step: float | None = None) -> float:
        """The difference step (or another), backwards where forwards would leave the bounds, and
        no wider than there is room."""
        step = self.step if step is None else step
        if value + step <= self.high:
            return step
        return -min(step, value - self.low) if value - self.low > self.step else -self.step

    def ran_off(self, value: float) -> bool:
        """Whether a fit went to a bound that only says how far numbers go."""
        return not self.low < value < self.high and abs(value) >= FAR


WEAK = 1e-7
"""Share of the change by the parameter that changes the data most which is no change."""
FAR = 1e5
"""Size from which on a bound says no more than how far numbers go."""


@dataclasses.dataclass(frozen=True, eq=False)
class Hints:
    """Approximate derivatives of the weighted data.

    Attributes:
      free: [W, data, 2 nv] by the window starts, or None.
      slopes: [W, data] by the unknown of that number.
      exact: whether derivatives by the starts are taken anew in every iteration (contacts).
      rough: whether `free` holds only at first (contacts).
      quick: whether to do without starting badly fitting windows anew (contacts), and without
        information, score and covariance.
      near: whether windows begin where they are told to, and other starts are not tried (contacts).
      lenient: mean square of a window beyond which it counts less and less for the unknowns, in
        units of what is typical of windows, at least the noise (contacts); 0 if all count alike.
    """

    free: Floats | None = None
    slopes: Mapping[int, Floats] = dataclasses.field(default_factory=dict)
    exact: bool = False
    rough: bool = False
    quick: bool = False
    near: bool = False
    lenient: float = 0.0

    def some(self, which: npt.NDArray[np.int64]) -> Hints:
        """Of the windows of these numbers."""
        return dataclasses.replace(
            self,
            free=None if self.free is None else self.free[which],
            slopes={k: one[which] for k, one in self.slopes.items()},
        )


NOTHING = Hints()
"""No derivative is known."""
