"""Figures as inline SVG."""

from __future__ import annotations

import io
import re
from typing import Any
from xml.etree import ElementTree

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure

from orbisim.report import figures


def drawn(title: str = "title") -> str:
    figure, axes = figures.figure()
    axes.plot([0, 1], [1, 2], color=figures.A, label="line")
    axes.set(title=title)
    figures.legend(axes)
    return str(figures.to_svg(figure, "what <it> shows"))


def test_it_is_svg_that_follows_the_page() -> None:
    svg = drawn()
    root = ElementTree.fromstring(svg)
    assert root.get("aria-label") == "what <it> shows"
    assert root.get("width") == "100%"
    assert "currentColor" in svg
    assert "var(--grid)" in svg
    assert figures.A in svg
    assert "#010203" not in svg
    assert "<metadata" not in svg


def test_two_figures_of_a_page_share_no_name() -> None:
    ids = [set(re.findall(r' id="([^"]+)"', drawn())) for _ in range(2)]
    assert ids[0]
    assert not ids[0] & ids[1]
    svg = drawn()
    names = set(re.findall(r' id="([^"]+)"', svg))
    used = set(re.findall(r'(?:href="#|url\(#)([^")]+)', svg))
    assert used
    assert used <= names


def test_a_figure_is_drawn_once_and_placed_as_savefig_places_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def made() -> tuple[Figure, Any]:
        figure, axes = figures.figure()
        axes.plot([0, 1], [1e5, 2e5], label="line")
        axes.set(title="two\nlines", ylabel="a label")
        return figure, axes

    expected, box = made()
    with mpl.rc_context(figures._STYLE):
        expected.savefig(io.BytesIO(), format="svg")
    figure, axes = made()
    before, draws = np.array(axes.get_position()), []
    draw = type(axes).draw
    monkeypatch.setattr(type(axes), "draw", lambda *given: (draws.append(1), draw(*given)))
    figures.to_svg(figure, "alt")
    assert len(draws) == 1
    np.testing.assert_allclose(np.array(axes.get_position()), np.array(box.get_position()))
    assert np.abs(np.array(axes.get_position()) - before).max() > 0.01


def test_a_band_is_median_and_quantiles_of_what_is_finite() -> None:
    _, axes = figures.figure()
    x = np.arange(3.0)
    values = np.array([[1.0, np.nan, np.nan], [2.0, 5.0, np.inf], [3.0, np.inf, np.nan]])
    figures.band(axes, x, values, "red", "label", (0.0, 0.5, 1.0))
    (line,) = axes.lines
    np.testing.assert_array_equal(line.get_xdata(), [0, 1])
    np.testing.assert_array_equal(line.get_ydata(), [2, 5])
    outline = axes.collections[0].get_paths()[0].vertices
    assert (outline[:, 1].min(), outline[:, 1].max()) == (1.0, 5.0)
    figures.band(axes, x, np.full((2, 3), np.nan), "red", "nothing")
    assert len(axes.lines) == 1


@pytest.mark.parametrize(("largest", "scale"), [(29.0, "linear"), (31.0, "log")])
def test_wide_ranges_are_logarithmic(largest: float, scale: str) -> None:
    _, axes = figures.figure()
    figures.log_if_wide(axes, [np.array([1.0, 0.0, np.nan]), np.array([largest, -1.0])])
    assert axes.get_yscale() == scale
