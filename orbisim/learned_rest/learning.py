"""Networks for the force that a hypothesis leaves, by the windows that it was fitted to."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import numpy.typing as npt

from orbisim.effects.residual_network import Network, with_rest
from orbisim.learned_rest.response import affordable, responses
from orbisim.learned_rest.training import Trained, own_inputs, speed_inputs, train, tree_inputs
from orbisim.motion.linear import Intervals, linearize, missing_force, smoothed_force
from orbisim.recording.joints import Joint, joints
from orbisim.scene import Scene
from orbisim.shooting.along import along
from orbisim.shooting.bench import Bench
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.regress import fit, force_columns, normal_equations, total
from orbisim.shooting.windows import Windows

Floats = npt.NDArray[np.float64]

_SHARE = 0.05
"""Share of what forces at all joints would explain from which on a joint gets a network."""
_SIMPLER = 0.9
"""Loss, over that of networks that read less, below which those that read more are taken."""
_TYPICAL = 1.5
"""Root mean square over median of a normal variable; impacts do not change a median."""


@dataclasses.dataclass(frozen=True)
class WithRest(Hypothesis):
    """A hypothesis with learned forces on top."""

    networks: tuple[Network, ...] = ()

    def scene(self, declared: Scene) -> Scene:
        """The scene of the hypothesis with the learned forces."""
        return with_rest(super().scene(declared), self.networks)


@dataclasses.dataclass(frozen=True, eq=False)
class RestData:
    """What is learned from.

    Attributes:
      bench: the windows. intervals: the linear system along them.
      force: [N, nv] a rough guess of the force that is missing over each interval.
    """

    bench: Bench
    intervals: Intervals
    force: Floats


def rest_data(bench: Bench, hypothesis: Hypothesis, windows: Windows, start: Floats) -> RestData:
    """The data along the hypothesis; with contacts, along its own free runs.

    Args:
      windows: those that the hypothesis was fitted to. start: [W, 2 nv] where they begin.
    """
    intervals = linearize(bench.flow(hypothesis))
    force = smoothed_force(missing_force(intervals))
    runs = along(bench, hypothesis, windows, start) if bench.contacts else None
    if runs is None:
        return RestData(bench, intervals, force)
    local, numbers = runs
    check = np.arange(len(local.windows)) % 3 == 1
    local = dataclasses.replace(local, fit=~check, check=check)
    return RestData(local, local.intervals, force[numbers])


def joints_with_force(data: RestData, hypothesis: Hypothesis) -> list[Joint]:
    """Joints at which a slow missing force by itself would take away some of the residual."""
    bench, intervals, force = data.bench, data.intervals, data.force
    columns = force_columns(force)
    known = bench.known_signal(hypothesis)
    windows = bench.windows.some(bench.fit)
    normal = total(normal_equations(bench.samples, intervals, windows, columns, bench.noise, known))
    gains = np.array([max(normal.square - fit(normal, [d])[1], 0.0) for d in range(len(columns))])
    every = joints(bench.scene.model)
    whole = max(float(gains.sum()), 1e-300)
    return [joint for joint in every if gains[joint.v].sum() > _SHARE * whole]


def trained_networks(
    data: RestData, hypothesis: Hypothesis, chosen: list[Joint], seed: int
) -> Trained | None:
    """Networks that read their joint's velocity, or all of their joint, or the whole tree: the more
    only if that is clearly better."""
    bench, intervals = data.bench, data.intervals
    flow, model = bench.flow(hypothesis), bench.scene.model
    dofs = np.concatenate([np.arange(j.v.start, j.v.stop) for j in chosen])
    windows = bench.windows
    some = affordable(windows, len(dofs))
    every = responses(bench, hypothesis, intervals, windows.some(some), dofs)
    apart = bench.check[some]
    size = np.maximum(_TYPICAL * np.median(np.abs(data.force[:, dofs]), axis=0), 1e-12)
    best: Trained | None = None
    tried: list[Any] = []
    for read in (speed_inputs, own_inputs, tree_inputs):
        inputs = [(joint, read(model, joint, flow)) for joint in chosen]
        if inputs in tried:
            continue
        tried.append(inputs)
        one = train(
            flow, inputs, every.some(~apart), every.some(apart), size,
            robust=bench.contacts, seed=seed,
        )  # fmt: skip
        if one.after < (one.before if best is None else _SIMPLER * best.after):
            best = one
    return best
