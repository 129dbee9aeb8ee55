"""Selection of groups of columns by cross-validation."""

import numpy as np
import pytest

from orbisim.diagnosis.regress import Normal
from orbisim.diagnosis.selection import Group, Rule, select
from orbisim.effects import EffectInstance

ROWS, COLUMNS, BLOCKS = 80, 24, 10


def group(*index: int, sign: bool = False) -> Group:
    def instance(x: np.ndarray) -> EffectInstance | None:
        return None if sign and x[0] < 0 else EffectInstance("viscous_damping", "j", {})

    return Group(tuple(index), (str(index[0]),), instance)


def data(truth: np.ndarray, noise: float, seed: int) -> list[Normal]:
    rng = np.random.default_rng(seed)
    mix = rng.standard_normal((COLUMNS, COLUMNS)) * 0.3 + np.eye(COLUMNS)
    found = []
    for _ in range(BLOCKS):
        design = rng.standard_normal((ROWS, COLUMNS)) @ mix
        target = design @ truth + noise * rng.standard_normal(ROWS)
        moment = design.T @ target
        found.append(Normal(design.T @ design, moment, float(target @ target), ROWS))
    return found


@pytest.mark.parametrize("seed", range(5))
def test_finds_all_that_matter_and_nothing_else(seed: int) -> None:
    truth = np.zeros(COLUMNS)
    truth[[2, 7, 8, 15]] = [1.0, -2.0, 0.7, 1.5]
    groups = [group(7, 8), *(group(i) for i in range(COLUMNS) if i not in (7, 8))]
    found = select(data(truth, 0.5, seed), groups, Rule())
    assert {g.index for g in found.groups} == {(2,), (7, 8), (15,)}
    for g, x in zip(found.groups, found.coefficients, strict=True):
        assert x == pytest.approx(truth[list(g.index)], abs=0.15)
    assert found.predicted.sum() < 0.1 * found.before.sum()


@pytest.mark.parametrize("seed", range(5))
def test_finds_nothing_in_noise(seed: int) -> None:
    groups = [group(i) for i in range(COLUMNS)]
    assert not select(data(np.zeros(COLUMNS), 1.0, seed), groups, Rule()).groups


def test_impossible_coefficients_are_left_out() -> None:
    truth = np.zeros(COLUMNS)
    truth[3] = -1.0
    groups = [group(i, sign=i == 3) for i in range(COLUMNS)]
    found = select(data(truth, 0.1, 0), groups, Rule())
    assert (3,) not in {g.index for g in found.groups}
