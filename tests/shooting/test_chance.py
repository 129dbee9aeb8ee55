"""How many data count as independent, by what effects explain by chance."""

import mujoco
import numpy as np
import pytest

import orbisim
from orbisim.diagnosis.context import begun
from orbisim.diagnosis.settings import Settings
from orbisim.evidence import independent_by_chance
from orbisim.motion.samples import prepare_all
from orbisim.recording import Recording
from orbisim.shooting.bench import make_bench
from orbisim.shooting.hypothesis import Hypothesis

BALL = """
<mujoco><option timestep="0.005"/><worldbody><body name="ball" pos="0 0 1"><freejoint name="ball"/>
<geom size=".02" mass=".003"/></body></worldbody></mujoco>
"""


EVEN = np.ones(40)


def _random(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape)


def _course(*shape: int, memory: float, seed: int = 0) -> np.ndarray:
    """Of a first-order process along the second axis."""
    found = _random(*shape, seed=seed)
    for k in range(1, shape[1]):
        found[:, k] += memory * found[:, k - 1]
    return found


def _alike(seed: int) -> np.ndarray:
    """Sixty columns of twelve directions."""
    return _random(40, 100, 12, seed=seed) @ _random(12, 60, seed=seed + 1)


def _middle(numbers: list[float]) -> float:
    return float(np.median(numbers))


def test_of_independent_data_all_count() -> None:
    found = [
        independent_by_chance(_random(40, 100, 60, seed=s), _random(40, 100, seed=99 + s), EVEN)
        for s in range(9)
    ]
    assert 3200 < _middle(found) < 5000  # of 4000
    assert max(found) < 2 * min(found)


def test_columns_that_are_alike_count_as_the_directions_that_they_span() -> None:
    found = [
        independent_by_chance(_alike(s), _random(40, 100, seed=99 + s), EVEN) for s in range(25)
    ]
    assert 3000 < _middle(found) < 5300
    assert np.std(np.log(found)) < 0.9  # of one direction it is 1.6


def test_a_column_many_times_over_counts_once() -> None:
    columns, left = _random(40, 100, 12), _random(40, 100, seed=1)
    again = np.concatenate([columns, *(columns[..., :1] for _ in range(48))], axis=2)
    once = independent_by_chance(columns, left, EVEN)
    assert np.isclose(independent_by_chance(again, left, EVEN), once, rtol=0.3)


@pytest.mark.parametrize("beyond", [1e200, np.inf, np.nan])
def test_a_column_beyond_what_a_number_can_hold_is_left_out(beyond: float) -> None:
    columns, left = _random(40, 100, 12), _random(40, 100, seed=1)
    wild = columns[..., :1].copy()
    wild[3, 50:] = beyond
    known = independent_by_chance(columns[..., 2:], left, EVEN, columns[..., :2])
    more, fitted = (np.concatenate([x, wild], axis=2) for x in (columns[..., 2:], columns[..., :2]))
    assert independent_by_chance(more, left, EVEN, fitted) == known


def test_of_a_process_with_memory_as_many_count_as_its_columns_see() -> None:
    """Of two first-order processes, products have the variance of (1 - a b) / (1 + a b) as many."""
    found = [
        independent_by_chance(
            _course(40, 100, 20, memory=0.9, seed=s), _course(40, 100, memory=0.9, seed=99 + s),
            EVEN,
        )
        for s in range(15)
    ]  # fmt: skip
    assert _middle(found) == pytest.approx(4000 * (1 - 0.81) / (1 + 0.81), rel=0.3)


def test_structure_that_returns_in_every_window_counts_once() -> None:
    columns = [np.repeat(_alike(s)[:1], 40, axis=0) for s in range(25)]
    left = [np.repeat(_random(1, 100, seed=99 + s), 40, axis=0) for s in range(25)]
    found = [independent_by_chance(c, x, EVEN) for c, x in zip(columns, left, strict=True)]
    assert 70 < _middle(found) < 140  # of 4000: a window has 100


def test_what_is_left_of_nearly_the_same_explanations_counts_nearly_the_same() -> None:
    """Explanations that differ by a tenth of what they leave."""
    columns, left = _alike(0), _course(40, 100, memory=0.9, seed=7)
    found = [
        independent_by_chance(columns, left + 0.1 * left.std() * other, EVEN)
        for other in _random(20, 40, 100, seed=8)
    ]
    assert max(found) < 2.5 * min(found)


def test_what_was_fitted_is_no_chance() -> None:
    own, other = _random(40, 100, 12), _random(40, 100, 12, seed=1)
    left = _random(40, 100, seed=2)
    columns = own + 1e-3 * other
    beside = independent_by_chance(columns, left, EVEN, own)
    assert np.isclose(beside, independent_by_chance(other, left, EVEN, own), rtol=1e-3)


def test_an_effect_that_is_missing_is_no_chance() -> None:
    """It explains most of what is left, and lies in all directions that the columns span."""
    found = []
    for seed in range(15):
        columns, left = _alike(seed), _random(40, 100, seed=99 + seed)
        missing = columns[..., 0] / columns[..., 0].std()
        found.append(independent_by_chance(columns, left + 2 * missing, EVEN))
    assert _middle(found) > 4000  # of 4000, the missing one left out; it would be 15


def test_several_effects_may_be_missing() -> None:
    """As where all are selected at once: six of 24 directions are not counted."""
    one, several = [], []
    for seed in range(9):
        columns = _random(40, 100, 24, seed=seed) @ _random(24, 60, seed=seed + 1)
        missing = columns[..., :3] / columns[..., :3].std(axis=(0, 1))
        left = _random(40, 100, seed=99 + seed) + 2 * missing.sum(axis=2)
        one.append(independent_by_chance(columns, left, EVEN))
        several.append(independent_by_chance(columns, left, EVEN, missing=0.25))
    assert _middle(one) < 200
    assert _middle(several) > 4000  # of 4000; more, as shares are of the missing ones, too


def test_few_columns_say_nothing() -> None:
    assert independent_by_chance(_random(4, 10, 3), _random(4, 10), np.ones(4)) == np.inf


def test_a_free_body_of_which_position_and_spin_are_measured() -> None:
    """Only what is measured has rows, in what is left as in the columns."""
    scene = orbisim.load_scene(BALL)
    data = mujoco.MjData(scene.model)
    data.qvel[:3] = 3.0, 0.5, 2.0
    rows: list[np.ndarray] = []
    for _ in range(400):
        rows.append(data.qpos[:3].copy())
        mujoco.mj_step(scene.model, data)
    signals = {"xpos/ball": np.array(rows) + 1e-3 * _random(400, 3)}
    signals["qvel/ball"] = np.full((400, 6), np.nan)
    signals["qvel/ball"][:, 3:] = 0.1 * _random(400, 3, seed=1)
    run = Recording(0.005 * np.arange(400), signals)
    bench = make_bench(scene, prepare_all([run], scene), 0.5)
    measured = np.flatnonzero(np.isfinite(np.concatenate(bench.noise)))
    assert measured.tolist() == [0, 1, 2, 9, 10, 11]
    judged = begun(bench, Settings(), lambda _: None).judge.judge(Hypothesis())
    assert judged is not None and np.isfinite(judged.independent)
