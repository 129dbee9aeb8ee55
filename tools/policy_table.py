"""Tables and curves of `compare_policies.py`."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from orbisim_policies.evaluate import wilson
from orbisim_policies.problem import Problem

from orbisim.files.writing import writing

Rows = Sequence[Mapping[str, Any]]


def curves(path: Path, manifest: Mapping[str, Any], problem: Problem) -> dict[str, list[float]]:
    """Live estimates of a training: true steps and seconds, rewards and success, in columns."""
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    names = [f"true_{part}" for part in problem.parts]
    names += [name for line in lines for name in line if name.startswith("success_")]
    names = list(dict.fromkeys(names))
    kept = [line for line in lines if names[0] in line]
    found = {name: [float(line[name]) for line in kept] for name in ("true_steps", "seconds")}
    return found | {name: [round(float(line[name]), 4) for line in kept] for name in names}


def chosen(rows: Rows, task: str, method: str, kind: str = "policy") -> list[Mapping[str, Any]]:
    """Rows of a method, by seed and configuration."""
    mine = [
        row for row in rows if (row["kind"], row["task"], row["method"]) == (kind, task, method)
    ]
    return sorted(mine, key=lambda row: (row["seed"], row["choice"]))


def order(rows: Rows, name: str) -> list[str]:
    """The tasks or methods of rows, in the order of their appearance."""
    return list(dict.fromkeys(str(row[name]) for row in rows))


def pooled(rows: Rows, place: str, name: str) -> str:
    """Share of successes over the episodes of all seeds, in %, with its 95 % interval."""
    wins = sum(row[place]["success"][name]["successes"] for row in rows)
    count = sum(row[place]["episodes"] for row in rows)
    low, high = wilson(wins, count)
    return f"{100 * wins / count:.1f}, {100 * low:.1f} to {100 * high:.1f}"


def _each(rows: Rows, name: str) -> str:
    return ", ".join(f"{100 * row['mujoco']['success'][name]['share']:.0f}" for row in rows)


def _between(values: Sequence[float]) -> str:
    """The values as one number, or from the least to the most."""
    ends = dict.fromkeys(f"{round(value):,}" for value in (min(values), max(values)))
    return " to ".join(ends)


def table(rows: Rows) -> str:
    """All tables of the rows: of push, of the suite, and of what was searched."""
    found = [_push(rows, task) for task in order(rows, "task") if not task.startswith("suite:")]
    found += [_suite(rows), _searched(rows)]
    return "\n\n".join(part for part in found if part)


def _push(rows: Rows, task: str) -> str:
    """Success by each definition, each seed, inside the model, rewards, steps and seconds."""
    mine = [row for row in rows if row["task"] == task and row["kind"] == "policy"]
    if not mine:
        return ""
    names = list(mine[0]["mujoco"]["success"])
    parts = list(mine[0]["mujoco"]["reward"])
    head = ["method", "seeds", *(f"`{name}`, %" for name in names), f"`{names[0]}`, each seed"]
    head += [f"in the model: {', '.join(f'`{name}`' for name in names)}", ", ".join(parts)]
    head += ["in the model", "true steps", "episodes tried", "training, s"]
    lines = ["| " + " | ".join(head) + " |", "| " + " | ".join(["---"] * len(head)) + " |"]
    for method in order(mine, "method"):
        some = chosen(mine, task, method)
        cells = [method, str(len(some)), *(pooled(some, "mujoco", name) for name in names)]
        cells.append(_each(some, names[0]))
        shares = [pooled(some, "model", name).split(",")[0] for name in names]
        cells.append(", ".join(shares))
        for place in ("mujoco", "model"):
            means = (np.mean([row[place]["reward"][n]["mean"] for row in some]) for n in parts)
            cells.append(", ".join(f"{mean:.2f}" for mean in means))
        cells.append(_between([row["true_steps"] for row in some]))
        cells.append(_between([row["true_steps"] / row["steps_of_episode"] for row in some]))
        cells.append(_between([row["trained_s"] for row in some]))
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _suite(rows: Rows) -> str:
    """The mean return over seeds, every seed, inside the model, and true steps."""
    mine = [row for row in rows if row["task"].startswith("suite:") and row["kind"] == "policy"]
    if not mine:
        return ""
    head = "task | method | seeds | return in C MuJoCo | each seed | in the model | true steps"
    lines = [f"| {head} |", "| --- | --- | --- | --- | --- | --- | --- |"]
    for task in order(mine, "task"):
        for method in order(mine, "method"):
            some = chosen(mine, task, method)
            if not some:
                continue
            rewards = [row["mujoco"]["reward"]["return"] for row in some]
            scale = [row["steps_of_episode"] for row in some]
            pairs = list(zip(rewards, scale, strict=True))
            each = ", ".join(f"{s * r['mean']:.0f} ± {s * r['ci95_half']:.0f}" for r, s in pairs)
            inside = [
                s * row["model"]["reward"]["return"]["mean"]
                for row, s in zip(some, scale, strict=True)
            ]
            cells = [task.removeprefix("suite:"), method, str(len(some))]
            cells += [f"{np.mean([s * r['mean'] for r, s in pairs]):.0f}", each]
            cells += [f"{np.mean(inside):.0f}", _between([row["true_steps"] for row in some])]
            lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _searched(rows: Rows) -> str:
    """Reward and success of every configuration, and what it has used."""
    mine = [row for row in rows if row["kind"] == "search"]
    if not mine:
        return ""
    head = "task | method | configuration | reward | success, % | true steps | training, s"
    lines = [f"| {head} |", "| --- | --- | --- | --- | --- | --- | --- |"]
    for task in order(mine, "task"):
        for method in order(mine, "method"):
            for row in chosen(mine, task, method, "search"):
                total = sum(part["mean"] for part in row["mujoco"]["reward"].values())
                share = next(iter(row["mujoco"]["success"].values()))["share"]
                what = ", ".join(f"{k} {v:g}" for k, v in row["settings"].items()) or "defaults"
                cells = [task, method, what, f"{total:.3f}", f"{100 * share:.0f}"]
                cells += [f"{row['true_steps']:,}", f"{row['trained_s']:.0f}"]
                lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def figure(rows: Rows, path: Path) -> None:
    """Live estimates of each seed against true episodes, and against seconds.

    Of the suite the mean reward, of other tasks each part of it and the main success.
    """
    from matplotlib.figure import Figure

    mine = [row for row in rows if row["kind"] == "policy" and row["curve"]["true_steps"]]
    columns = []
    for task in order(mine, "task"):
        names = next(list(row["curve"]) for row in mine if row["task"] == task)
        shown = [n for n in names if n.startswith("true_") and n != "true_steps"]
        if not task.startswith("suite:"):  # there it is another name of the return
            shown.append(next(n for n in names if n.startswith("success_")))
        columns += [(task, name) for name in shown]
    methods = order(mine, "method")
    page = Figure(figsize=(2.6 * len(columns) + 1.2, 5), layout="constrained")
    axes = page.subplots(2, len(columns), sharey="col", squeeze=False)
    for column, (task, name) in enumerate(columns):
        for number, method in enumerate(methods):
            for row in chosen(mine, task, method):
                curve = row["curve"]
                episodes = np.array(curve["true_steps"]) / row["steps_of_episode"]
                how: Any = {"color": f"C{number}", "marker": "o", "ms": 2, "lw": 1}
                axes[0, column].plot(episodes, curve[name], **how)
                axes[1, column].plot(curve["seconds"], curve[name], **how)
        title = name.removeprefix("true_")
        axes[0, column].set(title=task if title == "return" else title, xscale="log")
        axes[0, column].set_xlabel("episodes of C MuJoCo")
        axes[1, column].set_xlabel("s")
    for number, method in enumerate(methods):
        axes[0, 0].plot([], [], color=f"C{number}", label=method)
    axes[0, 0].legend(frameon=False, fontsize=7)
    with writing(path) as part:
        page.savefig(part, dpi=100)
