"""What became of a learned rest."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from orbisim.effects.residual_network import Network
from orbisim.scene import Scene

FOLDER = "augmented_with_rest"
LABEL = (
    "A small neural network fitted to the force that is left. It is not a physical effect, "
    "explains nothing, and holds only near the motion it was trained on."
)


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
