"""Names of the episode format."""

from __future__ import annotations

from pathlib import Path

import pytest

from orbisim.tasks import make
from orbisim.tasks.schema import PER_STEP, SCHEMA, is_static

DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "episodes.md"


@pytest.mark.parametrize("name", ["ball", "push"])
def test_rows_of_every_dataset_follow_from_its_name(name: str) -> None:
    task = make(name)
    episode = task.episode(task.default_subtask, 0)
    for dataset, array in episode.arrays.items():
        if not is_static(dataset):
            expected = episode.steps if dataset in PER_STEP else episode.steps + 1
            assert len(array) == expected, dataset


def test_the_document_names_the_format() -> None:
    assert SCHEMA in DOCUMENT.read_text()
