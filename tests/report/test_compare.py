"""The page of `orbisim compare`."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest

from orbisim import load_scene, make_renderer, metrics
from orbisim.compare import Comparison, compare
from orbisim.errors import RenderingUnavailableError
from orbisim.penetration import Penetration
from orbisim.report.compare import (
    _beside_rounding,
    _command,
    _identical_to_the_eye,
    _qpos_names,
    _summary,
    _touching,
    _verdict,
)
from tests.physics.test_switching import Drift
from tests.test_compare import MIXED, Doubtful


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    return compare(load_scene(MIXED), "mujoco", Drift(), count=3, horizon=0.2, seed=1)


def test_the_report_stands_alone(comparison: Comparison, tmp_path: Path) -> None:
    page = comparison.report(tmp_path, video=False).read_text()
    assert json.loads((tmp_path / "report.json").read_text())["schema"] == "orbisim.compare/1"
    assert page.count("<svg") >= len(metrics.GROUPS) + 3
    assert "prefers-color-scheme: dark" in page
    assert 'name="viewport"' in page
    links = re.findall(r'(?:src|href)="([^"]+)"', page)
    assert all(link.startswith(("#", "data:")) for link in links)
    assert "orbisim compare" in page


def test_penetration_and_intervals_are_shown(tmp_path: Path) -> None:
    floor = "<worldbody><geom name='floor' type='plane' size='9 9 .1'/>"
    scene = load_scene(MIXED.replace("<worldbody>", floor).replace('pos="0 0 1"', 'pos="0 0 .099"'))
    page = compare(scene, "mujoco", Doubtful(), count=2, horizon=0.1).report(tmp_path, video=False)
    text = page.read_text()
    assert "<h2>Penetration</h2>" in text and "<h2>Predicted uncertainty</h2>" in text
    assert '<td class="name">Object and world</td>' in text and "floor and box" in text
    assert "Penetration: object and world of both sides over time" in text
    assert "Predicted intervals and true errors of box, rotation, over time" in text
    assert "Kinetic energy of both sides over time" in text


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_lost_episodes_have_no_penetration(comparison: Comparison) -> None:
    depth = np.array([[0.0, 0.003, np.nan], [0.001, np.nan, np.nan], [np.nan] * 3])
    lost = Penetration({"object-world": depth}, {"object-world": None})
    side = dataclasses.replace(comparison.b, penetration=lost)
    other = dataclasses.replace(comparison.a, penetration=lost)
    (row,) = _touching(dataclasses.replace(comparison, a=other, b=side))
    assert row["b"]["median"] == pytest.approx(0.002)
    assert row["b"]["worst"] == pytest.approx(0.003)
    every = Penetration({"object-world": depth[2:]}, {"object-world": None})
    side = dataclasses.replace(comparison.b, penetration=every)
    (row,) = _touching(dataclasses.replace(comparison, a=other, b=side))
    assert np.isnan(row["b"]["worst"])


def test_what_a_scene_lacks_is_not_shown(comparison: Comparison, tmp_path: Path) -> None:
    text = comparison.report(tmp_path, video=False).read_text()
    assert "Predicted uncertainty" not in text


def test_names_in_the_report_are_escaped(tmp_path: Path) -> None:
    result = compare(load_scene(MIXED), count=1, horizon=0.05, b="mujoco")
    page = dataclasses.replace(result, source="<script>alert(1)</script>").report(
        tmp_path, video=False
    )
    assert "<script>" not in page.read_text()


def test_one_sentence_says_how_far_apart(comparison: Comparison) -> None:
    fast = dataclasses.replace(comparison.a, steps_per_s=3000.0)
    slow = dataclasses.replace(comparison.b, steps_per_s=1000.0)
    text = _summary(dataclasses.replace(comparison, a=fast, b=slow))
    assert text.startswith("After 200 ms the median joint position error is ")
    assert text.endswith("Here mujoco is 3 times as fast as drift.")
    assert "rad (slides: m)" in text
    assert " drift and mujoco differ: " in text


def test_the_verdict_follows_the_ratio(comparison: Comparison) -> None:
    said = [_verdict(ratio, comparison) for ratio in (0.0, 5.0, 200.0, 1e6)]
    assert said == [
        "drift gives exactly what mujoco gives.",
        "drift agrees with mujoco as well as float32 allows in this scene: to within 10 times its "
        "rounding, and 1e-06 is the least that counts as rounding.",
        "drift agrees with mujoco to 2e+02 times what rounding does in this scene.",
        "drift and mujoco differ: 1e+06 times what rounding does in this scene.",
    ]


def test_what_rounding_scatters_in_the_end_does_not_excuse_the_beginning() -> None:
    rounding = [0.0, 1e-9, 1e-3, 0.1]
    assert _beside_rounding([0.3, 0.4, 0.5, 0.5], rounding) == pytest.approx(4e5)
    assert _beside_rounding([1e-7, 1e-6, 2e-3, 0.1], rounding) == pytest.approx(2)
    assert _beside_rounding([0.0] * 4, rounding) == 0


def test_lines_that_cover_each_other_are_drawn_as_their_difference() -> None:
    line = np.linspace(0, 1, 50)
    assert _identical_to_the_eye(line, line + 1e-3)
    assert not _identical_to_the_eye(line, line + 0.05)
    assert not _identical_to_the_eye(np.zeros(5), np.zeros(5) + 1e-9)  # nothing moves but one


def test_the_command_repeats_the_comparison(comparison: Comparison) -> None:
    command = _command(comparison)
    assert command.endswith("--a mujoco --b drift --episodes 3 --horizon 0.2 --seed 1")


def test_coordinates_are_named() -> None:
    names = _qpos_names(load_scene(MIXED).model)
    assert names[:3] == ["joint0/x", "joint0/y", "joint0/z"]
    assert names[3:] == [*(f"joint0/{q}" for q in ("qw", "qx", "qy", "qz")), "hinge", "slide"]


def test_another_renderer_is_shown_beside_mujocos(comparison: Comparison, tmp_path: Path) -> None:
    try:
        make_renderer("mujoco", comparison.scene).render(comparison.a.trajectory.initial)
    except RenderingUnavailableError:
        pytest.skip("no OpenGL")
    page = comparison.report(tmp_path, renderer="null").read_text()
    assert "in the middle as null does" in page
    assert "data:video/mp4" in page
