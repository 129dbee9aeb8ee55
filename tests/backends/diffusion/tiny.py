"""Small untrained models and synthetic stores, for tests of everything but quality."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import torch
from orbisim_diffusion.autoencoder import Autoencoder
from orbisim_diffusion.checkpoint import (
    AUTOENCODER,
    DENOISER,
    MANIFEST,
    digest,
    read_manifest,
    save_checkpoint,
)
from orbisim_diffusion.config import Buffer, preset
from orbisim_diffusion.denoiser import Denoiser
from orbisim_diffusion.inference import StateInference
from orbisim_diffusion.scope import Scope, ViewScope, read_scope
from orbisim_diffusion.store import Arrays, Store, _assembled
from safetensors.torch import save_file

from orbisim.scene import Scene, load_scene, visible

ARM = """
<mujoco model="arm">
  <worldbody>
    <light pos="0.5 -0.3 1.5" dir="0 0.2 -1"/>
    <light directional="true" dir="0.1 0 -1"/>
    <camera name="side" pos="0.5 -1 0.6" xyaxes="1 0 0 0 0.5 0.86"/>
    <geom name="floor" type="plane" size="2 2 0.1" rgba="0.4 0.5 0.4 1"/>
    <body name="upper" pos="0.3 0 0.3">
      <joint name="swing" axis="0 1 0.2"/>
      <geom type="capsule" size="0.05 0.1" pos="0 0 0.1" rgba="0.8 0.8 0.8 1"/>
      <body name="lower" pos="0 0 0.25">
        <joint name="reach" type="slide" axis="1 0 0"/>
        <geom type="cylinder" size="0.04 0.08" quat="1 0.3 0 0" rgba="0.3 0.3 0.8 1"/>
        <camera name="wrist" pos="0 -0.4 0.1" xyaxes="1 0 0 0 0 1"/>
      </body>
    </body>
    <body name="cube" pos="0.6 0.05 0.05">
      <freejoint name="cube"/>
      <geom name="cube" type="box" size="0.05 0.05 0.05" rgba="0.8 0.2 0.2 1"/>
    </body>
  </worldbody>
</mujoco>
"""


def arm() -> Scene:
    return load_scene(ARM)


def save_tiny(
    folder: Path, scene: Scene, *, anywhere: bool = True, left_out: tuple[Buffer, ...] = ()
) -> Path:
    """An untrained checkpoint for a scene; its one camera is at the origin unless `anywhere`."""
    torch.manual_seed(0)
    config = preset("tiny")
    network = dataclasses.replace(config.denoiser, left_out=left_out)
    config = dataclasses.replace(config, denoiser=network)
    autoencoder = Autoencoder(config.autoencoder)
    denoiser = Denoiser(config.denoiser, config.autoencoder.channels)
    for parameter in denoiser.leave.parameters():  # else an untrained network answers zero
        torch.nn.init.normal_(parameter, std=0.3)
    found = read_scope(store_of(scene, frames=1))
    view = ViewScope((0.0,) * 3, (0.0,) * 9, (0.0,) * 2, anywhere=anywhere)
    scope = Scope(found.scenes, (view,))
    save_checkpoint(
        folder, {AUTOENCODER: autoencoder, DENOISER: denoiser}, config, scope, {"metrics": {}}
    )
    return folder


def episode_of(scene: Scene, frames: int, seed: int = 0, size: int = 32) -> Arrays:
    """An episode as `read_episode` gives it: the scene moves at random, the images are noise."""
    rng = np.random.default_rng(seed)
    qpos = np.tile(scene.model.qpos0, (frames, 1))
    qpos[:, :3] += rng.uniform(-0.1, 0.1, qpos[:, :3].shape)
    poses = visible.poses(scene.model, qpos)
    return {
        "frames": rng.integers(0, 255, (frames, size, size, 3), np.uint8),
        "view_pos": np.tile(np.array([0.5, -1.0, 0.6], np.float32), (frames, 1)),
        "view_rot": np.tile(
            np.array([[1, 0, 0], [0, 0.5, -0.86], [0, 0.86, 0.5]], np.float32), (frames, 1, 1)
        ),
        "lens": np.array([1.2, 1.2, 0.0, 0.0], np.float32),
        "geoms": visible.rows(scene.model).astype(np.float32),
        "lights": visible.lights(scene.model).astype(np.float32),
        "pos": poses["geoms/pos"],
        "quat": poses["geoms/quat"],
        "robot/qpos": qpos[:, :2].astype(np.float32),
        "robot/pos": poses["geoms/pos"][:, -1],
        "robot/quat": poses["geoms/quat"][:, -1],
    }


def store_of(scene: Scene, frames: int = 8, episodes: int = 1) -> Store:
    made = [episode_of(scene, frames + i, seed=i) for i in range(episodes)]
    return _assembled(made, [0] * episodes, torch.device("cpu"))


def add_inference(folder: Path) -> Path:
    """A tiny checkpoint with an untrained StaInf."""
    torch.manual_seed(0)
    model = StateInference(4, 32)
    path = folder / "inference.safetensors"
    save_file({n: t.half().contiguous() for n, t in model.state_dict().items()}, str(path))
    manifest = read_manifest(folder)
    manifest["files"]["inference"] = {"sha256": digest(path), "bytes": path.stat().st_size}
    (folder / MANIFEST).write_text(json.dumps(manifest))
    return folder
