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
FREEDOM = 3.0
"""Degrees of freedom of Student's t, as which errors are distributed: those after contacts have
heavy tails."""
SURE = 0.99
"""Of the intervals that warnings go by: one failure in a hundred may come before a warning."""
WIDER = 2.4819
"""Times the half-width of an interval of `LEVEL`, one of `SURE` under that distribution: the
quantiles 5.8409 and 2.3534."""
WIDTH = 48  # of the hidden layers, unless a checkpoint says otherwise
UNITS = (1e-3, 0.0174532925)
"""What variances are measured in: 1 mm and 1 degree, in SI units."""
FLOOR = 0.05
"""In `UNITS`: errors below 50 micrometres and a twentieth of a degree are not told apart. Cubes at
rest are off by that much, in all ages of a rollout and whatever their variance; told apart, they
would decide how wide the intervals of all others are."""
_FORMER_FLOOR = 1e-3
"""Of checkpoints that do not say theirs."""
MOST_GAIN = 2.0
"""Of a variance in one step; one control step of a collision multiplies errors by less."""
_FAINT = -6.0
"""Bias of the gains from others: a variance of one reaches another at half a percent to begin."""
MOST = 1e8
"""Of a variance, (10 m)^2: from there on nothing is known."""


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


class Calibration(NamedTuple):
    """How the variances of a checkpoint become half-widths of intervals.

    Attributes:
      factors: [K, 2] by which standard deviations are multiplied. floor: of these, in `UNITS`.
    """

    factors: Tensor
    floor: float

    def half_widths(self, variance: Tensor) -> Tensor:
        """[..., K, 2] of position and rotation, m and rad."""
        widths = deviation(variance, self.floor) * self.factors.to(variance.device)
        return widths * variance.new_tensor(UNITS)

    def variances(self, width: Tensor) -> Tensor:
        """The variances [K, 2] of which these [2] are the half-widths, m and rad."""
        sizes = width / (self.factors * width.new_tensor(UNITS))
        return sizes.square() - self.floor**2


def calibration_of(uncertainty: Mapping[str, Any], layout: Layout) -> Calibration:
    """Of a manifest's `uncertainty`, for the entities of a layout."""
    known = uncertainty["factor"]
    rows = [known["robot"]] if layout.has_robot else []
    factors = torch.tensor([*rows, *[known["objects"]] * len(layout.objects)])
    return Calibration(factors, uncertainty.get("floor", _FORMER_FLOOR))


def deviation(variance: Tensor, floor: float = FLOOR) -> Tensor:
    """Standard deviations in `UNITS`."""
    return (variance + floor**2).sqrt()


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
