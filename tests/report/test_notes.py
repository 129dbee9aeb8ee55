"""Notes of several recordings, each said once."""

from __future__ import annotations

from orbisim.report.notes import merged


def test_notes_are_said_once() -> None:
    same = [f"run{i}.npz: 3 windows are left out" for i in range(1, 7)]
    assert merged([*same, "run1.npz: another", "of all", "of all"]) == [
        "run1.npz, run2.npz, run3.npz and 3 more: 3 windows are left out",
        "run1.npz: another",
        "of all",
    ]
    assert merged([]) == []
