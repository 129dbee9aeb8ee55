"""How many data count as independent, by what effects explain by chance."""

import mujoco
import numpy as np

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


def _random(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape)


def test_of_independent_data_all_count() -> None:
    columns, left = _random(40, 100, 60), _random(40, 100, seed=1)
    found = independent_by_chance(columns, left, np.ones(40))
    assert 1500 < found < 12000  # of 4000; the median of 60 shares is known to a factor


def test_structure_that_returns_in_every_window_counts_once() -> None:
    shape = np.sin(np.arange(100) / 15)
    left = np.repeat(shape[None], 40, axis=0)
    columns = np.repeat(np.cumsum(_random(1, 100, 60), axis=1), 40, axis=0)
    assert independent_by_chance(columns, left, np.ones(40)) < 40


def test_what_was_fitted_is_no_chance() -> None:
    own, other = _random(40, 100, 12), _random(40, 100, 12, seed=1)
    left = _random(40, 100, seed=2)
    columns = own + 1e-3 * other
    beside = independent_by_chance(columns, left, np.ones(40), own)
    assert np.isclose(beside, independent_by_chance(other, left, np.ones(40), own), rtol=1e-3)


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
