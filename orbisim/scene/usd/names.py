"""Names for MuJoCo from prim paths."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping

from orbisim.scene.usd.flat import FlatPrim


def unique_names(prims: Iterable[FlatPrim], reserved: Iterable[str] = ()) -> Mapping[str, str]:
    """A name for each path: the display name (or prim name), with parents only where needed.

    Two prims `/robot/left/foot` and `/robot/right/foot` become `left.foot` and `right.foot`.
    """
    prims = list(prims)
    taken = set(reserved)
    names: dict[str, str] = {}
    pending = prims
    depth = 1
    while pending:
        labels = {prim.path: _label(prim, depth) for prim in pending}
        count = Counter(labels.values())
        left = []
        for prim in pending:
            label = labels[prim.path]
            whole = depth > prim.path.count("/")
            if (count[label] == 1 and label not in taken) or whole:
                names[prim.path] = _untaken(label, taken)
                taken.add(names[prim.path])
            else:
                left.append(prim)
        pending = left
        depth += 1
    return names


class NameBook:
    """Hands out names of one kind, each once."""

    def __init__(self, taken: Iterable[str] = ()) -> None:
        self._taken = set(taken)

    def __call__(self, wanted: str) -> str:
        """The wanted name, or the wanted name and a number."""
        name = _untaken(wanted, self._taken)
        self._taken.add(name)
        return name


def _label(prim: FlatPrim, depth: int) -> str:
    parts = prim.path.strip("/").split("/")[-depth:]
    return ".".join([*parts[:-1], prim.display_name or parts[-1]])


def _untaken(label: str, taken: set[str]) -> str:
    if label not in taken:
        return label
    number = 1
    while f"{label}_{number}" in taken:
        number += 1
    return f"{label}_{number}"
