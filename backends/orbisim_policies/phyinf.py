"""PhyInf over many films at once: densities and friction from how what was read moves.

The same least squares through the frozen learned step as `orbisim identify` (paper, appendix B.3),
in one batch: a film is a problem, its windows of a second are its worlds.
"""

from __future__ import annotations

import dataclasses
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from orbisim.errors import InputError, RecordingError
from orbisim.identification.estimate import Estimate, estimate
from orbisim.identification.learned import Described, Simulation, bounds
from orbisim.identification.parameters import free_bodies, parameters
from orbisim.identification.windows import Grid, grid
from orbisim.recording import Recording, bind
from orbisim.registry import make_backend
from orbisim.replay import prepare
from orbisim_policies.films import Films
from orbisim_policies.learned import LearnedWorlds
from orbisim_policies.problem import Problem
from orbisim_policies.push import HIDDEN, PushProblem

WINDOW = 1.0
"""Of the free runs that are fitted, s, as `orbisim identify` has it."""
_MOVES = 0.02
"""m, that a body must move in a window for its density and the friction under it to show: several
times what a reading is off."""
_ENDS = 3
"""Frames at each end of a window over whose median the way of a body is taken."""
_STEPS = 12
"""Of the search, as `orbisim identify`."""
Ids = npt.NDArray[np.int64]


def inferred(problem: Problem, films: Films, checkpoint: str | Path | None, device: str) -> Films:
    """The films with parameters of their scenes as PhyInf finds them.

    What no window of a film shows stays nominal. The notes get how many films show something, and
    by how much percent, in the median, nominal and inferred values are off.

    Args:
      problem: on the CPU. films: of it.
      checkpoint: of the dynamics, see `LearnedWorlds`. device: where to compute.

    Raises:
      InputError: nothing of the problem's parameters can be inferred.
    """
    if not isinstance(problem, PushProblem):
        raise InputError(f"nothing can be inferred of the parameters of {problem.name}")
    windows, group = _windows(problem, films)
    found = np.array(films.params)
    columns = list(HIDDEN.values())
    if windows is not None:
        fitted = _fit(problem, films, windows, group, checkpoint, device)
        shown = np.unique(group)
        found[shown[:, None], columns] = fitted.values.cpu().numpy()
    true = problem.draw([int(seed) for seed in films.seeds]).params[:, columns]
    off = {
        name: {
            label: float(np.median(100 * np.abs(values[:, columns][:, i] / true[:, i] - 1)))
            for label, values in (("nominal", films.params), ("inferred", found))
        }
        for i, name in enumerate(HIDDEN)
    }
    notes = {"moving": len(np.unique(group)), "windows": len(group), "off_percent": off}
    return dataclasses.replace(films, params=found, notes={**films.notes, "phyinf": notes})


def _windows(problem: Problem, films: Films) -> tuple[Grid | None, Ids]:
    """Windows in which a body moves, if there are any, and the film [W] of each."""
    scene, step = problem.scene, problem.timestep
    model = scene.model
    starts = [int(model.joint(name).qposadr[0]) for name in free_bodies(model)]
    parts, group = [], []
    for number in range(len(films)):
        time = np.arange(films.qpos.shape[1]) * np.float64(step)
        signals = {"qpos": films.qpos[number], "ctrl": films.ctrl[number]}
        recording = Recording(time, signals, source=f"film {number}")
        try:
            found = grid([prepare(bind(recording, scene), WINDOW)], step)
        except RecordingError:  # shorter than a window, or nowhere a whole state
            continue
        for row in range(len(found.qpos)):
            path = found.target[row]
            way = [
                np.median(path[-_ENDS:, a : a + 2], 0) - np.median(path[:_ENDS, a : a + 2], 0)
                for a in starts
            ]
            if max(float(np.linalg.norm(one)) for one in way) > _MOVES:
                parts.append(tuple(getattr(found, f.name)[row] for f in dataclasses.fields(Grid)))
                group.append(number)
    if not parts:
        return None, np.zeros(0, int)
    return Grid(*(np.stack(column) for column in zip(*parts, strict=True))), np.array(group)


def _fit(
    problem: Problem,
    films: Films,
    windows: Grid,
    group: Ids,
    checkpoint: str | Path | None,
    device: str,
) -> Estimate:
    """Values [films shown, parameters], by the order of their first windows."""
    worlds = LearnedWorlds(problem.to(torch.device(device)), checkpoint, torch.device(device))
    shown, rank = np.unique(group, return_inverse=True)
    wanted = parameters(problem.scene, list(HIDDEN))
    nominal = films.params[shown][:, list(HIDDEN.values())]
    backend: Any = make_backend(
        f"learned:{worlds.folder}", problem.scene, device=device, compiled=False
    )
    starts = films.starts()
    pool = worlds.pool(starts)
    described = Described(backend, pool.attributes[torch.as_tensor(group, device=device)])
    run = Simulation(described, wanted, windows, device)
    ends = [bounds(described, parameter) for parameter in wanted]
    low, high = torch.tensor(ends, dtype=torch.float64, device=device).T
    start = torch.as_tensor(nominal, dtype=torch.float64, device=device)
    steps = windows.ctrl.shape[1]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of states far from the data: readings have outliers
        which = torch.as_tensor(rank, device=device)
        return estimate(run, start, (low, high), which, _STEPS, steps)
