"""A few damaged files of each kind that tools/fuzz_files.py makes by the thousand."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "tools"))
from fuzz_files import FINE, OUTCOMES, Outcome, judge, make_case, summary
from fuzz_kinds import KINDS

_COUNTS = {
    "archive": 6,
    "usdz": 3,
    "csv": 12,
    "hdf5": 10,
    "texts": 8,
    "checkpoint": 6,
    "progress": 8,
    "log_hdf5": 3,
}
"""Fewer than `_COUNT` where each takes long."""
_COUNT = 40


@pytest.mark.parametrize("name", KINDS)
def test_damaged_files_are_read_or_refused(tmp_path: Path, name: str) -> None:
    kind, pristine = KINDS[name], tmp_path / "pristine"
    pristine.mkdir()
    kind.make(pristine)
    kind.read(pristine)
    found = []
    for index in range(_COUNTS.get(name, 12 if name.startswith("log_") else _COUNT)):
        folder = make_case(kind, pristine, 0, index, tmp_path / "case")
        found.append(judge(kind, folder, index, most_bytes=math.inf))  # this process did much else
    assert not [one for one in found if one.outcome not in FINE]
    assert sum(one.outcome == "refused" for one in found) >= len(found) // 3


def test_what_is_a_fault(tmp_path: Path) -> None:
    class Broken:
        @staticmethod
        def read(folder: Path) -> None:
            raise RuntimeError("two\nlines")

    assert judge(Broken, tmp_path, 3).outcome == "other exception"
    counts = summary("npz", 0, [Outcome(i, name) for i, name in enumerate(OUTCOMES)])
    assert all(counts[name] == 1 for name in OUTCOMES)
    assert len(counts["faults"]) == len(OUTCOMES) - len(FINE)
