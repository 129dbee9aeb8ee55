"""Scenes that the tests of the viewer share, and a reader of what its pages carry."""

from __future__ import annotations

import base64
import re
import zlib
from typing import Any

import numpy as np
import umsgpack

from orbisim.registry import make_backend
from orbisim.scene import Scene, load_scene
from orbisim.trajectory import Trajectory

SHOWCASE = """
<mujoco model="showcase">
  <visual><global azimuth="110" elevation="-24"/></visual>
  <statistic center="0.1 -0.2 0.35" extent="1.7"/>
  <asset>
    <texture name="checker" type="2d" builtin="checker" rgb1=".78 .8 .83" rgb2=".68 .7 .74"
      width="128" height="128"/>
    <material name="floor" texture="checker" texrepeat="2 2" texuniform="true"/>
    <material name="glow" rgba="1 .75 .05 1" emission=".3"/>
    <mesh name="wedge" vertex="-.2 -.15 -.1  .2 -.15 -.1  .2 .15 -.1  -.2 .15 -.1
      -.2 -.15 .25  -.2 .15 .25"/>
    <mesh name="knob" builtin="sphere" params="2" scale=".13 .13 .18"/>
    <hfield name="hill" nrow="12" ncol="12" size=".3 .3 .25 .05"/>
  </asset>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1" material="floor"/>
    <geom name="hill" type="hfield" hfield="hill" pos=".95 -.75 .05" rgba=".3 .55 .25 1"/>
    <body name="ball" pos="-.85 0 .6"><freejoint/>
      <geom name="sphere" type="sphere" size=".15" rgba=".9 .1 .1 1"/></body>
    <body name="pill" pos="-.42 0 .6" euler="20 30 0"><freejoint/>
      <geom name="capsule" type="capsule" size=".1 .14" rgba=".1 .7 .2 1"/></body>
    <body name="egg" pos=".02 0 .6" euler="0 0 40"><freejoint/>
      <geom name="ellipsoid" type="ellipsoid" size=".2 .12 .09" rgba=".1 .3 .9 1"/></body>
    <body name="can" pos=".48 0 .6" euler="60 0 20"><freejoint/>
      <geom name="cylinder" type="cylinder" size=".12 .15" rgba=".1 .75 .75 1"/></body>
    <body name="brick" pos=".92 0 .6" euler="10 20 30"><freejoint/>
      <geom name="box" type="box" size=".16 .11 .08" rgba=".6 .2 .8 1"/></body>
    <body name="ramp" pos="-.6 -.65 .35" euler="0 0 30"><freejoint/>
      <geom name="mesh" type="mesh" mesh="wedge" material="glow" pos=".02 .03 .01"/></body>
    <body name="knob" pos="-.05 -.7 .3"><freejoint/>
      <geom name="sdf" type="sdf" mesh="knob" rgba=".85 .2 .5 1"/></body>
    <body name="arm" pos=".45 -.65 .35"><joint name="hinge" axis="1 0 0" range="-60 60"/>
      <geom name="glass" type="box" size=".14 .12 .12" rgba=".1 .5 .9 .5"/>
      <geom name="hidden" type="sphere" size=".05" group="3"/>
      <geom name="invisible" type="sphere" size=".05" rgba="1 0 0 0"/>
      <site name="tip" pos="0 0 .2" size=".02" rgba="1 1 0 1"/></body>
    <body name="target" mocap="true" pos="-1.1 -.6 .2">
      <geom name="marker" type="box" size=".05 .05 .05" rgba=".95 .55 .1 1"
        contype="0" conaffinity="0"/></body>
  </worldbody>
</mujoco>
"""

