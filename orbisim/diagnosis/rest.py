"""`--learn-rest`: a learned residual force where no effect explains what is left. It is no effect.

It is offered only where the verdict is `unexplained` or `partly_explained`, and kept only if it
lowers the error of free runs on windows that it was not trained on; held-out data only report.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from orbisim.backend import Backend
from orbisim.diagnosis.along import along
from orbisim.diagnosis.bench import Bench, Hypothesis
from orbisim.diagnosis.conclusion import Attribution
from orbisim.diagnosis.refine import Judge
from orbisim.diagnosis.regress import fit, normal_equations, total
from orbisim.diagnosis.response import affordable, responses
from orbisim.diagnosis.rest_training import Trained, own_inputs, speed_inputs, train, tree_inputs
from orbisim.diagnosis.scoring import score
from orbisim.diagnosis.screening import missing_force
from orbisim.effects import find
from orbisim.effects.residual_network import Network, with_rest
from orbisim.effects.screening import Column
from orbisim.motion.linear import Intervals, linearize
from orbisim.recording import Recording
from orbisim.recording.joints import Joint, joints
from orbisim.scene import Scene

Floats = npt.NDArray[np.float64]
Progress = Callable[[str], None]

FOLDER = "augmented_with_rest"
LABEL = (
    "A small neural network fitted to the force that is left. It is not a physical effect, "
    "explains nothing, and holds only near the motion it was trained on."
)
_SHARE = 0.05
_GAIN = 0.1
_CERTAINTY = 2.0
_SIMPLER = 0.9
_MOST_WINDOWS = 96
_TYPICAL = 1.5
"""Root mean square over median of a normal variable; impacts do not change a median."""


@dataclasses.dataclass(frozen=True, eq=False)
class Rest:
    """A learned residual force, or why there is none.

    Attributes:
      reason: why it is kept, or why not.
      networks: one for each joint with a force; none if it is not kept.
      scene: the augmented scene with them; None if there are none.
      ratio: residual over noise on held-out data, window starts fitted, `without` and `with`.
      error: free-running error `without` and `with`, of `fit` and `held_out`, as in the report.
    """

    reason: str
    networks: tuple[Network, ...] = ()
    scene: Scene | None = None
    ratio: Mapping[str, float] = dataclasses.field(default_factory=dict)
    error: Mapping[str, Mapping[str, float]] = dataclasses.field(default_factory=dict)

    @property
    def parameters(self) -> int:
        """Number of weights and biases."""
        return sum(w.size + b.size for network in self.networks for w, b in network.layers)

    def to_json(self) -> dict[str, Any]:
        """As it stands in report.json."""
        return {
            "kept": self.scene is not None,
            "label": LABEL,
            "reason": self.reason,
            "joints": [network.joint for network in self.networks],
            "inputs": {
                n.joint: [f"{one.source} {one.name}" for one in n.inputs] for n in self.networks
            },
            "parameters": self.parameters,
            "ratio_to_noise": dict(self.ratio),
            "error": {kind: dict(values) for kind, values in self.error.items()},
            "scene": None if self.scene is None else f"{FOLDER}/scene.xml",
        }


@dataclasses.dataclass(frozen=True)
class _WithRest(Hypothesis):
    """A hypothesis with learned forces on top."""

    networks: tuple[Network, ...] = ()

    def scene(self, declared: Scene) -> Scene:
        """The scene of the hypothesis with the learned forces."""
        return with_rest(super().scene(declared), self.networks)


def learn_rest(
    found: Attribution,
    verdict: str,
    augmented: Scene,
    fit_set: Sequence[Recording],
    held_out: Sequence[Recording],
    window: float,
    backend: str | Backend = "mujoco",
    *,
    unseen: Bench,
    seed: int = 0,
    say: Progress = lambda _: None,
) -> Rest:
    """Fits a residual force to what a diagnosis has left over, and keeps it if it helps.

    Args:
      found: the search. verdict: on the motion. augmented: the scene with what was found.
      fit_set, held_out: recordings. window: duration of free runs, s.
      backend: what the free-running errors are computed with.
      unseen: windows of the held-out recordings. seed: of the first weights.

    Raises:
      MissingDependencyError: torch is not installed.
    """
    if verdict not in ("unexplained", "partly_explained"):
        return Rest(f"nothing to learn: the verdict on the motion is {verdict}")
    say("learning what is left")
    hypothesis = found.after.hypothesis
    data = _data(found)
    chosen = _where(data, hypothesis)
    if not chosen:
        return Rest("no force at any joint would lower the residual")
    trained = _trained(data, hypothesis, chosen, seed)
    if trained is None:
        return Rest("no network lowers the residual on windows that it was not trained on")
    added = _WithRest(hypothesis.effects, hypothesis.frozen, hypothesis.factors, trained.networks)
    if not _better(dataclasses.replace(found.bench, fit=found.bench.check), hypothesis, added)[0]:
        return Rest("it does not lower the residual of free runs on windows it was not trained on")
    say("what the learned force does on held-out data")
    error = _errors(hypothesis, trained.networks, augmented, fit_set, held_out, window, backend)
    ratio = _better(unseen, hypothesis, added)[1]
    scene = with_rest(augmented, trained.networks)
    reason = "it lowers the error on windows that it was not trained on"
    return Rest(reason, trained.networks, scene, ratio, error)


@dataclasses.dataclass(frozen=True, eq=False)
class _Data:
    """What is learned from.

    Attributes:
      bench: the windows. intervals: the linear system along them.
      force: [N, nv] a rough guess of the force that is missing over each interval.
    """

    bench: Bench
    intervals: Intervals
    force: Floats


def _data(found: Attribution) -> _Data:
    """The data along the hypothesis; with contacts, along its own free runs."""
    bench, hypothesis = found.bench, found.after.hypothesis
    intervals = linearize(bench.flow(hypothesis))
    force = _smoothed(missing_force(intervals))
    runs = along(bench, found.after) if bench.contacts else None
    if runs is None:
        return _Data(bench, intervals, force)
    local, numbers = runs
    check = np.arange(len(local.windows)) % 3 == 1
    local = dataclasses.replace(local, fit=~check, check=check)
    return _Data(local, local.intervals, force[numbers])


def _smoothed(force: Floats) -> Floats:
    """Averaged over a few intervals."""
    kernel = np.ones(_SMOOTH) / _SMOOTH
    known = np.nan_to_num(force)
    return np.stack([np.convolve(column, kernel, mode="same") for column in known.T], axis=1)


_SMOOTH = 7


def _where(data: _Data, hypothesis: Hypothesis) -> list[Joint]:
    """Joints at which a slow missing force by itself would take away some of the residual."""
    bench, intervals, force = data.bench, data.intervals, data.force
    nv = force.shape[1]
    columns = []
    for dof in range(nv):
        values = np.zeros((2 * len(force), nv))
        values[: len(force), dof] = values[len(force) :, dof] = force[:, dof]
        columns.append(Column("force", values))
    known = bench.known_signal(hypothesis)
    windows = bench.windows.some(bench.fit)
    normal = total(normal_equations(bench.samples, intervals, windows, columns, bench.noise, known))
    gains = np.array([max(normal.square - fit(normal, [d])[1], 0.0) for d in range(nv)])
    every = joints(bench.scene.model)
    whole = max(float(gains.sum()), 1e-300)
    return [joint for joint in every if gains[joint.v].sum() > _SHARE * whole]


def _trained(data: _Data, hypothesis: Hypothesis, chosen: list[Joint], seed: int) -> Trained | None:
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


def _better(
    bench: Bench, hypothesis: Hypothesis, added: _WithRest
) -> tuple[bool, dict[str, float]]:
    """Whether free runs get better on check windows, by enough and surely; residual over noise."""
    judge = Judge(bench, bench.intervals, most=2 * _MOST_WINDOWS)
    means = [
        np.asarray(judge.score(one, judge.check).per_window / np.maximum(judge.check.data, 1))
        for one in (hypothesis, added)
    ]
    drop = means[0] - means[1]
    certain = float(drop.mean()) > _CERTAINTY * float(drop.std()) / np.sqrt(len(drop))
    excess = max(float(means[0].mean()) - 1.0, 0.0)
    ratio = {
        name: float(np.sqrt(part.mean()))
        for name, part in zip(("without", "with"), means, strict=True)
    }
    typical = float(np.median(means[0]) - np.median(means[1]))
    return bool(drop.mean() > _GAIN * excess and (certain or typical > _GAIN * excess)), ratio


def _errors(
    hypothesis: Hypothesis,
    networks: Sequence[Network],
    augmented: Scene,
    fit_set: Sequence[Recording],
    held_out: Sequence[Recording],
    window: float,
    backend: str | Backend,
) -> dict[str, dict[str, float]]:
    """Free-running error of the augmented scene without and with the learned force."""
    measuring = [e for e in hypothesis.effects if find(e.effect).measurement]
    scenes = {"without": augmented, "with": with_rest(augmented, networks)}
    return {
        kind: {
            name: score(scene, list(data), window, measuring, backend).rms
            for name, scene in scenes.items()
        }
        for kind, data in (("fit", fit_set), ("held_out", held_out))
    }
