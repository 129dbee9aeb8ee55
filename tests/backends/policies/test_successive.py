from __future__ import annotations

import numpy as np
import torch
from orbisim_policies.push import PushProblem
from orbisim_policies.successive import SuccessiveEpisodes
from orbisim_policies.suite import SuiteProblem


def test_a_sparse_reward_comes_at_the_end_which_is_final(push: PushProblem) -> None:
    episodes = SuccessiveEpisodes(push, 2, push.draw([1, 2]), nthread=1)
    view = episodes.reset()
    for step in range(push.steps):
        turn = episodes.step(torch.tensor([[-1.0, 0.0, -1.0, 0.0]] * 2))
        last = step == push.steps - 1
        assert turn.done.all() == last and not turn.cut.any() and not turn.lost.any()
        assert (turn.reward > 0).any() <= last
    np.testing.assert_allclose(turn.reward, turn.parts.sum(1), rtol=1e-6)
    assert not torch.equal(turn.view, turn.last)  # the next episode's first, and this one's last
    assert turn.view.shape == view.shape
    episodes.close()


def test_episodes_go_on_from_a_state(cartpole: SuiteProblem) -> None:
    def made() -> SuccessiveEpisodes:
        episodes = SuccessiveEpisodes(cartpole, 2, cartpole.draw(range(4)), seed=3, nthread=1)
        episodes.reset()
        return episodes

    first, action = made(), torch.full((2, 1), 0.3)
    for _ in range(11):  # the second episode of eight steps
        first.step(action)
    kept = {name: tensor.clone() for name, tensor in first.state().items()}
    second = made()
    second.restore(kept)
    for _ in range(9):  # into the third
        one, other = first.step(action), second.step(action)
        assert torch.equal(one.view, other.view) and np.array_equal(one.reward, other.reward)
    first.close()
    second.close()
