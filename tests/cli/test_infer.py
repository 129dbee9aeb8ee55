"""`orbisim infer` writes a recording that binds to the scene."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest
import torch
from orbisim_diffusion.checkpoint import PHYSICS, add_part
from orbisim_diffusion.estimate_physics import Reach
from orbisim_diffusion.physics import PhysicsInference
from orbisim_diffusion.refine import Refiner

from orbisim.cli.main import run
from orbisim.recording import Recording, bind
from orbisim.scene import load_scene
from tests.backends.diffusion.test_refine import SIZE, TABLE, drawn, state
from tests.backends.diffusion.tiny import ARM, add_inference, arm, save_tiny


def test_the_command_writes_a_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = add_inference(save_tiny(tmp_path / "tiny", arm()))
    (tmp_path / "scene.xml").write_text(ARM)
    rng = np.random.default_rng(0)
    frames = rng.integers(0, 255, (5, 64, 96, 3), np.uint8)
    iio.imwrite(tmp_path / "video.mp4", frames, plugin="FFMPEG", fps=20, macro_block_size=2)
    command = ["infer", str(tmp_path / "video.mp4"), "--scene", str(tmp_path / "scene.xml")]
    options = ["--checkpoint", str(folder), "--out", str(tmp_path / "rec.npz"), "--json"]
    options.append("--no-refine")  # the frames are noise
    assert run([*command, *options]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["signals"] == ["qpos/reach", "qpos/swing", "xpos/cube", "xquat/cube"]
    recording = Recording.load(tmp_path / "rec.npz")
    np.testing.assert_allclose(recording.time, np.arange(5) / 20)
    assert bind(recording, arm()).qpos.shape == (5, 9)


def test_what_a_film_says_of_densities_and_friction_stands_in_the_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    xml = ARM.replace('<camera name="wrist"', '<site name="palm"/><camera name="wrist"')
    folder = add_inference(save_tiny(tmp_path / "tiny", load_scene(xml)))
    network = PhysicsInference()
    network.know(torch.tensor([0.2, 0.6]), torch.tensor([150.0, 900.0]))
    reach = Reach(("swing", "reach"), "palm", "floor", 0.05, (0.04, 0.06), "arm", "0" * 64)
    add_part(folder, PHYSICS, network, {}, dataclasses.asdict(reach))
    (tmp_path / "scene.xml").write_text(xml)
    frames = np.random.default_rng(0).integers(0, 255, (15, 64, 96, 3), np.uint8)
    iio.imwrite(tmp_path / "video.mp4", frames, plugin="FFMPEG", fps=20, macro_block_size=2)
    command = ["infer", str(tmp_path / "video.mp4"), "--scene", str(tmp_path / "scene.xml")]
    command += ["--checkpoint", str(folder), "--out", str(tmp_path / "rec.npz"), "--no-refine"]
    assert run([*command, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)["physics"]
    assert list(said) == ["friction:floor", "density:cube"]
    known = said["density:cube"]  # of an untrained network: the prior
    assert known["value"] == pytest.approx((150.0 * 900.0) ** 0.5, rel=0.01)
    assert known["ci95"] == pytest.approx([150.0, 900.0], rel=0.01) and known["unit"] == "kg/m^3"
    assert Recording.load(tmp_path / "rec.npz").metadata["physics"] == said
    other = dataclasses.replace(reach, surface="table")
    add_part(folder, PHYSICS, network, {}, dataclasses.asdict(other))
    assert run(command) == 0
    assert "no geom 'table'" in capsys.readouterr().err


def test_what_is_missing_is_said_before_anything_is_computed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "scene.xml").write_text("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    end = ["--scene", str(tmp_path / "scene.xml"), "--out", str(tmp_path / "rec.npz")]
    assert run(["infer", str(tmp_path / "film.mp4"), *end]) == 2
    assert "film.mp4: no such file" in capsys.readouterr().err
    (tmp_path / "film.mp4").write_bytes(b"")
    assert run(["infer", str(tmp_path / "film.mp4"), *end]) == 2
    assert "declares no camera; add one" in capsys.readouterr().err
    assert run(["infer", str(tmp_path / "film.mp4"), *end, "--fit", "sizes,weights"]) == 2
    assert "expected sizes, colors or sizes,colors" in capsys.readouterr().err
    assert run(["infer", str(tmp_path / "film.mp4"), *end, "--fit", "sizes", "--no-refine"]) == 2
    assert "leave --no-refine out" in capsys.readouterr().err


PENDULUM = """
<mujoco>
  <worldbody>
    <light pos="0 -2 2" dir="0 1 -1"/>
    <camera name="side" pos="0 -1.3 0.5" xyaxes="1 0 0 0 0 1"/>
    <body pos="0 0 0.6">
      <joint name="hinge" axis="0 1 0" damping="0.002"/>
      <geom type="capsule" fromto="0 0 0 0.15 0 -0.3" size="0.02" mass="0.3" rgba="0.8 0.2 0.1 1"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.mark.slow
