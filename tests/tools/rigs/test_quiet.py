"""Recordings without an effect, with what real ones have beside white noise: silence."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "tools"))

from rigs.diagnosing import recordings_of, scene_of
from rigs.making import Wish, make, name_of

import orbisim
from orbisim import Recording, load_scene


@pytest.mark.parametrize(
    ("machine", "artefact"),
    [("served_ball", "jitter"), pytest.param("suite_acrobot", "encoder", marks=pytest.mark.slow)],
)
def test_no_effect_is_named(machine: str, artefact: str, tmp_path: Path) -> None:
    made = make(1, 3, tmp_path, Wish((machine,), "none", (artefact,)))
    assert made["artefacts"] == [artefact]
    folder = tmp_path / "trials" / name_of(1)
    fit, held = (
        [Recording.load(path) for path in recordings_of(folder, part)] for part in ("fit", "held")
    )
    scene = load_scene(scene_of(folder), trusted=True)
    assert orbisim.diagnose(scene, fit, held, progress=False).verdict == "no_residual"
