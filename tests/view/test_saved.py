"""Saved trajectories: what is chosen from them, and what the page carries."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orbisim import view
from orbisim.errors import InputError, MissingDependencyError
from orbisim.scene import load_scene
from orbisim.trajectory import Trajectory
from orbisim.view import page, saved
from orbisim.view.animation import Frames, frames_of, nearest_to_grid
from orbisim.view.drawing import Drawing
from orbisim.view.options import GHOST
from tests.view.scenes import CLOTH, commands_of, falling, matrix_of, showcase

SCENE = showcase()
RUN = falling(SCENE, 400)
BALL = SCENE.model.body("ball").id


def animation(html: str) -> dict[str, Any]:
    """The animation command of a page."""
    (found,) = [c for c in commands_of(html) if c["type"] == "set_animation"]
    return found


def tracks(html: str) -> dict[str, dict[str, Any]]:
    """Tracks by path and property."""
    return {
        clip["path"] + track["name"]: track
        for clip in animation(html)["animations"]
        for track in clip["clip"]["tracks"]
    }


def only(trajectory: Trajectory, steps: int) -> Trajectory:
    """The first steps of a trajectory."""
    names = ("control", "time", "qpos", "qvel", "act")
    cut = {name: getattr(trajectory, name)[:, :steps] for name in names}
    return dataclasses.replace(trajectory, **cut)


def with_nan(trajectory: Trajectory, step: int) -> Trajectory:
    qpos = trajectory.qpos.copy()
    qpos[:, step:] = np.nan
    return dataclasses.replace(trajectory, qpos=qpos)


@settings(deadline=None)
@given(steps=st.lists(st.floats(1e-4, 0.5), min_size=0, max_size=60), fps=st.floats(0.5, 200.0))
def test_chosen_samples(steps: list[float], fps: float) -> None:
    elapsed = np.concatenate([[0.0], np.cumsum(steps)])
    chosen = nearest_to_grid(elapsed, fps)
    assert chosen[0] == 0
    assert chosen[-1] == len(elapsed) - 1
    assert (np.diff(chosen) > 0).all()
    assert len(chosen) <= elapsed[-1] * fps + 2 + 1e-6
    for moment in np.arange(0, elapsed[-1], 1 / fps):
        nearest = np.abs(elapsed - moment).min()
        assert np.abs(elapsed[chosen] - moment).min() == pytest.approx(nearest, abs=1e-12)


def test_keys_are_the_recorded_states() -> None:
    found = tracks(view.trajectory_html(SCENE, RUN, fps=20))
    path = Drawing(SCENE.model).bodies[BALL]
    position, rotation = found[f"{path}.position"], found[f"{path}.quaternion"]
    elapsed = RUN.with_initial("time")[0]
    qpos = RUN.with_initial("qpos")[0]
    keys = np.array([np.abs(elapsed - time).argmin() for time in position["times"]])
    np.testing.assert_allclose(position["times"], elapsed[keys], atol=1e-6)
    assert position["times"][-1] == pytest.approx(0.8)
    address = SCENE.model.jnt_qposadr[SCENE.model.body("ball").jntadr[0]]
    np.testing.assert_allclose(
        position["values"].reshape(-1, 3), qpos[keys, address : address + 3], atol=1e-6
    )
    values = rotation["values"].reshape(-1, 4)  # x, y, z, w
    turned = np.array([np.abs(elapsed - time).argmin() for time in rotation["times"]])
    expected = qpos[turned][:, address + np.array([4, 5, 6, 3])]
    np.testing.assert_allclose(values, expected, atol=1e-6)


def test_what_stands_still_has_no_track_and_the_first_frame_is_drawn() -> None:
    html = view.trajectory_html(SCENE, RUN)
    found = tracks(html)
    drawing = Drawing(SCENE.model)
    assert not any("world" in path or "target" in path for path in found)
    placed = [c for c in commands_of(html) if c["type"] == "set_transform"]
    (matrix,) = [c["matrix"] for c in placed if c["path"] == drawing.bodies[BALL]]
    np.testing.assert_allclose(matrix_of(matrix)[:3, 3], [-0.85, 0, 0.6], atol=1e-9)


def test_rest_costs_no_keys() -> None:
    still = RUN.qpos.copy()
    still[:, 10:] = still[:, 10:11]
    resting = dataclasses.replace(RUN, qpos=still)
    path = Drawing(SCENE.model).bodies[BALL] + ".position"
    moving = tracks(view.trajectory_html(SCENE, RUN, fps=500))[path]
    rested = tracks(view.trajectory_html(SCENE, resting, fps=500))[path]
    assert len(rested["times"]) < 15 < len(moving["times"])
    assert rested["times"][-1] == moving["times"][-1]


def test_a_ghost_lasts_as_long_as_the_other() -> None:
    html = view.trajectory_html(SCENE, RUN, ghost=falling(SCENE, 100, push=0.3))
    ends = {path: track["times"][-1] for path, track in tracks(html).items()}
    assert {path.split("/")[1] for path in ends} == {"scene", "ghost"}
    np.testing.assert_allclose(list(ends.values()), 0.8, rtol=1e-6)
    held = tracks(html)[Drawing(SCENE.model, look=GHOST).bodies[BALL] + ".position"]
    assert held["times"][-2] == pytest.approx(0.2)
    np.testing.assert_array_equal(held["values"][-3:], held["values"][-6:-3])
    assert animation(html)["options"]["repetitions"] == np.inf
    assert "trajectory" in html and "rgb(242,115,13)" in html


def test_a_ghost_may_have_a_scene_of_its_own() -> None:
    other = load_scene(
        "<mujoco model='other'><worldbody><body><freejoint/><geom size='.1'/></body></worldbody>"
        "</mujoco>"
    )
    run = falling(other, 50)
    with pytest.raises(InputError, match="qpos has 7 columns"):
        view.trajectory_html(SCENE, RUN, ghost=run)
    paths = tracks(view.trajectory_html(SCENE, RUN, ghost=run, ghost_scene=other))
    assert "/ghost/body 1.position" in paths


def test_another_world() -> None:
    many = falling(SCENE, 20, nworld=2)
    moved = many.qpos.copy()
    moved[1, :, 0] += 1
    many = dataclasses.replace(many, qpos=moved)
    frames = [frames_of(SCENE, many, world=w, fps=30) for w in (0, 1)]
    assert frames[1].qpos[-1, 0] == pytest.approx(frames[0].qpos[-1, 0] + 1)
    with pytest.raises(InputError, match="2 worlds, numbered from 0; got world 2"):
        frames_of(SCENE, many, world=2, fps=30)


def test_a_trajectory_of_another_scene() -> None:
    other = load_scene("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    with pytest.raises(InputError, match=r"its qpos has \d+ columns and the scene's nq is 0"):
        view.trajectory_html(other, RUN)


def test_stops_where_the_state_is_not_finite_and_says_so() -> None:
    with pytest.warns(UserWarning, match=r"not finite from 0\.202 s on") as caught:
        html = view.trajectory_html(SCENE, with_nan(RUN, 100))
    assert caught[0].filename == __file__
    assert "the state is not finite from 0.202 s on" in html
    found = tracks(html)
    assert max(track["times"][-1] for track in found.values()) == pytest.approx(0.2)
    assert all(np.isfinite(track["values"]).all() for track in found.values())


def test_a_first_state_that_is_not_finite() -> None:
    initial = RUN.initial.replace(qpos=RUN.initial.qpos * np.nan)
    with pytest.raises(InputError, match="nothing to show"):
        view.trajectory_html(SCENE, dataclasses.replace(RUN, initial=initial))


def test_no_steps() -> None:
    with pytest.warns(UserWarning, match="has no steps"):
        html = view.trajectory_html(SCENE, only(RUN, 0))
    assert not any(c["type"] == "set_animation" for c in commands_of(html))
    assert "only its initial state is shown" in html
    still = view.trajectory_html(SCENE, None)
    assert not any(c["type"] == "set_animation" for c in commands_of(still))


def test_time_must_not_be_endless() -> None:
    with pytest.raises(InputError, match="at most 10000000 are shown"):
        view.trajectory_html(SCENE, dataclasses.replace(RUN, time=RUN.time * 1e9))


def test_time_must_increase() -> None:
    time = RUN.time.copy()
    time[:, 5] = time[:, 3]
    with pytest.raises(InputError, match="time does not increase"):
        view.trajectory_html(SCENE, dataclasses.replace(RUN, time=time))


def test_a_saved_trajectory_and_a_torch_one(tmp_path: Path) -> None:
    RUN.save(tmp_path / "run.npz")
    loaded, _ = Trajectory.load(tmp_path / "run.npz")
    assert view.trajectory_html(SCENE, loaded) == view.trajectory_html(SCENE, RUN)
    torch = pytest.importorskip("torch")
    names = ("time", "qpos", "qvel", "act")
    tensors = {name: torch.as_tensor(getattr(RUN, name)) for name in names}
    on_device = dataclasses.replace(RUN, **tensors)
    assert view.trajectory_html(SCENE, on_device) == view.trajectory_html(SCENE, RUN)


def test_mocap_of_the_initial_state_is_used() -> None:
    memory = {"mocap_pos": np.array([[[0.0, 0, 3.0]]]), "mocap_quat": np.array([[[1.0, 0, 0, 0]]])}
    moved = dataclasses.replace(RUN, initial=RUN.initial.with_memory(**memory))
    frames = frames_of(SCENE, moved, world=0, fps=30)
    drawing = Drawing(SCENE.model)
    drawing.place(frames.qpos[0], frames.memory)
    target = SCENE.model.body("target").id
    np.testing.assert_allclose(drawing.kinematics.body_matrix(target)[:3, 3], [0, 0, 3])


def test_flexes_have_vertex_tracks() -> None:
    scene = load_scene(CLOTH)
    run = falling(scene, 100)
    html = view.trajectory_html(scene, run, fps=20)
    found = {c["path"]: c for c in commands_of(html) if c["type"] == "vertex_track"}
    assert sorted(path.split("/")[2] for path in found) == ["cloth 0", "jelly 2", "rope 1"]
    cloth = found["/scene/cloth 0"]
    frames = frames_of(scene, run, world=0, fps=20)
    assert len(cloth["times"]) == len(frames.time)
    data = mujoco.MjData(scene.model)
    data.qpos[:] = frames.qpos[-1]
    mujoco.mj_forward(scene.model, data)
    last = cloth["positions"].reshape(len(frames.time), -1, 3)[-1]
    np.testing.assert_allclose(last, data.flexvert_xpos[:49], atol=1e-6)
    assert animation(html)["animations"]  # something runs the clock


def test_frames_with_fewer_contacts_are_filled_up() -> None:
    scene = load_scene(
        "<mujoco><worldbody><geom type='plane' size='1 1 1'/><body pos='0 0 .12'><freejoint/>"
        "<geom type='box' size='.1 .1 .1'/></body></worldbody></mujoco>"
    )
    options = view.ViewOptions(contacts=True)
    html = view.trajectory_html(scene, falling(scene, 100), options=options)
    (track,) = [c for c in commands_of(html) if c["type"] == "vertex_track"]
    shape = (len(track["times"]), 8, 3)  # four contacts
    assert track["positions"].reshape(shape)[0].tolist() == np.zeros((8, 3)).tolist()
    assert np.ptp(track["positions"].reshape(shape)[-1, :, 0]) > 0.19
    assert not track["interpolate"]


def test_page_is_one_file_without_references() -> None:
    html = view.trajectory_html(SCENE, RUN, title="<b>&amp;</b>")
    own = html.replace(page.viewer_script(), "")
    assert "<b>" not in own
    assert "src=" not in own and "@import" not in own and "url(" not in own
    assert 'href="data:,"' in own
    assert own.count("://") == 3  # meshcat's project, in a comment; ws and wss
    assert len(html) < 1_200_000


def test_equal_input_gives_equal_pages() -> None:
    assert view.trajectory_html(SCENE, RUN) == view.trajectory_html(SCENE, RUN)


def test_save_html(tmp_path: Path) -> None:
    path = view.save_html(tmp_path / "run.html", SCENE, RUN, fps=10)
    assert path.read_text(encoding="utf-8") == view.trajectory_html(SCENE, RUN, fps=10)
    with pytest.raises(InputError, match="cannot be written"):
        view.save_html(tmp_path / "none" / "run.html", SCENE, RUN)


def test_large_pages_come_with_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        view.trajectory_html(SCENE, RUN)
    monkeypatch.setattr(saved, "LARGE", 10_000)
    with pytest.warns(UserWarning, match="lower fps"):
        view.trajectory_html(SCENE, RUN)


@pytest.mark.parametrize("wrong", [{"fps": 0}, {"fps": float("nan")}, {"ghost": RUN, "x": None}])
def test_wrong_choices(wrong: dict[str, Any]) -> None:
    run = wrong.pop("x", RUN)
    with pytest.raises(InputError):
        view.trajectory_html(SCENE, run, **wrong)


def printed(script: str) -> str:
    """What a script of its own process prints."""
    arguments = [sys.executable, "-c", script]
    return subprocess.run(arguments, capture_output=True, text=True, check=True).stdout


def test_missing_packages_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page.importlib.util, "find_spec", lambda name: None)
    page.viewer_script.cache_clear()
    try:
        with pytest.raises(MissingDependencyError, match=r"pip install 'orbisim\[view\]'"):
            view.trajectory_html(SCENE, None)
    finally:
        page.viewer_script.cache_clear()
    script = (
        "import sys, json; sys.modules['umsgpack'] = None\n"
        "from orbisim.errors import MissingDependencyError\n"
        "try:\n    from orbisim.view import save_html\n"
        "except MissingDependencyError as error: print(json.dumps(str(error)))"
    )
    told = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert "packages for the viewer are not installed" in json.loads(told.stdout)


def test_importing_the_package_loads_nothing() -> None:
    script = "import sys, orbisim.view; print('mujoco' in sys.modules, 'tornado' in sys.modules)"
    told = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert told.stdout.split() == ["False", "False"]
    assert set(view.__all__) <= set(dir(view))
    with pytest.raises(AttributeError):
        _ = view.nothing


def test_frames_know_their_duration() -> None:
    assert Frames(np.array([0.0, 1.5]), np.zeros((2, 1)), {}).duration == 1.5
