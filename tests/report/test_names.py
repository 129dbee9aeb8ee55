"""Names are shown as they are, in every kind of report: `$` begins no formula."""

from __future__ import annotations

from pathlib import Path

import pytest

import orbisim
from orbisim.compare import compare
from orbisim.diagnosis import Settings
from orbisim.recording import capture
from orbisim.report import figures
from tests.recording.scenes import simulate

HINGE, BODY = r"hinge$\frac{$", r"$^_arm\$$"
"""Formulas, if anything is: neither can be drawn as one."""
ARM = f"""
<mujoco model="$model$">
  <option timestep="0.005"/>
  <worldbody>
    <body name="{BODY}"><joint name="{HINGE}" axis="0 1 0" damping="0.02"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.4" size=".02" mass=".5"/></body>
  </worldbody>
  <actuator><motor name="$motor$" joint="{HINGE}" ctrlrange="-1 1"/></actuator>
  <sensor><jointpos name="$encoder_$" joint="{HINGE}"/></sensor>
</mujoco>
"""


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three recordings of the arm with friction, one of them in a file named like a formula."""
    folder = tmp_path_factory.mktemp("names")
    rubbing = orbisim.load_scene(ARM.replace("damping=", 'frictionloss="0.1" damping='))
    paths = [folder / name for name in ("a.npz", "b.npz", r"$\alpha_{$.npz")]
    for seed, path in enumerate(paths):
        capture(rubbing, simulate(rubbing, 300, seed=seed), noise=1e-4).save(path)
    return paths


def test_compare(tmp_path: Path) -> None:
    page = compare(orbisim.load_scene(ARM), "mujoco", "mujoco", count=2, horizon=0.1)
    text = page.report(tmp_path, video=False).read_text()
    assert f"qpos {HINGE}" in text


def test_replay(recordings: list[Path], tmp_path: Path) -> None:
    text = orbisim.replay(ARM, list(recordings)).report(tmp_path).read_text()
    assert f"Error of qpos/{HINGE}" in text


@pytest.mark.parametrize("residual", ["motion", "force"])
def test_diagnosis(recordings: list[Path], tmp_path: Path, residual: str) -> None:
    found = orbisim.diagnose(
        ARM,
        recordings[:2],
        recordings[2:],
        residual=residual,  # type: ignore[arg-type]
        settings=Settings(effects=("coulomb_friction",), retune=False),
        progress=False,
    )
    found.save(tmp_path)
    text = (tmp_path / "report.html").read_text()
    assert f"Missing force at {HINGE}" in text
    assert recordings[2].name in text


def test_ticks_of_powers_of_ten_stay_formulas() -> None:
    drawn, axes = figures.figure()
    axes.plot([1, 2], [1.0, 1e6], label="$x^$")
    axes.set(yscale="log", title="$y_$")
    figures.legend(axes)
    page = str(figures.to_svg(drawn, "a line"))
    assert "$x^$" in page
    assert "$y_$" in page
    assert "<tspan" in page  # a power of ten, laid out
    assert ">$\\mathdefault" not in page
