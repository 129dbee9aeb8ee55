"""Training of a learned residual force on windows of recordings."""

from __future__ import annotations

import copy
import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.effects.residual_network import Input, Network, features
from orbisim.errors import MissingDependencyError
from orbisim.learned_rest.response import Responses
from orbisim.motion.linear import IntervalMap
from orbisim.recording.actuators import actuators
from orbisim.recording.joints import Joint, Kind, joints

Floats = npt.NDArray[np.float64]

_HIDDEN = (32, 32)
_ADAM = 200
"""Steps of Adam at most; `_PATIENCE` mostly ends them before."""
_LBFGS = 60
"""Steps of L-BFGS at most, of ten iterations each."""
_PATIENCE = 12
"""Looks at the check windows in a row without a gain after which the training ends."""
_RATE = 1e-2
"""Learning rate of Adam: inputs and forces are scaled to about one."""
_DECAY = 1e-5
"""Weight of squared weights beside a loss that begins at one: smooth where nothing was seen."""
_MARGIN = 0.05
"""Share of an input's range by which a network may be asked beyond what was seen."""
_ROUND = 4.0
"""Travel, rad, from which on a hinge without limits is taken to go round."""


@dataclasses.dataclass(frozen=True, eq=False)
class Trained:
    """Networks with their mean squared weighted residual on windows that only stopped the training.

    Attributes:
      networks: one for each joint. before, after: without and with them.
    """

    networks: tuple[Network, ...]
    before: float
    after: float


def speed_inputs(model: mujoco.MjModel, joint: Joint, flow: IntervalMap) -> tuple[Input, ...]:
    """A joint's own velocity."""
    return (Input("velocity", joint.label),)


def own_inputs(model: mujoco.MjModel, joint: Joint, flow: IntervalMap) -> tuple[Input, ...]:
    """A joint's own position, velocity and drive."""
    return _inputs(model, [joint], flow)


def tree_inputs(model: mujoco.MjModel, joint: Joint, flow: IntervalMap) -> tuple[Input, ...]:
    """Those of all joints of its kinematic tree."""
    root = model.body_rootid[joint.body]
    return _inputs(model, [j for j in joints(model) if model.body_rootid[j.body] == root], flow)


def _inputs(model: mujoco.MjModel, read: Sequence[Joint], flow: IntervalMap) -> tuple[Input, ...]:
    found: list[Input] = []
    for joint in read:
        if not joint.scalar:
            found.append(Input("pose", joint.label))
        elif _turns(model, joint, float(np.ptp(flow.qpos[:, joint.q]))):
            found.append(Input("turn", joint.label))
        else:
            found.append(Input("position", joint.label))
        found.append(Input("velocity", joint.label))
        if flow.force[:, joint.v].any():
            found.append(Input("force", joint.label))
    ids = {joint.id for joint in read}
    columns = {
        c for a in actuators(model) if a.joint in ids for c in range(a.ctrl.start, a.ctrl.stop)
    }
    columns |= {
        c for a in actuators(model) if a.joint < 0 for c in range(a.ctrl.start, a.ctrl.stop)
    }
    found += [Input("control", str(c)) for c in sorted(columns) if np.ptp(flow.ctrl[:, c]) > 0]
    return tuple(found)


def _turns(model: mujoco.MjModel, joint: Joint, travel: float) -> bool:
    """Whether a hinge goes round, so that only its angle matters."""
    return joint.kind == Kind.HINGE and not model.jnt_limited[joint.id] and travel > _ROUND


def train(
    flow: IntervalMap,
    chosen: Sequence[tuple[Joint, tuple[Input, ...]]],
    fit: Responses,
    check: Responses,
    size: Floats,
    *,
    robust: bool = False,
    seed: int = 0,
) -> Trained:
    """Trains one network for each joint, all together, by the windows' responses to their forces.

    Adam, then L-BFGS on the mean squared weighted residual of `fit`; the networks with the least on
    `check` are
    taken, and the training ends when that has not fallen for a while.

    Args:
      chosen: the joints, in the order of the responses' degrees of freedom, with what is read.
      size: [D] typical size of the missing force at each degree of freedom.
      robust: whether windows count by the logarithm of their residual (impacts).

    Raises:
      MissingDependencyError: torch is not installed.
    """
    torch = _torch()
    rng = torch.Generator().manual_seed(seed)
    blank = [_blank(flow, joint, inputs) for joint, inputs in chosen]
    read = [_read(flow, network) for network in blank]
    parts = np.split(size, np.cumsum([j.v.stop - j.v.start for j, _ in chosen])[:-1])
    nets = [
        _layers(torch, x.shape[-1], len(part), rng) for x, part in zip(read, parts, strict=True)
    ]
    sets = [_Set(torch, one, read, parts, robust) for one in (fit, check)]
    weights = [p for net in nets for layer in net for p in layer]
    keeper = _Keeper(sets[1], nets)
    before = keeper.least
    _descend(torch, sets[0], nets, weights, keeper)
    networks = [
        _filled(one, net, part) for one, net, part in zip(blank, keeper.best, parts, strict=True)
    ]
    return Trained(tuple(networks), before, keeper.least)


class _Keeper:
    """The networks with the least residual on windows that they are not trained on."""

    def __init__(self, check: _Set, nets: Any) -> None:
        self._check, self._nets, self._since = check, nets, 0
        self.best, self.least = copy.deepcopy(nets), float(check.loss(None))

    def enough(self) -> bool:
        """Looks at the networks; whether nothing has been gained for a while."""
        now = float(self._check.loss(self._nets).detach())
        self._since = 0 if now < 0.999 * self.least else self._since + 1
        if now < self.least:
            self.best, self.least = copy.deepcopy(self._nets), now
        return self._since > _PATIENCE


