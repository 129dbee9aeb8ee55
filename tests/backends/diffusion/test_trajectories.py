"""TrajErr is that of the paper: nothing for the truth, and what each error adds."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from orbisim_diffusion.inference import Inferred
from orbisim_diffusion.trajectories import trajectory_errors, true_states

from tests.backends.diffusion.tiny import arm, store_of

EPISODES, HORIZON, STEP = 2, 4, 0.05


def _perfect() -> tuple[Inferred, object]:
    store = store_of(arm(), frames=HORIZON + 1, episodes=EPISODES)
    true = true_states(store, HORIZON)
    there = torch.where(true.there, 9.0, -9.0)
    parts = true.hand_pos, true.hand_rot, true.joints, there
    return Inferred(*parts, true.pos, true.rot, true.size, true.colour), true


def test_the_truth_has_no_error_and_a_shift_has_its_own() -> None:
    found, true = _perfect()
    assert trajectory_errors(found, true, EPISODES, STEP)["TrajErr"] == pytest.approx(0, abs=1e-3)
    shifted = found._replace(pos=found.pos + torch.tensor([0.3, 0.0, 0.0]))
    errors = trajectory_errors(shifted, true, EPISODES, STEP)
    assert errors["TrajErr"] == pytest.approx(0.5 * 0.3**2 / 3, abs=1e-4)  # no change of velocity
    assert errors["object_position_mm"] == pytest.approx(300, rel=1e-3)


def test_velocities_and_rotations_count() -> None:
    found, true = _perfect()
    times = torch.arange(EPISODES * HORIZON).remainder(HORIZON)
    drift = 0.4 * STEP * times[:, None] * torch.tensor([0.0, 1.0, 0.0])  # 0.4 m/s
    slid = trajectory_errors(found._replace(hand_pos=found.hand_pos + drift), true, EPISODES, STEP)
    places = 0.5 * drift.square().sum(-1).mean() / 3
    assert slid["TrajErr"] == pytest.approx(float(places) + 0.5 * 0.4**2 / 3, abs=1e-3)
    sine, cosine = np.sin(0.2), np.cos(0.2)
    turn = torch.tensor([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]], dtype=torch.float32)
    turned = trajectory_errors(found._replace(rot=found.rot @ turn), true, EPISODES, STEP)
    assert turned["TrajErr"] == pytest.approx(np.sin(0.1) ** 2, abs=1e-3)
    assert turned["object_rotation_deg"] == pytest.approx(np.degrees(0.2), abs=0.1)
