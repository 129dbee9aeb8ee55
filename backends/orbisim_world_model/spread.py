"""`Spread`: how far off a rollout may be by now, carried along as a variance of each entity.

Errors of a rollout grow and shrink with what happens: a servo forgets them, a collision hands
them on and multiplies them. To first order the variance of an error obeys
s_i' = sum_j G_ij s_j + n_i; the gains G and the noise n are learned functions of the state and the
control, from rollouts of a finished model against the truth (see `spread_fitting`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import silu

from orbisim_world_model.entities import Entities
from orbisim_world_model.layout import Layout
from orbisim_world_model.network.inputs import Inputs, Sizes
from orbisim_world_model.rotation import conjugate, geodesic_distance, logarithm, multiply

LEVEL = 0.9
"""Of the intervals: the share that is to hold the truth."""
WIDTH = 48  # of the hidden layers, unless a checkpoint says otherwise
UNITS = (1e-3, 0.0174532925)
"""What variances are measured in: 1 mm and 1 degree, in SI units."""
_FLOOR = 1e-3
"""In `UNITS`: errors below a micrometre and a thousandth of a degree are not told apart."""
MOST_GAIN = 2.0
"""Of a variance in one step; one control step of a collision multiplies errors by less."""
_FAINT = -6.0
"""Bias of the gains from others: a variance of one reaches another at half a percent to begin."""
MOST = 1e8
"""Of a variance, (10 m)^2: from there on nothing is known."""
CARRIED = 3
"""Numbers that each entity's memory ends with: two variances, and the rollout's age in steps."""


class Spread(nn.Module):
    """One step of the variances of position and rotation errors, [B, K, 2] in squared `UNITS`.

    Args:
      sizes: of the features that the model gives.
      width: of the layers.
    """

    def __init__(self, sizes: Sizes, width: int = WIDTH) -> None:
        super().__init__()
        self.width = width
        given = sizes.robot + sizes.control + sizes.world
        self.robot = nn.Linear(given, width) if sizes.robot else None
        given = sizes.objects + sizes.attributes + sizes.world
        self.objects = nn.Linear(given, width) if sizes.many else None
        self.pair = nn.Linear(sizes.edges, width) if sizes.edges else None
        self.sender, self.mix = nn.Linear(width, width), nn.Linear(width, width)
        self.gain, self.noise = nn.Linear(width, 4), nn.Linear(2 * width, 2)
        nn.init.zeros_(self.gain.weight)
        nn.init.zeros_(self.gain.bias)
        nn.init.zeros_(self.noise.weight)
        nn.init.constant_(self.noise.bias, -6.0)
        # a variance begins as that of its own kind and entity alone
        own = torch.tensor([0.0, _FAINT, _FAINT, 0.0])
        count = sizes.tokens
        start = torch.full((count, count, 4), _FAINT)
        start[torch.arange(count), torch.arange(count)] = own
        self.register_buffer("start", start, persistent=False)

    def forward(self, inputs: Inputs, variance: Tensor) -> Tensor:
        """The variances [B, K, 2] after the step that these features describe."""
        return propagated(*self.rates(inputs), variance)

    def rates(self, inputs: Inputs) -> tuple[Tensor, Tensor]:
        """Gains [B, K, K, 2, 2] and noise [B, K, 2]; a gain is onto i, from j, onto, from."""
        token = self._tokens(inputs)
        pair = silu(token)[:, :, None] + self.sender(silu(token))[:, None]
        if self.pair is not None:
            pair = pair + self.pair(inputs.edges)
        pair = silu(self.mix(silu(pair)))  # [B, K, K, width]
        gain = MOST_GAIN * torch.sigmoid(self.gain(pair) + self.start)
        seen = torch.cat([silu(token), pair.sum(2)], dim=-1)
        noise = self.noise(seen).clamp(-20.0, 10.0).exp()
        return gain.unflatten(-1, (2, 2)), noise

    def _tokens(self, inputs: Inputs) -> Tensor:
        world, parts = inputs.world, []
        if self.robot is not None:
            parts.append(self.robot(torch.cat([inputs.robot, inputs.control, world], -1))[:, None])
        if self.objects is not None:
            spread = world[:, None].expand(-1, inputs.attributes.shape[1], -1)
            seen = torch.cat([inputs.objects, inputs.attributes, spread], dim=-1)
            parts.append(self.objects(seen))
        return parts[0] if len(parts) == 1 else torch.cat(parts, dim=1)


def propagated(gain: Tensor, noise: Tensor, variance: Tensor) -> Tensor:
    """s_i' = sum_j G_ij s_j + n_i, [B, K, 2]."""
    sent = (gain * variance[:, None, :, None, :]).sum(-1).sum(2)
    return (sent + noise).clamp(max=MOST)


