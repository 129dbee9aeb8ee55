"""What a recording was read from."""

from __future__ import annotations

import subprocess
from pathlib import Path

from orbisim.recording.origin import digest_of_source, files_of


def test_a_folder_has_the_hash_that_a_shell_says_of_it(tmp_path: Path) -> None:
    (tmp_path / "log").mkdir()
    for name in ("b.parquet", "a.json", "film.mp4"):
        (tmp_path / "log" / name).write_text(name)
    lines = "find . -type f -not -name '*.mp4' | LC_ALL=C sort | xargs sha256sum | sha256sum"
    said = subprocess.check_output(lines, shell=True, text=True, cwd=tmp_path / "log")
    whole = digest_of_source(f"{tmp_path}/log")
    assert digest_of_source(f"{tmp_path}/log#3") == whole == said.split()[0]
    assert digest_of_source("made here") is None


def test_stretches_are_of_one_file() -> None:
    parts = ["a.npz[0 s to 2.5 s]", "a.npz[2.51 s to 3 s]", "b.h5#2", "b.h5#2[0 s to 1 s]"]
    assert files_of(parts) == ["a.npz", "b.h5#2"]
