"""States at the steps of pieces of a simulation, put together."""

from __future__ import annotations

import numpy as np
import pytest

from orbisim.freerun.nodes import Nodes, host, join
from orbisim.state import State
from orbisim.trajectory import Trajectory


def piece(first: float, count: int, sensors: bool = True, lost: tuple[int, ...] = ()) -> Trajectory:
    """Two worlds that count steps from `first` on; the worlds in `lost` are NaN throughout."""
    steps = first + 1 + np.arange(count, dtype=float)
    values = np.stack([steps, steps + 100])[..., None]
    values[list(lost)] = np.nan
    start = State(
        time=np.full(2, first),
        qpos=np.array([[first], [first + 100]]),
        qvel=np.zeros((2, 1)),
        act=np.zeros((2, 0)),
    )
    return Trajectory(
        initial=start,
        control=np.zeros((2, count, 0)),
        time=np.tile(steps, (2, 1)),
        qpos=values,
        qvel=-values,
        act=np.zeros((2, count, 0)),
        sensordata=values - 1 if sensors else None,  # computed where the step began
        diverged_at=np.array([0 if world in lost else -1 for world in range(2)]),
        final=start.replace(qpos=values[:, -1]),
    )


def test_states_stand_at_the_nodes_from_the_initial_one_on() -> None:
    nodes = Nodes(piece(0, 3), None, done=0)
    assert nodes.values["qpos"][0, :, 0].tolist() == [0, 1, 2, 3]
    assert nodes.values["qvel"][1, :, 0].tolist() == [0, -101, -102, -103]
    assert set(nodes.first.values()) == {0}


def test_sensors_of_a_node_come_with_the_step_after_it() -> None:
    """So that the last node of a piece has them only when the next piece is there."""
    first = Nodes(piece(0, 3), None, done=0)
    assert first.values["sensordata"][0, :, 0].tolist() == [0, 1, 2]
    second = Nodes(piece(3, 2), first, done=3)
    assert second.first["sensordata"] == 2
    assert second.values["sensordata"][0, :, 0].tolist() == [2, 3, 4]
    assert second.first["qpos"] == 3


def test_without_sensors() -> None:
    assert Nodes(piece(0, 3, sensors=False), None, done=0).values["sensordata"] is None


def test_some_worlds() -> None:
    nodes = Nodes(piece(0, 3), None, done=0).only(np.array([False, True]))
    assert nodes.values["qpos"].shape == (1, 4, 1)
    assert nodes.values["qpos"][0, 0, 0] == 100
    assert Nodes(piece(0, 3, sensors=False), None, 0).only(np.array([True, False])).first


def test_pieces_are_one_trajectory() -> None:
    pieces = [piece(0, 1), piece(1, 1), piece(2, 1)]
    whole = join(pieces[0].initial, np.zeros((2, 3, 0)), pieces)
    assert whole.qpos[1, :, 0].tolist() == [101, 102, 103]
    assert whole.sensordata[0, :, 0].tolist() == [0, 1, 2]
    assert whole.diverged_at.tolist() == [-1, -1]
    assert whole.final is pieces[-1].final
    assert whole.initial is pieces[0].initial
    without = join(
        pieces[0].initial, np.zeros((2, 2, 0)), [piece(0, 1), piece(1, 1, sensors=False)]
    )
    assert without.sensordata is None


def test_a_world_is_lost_where_it_is_lost_first() -> None:
    pieces = [piece(0, 1), piece(1, 1, lost=(1,)), piece(2, 1, lost=(1,))]
    assert join(pieces[0].initial, np.zeros((2, 3, 0)), pieces).diverged_at.tolist() == [-1, 1]


def test_arrays_of_any_library_come_to_the_host() -> None:
    torch = pytest.importorskip("torch")
    found = host(torch.arange(3, dtype=torch.float32, requires_grad=True))
    assert isinstance(found, np.ndarray)
    assert found.dtype == np.float64
    assert found.tolist() == [0, 1, 2]
