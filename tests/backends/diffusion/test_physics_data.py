"""Windows of episodes, and other densities and friction in a model's descriptors."""

from __future__ import annotations

import pytest
import torch
from orbisim_diffusion.physics import FRAMES
from orbisim_diffusion.physics_data import Noise, Windows, changed, densities, frictions, usable
from orbisim_world_model.pack import Pack
from orbisim_world_model.packing import read_data
from orbisim_world_model.properties import with_object, with_world

from orbisim.errors import InputError
from orbisim.tasks.collect import collect


@pytest.fixture(scope="module")
def pack(tmp_path_factory: pytest.TempPathFactory) -> Pack:
    path = tmp_path_factory.mktemp("data") / "push.h5"
    collect("push", path, episodes=3, workers=1, seed=4)
    return usable(read_data([path]))


def test_values_go_where_the_scene_has_them(pack: Pack) -> None:
    density, friction = densities(pack), frictions(pack)
    assert ((density >= 150.0 - 1) & (density <= 900.0 + 1)).all()
    assert ((friction >= 0.2 - 1e-6) & (friction <= 0.6 + 1e-6)).all()
    context = pack.context(torch.arange(3))
    same = changed(context, pack, torch.cat([friction[:, None], density], dim=1))
    torch.testing.assert_close(same.attributes, context.attributes)
    torch.testing.assert_close(same.world, context.world)
    values = torch.tensor([[0.31, 200.0, 700.0]]).expand(3, 3).clone().requires_grad_()
    other = changed(context, pack, values)
    rows = with_object(context.attributes, pack.layout, "cube1", {"density": 200.0})
    rows = with_object(rows, pack.layout, "cube2", {"density": 700.0})
    torch.testing.assert_close(other.attributes, rows)
    torch.testing.assert_close(
        other.world, with_world(context.world, pack.layout, {"friction_slide": 0.31})
    )
    (other.attributes.sum() + other.world.sum()).backward()
    assert values.grad is not None and (values.grad > 0).all()


def test_windows_lie_within_episodes(pack: Pack) -> None:
    windows = Windows(pack)
    truth = windows.draw(200)
    begin, end = pack.start[truth.episode], (pack.start + pack.length)[truth.episode]
    assert (truth.first >= begin).all() and (truth.first + FRAMES - 1 <= end).all()
    assert len(truth.episode.unique()) == 3
    every = windows.every(16)
    assert [int((every.episode == e).sum()) for e in range(3)] == [
        (int(n) - FRAMES + 1) // 16 + 1 for n in pack.length
    ]


def test_what_is_seen_is_the_episode_turned_with_errors_and_gaps(pack: Pack) -> None:
    torch.manual_seed(0)
    windows = Windows(pack)
    truth = windows.draw(64)
    exact, noisy = windows.seen(truth, noisy=False), windows.seen(truth)
    rows = pack.states(truth.first[:, None] + torch.arange(FRAMES))
    torch.testing.assert_close(exact.pos, rows.pos.unflatten(0, (64, FRAMES)))
    torch.testing.assert_close(exact.hand_pos, rows.hand_pos.unflatten(0, (64, FRAMES)))
    assert bool((exact.known == 1).all()) and 0.5 < float(noisy.known.mean()) < 1.0
    # a turn about the vertical keeps heights and distances, but for the errors
    off = (noisy.pos - exact.pos)[..., 2].abs().amax((1, 2))
    assert float((off < 1e-5).float().mean()) == pytest.approx(windows.noise.exact, abs=0.25)
    assert 1e-4 < float(off.median()) < 0.02 or float((off < 1e-5).float().mean()) > 0.5
    way = [(w.pos - w.hand_pos[:, :, None]).norm(dim=-1) for w in (exact, noisy)]
    assert float((way[0] - way[1]).abs().median()) < 0.005
    assert float((exact.pos[..., :2] - noisy.pos[..., :2]).abs().median()) > 0.02
    torch.testing.assert_close(noisy.quat.norm(dim=-1), torch.ones(64, FRAMES, 2))


def test_what_moves_is_read_worse_than_what_rests_and_errors_stay(pack: Pack) -> None:
    torch.manual_seed(0)
    plain = {"exact": 0.0, "offset": 0.0, "tilt": 0.0, "turn": 0.0}
    windows = Windows(pack, Noise(**plain))
    truth = windows.draw(256)
    exact, noisy = windows.seen(truth, noisy=False), windows.seen(truth)
    # turned about the vertical: lengths from where the hand is cannot tell, steps can
    way = (exact.pos[:, 1:] - exact.pos[:, :-1]).norm(dim=-1)
    height = (noisy.pos - exact.pos)[..., 2].abs()[:, 1:]
    rests, moves = height[way < 1e-5], height[way > 0.005]
    assert len(moves) > 200 and float(moves.median()) > 4.0 * float(rests.median())
    near = Windows(pack, Noise(**plain, stays=0.0)).seen(truth)
    steps = [
        (w.pos[:, 1:] - w.pos[:, :-1])[..., 2].abs()[way > 0.005].median() for w in (noisy, near)
    ]
    errors = [(w.pos - exact.pos)[:, 1:, :, 2].abs()[way > 0.005].median() for w in (noisy, near)]
    assert float(steps[0] / errors[0]) < 0.8 * float(steps[1] / errors[1])


def test_episodes_that_are_too_short_are_refused(pack: Pack) -> None:
    import dataclasses

    with pytest.raises(InputError, match="64 frames"):
        usable(dataclasses.replace(pack, length=torch.full_like(pack.length, 40)))
