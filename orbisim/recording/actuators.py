"""The actuators of a model by name, with the controls that they read."""

from __future__ import annotations

import dataclasses

import mujoco

_OF_JOINT = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))


@dataclasses.dataclass(frozen=True)
class Actuator:
    """An actuator.

    Attributes:
      id: its number. name: its name, empty if it has none.
      ctrl: its slice of ctrl; empty for one that reads no control (friction models).
      joint: number of the joint that it acts on; -1 for other transmissions.
    """

    id: int
    name: str
    ctrl: slice
    joint: int

    @property
    def label(self) -> str:
        """Its name, or `#number`."""
        return self.name or f"#{self.id}"

    @property
    def driven(self) -> bool:
        """Whether it reads a control."""
        return bool(self.ctrl.stop > self.ctrl.start)


def actuators(model: mujoco.MjModel) -> tuple[Actuator, ...]:
    """All actuators in the model's order."""
    found = []
    for index in range(model.nactuator):
        start = int(model.actuator_ctrladr[index])
        ctrl = slice(start, start + int(model.actuator_ctrlnum[index]))
        on_joint = model.actuator_trntype[index] in _OF_JOINT
        joint = int(model.actuator_trnid[index, 0]) if on_joint else -1
        found.append(Actuator(index, model.actuator(index).name, ctrl, joint))
    return tuple(found)
