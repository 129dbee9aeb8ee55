"""Selection of groups of columns by what they predict."""

import dataclasses

import mujoco
import numpy as np
import pytest

from orbisim.diagnosis.selection import Group, groups_of, select
from orbisim.effects import EffectInstance
from orbisim.effects.screening import Candidate, Column
from orbisim.evidence import EFFECT, Blocks, like_parts
from orbisim.shooting.blocks import data_of
from orbisim.shooting.regress import Normal

ROWS, COLUMNS, BLOCKS = 80, 24, 10
COUNTS = Blocks(np.full(BLOCKS, 8.0), np.zeros(BLOCKS, int), np.full(BLOCKS, 1e-9))


def group(*index: int, sign: bool = False, prior: float = -1.0) -> Group:
    def instance(x: np.ndarray) -> EffectInstance | None:
        return None if sign and x[0] < 0 else EffectInstance("viscous_damping", "j", {})

    return Group(tuple(index), (str(index[0]), "j"), instance, prior=prior)


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
@pytest.mark.parametrize("prior", [-1.0, -2.0])
def test_finds_all_that_matter_and_nothing_else(seed: int, prior: float) -> None:
    truth = np.zeros(COLUMNS)
    truth[[2, 7, 8, 15]] = [1.0, -2.0, 0.7, 1.5]
    groups = [
        group(7, 8, prior=prior),
        *(group(i, prior=prior) for i in range(COLUMNS) if i not in (7, 8)),
    ]
    found = select(data_of(data(truth, 0.5, seed), COUNTS), groups)
    assert {g.index for g in found.groups} == {(2,), (7, 8), (15,)}
    for g, x in zip(found.groups, found.coefficients, strict=True):
        assert x == pytest.approx(truth[list(g.index)], abs=0.15)
    assert found.predicted.sum() < 0.1 * found.before.sum()
    assert all(worth.sure > 0 for worth in found.gains)


def test_what_like_parts_have_is_likelier_of_the_last() -> None:
    truth = np.zeros(COLUMNS)
    truth[:6] = [1.0, -1.2, 0.9, 1.1, -0.8, 0.15]
    every = data(truth, 0.5, 0)

    def worth(parts: int) -> float:
        groups = [
            dataclasses.replace(group(i), key=("friction", str(i)), parts=parts) for i in range(6)
        ]
        found = select(data_of(every, COUNTS), groups)
        assert len(found.groups) == 6
        return {g.index[0]: one.total for g, one in zip(found.groups, found.gains, strict=True)}[5]

    last = like_parts(6, 6) - like_parts(5, 6)
    assert worth(6) - worth(1) == pytest.approx(last - EFFECT) and last > 0


@pytest.mark.parametrize("seed", range(5))
def test_finds_nothing_in_noise(seed: int) -> None:
    groups = [group(i) for i in range(COLUMNS)]
    assert not select(data_of(data(np.zeros(COLUMNS), 1.0, seed), COUNTS), groups).groups


def test_impossible_coefficients_are_left_out() -> None:
    truth = np.zeros(COLUMNS)
    truth[3] = -1.0
    groups = [group(i, sign=i == 3) for i in range(COLUMNS)]
    found = select(data_of(data(truth, 0.1, 0), COUNTS), groups)
    assert (3,) not in {g.index for g in found.groups}


def test_what_one_group_makes_possible_goes_only_with_both() -> None:
    """The second column nearly undoes the first one: without it, the first would be negative."""
    rng, blocks = np.random.default_rng(0), list[Normal]()
    for _ in range(BLOCKS):
        other = rng.standard_normal(ROWS)
        design = np.stack([-2 * other + 0.1 * rng.standard_normal(ROWS), other], axis=1)
        target = design.sum(axis=1) + 0.3 * rng.standard_normal(ROWS)
        square = float(target @ target)
        blocks.append(Normal(design.T @ design, design.T @ target, square, ROWS))

    def at_least(index: int, least: float) -> Group:
        def instance(x: np.ndarray) -> EffectInstance | None:
            return EffectInstance("viscous_damping", "j", {}) if x[0] > least else None

        return Group((index,), (str(index), "j"), instance, prior=-1.0)

    found = select(data_of(blocks, COUNTS), [at_least(0, 0.7), at_least(1, 0.0)])
    assert {g.index for g in found.groups} == {(0,), (1,)}
    assert found.predicted.sum() < 0.2 * found.before.sum()


def test_of_two_that_reach_the_noise_that_with_fewer_columns_stays() -> None:
    """Below the noise nothing gains, and either of them is worth as much."""
    truth = np.zeros(COLUMNS)
    truth[3] = 1.0
    floor = Blocks(COUNTS.size, COUNTS.signal, np.full(BLOCKS, 0.5))
    for groups in ([group(3), group(4, 3)], [group(4, 3), group(3)]):
        found = select(data_of(data(truth, 0.3, 2), floor), groups)
        assert [g.index for g in found.groups] == [(3,)]


def test_what_could_stand_in_the_place_of_a_choice_is_told() -> None:
    truth = np.zeros(COLUMNS)
    truth[3] = 1.0
    normals = []
    for one in data(truth, 0.3, 1):
        gram, moment = one.gram.copy(), one.moment.copy()
        gram[4], moment[4] = gram[3], moment[3]
        gram[:, 4] = gram[:, 3]
        gram[4, 4] = gram[3, 3]
        normals.append(Normal(gram, moment, one.square, one.count))
    found = select(data_of(normals, COUNTS), [group(3), group(4), group(5)])
    (chosen,) = found.groups
    (twin,) = {3, 4} - set(chosen.index)
    assert found.rivals[0].group.index == (twin,)
    assert found.rivals[0].gain.total == pytest.approx(0.0, abs=1e-3)


def test_a_candidate_with_many_columns_is_offered_with_few_too() -> None:
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body name='b'><joint name='j'/><geom size='.1'/></body></worldbody>"
        "</mujoco>"
    )
    column = Column("force", np.zeros((2, 1)))
    wide = Candidate("payload", "b", (column,) * 6, lambda c: {"mass": float(c[0])})
    whole = Normal(np.eye(6), np.zeros(6), 1.0, 10)
    found = groups_of(model, [wide], whole, lambda _: 0.0)
    assert [len(one.index) for one in found] == [4, 6]
