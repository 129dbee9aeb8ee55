"""Identification by mujoco.sysid: least squares on C MuJoCo's rollouts, by finite differences."""

from __future__ import annotations

import contextlib
import io
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from mujoco import sysid
from torch import Tensor

from orbisim.host.progress import status
from orbisim.identification.estimate import LARGE, Estimate, widths
from orbisim.identification.parameters import Parameter, patched
from orbisim.identification.residual import counted, errors
from orbisim.identification.windows import Grid
from orbisim.registry import make_backend
from orbisim.scene import Scene
from orbisim.state import State


def identify_classical(
    scene: Scene, parameters: Sequence[Parameter], grid: Grid, substeps: int, steps: int
) -> Estimate:
    """One problem with all windows; values are searched by their logarithm.

    Args:
      scene: as declared.
      parameters: to fit.
      grid: with steps of `substeps` timesteps.
      substeps: of the scene in a step of the grid.
      steps: of the search at most.
    """
    run = simulated(scene, parameters, grid, substeps)
    count = itertools.count(1)

    def residual(vector: np.ndarray, _: sysid.ParameterDict) -> tuple[list[np.ndarray], None, None]:
        say(f"simulation {next(count)}")
        return [(run(vector) / grid.ctrl.shape[1] ** 0.5).numpy().ravel()], None, None

    start = np.log([parameter.declared for parameter in parameters])
    # it prints each step, whatever it is told
    with contextlib.redirect_stdout(io.StringIO()), status("identifying") as say:
        result = _searched(parameters, start, residual, steps, {})
        left = run(result.x)
        size = max(1.0, 1.48 * float(left[left != 0].abs().median())) if left.any() else 1.0
        scale = LARGE * size / grid.ctrl.shape[1] ** 0.5
        robust = {"loss": "cauchy", "f_scale": scale}  # what is far off now is not believed
        result = _searched(parameters, result.x, residual, steps, robust)
    return around(run, parameters, np.ravel(result.x), grid, float(result.cost))


def simulated(
    scene: Scene, parameters: Sequence[Parameter], grid: Grid, substeps: int
) -> Callable[[np.ndarray], Tensor]:
    """From logarithms [P] of values to errors [windows, R] of C MuJoCo's rollouts, all finite."""
    joints, bodies = counted(scene.model, parameters)
    target, count = torch.as_tensor(grid.target), len(grid.qpos)

    def run(logarithms: np.ndarray) -> Tensor:
        values = np.exp(np.ravel(logarithms))
        edited = patched(scene, dict(zip(parameters, values, strict=True)))
        backend = make_backend("mujoco", edited, nworld=count)
        state = backend.reset(count).replace(qpos=grid.qpos, qvel=grid.qvel, act=grid.act)
        assert isinstance(state, State)
        path = backend.rollout(state, grid.ctrl, nstep=substeps, sensors=False)
        found = errors(torch.as_tensor(np.asarray(path.qpos)), target, joints, bodies)
        return found.nan_to_num(1e3, 1e3, -1e3)

    return run


def around(
    run: Callable[[np.ndarray], Tensor],
    parameters: Sequence[Parameter],
    logarithms: np.ndarray,
    grid: Grid,
    cost: float,
) -> Estimate:
    """The estimate at values that a search has found, with intervals."""
    z, left = torch.as_tensor(logarithms)[None], run(logarithms)
    slopes = torch.stack(
        [(run(logarithms + e) - left) / _STEP for e in _STEP * np.eye(len(logarithms))], -1
    )
    group = torch.zeros(len(grid.qpos), dtype=torch.long)
    width = widths(left, slopes.nan_to_num(0.0), z, group, grid.ctrl.shape[1])
    low, high = (
        torch.log(torch.tensor([getattr(p, end) for p in parameters], dtype=torch.float64))
        for end in ("low", "high")
    )
    below, above = ((z + sign * width).clamp(low, high).exp() for sign in (-1.0, 1.0))
    return Estimate(z.exp(), below, above, torch.tensor([[cost]]))


def _searched(
    parameters: Sequence[Parameter], start: Any, residual: Any, steps: int, options: Any
) -> Any:
    """What `mujoco.sysid.optimize` finds."""
    names = sysid.ParameterDict()
    for parameter, begin in zip(parameters, start, strict=True):
        low, high = np.log([parameter.low, parameter.high])
        inside = float(np.clip(begin, low, high))
        names.add(sysid.Parameter(parameter.label, inside, low, high))
    return sysid.optimize(
        names, residual, "scipy", verbose=False, max_iters=steps, diff_step=1e-2, **options
    )[1]


_STEP = 1e-2
"""Of a logarithm: contacts make smaller differences noisy."""
