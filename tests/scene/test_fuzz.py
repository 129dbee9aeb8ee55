"""A few damaged scenes of those that tools/fuzz_readers.py makes by the thousand."""

from __future__ import annotations

import random
import sys
from pathlib import Path

import pytest

from orbisim import load_scene
from orbisim.errors import SceneError
from orbisim.files.guard import FAILED

sys.path.insert(0, str(Path(__file__).parents[2] / "tools"))
from fuzz_mutations import mutated
from fuzz_readers import summary
from fuzz_seeds import builtin_seeds, write


@pytest.mark.parametrize("reader", ["mjcf", "urdf"])
def test_seeds_load_as_they_are(tmp_path: Path, reader: str) -> None:
    for number, files in enumerate(builtin_seeds(reader)):
        folder = tmp_path / str(number)
        folder.mkdir()
        assert load_scene(write(files, folder)).model.nbody > 1


@pytest.mark.parametrize("reader", ["mjcf", "urdf"])
def test_damaged_scenes_load_or_are_refused(tmp_path: Path, reader: str) -> None:
    seeds = builtin_seeds(reader)
    changed = refused = 0
    for index in range(16):
        rng = random.Random(f"test/{index}")
        files = mutated(rng.choice(seeds), rng)
        changed += files not in seeds
        try:
            load_scene(write(files, tmp_path))
        except SceneError as error:
            refused += 1
            assert FAILED not in str(error)
            assert "\n" not in str(error)
    assert changed > 12
    assert 3 < refused < 16


def test_summary_counts_every_outcome() -> None:
    from fuzz_readers import OUTCOMES, Outcome

    row = summary("urdf", [Outcome(i, name, "", 0.1) for i, name in enumerate(OUTCOMES)])
    assert all(row[name] == 1 for name in OUTCOMES)
