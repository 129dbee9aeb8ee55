"""The hand's paths: continuous, and where the mechanism's parts are."""

from __future__ import annotations

import numpy as np

from orbisim import tasks
from orbisim.tasks.arm import pointing_down
from orbisim.tasks.mechanism import MechanismTask
from orbisim.tasks.mechanisms.operating import Manner, Operator
from orbisim.tasks.motion import CLOSED, Follow
from orbisim.tasks.staging import Stage

START = np.array([0.36, 0.0, 0.42])


def test_a_path_begins_at_rest_and_has_no_jumps() -> None:
    task = tasks.make("mechanism:door")
    assert isinstance(task, MechanismTask)
    door = task.instance(None, None)
    stage = Stage(task.scene().model)
    manner = Manner(speed=0.3, turning=1.0, step=0.05)
    rot = pointing_down(door.yaw)
    plan = list(Operator(stage, "door_", manner, START, rot).plan(door))
    paths = [segment for segment in plan if isinstance(segment, Follow)]
    pos = np.concatenate([START[None], *(path.pos for path in paths)])
    steps = np.linalg.norm(np.diff(pos, axis=0), axis=1)
    assert steps.max() < 1.1 * 0.3 * 0.05
    assert steps[0] < 0.2 * steps.max()
    turns = np.concatenate([rot[None], *(path.rot for path in paths)])
    cosine = (np.einsum("tij,tij->t", turns[1:], turns[:-1]) - 1) / 2
    assert np.arccos(np.clip(cosine, -1, 1)).max() < 1.6 * 1.0 * 0.05
    assert any(getattr(segment, "grip", None) == CLOSED for segment in plan)
    assert pos[-1, 0] < pos[len(paths[0].pos) + len(paths[1].pos), 0] - 0.03  # it was pulled
