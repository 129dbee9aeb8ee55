"""Figures as inline SVG that follow the page's light or dark theme."""

from __future__ import annotations

import io
import itertools
import re
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from markupsafe import Markup
from matplotlib.axis import Tick
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.text import Text

_INK, _FAINT = "#010203", "#040506"  # stand for the page's colours until the SVG is written
A, B, C = "#2f7de1", "#e8590c", "#868e96"
"""Colours of the first side, the second side, and a reference; legible on light and dark."""

_STYLE = {
    "axes.edgecolor": _INK,
    "axes.facecolor": "none",
    "axes.grid": True,
    "axes.labelcolor": _INK,
    "axes.labelsize": 9,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlecolor": _INK,
    "axes.titlesize": 10,
    "figure.facecolor": "none",
    "font.family": "sans-serif",
    "font.size": 9,
    "grid.color": _FAINT,
    "grid.linewidth": 0.6,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "lines.linewidth": 1.6,
    "svg.fonttype": "none",
    "text.color": _INK,
    "xtick.color": _INK,
    "ytick.color": _INK,
}
_counter = itertools.count()


def figure(width: float = 6.0, height: float = 3.2, **subplots: Any) -> tuple[Figure, Any]:
    """A figure with axes in the report's style; sizes in inches."""
    with mpl.rc_context(_STYLE):
        drawn = Figure(figsize=(width, height), layout="constrained")
        return drawn, drawn.subplots(**subplots)


def to_svg(drawn: Figure, alt: str) -> Markup:
    """The figure as inline SVG.

    Args:
      alt: what the figure shows, for readers who cannot see it.
    """
    _take_literally(drawn)
    buffer = io.StringIO()
    prefix = f"f{next(_counter)}-"
    with mpl.rc_context({**_STYLE, "svg.hashsalt": prefix}):
        _lay_out(drawn)
        drawn.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = svg.replace(_INK, "currentColor").replace(_FAINT, "var(--grid)")
    svg = re.sub(r'id="([^"]+)"', rf'id="{prefix}\1"', svg)
    svg = re.sub(r'(href="#|url\(#)([^")]+)', rf"\g<1>{prefix}\2", svg)
    svg = re.sub(r'width="[\d.]+pt" height="[\d.]+pt"', 'width="100%"', svg, count=1)
    label = Markup.escape(alt)
    return Markup(svg.replace("<svg ", f'<svg role="img" aria-label="{label}" ', 1))


def _lay_out(drawn: Figure) -> None:
    """Places what is in the figure, for which `savefig` would draw it once more."""
    layout = drawn.get_layout_engine()
    if layout is not None:
        FigureCanvasSVG(drawn)  # measures texts as the SVG has them
        layout.execute(drawn)
        drawn.set_layout_engine(None)


def _take_literally(drawn: Figure) -> None:
    """Draws titles, labels and legends as they are: a name may hold the `$` of a formula.

    Numbers at ticks stay what matplotlib makes of them: powers of ten are formulas.
    """
    ticks = {id(text) for tick in drawn.findobj(Tick) for text in (tick.label1, tick.label2)}
    for text in drawn.findobj(Text):
        if id(text) not in ticks:
            text.set_parse_math(False)


def band(
    axes: Any,
    x: npt.NDArray[Any],
    values: npt.NDArray[Any],
    colour: str,
    label: str,
    levels: tuple[float, float, float] = (0.05, 0.5, 0.95),
    linestyle: str = "-",
) -> None:
    """Draws the median over the first axis as a line and the outer quantiles as a band."""
    finite = np.where(np.isfinite(values), values, np.nan)
    some = np.isfinite(finite).any(axis=0)
    if not some.any():
        return
    low, middle, high = np.nanquantile(finite[:, some], levels, axis=0)
    axes.fill_between(x[some], low, high, color=colour, alpha=0.18, linewidth=0)
    axes.plot(x[some], middle, color=colour, label=label, linestyle=linestyle)


def log_if_wide(axes: Any, values: Sequence[npt.NDArray[Any]]) -> None:
    """A logarithmic y axis where the positive values span more than a factor of 30."""
    positive = np.concatenate([v[np.isfinite(v) & (v > 0)] for v in values])
    if positive.size and positive.max() > 30 * positive.min():
        axes.set_yscale("log")


_LABELS_IN_A_ROW = 4
"""Of a legend: more are wider than a figure, as they name backends and files."""


def legend(axes: Any, **options: Any) -> None:
    """A legend without a frame, in the page's ink; below the axes, where it hides nothing."""
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        axes.figure.legend(
            handles,
            labels,
            loc="outside lower center",
            ncols=min(len(labels), _LABELS_IN_A_ROW),
            frameon=False,
            labelcolor=_INK,
            fontsize=8,
            **options,
        )