def test_a_film_of_a_pendulum_becomes_a_recording_wherever_it_starts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = tmp_path / "pendulum.xml"
    scene.write_text(PENDULUM)
    refiner = Refiner(load_scene(scene), 0, 96)
    true = np.array([-1.6, -1.58, -1.52, 2.9])  # in the last it is elsewhere at once
    pixels = torch.arange(96 * 96)
    drawings = [refiner.eye.draw(np.array([[q]]), pixels).pixels[0] for q in true]
    frames = [(255 * d.reshape(96, 96, 3)).round().to(torch.uint8).numpy() for d in drawings]
    video = str(tmp_path / "video.mp4")
    iio.imwrite(video, np.stack(frames), plugin="FFMPEG", fps=20, quality=9)
    out = ["--out", str(tmp_path / "rec.npz"), "--pixels", "96", "--json"]
    assert run(["infer", video, "--scene", str(scene), *out]) == 0
    printed = json.loads(capsys.readouterr().out)
    hinge = Recording.load(tmp_path / "rec.npz").signals["qpos/hinge"]
    np.testing.assert_allclose(hinge[:3], true[:3], atol=0.02)
    assert np.isnan(hinge[3])
    ((gap),) = printed["not_seen"]
    assert gap["joints"] == ["hinge"] and gap["from"] == pytest.approx(0.15)


@pytest.mark.slow
def test_a_scene_without_a_network_is_read_by_fitting(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = tmp_path / "table.xml"
    servo = '<actuator><position name="swing" joint="swing" kp="50" kv="5"/></actuator></mujoco>'
    scene.write_text(TABLE.replace("</mujoco>", servo))
    refiner = Refiner(load_scene(scene), 0, SIZE)
    states = np.array([state(0.05 + 0.004 * i, 0.02, 0.3, 0.02 * i) for i in range(6)])
    frames = np.stack([drawn(refiner, one) for one in states])
    video = str(tmp_path / "video.mp4")
    iio.imwrite(video, frames.repeat(2, 1).repeat(2, 2), plugin="FFMPEG", fps=20, quality=9)
    out = ["--out", str(tmp_path / "rec.npz"), "--pixels", str(SIZE), "--json"]
    assert run(["infer", video, "--scene", str(scene), *out]) == 0
    said = capsys.readouterr()
    printed = json.loads(said.out)
    assert "no frame shows" not in said.err
    assert printed["signals"] == ["ctrl/swing", "qpos/swing", "xpos/cube", "xquat/cube"]
    assert printed["refined"] and printed["not_seen"] == [] and printed["looks"] == {}
    green = tmp_path / "green.xml"
    green.write_text(scene.read_text().replace("0.8 0.2 0.2 1", "0.1 0.9 0.2 1"))
    elsewhere = ["--out", str(tmp_path / "green.npz"), *out[2:]]
    assert run(["infer", video, "--scene", str(green), *elsewhere]) == 0
    assert f"no frame shows cube as {green} declares it" in capsys.readouterr().err
    assert run(["infer", video, "--scene", str(scene), *out, "--fit", "colors"]) == 2
    assert "none was trained on" in capsys.readouterr().err
    bound = bind(Recording.load(tmp_path / "rec.npz"), load_scene(scene))
    np.testing.assert_allclose(bound.qpos[:, 1:4], states[:, 1:4], atol=4e-3)
    np.testing.assert_allclose(bound.qpos[:, 0], states[:, 0], atol=0.05)
