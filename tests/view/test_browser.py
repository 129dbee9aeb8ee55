"""The pages in a real browser: what three.js makes of them, and what one sees."""

from __future__ import annotations

import colorsys
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from orbisim_mujoco import MujocoBackend
from PIL import Image

from orbisim.errors import RenderingUnavailableError
from orbisim.registry import make_backend, make_renderer
from orbisim.scene import Scene, load_scene
from orbisim.view import ViewOptions, save_html
from orbisim.view.drawing import Drawing
from orbisim.view.options import GHOST
from orbisim.view.panel import Request, request_of
from orbisim.view.stage import camera_pose
from tests.view.chromium import Chromium, executable
from tests.view.scenes import CLOTH, falling, showcase
from tests.view.test_live import PENDULUM, live
from tests.view.test_panel import ROBOT

pytestmark = pytest.mark.skipif(executable() is None, reason="no Chromium here")

SCENE = showcase()
WIDTH, HEIGHT = 800, 560
Picture = np.ndarray[Any, np.dtype[np.uint8]]

MEASURE = """
(() => {
  const root = orbisim.viewer.scene_tree.find(["scene"]).object;
  orbisim.viewer.scene.updateMatrixWorld(true);
  const fromScene = orbisim.viewer.scene.matrixWorld.clone().invert();
  const found = {};
  root.traverse((object) => {
    if (!object.isMesh) return;
    const node = object.parent;
    const inNode = new orbisim.THREE.Box3().setFromBufferAttribute(
      object.geometry.clone().applyMatrix4(object.matrix).attributes.position);
    const pose = fromScene.clone().multiply(node.matrixWorld);
    found[node.name] = {
      pose: pose.toArray(), low: inNode.min.toArray(), high: inNode.max.toArray(),
      turns: object.matrixWorld.determinant(),
      shadow: object.castShadow,
    };
  });
  return found;
})()
"""


@pytest.fixture(scope="module")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chromium]:
    with Chromium(tmp_path_factory.mktemp("profile"), WIDTH, HEIGHT) as browser:
        yield browser


