"""`--learn-rest`: a learned residual force where no effect explains what is left. It is no effect.

It is offered only where the verdict is `unexplained` or `partly_explained`, and kept only if it
lowers the error of free runs on windows that it was not trained on; held-out data only report.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from orbisim.backend import Backend
from orbisim.diagnosis.conclusion import Attribution
from orbisim.diagnosis.scoring import score
from orbisim.effects import find
from orbisim.effects.residual_network import Network, with_rest
from orbisim.evidence import counted, gain, independent_share
from orbisim.learned_rest.learning import (
    WithRest,
    joints_with_force,
    rest_data,
    trained_networks,
)
from orbisim.learned_rest.result import Rest
from orbisim.recording import Recording
from orbisim.scene import Scene
from orbisim.shooting.bench import Bench
from orbisim.shooting.fits import data_in
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.judge import Judge

Floats = npt.NDArray[np.float64]
Progress = Callable[[str], None]

_MOST_WINDOWS = 192
"""Of those a share is simulated for speed; more hardly change which is better."""


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
    data = rest_data(found.bench, hypothesis, found.after.windows, found.after.fit.start)
    chosen = joints_with_force(data, hypothesis)
    if not chosen:
        return Rest("no force at any joint would lower the residual")
    trained = trained_networks(data, hypothesis, chosen, seed)
    if trained is None:
        return Rest("no network lowers the residual on windows that it was not trained on")
    added = WithRest(hypothesis.effects, hypothesis.frozen, hypothesis.factors, trained.networks)
    if not _better(dataclasses.replace(found.bench, fit=found.bench.check), hypothesis, added)[0]:
        return Rest("it does not lower the residual of free runs on windows it was not trained on")
    say("what the learned force does on held-out data")
    error = _errors(hypothesis, trained.networks, augmented, fit_set, held_out, window, backend)
    ratio = _better(unseen, hypothesis, added)[1]
    scene = with_rest(augmented, trained.networks)
    reason = "it lowers the error on windows that it was not trained on"
    return Rest(reason, trained.networks, scene, ratio, error)


def _better(bench: Bench, hypothesis: Hypothesis, added: WithRest) -> tuple[bool, dict[str, float]]:
    """Whether free runs surely get better on windows; residual over noise without and with it."""
    judge = Judge(bench, bench.intervals, most=_MOST_WINDOWS)
    fits = [judge.score(one) for one in (hypothesis, added)]
    means = [fit.per_window / np.maximum(judge.fitted.data, 1) for fit in fits]
    share = independent_share(fits[1].courses(judge.fitted.windows.length))
    sure = gain(means[0], means[1], counted(data_in([fits[1]]), share)).sure > 0
    without, with_it = (float(np.sqrt(part.mean())) for part in means)
    return sure, {"without": without, "with": with_it}


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
