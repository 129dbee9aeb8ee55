"""Rest by construction: a box that lies flat and is hardly moved stays exactly where it is.

A learned step is wrong by some micrometres, always in much the same direction, and a thousand
steps add them up. Dry friction does the opposite: what it holds does not creep. A box that slides
slower than friction's deceleration times the control step stops within that step, so that between
rest and motion there is a gap that no box without a push is in; `held` puts the boxes in it to
rest. Only what the network predicts decides whether a box is pushed: no contact is looked for.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from orbisim_world_model.entities import Context, Entities
from orbisim_world_model.layout import Layout
from orbisim_world_model.rotation import to_matrix

_SHARE = 0.01
"""Of the speed that a free fall gains in a control step (5 mm/s in 50 ms). Friction of 0.05 stops
five times that within the step; a box in free fall is past it after a hundredth of the step."""
_FLAT = 0.02
"""rad, largest tilt of a box that lies on a face."""


class Rest(nn.Module):
    """Keeps boxes at rest.

    Args:
      layout: with the sizes of boxes among the attributes, and gravity among the settings.
    """

    def __init__(self, layout: Layout) -> None:
        super().__init__()
        self.timestep = layout.timestep
        self._columns("sizes", layout.attributes, [f"half_{axis}" for axis in "xyz"])
        self._columns("box", layout.attributes, ["type_box"])
        self._columns("gravity", layout.settings, [f"gravity_{axis}" for axis in "xyz"])

    @staticmethod
    def suits(layout: Layout) -> bool:
        """Whether a layout has what is needed."""
        attributes = {"half_x", "half_y", "half_z", "type_box"}
        return attributes <= set(layout.attributes) and {
            f"gravity_{axis}" for axis in "xyz"
        } <= set(layout.settings)

    def forward(self, x: Entities, after: Entities, context: Context) -> Entities:
        """The predicted state with `held` boxes where they were."""
        still = self.held(x, after, context)[..., None]
        zero = torch.zeros_like(x.vel)
        return after._replace(
            pos=torch.where(still, x.pos, after.pos),
            quat=torch.where(still, x.quat, after.quat),
            vel=torch.where(still, zero, after.vel),
            ang=torch.where(still, zero, after.ang),
        )

    def held(self, x: Entities, after: Entities, context: Context) -> Tensor:
        """[B, N]: boxes that lie flat and move, before and after, no point faster than `_SHARE`."""
        slow = _SHARE * self.timestep * _length(context.world.index_select(1, self.gravity))
        slow = slow[:, None]  # [B, 1]
        reach = _length(context.attributes.index_select(2, self.sizes))  # [B, N]
        moved = _length(after.pos - x.pos) + reach * 2.0 * _length(after.quat - x.quat)
        before = _length(x.vel) + reach * _length(x.ang)
        later = _length(after.vel) + reach * _length(after.ang)
        up = to_matrix(x.quat)[..., 2, :].square()  # the vertical, by the box's axes
        flat = up.square().sum(-1) > 1.0 - 2.0 * _FLAT**2  # 1 - 2 tilt^2, near an axis
        box = context.attributes.index_select(2, self.box)[..., 0] > 0.5
        calm = (before < slow) & (later < slow) & (moved < slow * self.timestep)
        return calm & flat & box

    def _columns(self, name: str, known: tuple[str, ...], wanted: list[str]) -> None:
        index = torch.tensor([known.index(column) for column in wanted])
        self.register_buffer(name, index, persistent=False)


def _length(vector: Tensor) -> Tensor:
    return vector.square().sum(-1).sqrt()
