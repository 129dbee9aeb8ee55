"""`tools/plans.py`: what is done once is not done again, and one failure stops nothing."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))

from plans import carry_out, left, read_rows


@dataclasses.dataclass(frozen=True)
class Number:
    value: int

    @property
    def key(self) -> tuple[int]:
        return (self.value,)


def inverse(plan: Number) -> dict[str, Any]:
    return {"value": plan.value, "inverse": 1 / plan.value}


def test_rows_come_as_they_are_done_and_go_on(tmp_path: Path) -> None:
    out = tmp_path / "new" / "rows.jsonl"
    plans = [Number(value) for value in (2, 0, 4)]
    lanes = {"even": 1, "odd": 1}
    how: dict[str, Any] = {"jobs": lanes, "lanes": lambda plan: "odd" if plan.value % 2 else "even"}
    rows, failed = carry_out(plans, inverse, out, **how)
    assert failed and [row["inverse"] for row in rows] == [0.5, 0.25]
    with out.open("a") as file:
        file.write('{"value": 8, "inv')  # cut off by a kill
    assert read_rows(out) == rows
    waiting = left(plans, [(row["value"],) for row in rows])
    assert waiting == [Number(0)]


def test_nothing_is_begun_after_the_time(tmp_path: Path) -> None:
    found = carry_out([Number(1)], inverse, tmp_path / "rows.jsonl", time_limit=-1.0)
    assert found == ([], False)