@pytest.fixture(scope="module")
def run_page(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A page of the falling showcase with a ghost that is pushed."""
    path = tmp_path_factory.mktemp("page") / "run.html"
    run, ghost = falling(SCENE, 150), falling(SCENE, 100, push=0.4)
    return save_html(path, SCENE, run, ghost=ghost).as_uri()


def project(points: Any, scene: Scene = SCENE) -> Any:
    """[n, 2]: columns and rows of the pixels at which the first view shows points [n, 3]."""
    position, target = camera_pose(scene.model, ViewOptions())
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(right, forward), forward])
    x, y, depth = axes @ (np.asarray(points) - position).T
    scale = 0.5 * HEIGHT / np.tan(0.5 * np.deg2rad(scene.model.vis.global_.fovy))
    return np.stack([WIDTH / 2 + scale * x / depth, HEIGHT / 2 - scale * y / depth], axis=1)


def around(picture: Picture, pixel: Any, reach: int = 2) -> Any:
    """[3]: median colour around a pixel, in [0, 1]."""
    column, row = (round(float(p)) for p in pixel)
    patch = picture[row - reach : row + reach + 1, column - reach : column + reach + 1]
    return np.median(patch.reshape(-1, 3), axis=0) / 255


def hue_error(got: Any, expected: Any) -> float:
    """Difference of hue, in degrees."""
    a, b = colorsys.rgb_to_hsv(*got)[0], colorsys.rgb_to_hsv(*expected)[0]
    return 360 * abs((a - b + 0.5) % 1 - 0.5)


def test_three_places_and_sizes_everything_as_mujoco_does(
    chromium: Chromium, tmp_path: Path
) -> None:
    chromium.open(save_html(tmp_path / "still.html", SCENE, None).as_uri())
    found = {name.rsplit(" ", 1)[0]: what for name, what in chromium.evaluate(MEASURE).items()}
    model, data = SCENE.model, mujoco.MjData(SCENE.model)
    mujoco.mj_kinematics(model, data)
    shown = {"floor", "hill", "sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh", "sdf"}
    assert found.keys() == shown | {"glass", "marker"}
    for name, what in found.items():
        pose = np.array(what["pose"]).reshape(4, 4).T
        np.testing.assert_allclose(pose[:3, 3], data.geom(name).xpos, atol=1e-5)
        np.testing.assert_allclose(pose[:3, :3].ravel(), data.geom(name).xmat, atol=1e-5)
        assert what["turns"] > 0
        if name != "floor":
            aabb = model.geom_aabb[model.geom(name).id]
            low, high = aabb[:3] - aabb[3:], aabb[:3] + aabb[3:]
            if name == "hill":  # MuJoCo's box of a height field reaches up to its highest point
                low[2], high[2] = -0.05, 0.25 * model.hfield_data.max()
            tolerance = 0.01 * (high - low).max()  # round shapes are polyhedra
            np.testing.assert_allclose(what["low"], low, atol=tolerance)
            np.testing.assert_allclose(what["high"], high, atol=tolerance)
    assert {n for n, what in found.items() if not what["shadow"]} == {"floor", "glass"}
    assert chromium.errors == []
    assert len(chromium.requests) == 1


@pytest.mark.parametrize("background", ["light", "dark"])
def test_one_sees_every_shape_in_its_colour(
    chromium: Chromium, tmp_path: Path, background: Any
) -> None:
    options = ViewOptions(background=background)
    page = save_html(tmp_path / "still.html", SCENE, None, options=options)
    chromium.open(page.as_uri())
    picture = chromium.screenshot(tmp_path / "still.png")
    model, data = SCENE.model, mujoco.MjData(SCENE.model)
    mujoco.mj_kinematics(model, data)
    pixels = dict(
        zip([model.geom(g).name for g in range(model.ngeom)], project(data.geom_xpos), strict=True)
    )
    hill = data.geom("hill").xpos + [0, 0, 0.25]
    pixels["hill"] = project(hill[None])[0]
    for part in Drawing(model).parts:
        name = part.name.rsplit(" ", 1)[0]
        if name not in ("floor", "glass"):
            colour = around(picture, pixels[name])
            assert hue_error(colour, part.appearance.rgba[:3]) < 12, (name, colour)
            assert colorsys.rgb_to_hsv(*colour)[1] > 0.4, (name, colour)
    glass = around(picture, pixels["glass"])
    assert hue_error(glass, (0.1, 0.5, 0.9)) < 25
    ground = project([[x, -0.95 + 0.05 * x, 0] for x in np.linspace(-0.6, 0.5, 40)])
    tiles = np.array([around(picture, pixel, 1).mean() for pixel in ground])
    assert np.ptp(tiles) > 0.03  # light and dark tiles
    sky = picture[4, WIDTH // 2] / 255
    expected = np.array(options.theme.top)
    np.testing.assert_allclose(sky, expected, atol=0.12)
    assert chromium.errors == []


def seek(chromium: Chromium, time: float) -> None:
    """Moves meshcat's time slider as a hand would: through the number field beside it."""
    chromium.evaluate(
        "(() => { const field = orbisim.viewer.animator.time_scrubber.domElement.parentElement"
        ".querySelector('input'); field.value = '" + str(time) + "';"
        "field.dispatchEvent(new Event('change')); field.blur(); return true; })()"
    )


def positions(chromium: Chromium, root: str) -> Any:
    """Position of the ball's node under a root, as three.js has it."""
    return chromium.evaluate(
        f"(() => {{ const tree = orbisim.viewer.scene_tree.find(['{root}']);"
        "const name = Object.keys(tree.children).find((n) => n.startsWith('ball'));"
        "return tree.children[name].object.position.toArray(); })()"
    )


def test_the_slider_moves_both_trajectories(chromium: Chromium, run_page: str) -> None:
    chromium.open(run_page)
    assert chromium.evaluate("orbisim.viewer.animator.playing")
    chromium.wait_for("orbisim.viewer.animator.time > 0")
    chromium.evaluate("orbisim.viewer.animator.pause()")
    run, ghost = falling(SCENE, 150), falling(SCENE, 100, push=0.4)
    for moment in (0.0, 0.15, 0.3, 0.1):
        seek(chromium, moment)
        assert chromium.evaluate("orbisim.viewer.animator.time") == pytest.approx(moment)
        for root, trajectory in (("scene", run), ("ghost", ghost)):
            time = trajectory.with_initial("time")[0]
            expected = trajectory.with_initial("qpos")[0, np.abs(time - moment).argmin(), :3]
            if moment > time[-1]:
                expected = trajectory.qpos[0, -1, :3]
            np.testing.assert_allclose(positions(chromium, root), expected, atol=2e-3)
    assert chromium.errors == []


def test_one_sees_the_ball_fall(chromium: Chromium, run_page: str, tmp_path: Path) -> None:
    run, ghost = falling(SCENE, 150), falling(SCENE, 100, push=0.4)
    red = np.array([0.9, 0.1, 0.1])
    for moment in (0.0, 0.29):
        chromium.open(f"{run_page}#t={moment}")
        picture = chromium.screenshot(tmp_path / f"{moment}.png")
        at = run.with_initial("qpos")[0, round(moment / 0.002), :3]
        assert hue_error(around(picture, project(at[None])[0]), red) < 12
        if moment > 0:
            start = run.initial.qpos[0, :3]
            assert hue_error(around(picture, project(start[None])[0]), red) > 20
            (pixel,) = project(ghost.qpos[0, -1, :3][None] + [[0.12, 0, 0]])
            assert hue_error(around(picture, pixel), GHOST.tint) < 15
    assert "0.29" in chromium.evaluate(
        "orbisim.viewer.animator.time_scrubber.domElement.parentElement.querySelector('input').value"
    )


def test_a_cloth_deforms_with_the_slider(chromium: Chromium, tmp_path: Path) -> None:
    scene = load_scene(CLOTH)
    run = falling(scene, 200)
    page = save_html(tmp_path / "cloth.html", scene, run, fps=50)
    data = mujoco.MjData(scene.model)
    for moment in (0.0, 0.4):
        chromium.open(f"{page.as_uri()}#t={moment}")
        chromium.screenshot()
        got = chromium.evaluate(
            "Array.from(orbisim.viewer.scene_tree.find(['scene', 'cloth 0', '<object>'])"
            ".object.geometry.attributes.position.array)"
        )
        data.qpos[:] = run.with_initial("qpos")[0, round(moment / 0.002)]
        mujoco.mj_forward(scene.model, data)
        np.testing.assert_allclose(np.reshape(got, (-1, 3)), data.flexvert_xpos[:49], atol=1e-4)
    assert chromium.errors == []


def test_a_live_page_follows_the_simulation(chromium: Chromium) -> None:
    with live(PENDULUM) as running:
        chromium.open(running.url)
        chromium.wait_for("parseFloat(document.getElementById('clock').textContent) > 0.2")
        name = Drawing(PENDULUM.model).bodies[1].split("/")[-1]
        body = f"orbisim.viewer.scene_tree.find(['scene', '{name}']).object"
        turned = chromium.evaluate(f"{body}.quaternion.toArray()")
        chromium.wait_for(f"Math.abs({body}.quaternion.y - {turned[1]}) > 0.05")
        assert chromium.errors == []
    chromium.wait_for("document.getElementById('notices').textContent.includes('has ended')")


TEXTURED = """
<mujoco model="textured">
  <visual><global azimuth="90" elevation="-60"/>
    <headlight ambient=".8 .8 .8" diffuse="0 0 0" specular="0 0 0"/></visual>
  <statistic center="0 0 0" extent="1.5"/>
  <asset>
    <texture name="t" type="2d" file="t.png"/>
    <material name="once" texture="t"/>
    <material name="uniform" texture="t" texrepeat="3 2" texuniform="true"/>
    <material name="often" texture="t" texrepeat="4 4"/>
    <mesh name="with_uv" file="m.obj"/>
    <mesh name="without" vertex="0 0 0  .5 0 0  0 .5 0  0 0 .4"/>
    <hfield name="h" nrow="3" ncol="3" size=".3 .2 .05 .05" elevation="0 0 0 0 1 0 0 0 1"/>
  </asset>
  <worldbody>
    <geom type="plane" size="1.2 .8 .1" material="uniform"/>
    <geom type="plane" size=".3 .2 .1" pos="-.8 .4 .01" material="once"/>
    <geom type="box" size=".2 .15 .1" pos="0 .4 .2" material="once"/>
    <geom type="box" size=".2 .15 .1" pos=".6 .4 .2" material="uniform"/>
    <geom type="mesh" mesh="with_uv" pos="-.9 -.4 .25" material="often"/>
    <geom type="mesh" mesh="without" pos="0 -.5 .25" material="once"/>
    <geom type="hfield" hfield="h" pos=".75 -.4 .1" material="once"/>
  </worldbody>
</mujoco>
"""

SLAB = """
v 0 0 0\nv .5 0 0\nv .5 .5 0\nv 0 .5 0\nv .25 .25 -.2\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1
f 1/1 2/2 3/3\nf 1/1 3/3 4/4\nf 1/1 4/4 5/1\nf 2/1 1/1 5/1\nf 3/1 2/1 5/1\nf 4/1 3/1 5/1
"""


def test_textures_lie_as_in_mujocos_pictures(chromium: Chromium, tmp_path: Path) -> None:
    corners = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 0]]], np.uint8)
    file = io.BytesIO()
    Image.fromarray(corners.repeat(32, axis=0).repeat(32, axis=1)).save(file, "PNG")
    scene = load_scene(TEXTURED, assets={"t.png": file.getvalue(), "m.obj": SLAB.encode()})
    start = make_backend("mujoco", scene).reset(1)
    try:
        renderer = make_renderer("mujoco", scene)
        theirs = renderer.render(start, height=HEIGHT, width=WIDTH)
    except RenderingUnavailableError as error:
        pytest.skip(str(error))
    options = ViewOptions(shadows=False)
    chromium.open(save_html(tmp_path / "textured.html", scene, None, options=options).as_uri())
    ours = chromium.screenshot(tmp_path / "textured.png")

    def colours(picture: Picture) -> Any:
        """Which of red, green and blue are there."""
        return picture > 0.5 * picture.max(axis=-1, keepdims=True)

    saturated = theirs.max(axis=-1).astype(int) - theirs.min(axis=-1) > 120
    saturated[:60, :] = False  # caption and controls
    assert saturated.mean() > 0.4
    agree = (colours(ours) == colours(theirs)).all(axis=-1)[saturated]
    assert agree.mean() > 0.97