def _descend(torch: Any, fit: _Set, nets: Any, weights: list[Any], keeper: _Keeper) -> None:
    """Adam, which finds the way, then L-BFGS, which goes it to the end."""

    def loss() -> Any:
        optimizer.zero_grad()
        size = sum((p**2).sum() for net in nets for layer in net for p in layer[:1])
        value = fit.loss(nets) / scale + _DECAY * size
        value.backward()
        return value

    scale = max(float(fit.loss(None)), 1e-300)
    optimizer = torch.optim.Adam(weights, lr=_RATE)
    for step in range(_ADAM):
        optimizer.step(loss)
        if step % 10 == 9 and keeper.enough():
            return
    optimizer = torch.optim.LBFGS(
        weights, max_iter=10, history_size=30, line_search_fn="strong_wolfe"
    )
    for _ in range(_LBFGS):
        optimizer.step(loss)
        if keeper.enough():
            return


def _torch() -> Any:
    try:
        import torch
    except ImportError as error:
        raise MissingDependencyError("learn_rest", "learned", "no module 'torch'") from error
    return torch


def _blank(flow: IntervalMap, joint: Joint, inputs: tuple[Input, ...]) -> Network:
    """A network without layers, with the shift, scale and range of its inputs."""
    seen = features(flow.model, inputs, flow.qpos, flow.qvel, flow.ctrl, flow.force)
    centre, scale = seen.mean(axis=0), seen.std(axis=0)
    scale = np.where(scale > 1e-9, scale, 1.0)
    low, high = (seen.min(axis=0) - centre) / scale, (seen.max(axis=0) - centre) / scale
    spare = _MARGIN * (high - low)
    return Network(joint.label, inputs, centre, scale, low - spare, high + spare, ())


def _read(flow: IntervalMap, network: Network) -> Floats:
    """[2, N, F]: what a network reads at the starts and ends of all intervals, scaled."""
    ends = ((flow.qpos, flow.qvel), (flow.after_qpos, flow.after_qvel))
    both = [
        features(flow.model, network.inputs, qpos, qvel, flow.ctrl, flow.force)
        for qpos, qvel in ends
    ]
    return np.asarray(
        np.clip((np.stack(both) - network.centre) / network.scale, network.low, network.high)
    )


def _layers(torch: Any, width: int, outputs: int, rng: Any) -> list[list[Any]]:
    """Weights and biases that start with no force; the last are in units of its typical size."""
    shape = (width, *_HIDDEN, outputs)
    net = []
    for number, (inside, outside) in enumerate(itertools.pairwise(shape)):
        last = number == len(shape) - 2
        weight = torch.randn(inside, outside, generator=rng, dtype=torch.float64)
        weight = weight * (0.0 if last else 1 / math.sqrt(inside))
        bias = torch.zeros(outside, dtype=torch.float64)
        net.append([weight.requires_grad_(True), bias.requires_grad_(True)])
    return net


class _Set:
    """Windows with what the networks read in them."""

    def __init__(
        self,
        torch: Any,
        one: Responses,
        read: Sequence[Floats],
        sizes: Sequence[Floats],
        robust: bool,
    ) -> None:
        self._torch, self._robust = torch, robust
        self._gram, self._moment = torch.from_numpy(one.gram), torch.from_numpy(one.moment)
        self._square, self._count = torch.from_numpy(one.square), torch.from_numpy(one.count)
        last = read[0].shape[1] - 1
        number = np.minimum(one.number, last)
        self._read = [torch.from_numpy(np.ascontiguousarray(x[:, number])) for x in read]
        self._sizes = [torch.from_numpy(size) for size in sizes]
        mean = np.zeros((int(one.piece[-1]) + 1, len(one.piece)))
        mean[one.piece, np.arange(len(one.piece))] = 1.0
        self._mean = torch.from_numpy(mean / mean.sum(axis=1, keepdims=True))

    def loss(self, nets: Sequence[Any] | None) -> Any:
        """Mean squared weighted residual; without any force if None."""
        square = self._square
        if nets is not None:
            force = self._forces(nets)
            response = self._torch.einsum("wij,wj->wi", self._gram, force)
            square = square + (force * (response - 2 * self._moment)).sum(dim=1)
            square = square.clamp_min(0.0)
        if self._robust:
            return self._torch.log1p(square / self._count.clamp_min(1.0)).mean()
        return square.sum() / self._count.sum()

    def _forces(self, nets: Sequence[Any]) -> Any:
        """[W, P * D]."""
        found = []
        for net, x, size in zip(nets, self._read, self._sizes, strict=True):
            for weight, bias in net[:-1]:
                x = self._torch.tanh(x @ weight + bias)
            weight, bias = net[-1]
            found.append((x @ weight + bias).mean(dim=0) * size)
        pieces = self._torch.einsum("pk,wkd->wpd", self._mean, self._torch.cat(found, dim=2))
        return pieces.flatten(1)


def _filled(blank: Network, net: Sequence[Any], size: Floats) -> Network:
    layers = [tuple(p.detach().numpy().copy() for p in layer) for layer in net]
    weight, bias = layers[-1]
    layers[-1] = (weight * size, bias * size)
    return dataclasses.replace(blank, layers=tuple(layers))
