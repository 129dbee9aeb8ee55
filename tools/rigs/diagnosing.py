"""Runs `orbisim diagnose` with its defaults on a trial; only the trial's folder is read."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from traceback import extract_tb
from typing import Any

import from_source

KEPT = ("verdict", "effects", "retuned", "alternatives", "error", "residual", "noise", "notes")

_PLACES = 8
"""Innermost lines of a fault that are kept."""


def scene_of(folder: Path) -> Path:
    """The declared scene of a trial."""
    return next(iter(sorted(folder.glob("scene.*"))))


def recordings_of(folder: Path, part: str) -> list[Path]:
    """The files of the recordings to fit to (`fit`) or held out (`held`)."""
    return sorted(folder.glob(f"{part}_*.npz"))


def diagnosed(folder: Path, patience: float, seed: int = 0, half: bool = False) -> int:
    """Prints one JSON line: the report's main parts, or what failed.

    Args:
      half: whether every second recording is left out, of those to fit to and of those held out.
    """
    from_source.register("mujoco")
    from orbisim.cli.main import cli

    every = 2 if half else 1
    kept = recordings_of(folder, "held")[::every]
    held = [part for path in kept for part in ("--held-out", str(path))]
    fit = [str(path) for path in recordings_of(folder, "fit")[::every]]
    with tempfile.TemporaryDirectory() as out:
        words = ["diagnose", str(scene_of(folder)), *fit, *held, "--out", out]
        words += ["--patience", str(patience), "--seed", str(seed)]
        try:
            cli.main(words, standalone_mode=False)
        except Exception as error:
            frames = extract_tb(error.__traceback__)[-_PLACES:]
            places = ", ".join(f"{Path(f.filename).name}:{f.lineno}" for f in frames)
            print(json.dumps({"report": None, "failure": f"{error!r} at {places}"[:2000]}))
            return 0
        report: dict[str, Any] = json.loads((Path(out) / "report.json").read_text())
    told = {key: report[key] for key in KEPT if key in report}
    print(json.dumps({"report": told, "failure": None}))
    return 0