def change(chromium: Chromium, name: str, value: str) -> None:
    """Changes one of the page's controls as a hand would: through its field or its box."""
    done = chromium.evaluate(
        "(() => { const all = (gui) => [...gui.__controllers,"
        " ...Object.values(gui.__folders).flatMap(all)];"
        f"const one = all(orbisim.viewer.gui).find((c) => c.property === '{name}');"
        "const field = one.domElement.querySelector('input, select');"
        f"if (field && field.type === 'checkbox') {{ field.checked = {value}; }}"
        f"else if (field) {{ field.value = {value}; }}"
        "const event = field && field.type === 'checkbox' ? 'change' : 'change';"
        "if (field) { field.dispatchEvent(new Event(event)); field.blur(); }"
        "else { one.fire ? one.fire() : one.domElement.click(); } return true; })()"
    )
    assert done


@pytest.mark.slow
def test_a_live_pages_controls(chromium: Chromium) -> None:
    with live(ROBOT) as running:
        chromium.open(running.url)
        clock = "parseFloat(document.getElementById('clock').textContent)"
        chromium.wait_for(f"{clock} > 0.1")
        change(chromium, "pause / go on", "0")
        chromium.wait_for(f"(() => {{ const t = {clock}; const until = Date.now() + 150;"
                          f"while (Date.now() < until); return {clock} === t; }})()")  # fmt: skip
        change(chromium, "0 j", "1.25")
        name = Drawing(ROBOT.model).bodies[1].split("/")[-1]
        body = f"orbisim.viewer.scene_tree.find(['scene', '{name}']).object"
        chromium.wait_for(f"Math.abs(2 * Math.asin({body}.quaternion.y) - 1.25) < 1e-3")
        count = "(() => { let n = 0; orbisim.viewer.scene_tree.find(['scene']).object"
        count += ".traverse((o) => { n += o.isMesh ? 1 : 0; }); return n; })()"
        drawn = chromium.evaluate(count)
        change(chromium, "collisions", "true")
        chromium.wait_for(f"{count} === {drawn + 1}")
        change(chromium, "camera", "'wall'")
        chromium.screenshot()
        seen = chromium.evaluate("orbisim.viewer.camera.position.toArray()")
        np.testing.assert_allclose(seen, [0, 1, 3], atol=1e-6)  # three.js: y is up
        forward = chromium.evaluate(
            "orbisim.viewer.camera.getWorldDirection(new orbisim.THREE.Vector3()).toArray()"
        )
        np.testing.assert_allclose(forward, [0, 0, -1], atol=1e-6)
        change(chromium, "camera", "'free'")
        before = chromium.evaluate("orbisim.viewer.controls.target.toArray()")
        change(chromium, "follow", "'arm'")
        chromium.screenshot()
        change(chromium, "1 s", "0.5")  # slides along z
        chromium.wait_for(f"orbisim.viewer.controls.target.y > {before[1] + 0.4}")
        assert chromium.errors == []


