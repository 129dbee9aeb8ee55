"""Models that differ from world to world."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import orbisim
from orbisim.errors import InputError, UnknownNameError
from orbisim.vector import between, factor, intervals
from tests.vector import own
from tests.vector.test_scenes import report


def loaded(randomize: Any, nworld: int = 4, **options: Any) -> Any:
    return orbisim.vector.load(
        "cartpole", "balance", nworld, seed=0, randomize=randomize, **options
    )


def test_masses_differ_and_what_follows_from_them() -> None:
    environment = loaded({"body_mass": factor(0.5, 2.0), "geom_friction": factor(0.9, 1.1)})
    plain = loaded(None)
    environment.reset(), plain.reset()
    np.testing.assert_array_equal(environment.state.qpos, plain.state.qpos)
    fields = environment._fields.varied
    declared = environment._pristine.model.body_mass
    ratios = fields["body_mass"][:, 1:] / declared[1:]
    assert (ratios > 0.5).all() and (ratios < 2.0).all() and len(set(ratios[:, 0])) == 4
    total = fields["body_mass"].sum(axis=1)
    np.testing.assert_allclose(fields["body_subtreemass"][:, 0], total)
    speeds = [one.step(np.ones((4, 1))) and one.state.qvel[:, 0] for one in (environment, plain)]
    light = total < declared.sum()
    assert ((speeds[0] > speeds[1]) == light).all()


def test_each_episode_has_its_own() -> None:
    environment = loaded({"body_mass/cart": between(1.0, 3.0)})
    cart = environment._pristine.model.name2id("cart", "body")
    seen = []
    for _ in range(3):
        environment.reset()
        seen.append(environment._fields.varied["body_mass"][:, cart].copy())
    assert len(set(np.concatenate(seen))) == 12
    environment.reset(seed=0)
    np.testing.assert_array_equal(environment._fields.varied["body_mass"][:, cart], seen[0])
    others = np.delete(environment._fields.varied["body_mass"], cart, axis=1)
    assert (others == others[0]).all()


def test_functions_draw() -> None:
    environment = loaded({"opt.gravity": lambda random, g: g * random.choice([2.0, 3.0])})
    environment.reset()
    assert set(environment._fields.varied["opt.gravity"][:, 2]) <= {-2 * 9.81, -3 * 9.81}


@pytest.mark.parametrize(
    ("randomize", "error", "message"),
    [
        ({"body_mas": factor(1, 2)}, UnknownNameError, "did you mean 'body_mass'"),
        ({"body_mass/waggon": factor(1, 2)}, UnknownNameError, "waggon"),
        ({"body_mass": (0.5, 2.0)}, InputError, r"expected factor\(low, high\)"),
        ({"body_mass": lambda random, values: values[:1]}, InputError, "shape"),
        ({"body_mass": lambda random, values: values * np.nan}, InputError, "finite"),
    ],
)
def test_what_cannot_be_drawn(randomize: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        loaded(randomize)


def test_ranges() -> None:
    for wrong in ((2.0, 1.0), (np.nan, 1.0), (0.0, np.inf)):
        with pytest.raises(InputError, match="from a lower to a higher"):
            factor(*wrong)
        with pytest.raises(InputError, match="from a lower to a higher"):
            between(*wrong)


def test_a_report_is_read(tmp_path: Path) -> None:
    path = tmp_path / "report.json"
    path.write_text(json.dumps(report()))
    drawn = intervals(path).draw(orbisim.load_scene(own.XML), 0)
    assert 1.0 <= drawn.model.dof_damping[0] <= 3.0


def test_a_number_that_was_not_fitted_keeps_its_value() -> None:
    content = report(parameters={"coefficient": {"value": 2.0, "ci95": [None, None]}})
    drawn = {intervals(content).draw(orbisim.load_scene(own.XML), seed).model.dof_damping[0]
             for seed in range(3)}  # fmt: skip
    assert drawn == {2.0}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"schema": "orbisim.replay/1"}, "not a diagnosis"),
        ({"schema": "orbisim.diagnosis/1", "verdict": "no_residual"}, "names no effect"),
        (report("stribeck_friction"), "cannot differ from world to world"),
        (report(parameters={"coefficient": {"value": 1.0}}), "'value' and 'ci95'"),
        (
            report(parameters={"coefficient": {"value": 1.0, "ci95": [2.0, 1.0]}}),
            "from a lower to a higher",
        ),
    ],
)
def test_reports_that_are_none(content: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        intervals(content)
