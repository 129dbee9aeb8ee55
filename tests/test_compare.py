"""Comparisons: errors that are what they say, reports that stand alone."""

from __future__ import annotations

import json

import numpy as np
import pytest

from orbisim import load_scene, metrics
from orbisim.backend import Intervals
from orbisim.compare import Comparison, compare
from orbisim.episodes import Episodes
from orbisim.errors import InputError
from orbisim.registry import make_backend
from orbisim.state import State
from orbisim.trajectory import Trajectory
from tests.physics.test_switching import Drift

MIXED = """
<mujoco model="mixed">
  <compiler angle="radian"/>
  <option timestep="0.01"/>
  <worldbody>
    <body name="box" pos="0 0 1"><freejoint/><geom type="box" size="0.1 0.1 0.1" mass="1"/></body>
    <body name="arm" pos="2 0 1"><joint name="hinge" axis="0 1 0" range="-0.02 0.02"
        limited="true"/>
      <joint name="slide" type="slide"/>
      <geom size="0.1"/></body>
  </worldbody>
  <actuator>
    <motor joint="hinge" ctrlrange="-2 4" ctrllimited="true"/><motor joint="slide"/>
  </actuator>
</mujoco>
"""


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    return compare(load_scene(MIXED), "mujoco", Drift(), count=3, horizon=0.2, seed=1)


def test_errors_are_those_of_a_falling_box(comparison: Comparison) -> None:
    """`drift` leaves the box where it is while it falls: 1/2 g t^2, velocity g t."""
    t = comparison.horizon_s
    np.testing.assert_allclose(t, np.arange(1, 21) * 0.01)
    fallen = 9.81 * 0.01**2 * np.arange(1, 21) * np.arange(2, 22) / 2  # semi-implicit Euler
    np.testing.assert_allclose(comparison.error["object_position"], [fallen] * 3, rtol=1e-9)
    np.testing.assert_allclose(comparison.error["object_velocity"], [9.81 * t] * 3, rtol=1e-9)
    np.testing.assert_allclose(comparison.error["object_rotation"], 0, atol=1e-7)


def test_json_keeps_to_the_contract(comparison: Comparison) -> None:
    result = json.loads(json.dumps(comparison.to_json(), allow_nan=False))
    assert result["schema"] == "orbisim.compare/1"
    assert result["a"]["backend"] == "mujoco"
    assert result["b"]["backend"] == "drift"
    assert result["a"]["steps_per_s"] > 0
    assert set(result["error"]) == set(metrics.GROUPS)
    for group, unit in (("joint_position", "rad or m"), ("object_rotation", "rad")):
        entry = result["error"][group]
        assert entry["unit"] == unit
        assert len(entry["median"]) == len(entry["p95"]) == len(result["horizon_s"])
    assert result["diverged"] == 0
    for side in ("a", "b"):
        energy = result["energy"][side]
        assert len(energy["median"]) == len(energy["kinetic"]["p95"]) == len(result["horizon_s"])
        assert set(result["penetration"][side]) == set(comparison.a.penetration.depth)
    assert result["uncertainty"] == {"a": None, "b": None}


def test_penetration_is_that_of_each_side() -> None:
    """`drift` leaves a box 4 mm in the floor; MuJoCo pushes it out."""
    sunk = (
        "<mujoco><worldbody><geom name='floor' type='plane' size='1 1 .1'/><body pos='0 0 .046'>"
        "<freejoint/><geom type='box' size='.05 .05 .05'/></body></worldbody></mujoco>"
    )
    scene = load_scene(sunk)
    qpos, nv = scene.model.qpos0[None], scene.model.nv
    start = State(np.zeros(1), qpos, np.zeros((1, nv)), np.zeros((1, 0)))
    found = compare(
        Episodes(scene, start.tile(2)), "mujoco", Drift(), count=2, horizon=0.1
    ).to_json()["penetration"]
    ours, theirs = (found[side]["object-world"] for side in ("a", "b"))
    assert theirs["median"] == pytest.approx([0.004] * 50)
    assert theirs["deepest"]["between"] == ["floor", "body1"]
    assert 0 < ours["worst"][-1] < 0.003


class Doubtful(Drift):
    """Says that it may be 1 mm and 0.1 rad off."""

    name = "doubtful"

    def intervals(self, trajectory: Trajectory) -> Intervals:
        rows = np.ones((trajectory.nworld, trajectory.nstep, 1))
        return Intervals((("body", "box"),), 0.9, 1e-3 * rows, 0.1 * rows)


def test_intervals_are_held_against_the_other_side() -> None:
    result = compare(load_scene(MIXED), "mujoco", Doubtful(), count=3, horizon=0.2, seed=1)
    summary = json.loads(json.dumps(result.to_json(), allow_nan=False))["uncertainty"]
    assert summary["a"] is None
    (box,) = summary["b"]["frames"]
    assert box["name"] == "box"
    fallen = np.array(box["position"]["error"]["median"])
    assert box["position"]["covered"] == (fallen <= 1e-3).astype(float).tolist()
    assert fallen == pytest.approx(np.median(result.error["object_position"], axis=0))
    assert box["rotation"]["covered_in_all"] == 1.0


def test_the_reference_against_itself_is_zero() -> None:
    result = compare(load_scene(MIXED), "mujoco", "mujoco", count=2, horizon=0.1)
    assert all((values == 0).all() for values in result.error.values())
    assert result.rounding is not None
    assert 0 < result.rounding["joint_position"].max() < 1e-5


def test_divergence_is_counted() -> None:
    class Fails(Drift):
        name = "fails"

        def step(self, state, control=None, nstep=1):  # type: ignore[no-untyped-def]
            from orbisim.errors import DivergedError

            lost = np.flatnonzero(
                (state.time > 0.05) & (np.arange(state.nworld) == state.nworld - 1)
            )
            if lost.size and state.nworld == 3:
                raise DivergedError("gone", lost)
            return super().step(state, None, nstep)

    result = compare(load_scene(MIXED), "mujoco", Fails(), count=3, horizon=0.1)
    assert result.diverged == 1
    assert result.worst_episode == 2
    summary = json.dumps(result.to_json(), allow_nan=False)  # NaN became null
    assert "NaN" not in summary


def test_no_episodes() -> None:
    with pytest.raises(InputError, match="at least one episode"):
        compare(load_scene(MIXED), count=0)


def test_backends_that_do_not_fit() -> None:
    class Odd(Drift):
        name = "odd"
        timestep = 0.015  # type: ignore[assignment]

    with pytest.raises(InputError, match="cannot be compared"):
        compare(load_scene(MIXED), "mujoco", Odd())


def test_an_object_keeps_the_scene_that_it_has() -> None:
    scene = load_scene(MIXED)
    changed = make_backend("mujoco", MIXED.replace('type="slide"', 'type="slide" damping="2"'))
    result = compare(scene, "mujoco", changed, count=2, horizon=0.2, rounding=False)
    assert result.to_json()["error"]["joint_position"]["median"][-1] > 1e-4
    assert changed.model.dof_damping.max() == 2
    other = make_backend("mujoco", MIXED.replace('<motor joint="slide"/>', ""))
    with pytest.raises(InputError, match=r"has scene 'mixed' with .* 1\); .* same joints"):
        compare(scene, "mujoco", other, count=2, horizon=0.2)