def row(text: str, part: str = "") -> str:
    """JavaScript: the line of the page's controls that begins with a text, or a part of it."""
    lines = "[...orbisim.viewer.gui.domElement.querySelectorAll('li.cr, li.title')]"
    found = f"{lines}.find((li) => li.textContent.trim().startsWith('{text}'))"
    return f"{found}.querySelector('{part}')" if part else found


def choose(chromium: Chromium, text: str, value: str) -> None:
    """Chooses from a list, whose own menu a headless browser does not draw."""
    chromium.evaluate(
        f"(() => {{ const e = {row(text, 'select')}; e.value = '{value}';"
        "e.dispatchEvent(new Event('change')); return true; })()"
    )


class Twin(MujocoBackend):
    """C MuJoCo under another name."""

    name = "twin"


@pytest.mark.slow
def test_a_hand_on_the_mouse(chromium: Chromium, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Request | None] = []

    def heard(text: str) -> Request | None:
        asked.append(request_of(text))
        return asked[-1]

    monkeypatch.setattr("orbisim.view.live.request_of", heard)
    monkeypatch.setattr("orbisim.view.live.available_backends", lambda: ["mujoco", "twin"])
    monkeypatch.setattr("orbisim.view.live.make_backend", _either)
    clock = "document.getElementById('clock').textContent"
    name = Drawing(ROBOT.model).bodies[1].split("/")[-1]
    body = f"orbisim.viewer.scene_tree.find(['scene', '{name}']).object"
    turned = f"2 * Math.asin({body}.quaternion.y)"
    with live(ROBOT) as running:
        chromium.open(running.url)
        chromium.wait_for(f"parseFloat({clock}) > 0.05")
        chromium.click(row("pause"))
        chromium.click(row("restart"))
        chromium.wait_for(f"{clock} === '0.00 s, mujoco'")
        chromium.click(row("Joints"))  # opens it
        chromium.click(row("0 j", ".slider"), along=0.4)
        chromium.wait_for(f"Math.abs({turned} - 0.2) < 0.1")  # of -1 to 2 rad
        shown = float(chromium.evaluate(row("0 j", "input") + ".value"))
        assert shown == pytest.approx(chromium.evaluate(turned), abs=0.01)
        chromium.click(row("Actuators"))
        chromium.click(row("0 m", ".slider"), along=0.02)
        before = chromium.evaluate(turned)
        for step in range(1, 6):
            chromium.click(row("single step"))
            chromium.wait_for(f"{clock} === '{step * 0.002:.2f} s, mujoco'")
        chromium.wait_for(f"{turned} < {before} - 1e-4")  # the motor pulls it back
        assert chromium.evaluate(row("by hand", "input") + ".checked")
        chromium.click(row("speed", ".slider"), along=0.0)
        objects = "(() => { let n = 0; orbisim.viewer.scene_tree.find(['scene']).object"
        objects += ".traverse((o) => { n += o.isMesh || o.isLine ? 1 : 0; }); return n; })()"
        for toggle in ("sites", "collisions"):
            drawn = chromium.evaluate(objects)
            chromium.click(row(toggle, "input"))
            chromium.wait_for(f"{objects} > {drawn}")
        chromium.click(row("1 s", ".slider"), along=0.02)  # down to the floor
        drawn = chromium.evaluate(objects)
        chromium.click(row("contacts", "input"))
        chromium.wait_for(f"{objects} > {drawn}")
        choose(chromium, "camera", "wall")
        choose(chromium, "follow", "arm")
        choose(chromium, "backend", "twin")
        chromium.wait_for(f"{clock}.endsWith(', twin')")
        chromium.click(row("pause"))
        chromium.wait_for(f"parseFloat({clock}) > 0.03")
        assert chromium.errors == []
    done = [one.do for one in asked if one]
    assert {"pause", "restart", "step", "speed", "joint", "control", "show", "backend"} == set(done)
    (speed,) = (one.value for one in asked if one and one.do == "speed")
    assert speed == pytest.approx(0.05, abs=0.05)


