"""What docs/journeys.md says of a video, done as it is written there."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import orbisim

PAGE = Path(__file__).parents[2] / "docs" / "journeys.md"


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_video_becomes_a_patch(tmp_path: Path) -> None:
    text = PAGE.read_text().partition("## A video, a recording, a diagnosis")[2]
    (scene,) = re.findall(r"```xml\n(.*?)```", text, re.S)
    (commands,) = re.findall(r"```sh\n(.*?)```", text, re.S)
    (tmp_path / "pendulum.xml").write_text(scene)
    places = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-e", "-c", commands],
        cwd=tmp_path,
        env={**os.environ, "PATH": places},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    friction = orbisim.load_scene(tmp_path / "pendulum.xml").model.dof_frictionloss
    assert friction[0] == pytest.approx(0.02, rel=0.05)
