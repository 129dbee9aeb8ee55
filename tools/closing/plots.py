"""One picture for each data set: a held-out stretch, and the errors as bars."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from closing.metrics import Metric, Scored

COLOURS = {"declared": "tab:red", "diagnosed": "tab:blue", "published": "tab:green"}
_STYLES = {"declared": "-", "diagnosed": "-", "published": "--"}
_MOST_ROWS = 1500


def draw(name: str, metric: Metric, scored: Mapping[str, Scored], path: Path) -> None:
    """Writes a PNG. scored: by name of the scene, `declared` among them."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    shown = _typical(scored["declared"])
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(9, 3.2), width_ratios=(3, 2))
    trace = scored["declared"].traces[shown]
    step = max(1, len(trace.time) // _MOST_ROWS)
    left.plot(trace.time[::step], trace.measured[::step], "k", lw=2.5, alpha=0.5, label="measured")
    for kind, one in scored.items():
        line = one.traces[shown]
        style = {"color": COLOURS[kind], "ls": _STYLES[kind], "lw": 1.1, "label": kind}
        left.plot(line.time[::step], line.simulated[::step], **style)
    spread = np.ptp(trace.measured[np.isfinite(trace.measured)])
    middle = float(np.nanmean(trace.measured))
    low, high = left.get_ylim()
    left.set_ylim(max(low, middle - 2 * spread), min(high, middle + 2 * spread))
    left.set(xlabel="time, s", ylabel=trace.label, title=f"{name}: a typical held-out stretch")
    left.legend(fontsize=7, loc="best")
    labels = list(scored["declared"].figures)
    width = 0.8 / len(scored)
    for number, (kind, one) in enumerate(scored.items()):
        heights = [metric.factor * one.figures[label] for label in labels]
        places = np.arange(len(labels)) + (number - (len(scored) - 1) / 2) * width
        right.bar(places, heights, width, color=COLOURS[kind], label=kind)
    right.set_xticks(range(len(labels)), labels, fontsize=7, rotation=20, ha="right")
    right.set_yscale("log")
    right.set_ylabel(metric.unit)
    right.set_title(metric.words, fontsize=8)
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=75)
    pyplot.close(figure)


def _typical(scored: Scored) -> int:
    """The stretch whose error is the middle one."""
    errors = np.array([one.error for one in scored.traces])
    errors[~np.isfinite(errors)] = np.inf
    return int(np.argsort(errors)[len(errors) // 2])
