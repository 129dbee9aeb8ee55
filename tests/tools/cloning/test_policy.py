"""Demonstrations of `task:stack`, what is learnt from them, and episodes played by a policy."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent.parent.parent.parent / "tools"))

from cloning import policy
from cloning.seen import turned
from cloning.world import Episode, play

from orbisim.tasks import EpisodeFile
from orbisim.tasks.arm import PANDA
from orbisim.tasks.collect import collect
from orbisim.tasks.stack import Stack

YAWS = np.linspace(-1.0, 1.0, 40).reshape(10, 4)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A few adapted episodes, whose pieces are not off."""
    path = tmp_path_factory.mktemp("stack") / "stack.h5"
    collect("stack", path, episodes=4, workers=1, subtask="adapted", changes={"noise": [0.0, 0.0]})
    return path


def test_what_is_told_is_where_the_tool_is_told_to_be_next(data: Path) -> None:
    lessons = policy.demonstrations(data, 1)
    seen = lessons.seen
    for ahead in (1, 4):
        np.testing.assert_array_equal(lessons.places[:-ahead, ahead - 1], seen.command[ahead:])
        np.testing.assert_array_equal(lessons.yaws[:-ahead, ahead - 1], seen.told[ahead:])
    assert np.abs(np.diff(seen.told)).max() <= PANDA.turn + 1e-6  # no jump of a whole turn
    assert seen.changes[-1] == 4
    assert (seen.grip[1:] > 0).tolist() == lessons.grips[:-1, 0].tolist()


def test_a_demonstration_that_is_followed_place_by_place_succeeds(data: Path) -> None:
    lessons = policy.demonstrations(data, 1)
    with EpisodeFile(data) as file:
        known = file.attributes(lessons.numbers[0])
    world = Episode(Stack(noise=(0.0, 0.0)), known["seed"], int(lessons.seen.source[0]))
    np.testing.assert_allclose(world.seen().cubes[0], lessons.seen.cubes[0], atol=1e-6)
    for place, yaw, close in zip(lessons.places, lessons.yaws, lessons.grips, strict=True):
        world.go(place[0], float(yaw[0]), bool(close[0]))
    assert world.success
    assert world.stacked == 2
    assert (world.changes, world.age) == (4, lessons.seen.age[-1] + 1)


def test_a_tool_that_has_strayed_is_told_the_same_places(data: Path) -> None:
    lessons = policy.demonstrations(data, 1)
    rng = np.random.default_rng(0)
    features, wanted = policy.lesson(lessons, 0.0, YAWS, rng)
    turn = lessons.seen.turn(YAWS)[:, None]
    from_tool = PANDA.reach * turned(wanted[..., :3].astype(float), turn)
    command = lessons.places - from_tool
    np.testing.assert_allclose(command, command[:, :1].repeat(policy.CHUNK, 1), atol=1e-6)
    strayed = command[:, 0] - lessons.seen.command
    assert np.std(strayed) == pytest.approx(policy.STRAY, rel=0.1)
    assert len(features) == len(wanted)


def test_a_policy_that_has_learnt_nothing_stays(data: Path) -> None:
    lessons = policy.demonstrations(data, 1)
    made = policy.Policy(lessons.seen.features(YAWS).shape[1])
    for parameter in made.parameters():
        parameter.data.zero_()
    places, yaws, close = made.told(lessons.seen)
    np.testing.assert_allclose(places, lessons.seen.command[:, None].repeat(policy.CHUNK, 1))
    np.testing.assert_allclose(yaws[:, 0], lessons.seen.told)
    assert not close.any()


def test_a_clone_plays(data: Path, tmp_path: Path) -> None:
    options = SimpleNamespace(
        demonstrations=None, anonymous=False, noise=0.0, stray=1.0, steps=3, seed=0, device="cpu"
    )
    notes = policy.train(data, tmp_path, options)
    assert sum(notes["sources"]) == pytest.approx(1.0, abs=1e-3)
    ((success, stacked, source),) = play(tmp_path, {}, [7], 0.0, None)
    assert (success, stacked) == (False, 0)
    assert notes["sources"][source] > 0
