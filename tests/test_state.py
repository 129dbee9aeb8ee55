"""States are values."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from orbisim import State, Trajectory
from orbisim.errors import InputError
from orbisim.state import LARGEST

finite = st.floats(-1e6, 1e6)


@st.composite
def states(draw: st.DrawFn) -> State:
    nworld, nq, nv, na, nm = (draw(st.integers(lo, 4)) for lo in (1, 0, 0, 0, 0))

    def array(*shape: int) -> np.ndarray:
        return draw(hnp.arrays(np.float64, shape, elements=finite))

    return State(
        array(nworld), array(nworld, nq), array(nworld, nv), array(nworld, na),
        {"qacc_warmstart": array(nworld, nv), "private": array(nworld, nm, 2)},
    )  # fmt: skip


def same(a: State, b: State) -> bool:
    x, y = dict(a._named()), dict(b._named())
    return x.keys() == y.keys() and all(np.array_equal(x[k], y[k]) for k in x)


@settings(deadline=None)  # a disk takes its time
@given(states())
def test_saving_and_loading_changes_nothing(state: State) -> None:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        state.save(Path(folder) / "s.npz")
        assert same(State.load(Path(folder) / "s.npz"), state)


@given(states(), st.integers(1, 3))
def test_tiling_and_stacking(state: State, count: int) -> None:
    tiled = state.tile(count)
    assert tiled.nworld == state.nworld * count
    for world in range(state.nworld):
        assert same(tiled[world * count], state[world])
    assert same(State.stack([state[w] for w in range(state.nworld)]), state)


@given(states())
def test_selecting_worlds(state: State) -> None:
    order = np.arange(state.nworld)[::-1]
    assert same(state[order][order], state)
    assert state[-1].nworld == 1


def test_a_world_axis_is_demanded() -> None:
    with pytest.raises(InputError, match=r"State\.qvel has shape \(3, 1\).*2 worlds"):
        State(np.zeros(2), np.zeros((2, 1)), np.zeros((3, 1)), np.zeros((2, 0)))


def test_finite_looks_at_every_part() -> None:
    state = State(np.zeros(3), np.ones((3, 2)), np.ones((3, 2)), np.ones((3, 1)))
    state.qpos[0, 1] = np.nan
    state.act[2, 0] = np.inf
    assert list(state.finite) == [False, True, False]


def test_stacking_nothing_is_an_error() -> None:
    with pytest.raises(InputError):
        State.stack([])


@pytest.mark.parametrize("kind", [State, Trajectory])
@pytest.mark.parametrize("content", [b"", b"not a zip", b"PK\x03\x04 broken"])
def test_loading_something_else(tmp_path: Path, kind: type, content: bytes) -> None:
    path = tmp_path / "x.npz"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"x\.npz: (not a saved|is not an \.npz)"):
        kind.load(path)


def test_loading_never_unpickles(tmp_path: Path) -> None:
    path = tmp_path / "x.npz"
    np.savez(path, header=np.array([{"schema": "orbisim.state/1"}], dtype=object))
    with pytest.raises(InputError):
        State.load(path)


def test_what_is_no_array_is_refused() -> None:
    with pytest.raises(InputError, match=r"State\.qpos must be an array"):
        State(np.zeros(1), [[0.0]], np.zeros((1, 1)), np.zeros((1, 0)))
    with pytest.raises(InputError, match=r"State\.time must be an array"):
        State(0.0, np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 0)))


def test_valid_is_what_mujoco_accepts() -> None:
    assert mujoco.mjMAXVAL == LARGEST
    qvel = np.array([[0.0], [1e11], [np.nan], [-1e11]])
    state = State(np.zeros(4), np.zeros((4, 1)), qvel, np.zeros((4, 0)))
    assert list(state.valid) == [True, False, False, False]
    assert list(state.finite) == [True, True, False, True]
