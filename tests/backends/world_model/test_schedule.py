"""Where a training stands."""

from __future__ import annotations

import math

import pytest
from orbisim_world_model.config import Stage, TrainConfig, replaced
from orbisim_world_model.presets import preset
from orbisim_world_model.schedule import Clock, learning_rate, stage_at


def test_the_schedule() -> None:
    config = replaced(preset("default"), {"train.stages": "0.5x1x8,0.5x2x4ar"}).train
    assert stage_at(config, 0.0) == (0, 0.0)
    assert stage_at(config, 0.75) == (1, 0.5)
    assert stage_at(config, 1.0) == (1, 1.0)
    rates = [learning_rate(config, p / 100) for p in range(101)]
    assert max(rates) == pytest.approx(config.rate, rel=1e-3)
    assert rates[-1] == pytest.approx(config.final_rate)
    assert rates[0] < 0.1 * config.rate


def test_stages_take_their_shares() -> None:
    config = TrainConfig(stages=(Stage(1.0, 1, 1), Stage(2.0, 1, 1), Stage(1.0, 1, 1)))
    for progress, expected in (
        (0.0, (0, 0.0)),
        (0.125, (0, 0.5)),
        (0.5, (1, 0.5)),
        (1.0, (2, 1.0)),
    ):
        number, within = stage_at(config, progress)
        assert (number, within) == (expected[0], pytest.approx(expected[1]))


def test_the_rate_is_half_a_cosine() -> None:
    config = TrainConfig(rate=1e-3, final_rate=1e-5, warmup=0.1)
    middle = learning_rate(config, 0.1 + 0.9 / 2)
    assert middle == pytest.approx((1e-3 + 1e-5) / 2)
    assert learning_rate(config, 1.0) == pytest.approx(1e-5)
    assert learning_rate(config, 0.1) == pytest.approx(1e-3)
    quarter = 1e-5 + 0.5 * (1e-3 - 1e-5) * (1 + math.cos(math.pi / 4))
    assert learning_rate(config, 0.1 + 0.9 / 4) == pytest.approx(quarter)
    assert 0 < learning_rate(config, 0.0) < learning_rate(config, 0.05) < 1e-3


def test_the_larger_of_both_budgets_counts() -> None:
    assert Clock(10, None, done=4).progress == 0.4
    assert Clock(10, 1000.0, done=1, spent=500.0).progress == pytest.approx(0.5, abs=0.01)
    assert Clock(10, None, done=99).progress == 1.0


def test_seconds_that_were_no_training_are_taken_off() -> None:
    clock = Clock(None, 100.0, spent=50.0)
    clock.skip(60.0)
    assert clock.limit == 40.0
    assert clock.elapsed < 0.0 + 50.0
