"""`orbisim identify`: what it prints, writes and refuses."""

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from orbisim import Recording
from orbisim.cli.main import run

PENDULUM = """
<mujoco model="pendulum">
  <option timestep="0.005" integrator="implicitfast"/>
  <worldbody>
    <body name="rod"><joint name="hinge" axis="0 1 0" damping="0.1"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.02" mass="1"/></body>
  </worldbody>
</mujoco>
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A scene, and a recording of one with other damping."""
    (tmp_path / "scene.xml").write_text(PENDULUM)
    model = mujoco.MjModel.from_xml_string(PENDULUM.replace('"0.1"', '"0.03"'))
    data, rows = mujoco.MjData(model), []
    data.qpos[0] = 1.0
    for _ in range(200):
        rows.append((data.time, data.qpos.copy(), data.qvel.copy()))
        mujoco.mj_step(model, data, 2)
    time, qpos, qvel = (np.array(column) for column in zip(*rows, strict=True))
    Recording(time, {"qpos": qpos, "qvel": qvel}).save(tmp_path / "swing.npz")
    return tmp_path


def test_damping_by_sysid(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    given = [str(folder / "scene.xml"), str(folder / "swing.npz"), "--params", "damping"]
    out = folder / "out"
    assert run(["identify", *given, "--backend", "mujoco", "--out", str(out), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    found = said["parameters"]["damping:hinge"]
    assert found["value"] == pytest.approx(0.03, rel=0.02) and found["declared"] == 0.1
    assert found["ci95"][0] <= found["value"] <= found["ci95"][1]
    assert said["error"]["after"] < 0.05 * said["error"]["before"]
    assert json.loads((out / "identified.json").read_text()) == said
    assert (out / "scene" / "scene.xml").exists()


def test_wrong_names(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    given = [str(folder / "scene.xml"), str(folder / "swing.npz")]
    assert run(["identify", *given, "--params", "colour", "--backend", "mujoco"]) == 2
    assert "colour" in capsys.readouterr().err
