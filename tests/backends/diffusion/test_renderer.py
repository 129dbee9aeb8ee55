"""The diffusion renderer in the place of any other: conformance, memory, refusals, gradients."""

from __future__ import annotations

import json
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import torch
from orbisim_diffusion.config import Buffer
from orbisim_diffusion.renderer import LATENTS, TIMES, DiffusionRenderer

from orbisim.errors import InputError, UnsupportedSceneError
from orbisim.physics import Physics
from orbisim.registry import make_backend, make_renderer
from orbisim.scene import load_scene
from orbisim.testing import RendererConformance, scenes
from tests.backends.diffusion.tiny import ARM, arm, save_tiny


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_tiny(tmp_path_factory.mktemp("tiny"), arm())


class TestDiffusion(RendererConformance):
    renderer = "diffusion"
    faithful = False  # the checkpoint is not trained

    @pytest.fixture(scope="class", autouse=True)
    @classmethod
    def trained(cls, tmp_path_factory: pytest.TempPathFactory) -> None:
        path = save_tiny(tmp_path_factory.mktemp("colours"), load_scene(scenes.COLOURS))
        cls.config = {"argument": str(path), "device": "cpu"}


def painter(folder: Path, **options: object) -> DiffusionRenderer:
    made = make_renderer("diffusion", arm(), argument=str(folder), device="cpu", **options)
    assert isinstance(made, DiffusionRenderer)
    return made


def test_frames_travel_in_the_state(folder: Path) -> None:
    """A snapshot restored gives the same images again, with the frames before it as context."""
    physics = Physics.from_scene(arm())
    physics.use_renderer("diffusion", argument=str(folder), device="cpu")
    shown = []
    for _ in range(3):
        physics.step(10)
        shown.append(physics.render(32, 32, camera_id="side"))
    kept = physics.snapshot()
    assert np.isfinite(kept.memory[TIMES]).sum() == 3

    def go_on() -> list[np.ndarray]:
        images = []
        for _ in range(2):
            physics.step(10)
            images.append(physics.render(32, 32, camera_id="side"))
        return images

    first = go_on()
    physics.restore(kept)
    for a, b in zip(first, go_on(), strict=True):
        np.testing.assert_array_equal(a, b)
    physics.restore(kept.replace(memory={}))
    assert np.abs(go_on()[0].astype(int) - first[0]).max() > 0  # without them it is another image


def test_seven_frames_leave_six_and_a_rewind_forgets_what_is_later(folder: Path) -> None:
    renderer, state = painter(folder), make_backend("mujoco", arm()).reset(2)
    for i in range(7):
        state = state.replace(time=np.full(2, 0.1 * i))
        _, memory = renderer.observe(state, camera="side", height=32, width=32)
        state = state.with_memory(**memory)
    np.testing.assert_allclose(state.memory[TIMES][0], 0.1 * np.arange(1, 7))
    assert state.memory[LATENTS].shape[:2] == (2, 6)
    early = state.replace(time=np.full(2, 0.25))
    _, memory = renderer.observe(early, camera="side", height=32, width=32)
    np.testing.assert_allclose(memory[TIMES][1, :3], [0.1, 0.2, 0.25])
    assert np.isinf(memory[TIMES][1, 3:]).all()


def test_another_camera_or_size_begins_anew(folder: Path) -> None:
    renderer, state = painter(folder), make_backend("mujoco", arm()).reset(1)
    _, memory = renderer.observe(state, camera="side", height=32, width=32)
    later = state.replace(time=np.array([0.1])).with_memory(**memory)
    for camera, width in (("wrist", 32), ("side", 64)):
        _, found = renderer.observe(later, camera=camera, height=32, width=width)
        assert np.isfinite(found[TIMES]).sum() == 1


def test_worlds_with_different_histories_in_one_batch(folder: Path) -> None:
    renderer, state = painter(folder), make_backend("mujoco", arm()).reset(2)
    _, memory = renderer.observe(state, camera="side", height=32, width=32)
    later = state.replace(time=np.array([0.1, 0.0])).with_memory(**memory)
    images, _ = renderer.observe(later, camera="side", height=32, width=32)
    for world in range(2):
        alone = renderer.render(later, world=world, camera="side", height=32, width=32)
        assert np.abs(images[world].astype(int) - alone).max() <= 1


def test_an_image_from_elsewhere_can_be_continued(folder: Path) -> None:
    renderer, state = painter(folder), make_backend("mujoco", arm()).reset(1)
    image = np.full((32, 32, 3), 200, np.uint8)
    seen = renderer.remembering(state, image, "side").replace(time=np.array([0.1]))
    plain = state.replace(time=np.array([0.1]))
    options = {"camera": "side", "height": 32, "width": 32}
    assert np.any(renderer.render(seen, **options) != renderer.render(plain, **options))
    with pytest.raises(InputError, match="32 pixels high"):
        renderer.remembering(state, image[:16], "side")


