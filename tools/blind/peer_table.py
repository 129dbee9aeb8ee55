"""The diagnosis beside mujoco.sysid, on the same held-out windows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from blind.outcomes import Outcome

RAISED = 1.001
"""Error after over before from which it counts as raised."""

_GROUPS: tuple[tuple[str, Callable[[Outcome], bool]], ...] = (
    ("one effect", lambda o: o.kind == "single"),
    ("... of scenes with joints to fit", lambda o: o.kind == "single" and o.peer_fits > 0),
    ("two effects", lambda o: o.kind == "pair"),
    ("no effect, declared rightly", lambda o: o.kind == "none" and o.wrong == "right"),
    ("no effect, declared wrongly", lambda o: o.kind == "none" and o.wrong != "right"),
    ("outside the catalogue", lambda o: o.kind == "outside"),
)


def peer_table(outcomes: Sequence[Outcome]) -> list[str]:
    """Held-out error as a share of the declared scene's: ours, the peer's and the true scene's."""
    ran = [o for o in outcomes if o.peer_verdict]
    if not ran:
        return []
    ends = [sum(o.peer_verdict == v for o in ran) for v in ("stopped", "nothing to fit", "failed")]
    lines = [
        "",
        "## Beside mujoco.sysid with armature, friction loss, damping and stiffness of each joint",
        "",
        "Held-out free-running error as a share of the declared scene's, on the same windows: "
        "median, and in how many trials it was raised. Trials that both have finished; a diagnosis "
        "that names nothing leaves the error as it is.",
        "",
        f"Of {len(ran)} trials the peer was stopped in {ends[0]} (scored with its best values so "
        f"far), had no joint to fit in {ends[1]} (the error stays), and failed in {ends[2]}.",
        "",
        "| trials | n | diagnosis | raised | sysid | raised | sysid lower | true scene |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    both = [o for o in ran if np.isfinite(o.peer) and not o.failure and o.declared > 0]
    for name, chosen in _GROUPS:
        some = [o for o in both if chosen(o)]
        if some:
            lines.append(_row(name, some))
    return lines


def _row(name: str, some: Sequence[Outcome]) -> str:
    ours = [o.after / o.declared for o in some]
    theirs = [o.peer / o.declared for o in some]
    true = [o.true / o.declared for o in some if np.isfinite(o.true)]
    lower = sum(t < u for t, u in zip(theirs, ours, strict=True))
    cells = (_percent(ours), _raised(ours), _percent(theirs), _raised(theirs), str(lower))
    return f"| {name} | {len(some)} | {' | '.join(cells)} | {_percent(true)} |"


def _percent(ratios: Sequence[float]) -> str:
    return f"{100 * np.median(ratios):.3g} %" if ratios else "-"


def _raised(ratios: Iterable[float]) -> str:
    return str(sum(r > RAISED for r in ratios))
