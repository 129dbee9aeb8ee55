"""The missing force, and what it depends on."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from matplotlib.figure import Figure

from orbisim.report.shape import (
    Course,
    Degree,
    Regressor,
    degrees,
    dependence,
    dependence_rows,
    scatter,
    thin,
    within,
)


def test_dependence_is_the_share_that_follows() -> None:
    rng = np.random.default_rng(0)
    x, noise = rng.uniform(-2, 2, 4000), rng.normal(size=4000)
    law = np.abs(x)  # even: a correlation coefficient would see nothing
    signal = law + 0.5 * law.std() * noise
    assert dependence(x, signal) == pytest.approx(0.8, abs=0.03)
    assert dependence(rng.uniform(size=4000), signal) < 0.01
    assert dependence(x, np.where(x > 5, np.nan, law)) > 0.97


def test_every_degree_of_freedom_has_its_name_and_units() -> None:
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body><joint name="h"/><joint name="s" type="slide"/><geom size="1"/>
        <body><joint name="b" type="ball"/><geom size="1"/></body></body>
        <body><freejoint name="f"/><geom size="1"/></body></worldbody></mujoco>"""
    )
    found = degrees(model)
    assert [one.dof for one in found] == list(range(model.nv))
    assert (found[0].unit, found[0].force_unit) == ("rad", "N*m")
    assert (found[1].unit, found[1].force_unit, found[1].q) == ("m", "N", 1)
    assert [one.name for one in found[2:5]] == ["b, about x", "b, about y", "b, about z"]
    assert [one.q for one in found[2:5]] == [None] * 3
    assert [one.q for one in found[5:8]] == [6, 7, 8]
    assert [one.name for one in found[5:]] == [
        *(f"f, along {axis}" for axis in "xyz"), *(f"f, about {axis}" for axis in "xyz")
    ]  # fmt: skip


def test_what_explains_most_comes_first() -> None:
    rng = np.random.default_rng(0)
    x, y, noise = rng.normal(size=(3, 2000))
    every = [Regressor("y", "m", y), Regressor("x", "m", x), Regressor("else", "", noise)]
    before, after = Course("b", "red", x + y), Course("a", "blue", x + 0.3 * y)
    rows = dependence_rows(every, before, after)
    assert [row["name"] for row in rows] == ["x", "y"]
    assert rows[0]["before"] == pytest.approx(0.5, abs=0.06)
    assert rows[0]["after"] == pytest.approx(1 / 1.09, abs=0.05)


def test_too_few_samples_say_nothing() -> None:
    x = np.arange(40.0)
    assert dependence(x, x) == 0.0
    assert dependence(np.arange(400.0), np.ones(400)) == 0.0


def test_rows_are_thinned_evenly() -> None:
    assert thin(np.arange(10)).tolist() == list(range(10))
    kept = thin(np.arange(6000))
    assert len(kept) == 1500
    assert set(np.diff(kept)) == {4}


def test_single_outliers_do_not_flatten_the_rest() -> None:
    values = np.sin(np.linspace(0, 60, 5000))
    for outlier, limited in ((1000.0, True), (0.5, False)):
        axes = Figure().subplots()
        axes.plot([0, 1], [-5000, 5000])
        within(axes, [np.append(values, outlier)])
        assert (axes.get_ylim()[1] < 3) == limited


def test_a_chart_has_all_courses() -> None:
    degree = Degree("elbow", "elbow", 0, 0, "rad", "N*m")
    x = np.linspace(-1, 1, 500)
    drawn = scatter(
        Regressor("velocity of elbow", "rad/s", x),
        [Course("as declared", "#ff0000", x), Course("after", "#00ff00", 0 * x)],
        degree,
    )
    for text in ("as declared", "after", "velocity of elbow (rad/s)", "#ff0000", "#00ff00"):
        assert text in drawn
