"""Names are shown as they are, in every kind of report: `$` begins no formula."""

from __future__ import annotations

import dataclasses
import shlex
from pathlib import Path
from types import SimpleNamespace

import pytest

import orbisim
from orbisim.cli.diagnose import command as diagnose
from orbisim.compare import compare
from orbisim.diagnosis import Settings
from orbisim.recording import capture
from orbisim.report import figures
from orbisim.report.diagnosis import _command
from tests.recording.scenes import simulate
from tests.view.chromium import Chromium, executable

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


def test_the_command_names_the_map(recordings: list[Path]) -> None:
    loaded = [orbisim.Recording.load(path).replace(map_file="map.yaml") for path in recordings]
    error = {"window_s": 0.5}
    result = SimpleNamespace(
        source="arm.xml", fit=loaded[:2], held_out=loaded[2:], error=error, rest=None,
        backend="mujoco", settings=Settings(),
    )  # fmt: skip
    assert _command(result).endswith(" --map map.yaml --window 0.5")  # type: ignore[arg-type]
    result.held_out = [one.replace(map_file=None) for one in loaded[2:]]
    assert "--map" not in _command(result)  # type: ignore[arg-type]


def test_the_command_names_what_was_told(recordings: list[Path], tmp_path: Path) -> None:
    told = Settings(effects=("cogging", "backlash"), retune=False, patience=90.0, seed=3)
    result = orbisim.diagnose(ARM, recordings[:2], recordings[2:], settings=told, progress=False)
    command = _command(result)
    assert command.endswith(
        " --effect cogging --effect backlash --patience 90 --seed 3 --no-retune"
    )
    source = tmp_path / "arm.xml"  # the command wants files that exist
    source.write_text(ARM)
    words = [str(source) if word == ARM else word for word in shlex.split(command)[2:]]
    context = diagnose.make_context("diagnose", words)
    assert context.params["effects"] == ("cogging", "backlash")
    assert context.params["patience"] == 90.0
    assert context.params["seed"] == 3
    assert not context.params["retune"]


WIDE = """
(() => {
  const cut = [...document.querySelectorAll("td.n, th.n")].filter((cell) => {
    const range = document.createRange();
    range.selectNodeContents(cell);
    const words = cell.innerText.trim().split(/\\s+/).length;
    const lines = new Set([...range.getClientRects()].map((one) => Math.round(one.top)));
    return lines.size > words;
  });
  return {
    page: document.documentElement.scrollWidth - innerWidth,
    cut: cut.map((cell) => cell.innerText),
    hidden: [...document.querySelectorAll(".scroll > table")].filter(
      (table) => getComputedStyle(table.parentElement).overflowX !== "auto"
        && table.scrollWidth > table.parentElement.clientWidth).length,
  };
})()
"""
"""By how much a page is wider than the screen, cells in which a word or number is cut in two, and
tables that are too wide and cannot be moved."""


@pytest.mark.slow
@pytest.mark.skipif(executable() is None, reason="no Chromium here")
def test_on_a_phone_no_number_is_cut(recordings: list[Path], tmp_path: Path) -> None:
    named = orbisim.load_scene(ARM)
    long = dataclasses.replace(named, source="robot.urdf?actuators=position&actuate=all" * 3)
    pages = [
        compare(long, "mujoco", "mujoco", count=2, horizon=0.1).report(tmp_path / "a"),
        orbisim.replay(ARM, list(recordings)).report(tmp_path / "b"),
    ]
    only = Settings(effects=("coulomb_friction",), retune=False)
    found = orbisim.diagnose(ARM, recordings[:2], recordings[2:], settings=only, progress=False)
    found.save(tmp_path / "c")
    with Chromium(tmp_path / "profile", 375, 667) as browser:
        for page in (*pages, tmp_path / "c" / "report.html"):
            browser.visit(page.as_uri())
            assert browser.evaluate(WIDE) == {"page": 0, "cut": [], "hidden": 0}
            assert browser.errors == []
            assert browser.requests == [page.as_uri()]
            if browser.evaluate("document.querySelectorAll('video').length"):
                browser.evaluate("document.querySelector('video').play().then(() => 0)")
                browser.wait_for("document.querySelector('video').currentTime > 0")


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