def _either(name: str, scene: Scene, device: str | None = None) -> MujocoBackend:
    backend = Twin() if name == Twin.name else MujocoBackend()
    backend.load(scene)
    return backend


@pytest.mark.slow
def test_on_a_phone_the_scene_is_seen_and_the_panel_opens_by_a_click(
    chromium: Chromium, run_page: str, tmp_path: Path
) -> None:
    corners = (
        "(() => { const box = new orbisim.THREE.Box3().setFromObject("
        "orbisim.viewer.scene_tree.find(['scene']).object);"
        "return [box.min, box.max].flatMap((p) => {"
        "const q = p.clone().project(orbisim.viewer.camera); return [q.x, q.y]; }); })()"
    )
    chromium.open(run_page)
    chromium.screenshot()
    wide = np.array(chromium.evaluate(corners))
    with Chromium(tmp_path / "profile", 375, 667) as phone:
        phone.open(run_page)
        phone.screenshot()
        sides = wide[::2] * (WIDTH / HEIGHT) / (4 / 3)  # as a page of 4 : 3 shows them
        np.testing.assert_allclose(phone.evaluate(corners)[::2], sides, rtol=0.05)  # it plays
        heights = "orbisim.viewer.gui.domElement.getBoundingClientRect().height"
        closed = phone.evaluate(heights)
        assert closed < 100
        phone.evaluate("orbisim.viewer.gui.domElement.querySelector('.close-button').click()")
        phone.wait_for(f"{heights} > {closed} + 50")
        assert phone.errors == []
