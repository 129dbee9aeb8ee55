"""Problems of identification, and one of them solved by each classical method."""

from __future__ import annotations

import dataclasses
import sys
import types
from pathlib import Path

import numpy as np
import pytest
from orbisim_world_model.pack import Pack

from orbisim.errors import InputError

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))
import identify_push


def test_windows_are_those_in_which_a_cube_moves(pushes: Pack) -> None:
    problems = identify_push.cut(pushes, 20)
    assert problems
    for episode, problem in problems.items():
        np.testing.assert_allclose(problem.truth, identify_push.hidden(pushes)[episode])
        for grid in (problem.fit, problem.held):
            for start, ends in zip(grid.qpos, grid.target, strict=True):
                moves = (ends - start)[:, identify_push.CUBES :].reshape(len(ends), -1, 7)
                assert np.linalg.norm(moves[..., :3], axis=-1).max() >= identify_push.MOVES


def test_true_values_explain_what_is_held_out(pushes: Pack) -> None:
    problem = next(iter(identify_push.cut(pushes, 20).values()))
    problem = dataclasses.replace(problem, held=problem.fit)
    true = identify_push.slide(problem, problem.truth)
    wrong = identify_push.slide(problem, problem.truth * [3.0, 1.0])
    assert 2 * max(true) < max(wrong)


@pytest.fixture(scope="module")
def shoves() -> dict[int, identify_push.Problem]:
    return _made("thrown=2,flick=1", window=0.6, seed=3)


def _made(motions: str, **changes: object) -> dict[int, identify_push.Problem]:
    options = {"window": 1.0, "episodes": 2, "seed": 1, "force": None, **changes}
    return identify_push.made(types.SimpleNamespace(motions=motions, **options))


def test_true_values_reproduce_recordings_of_shove(
    shoves: dict[int, identify_push.Problem],
) -> None:
    for problem in shoves.values():
        assert len(problem.fit.qpos) == 3
        assert len(problem.held.qpos) == 2
        scene, wanted = identify_push.sized(problem)
        nstep = round(problem.timestep / float(scene.model.opt.timestep))
        run = identify_push.simulated(scene, wanted, problem.fit, nstep)
        assert float(run(np.log(problem.truth)).abs().max()) < 1e-3
        for factor in ([1.1, 1.0], [1.0, 1.1]):
            assert float(run(np.log(problem.truth * factor)).abs().max()) > 0.05


def test_the_bound_falls_with_more_windows(shoves: dict[int, identify_push.Problem]) -> None:
    fewer = {
        number: dataclasses.replace(problem, fit=identify_push._rows(problem.fit, slice(0, 1)))
        for number, problem in shoves.items()
    }
    all_of_them, one = identify_push.bound(shoves), identify_push.bound(fewer)
    for label, quantiles in all_of_them["noise"].items():
        assert 0 < quantiles[2] < one["noise"][label][2]
        assert quantiles[2] < all_of_them["model"][label][2]


@pytest.mark.parametrize("motions", ["thrown", "thrown=0", "thrown=x"])
def test_motions_say_how_often(motions: str) -> None:
    with pytest.raises(InputError, match="how often"):
        _made(motions)


def test_a_lift_shows_density_where_the_gripper_is_weak() -> None:
    weak, strong = (
        identify_push.bound(_made("lifted=3", episodes=3, force=force))["noise"]["density:cube1"]
        for force in (None, 60.0)
    )
    assert weak[0] < 0.05  # of the density, where a sample is off by 0.5 mm and 5 mrad
    assert strong[0] > 5 * weak[0]


@pytest.mark.slow
def test_sysid_and_cma_bring_the_error_down(pushes: Pack) -> None:
    problem = next(iter(identify_push.cut(pushes, 20).values()))
    row = identify_push.one("sysid", problem, 6, None)
    assert row["low"][0] <= row["values"][0] <= row["high"][0]
    pytest.importorskip("cma")
    other = identify_push.one("cma", problem, 6, 3.0)
    assert other["processor_seconds"] < 30.0
    table = identify_push.summary({"rows": {"0": other}}, {0: problem})
    assert table["friction:table"]["error"][0] < table["friction:table"]["declared"][0]


@pytest.mark.slow
def test_thrown_cubes_tell_their_density_through_the_model_that_knows_them() -> None:
    problems = _made("thrown=3")
    zoo = identify_push.ROOT / "backends" / "orbisim_world_model" / "zoo"
    options = types.SimpleNamespace(checkpoint=zoo / "shove", device="cpu", steps=5, scan=0)
    table = identify_push.summary(identify_push.learned(problems, options), problems)
    for label, most in (("friction:table", 0.1), ("density:cube1", 0.2)):
        error = table[label]["error"][0]
        assert error < most and error < table[label]["declared"][0]


def test_what_is_printed() -> None:
    assert identify_push._quantiles([]) == []
    assert identify_push._quantiles([1.0, 2.0, 3.0])[0] == 2.0


def test_errors_of_density_are_told_apart_by_mass(
    shoves: dict[int, identify_push.Problem],
) -> None:
    chosen = list(shoves.values())
    true = np.array([problem.truth[1] for problem in chosen])
    found = identify_push.by_ratio(1.2 * true, chosen)
    assert sum(row[0] for row in found.values()) == len(chosen)
    for _, size, signed in found.values():
        assert size == pytest.approx(0.2) and signed == pytest.approx(0.2)