class Factors(NamedTuple):
    """By how much standard deviations are multiplied to become half-widths of intervals.

    Errors grow faster along a rollout than the variances say, and how much faster is measured at
    some ages of rollouts. Between these a factor is linear in the logarithm of the age; before the
    first and after the last it is constant.

    Attributes:
      steps: [n] the ages, rising. values: [n, K, 2] of each entity's position and rotation.
    """

    steps: Tensor
    values: Tensor

    def at(self, age: Tensor) -> Tensor:
        """Factors [..., K, 2] of entities whose rollouts are so many steps old [..., K]."""
        known = self.steps.to(age.device, age.dtype).log()
        values = self.values.to(age.device, age.dtype)
        way = age.clamp_min(1.0).log()[..., None] - known[:-1]  # [..., K, n - 1]
        share = (way / known.diff()).clamp(0.0, 1.0)
        return values[0] + torch.einsum("...kn,nkq->...kq", share, values.diff(dim=0))

    @property
    def largest(self) -> Tensor:
        """[K, 2] at any age."""
        return self.values.amax(0)


def half_widths(carried: Tensor, factors: Factors) -> Tensor:
    """Half-widths [..., K, 2] of intervals, m and rad, from what a memory carries [..., K, 3]."""
    widths = deviation(carried[..., :2]) * factors.at(carried[..., 2])
    return widths * carried.new_tensor(UNITS)


def factors_of(known: Mapping[str, Any], layout: Layout) -> Factors:
    """The factors of a manifest's `factor`, for the entities of a layout."""
    robots, count = int(layout.has_robot), len(layout.objects)
    rows = [
        [*[robot] * robots, *[objects] * count]
        for robot, objects in zip(known["robot"], known["objects"], strict=True)
    ]
    return Factors(torch.tensor(known["steps"], dtype=torch.float32), torch.tensor(rows))


def deviation(variance: Tensor) -> Tensor:
    """Standard deviations in `UNITS`."""
    return (variance + _FLOOR**2).sqrt()


def true_errors(predicted: Entities, truth: Entities, layout: Layout) -> Tensor:
    """Position and rotation errors [..., K, 2] of each entity, in `UNITS`.

    A robot's are its hand's; without a hand, the root mean square over its joints' positions and
    velocities (hinges: 1e-3 rad and 0.0175 rad/s).
    """
    parts = []
    if layout.hand:
        turn = geodesic_distance(predicted.hand_rot, truth.hand_rot)
        place = (predicted.hand_pos - truth.hand_pos).norm(dim=-1)
        parts.append(torch.stack([place, turn], -1)[..., None, :])
    elif layout.has_robot:
        rows = [(a - b).square().mean(-1).sqrt() for a, b in
                ((predicted.q, truth.q), (predicted.v, truth.v))]  # fmt: skip
        parts.append(torch.stack(rows, -1)[..., None, :])
    if layout.objects:
        turn = logarithm(multiply(predicted.quat, conjugate(truth.quat))).norm(dim=-1)
        place = (predicted.pos - truth.pos).norm(dim=-1)
        parts.append(torch.stack([place, turn], -1))
    return torch.cat(parts, dim=-2) / torch.tensor(UNITS, device=predicted.pos.device)