def test_pixels_have_gradients_to_the_state(tmp_path: Path) -> None:
    """Of latents with respect to coordinates, by finite differences.

    In a scene without edges inside of outlines: across those, normals jump from pixel to pixel.
    """
    text = ARM.replace('type="box" size="0.05 0.05 0.05"', 'type="sphere" size="0.06"')
    scene = load_scene(text.replace("cylinder", "capsule"))
    folder = str(save_tiny(tmp_path, scene))
    renderer = make_renderer("diffusion", scene, argument=folder, device="cpu")
    assert isinstance(renderer, DiffusionRenderer)
    start = torch.tensor(scene.model.qpos0, dtype=torch.float32)
    weights = torch.randn(4, 4, 4, generator=torch.Generator().manual_seed(1))

    def value(qpos: torch.Tensor) -> torch.Tensor:
        return (renderer.latents(qpos[None], camera="side", height=32, width=32)[0] * weights).sum()

    qpos = start.clone().requires_grad_(True)
    (gradient,) = torch.autograd.grad(value(qpos), qpos)
    assert gradient.abs().max() > 1e-2
    for i in (0, 1, 2, 4):
        step = torch.zeros_like(start)
        step[i] = 3e-4
        with torch.no_grad():
            slope = float(value(start + step) - value(start - step)) / 6e-4
        assert float(gradient[i]) == pytest.approx(slope, rel=0.15, abs=0.1)


def test_other_scenes_and_cameras_are_refused(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(UnsupportedSceneError, match="geoms that are no objects"):
        make_renderer("diffusion", scenes.COLOURS, argument=str(folder), device="cpu")
    with pytest.raises(UnsupportedSceneError, match="another type, size or colour"):
        text = ARM.replace('size="0.05 0.1"', 'size="0.06 0.1"')
        make_renderer("diffusion", load_scene(text), argument=str(folder), device="cpu")
    fixed = save_tiny(tmp_path, arm(), anywhere=False)
    state = make_backend("mujoco", arm()).reset(1)
    with pytest.raises(InputError, match="the camera stands"):
        painter(fixed).render(state, camera="side", height=32, width=32)


def test_bad_arguments_are_refused(folder: Path) -> None:
    state = make_backend("mujoco", arm()).reset(1)
    with pytest.raises(InputError, match="1 to 1000 steps"):
        painter(folder, steps=0)
    with pytest.raises(InputError, match="at most 4 times"):
        painter(folder).render(state, camera="side", height=10, width=100)
    with pytest.raises(InputError, match="not among the state's"):
        painter(folder).render(state, world=1)


def test_a_damaged_checkpoint_is_refused(folder: Path, tmp_path: Path) -> None:
    for path in folder.iterdir():
        if path.is_file():
            (tmp_path / path.name).write_bytes(path.read_bytes())
    weights = tmp_path / "denoiser.safetensors"
    data = bytearray(weights.read_bytes())
    data[-1] ^= 1
    weights.write_bytes(bytes(data))
    with pytest.raises(InputError, match="sha256"):
        painter(tmp_path)
    manifest = json.loads((folder / "manifest.json").read_text())
    ((view, *_), (scene, *_)) = manifest["scope"]["views"], manifest["scope"]["scenes"]

    def without(*buffers: str, **others: str) -> dict[str, object]:
        known = manifest["config"]
        return {**known, "denoiser": {**known["denoiser"], "left_out": buffers, **others}}

    odd_view, odd_row = {**view, "rot": [1, 2]}, {**scene, "fixed": [[1]]}
    for entry, value, says in (
        ("scope", {**manifest["scope"], "views": [odd_view]}, "rot: expected 9 numbers"),
        ("scope", {**manifest["scope"], "scenes": [odd_row]}, "fixed: expected rows of 7"),
        ("schema", "x", "orbisim.vision/1"),
        ("config", {"name": 3}, "config"),
        ("config", without("shadows"), "expected one of 'colour'"),
        ("config", without("colour", maps="heatmaps"), "names geometry buffers"),
        ("config", without(*get_args(Buffer)), "one at least is left"),
        ("scope", {"scenes": []}, "scope"),
        ("files", {}, "has no entry"),
    ):
        (tmp_path / "manifest.json").write_text(json.dumps({**manifest, entry: value}))
        with pytest.raises(InputError, match=says):
            painter(tmp_path)


def test_a_checkpoint_without_a_buffer_shows_states(tmp_path: Path) -> None:
    state = make_backend("mujoco", arm()).reset(1)
    images = [
        painter(save_tiny(tmp_path / str(i), arm(), left_out=buffers)).render(
            state, camera="side", height=32, width=32
        )
        for i, buffers in enumerate([(), ("light",), ("light", "depth")])
    ]
    assert np.abs(images[0].astype(int) - images[1]).max() > 0
    assert np.abs(images[1].astype(int) - images[2]).max() > 0


def test_half_precision_is_for_the_network_alone(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a GPU: poses and rays keep single precision, and the image hardly changes."""
    state = make_backend("mujoco", arm()).reset(1)
    moved = state.replace(qpos=state.qpos + 0.1)
    exact = painter(folder).render(moved, camera="wrist", height=32, width=32)
    half = torch.autocast("cpu", torch.bfloat16)
    monkeypatch.setattr("orbisim_diffusion.renderer.mixed", lambda _: half)
    found = painter(folder).render(moved, camera="wrist", height=32, width=32)
    assert 0 < np.abs(found.astype(int) - exact).max() < 30