CLOTH = """
<mujoco model="cloth">
  <option timestep=".002"/>
  <worldbody>
    <geom name="ball" size=".2" pos="0 0 .2" rgba=".2 .5 .8 1"/>
    <flexcomp name="cloth" type="grid" count="7 7 1" spacing=".1 .1 .1" pos="0 0 .6" radius=".01"
      dim="2" mass=".3" rgba=".8 .2 .3 1">
      <contact selfcollide="none"/><edge equality="true" damping=".01"/></flexcomp>
    <flexcomp name="rope" type="grid" count="5 1 1" spacing=".1 .1 .1" pos="1 0 .6" radius=".01"
      dim="1" mass=".1"><edge equality="true"/></flexcomp>
    <flexcomp name="jelly" type="grid" count="3 3 3" spacing=".1 .1 .1" pos="-1 0 .6" radius=".01"
      dim="3" mass=".3"><contact selfcollide="none"/><edge equality="true"/></flexcomp>
  </worldbody>
</mujoco>
"""

TENDONS = """
<mujoco model="tendons">
  <worldbody>
    <site name="top" pos="-.5 0 1"/>
    <body pos="0 0 .7"><joint type="hinge" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 .4 0 0" size=".05"/>
      <site name="end" pos=".3 0 .1"/><site name="other" pos=".3 0 -.1"/></body>
  </worldbody>
  <tendon>
    <spatial name="rope" rgba="1 0 0 1">
      <site site="top"/><site site="end"/><pulley divisor="2"/><site site="other"/>
      <site site="end"/>
    </spatial>
  </tendon>
</mujoco>
"""

SKIN = """
<mujoco model="skinned">
  <asset><skin name="skin" rgba=".8 .6 .4 1" vertex="0 0 0  .4 0 0  .4 .2 0  0 .2 0"
    face="0 1 2  0 2 3">
    <bone body="arm" bindpos="0 0 0" bindquat="1 0 0 0" vertid="0 1 2 3" vertweight="1 1 1 1"/>
  </skin></asset>
  <worldbody><body name="arm"><joint type="hinge" axis="0 1 0"/>
    <geom size=".05"/></body></worldbody>
</mujoco>
"""


def showcase() -> Scene:
    """Every type of geom, materials, a texture, a mocap body; the hill gets its shape here."""
    scene = load_scene(SHOWCASE)
    rows = np.linspace(-1, 1, 12)
    heights = np.exp(-4 * (rows[:, None] ** 2 + rows[None] ** 2))
    scene.model.hfield_data[:] = heights.ravel().astype(np.float32)
    return scene


def falling(scene: Scene, steps: int, *, push: float = 0.0, nworld: int = 1) -> Trajectory:
    """What MuJoCo makes of a scene; `push` is the first velocity of every degree of freedom."""
    backend = make_backend("mujoco", scene, nworld=nworld)
    start = backend.reset(nworld)
    start = start.replace(qvel=start.qvel + push)
    return backend.rollout(start, np.zeros((steps, scene.model.nu)))


_TYPES = {0x12: np.uint8, 0x14: np.uint16, 0x16: np.uint32, 0x17: np.float32}


def unpacked(payload: bytes) -> list[dict[str, Any]]:
    """The commands in a frame; typed arrays as NumPy's."""
    commands, at = [], 0
    while at < len(payload):
        size = int.from_bytes(payload[at : at + 4], "little")
        commands.append(_plain(umsgpack.unpackb(payload[at + 4 : at + 4 + size])))
        at += 4 + size
    return commands


def _plain(value: Any) -> Any:
    if isinstance(value, umsgpack.Ext):
        return np.frombuffer(value.data, _TYPES[value.type])
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_plain(entry) for entry in value]
    return value


def commands_of(html: str) -> list[dict[str, Any]]:
    """The commands that a page carries."""
    found = re.search(r'id="commands">([^<]*)<', html)
    assert found is not None
    return unpacked(zlib.decompress(base64.b64decode(found[1])))


def plain(commands: Any) -> list[dict[str, Any]]:
    """Commands as `commands_of` gives them."""
    return [_plain(command) for command in commands]


def matrix_of(numbers: list[float]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """[4, 4] from three.js's order."""
    return np.array(numbers, np.float64).reshape(4, 4).T
