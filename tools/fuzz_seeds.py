"""Small scenes that use much of a format, for `fuzz_readers`."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import trimesh

Files = Mapping[str, bytes | Path]
"""A scene: file names and contents, or where these are; the first is the scene file itself."""

_COLLADA = Path(__file__).parent.parent / "tests/scene/urdf/data/two_nodes.dae"

_MJCF = (
    """<mujoco model="arm">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.002" gravity="0 0 -9.81" integrator="implicitfast"/>
  <default><joint damping="0.1"/><geom friction="0.8 0.01 0.001" rgba="0.5 0.5 0.5 1"/></default>
  <asset>
    <mesh name="part" file="part.stl" scale="0.1 0.1 0.1"/>
    <mesh name="other" file="other.obj"/>
    <texture name="grid" type="2d" builtin="checker" width="32" height="32" rgb1="0 0 0"/>
    <material name="grid" texture="grid" texrepeat="2 2"/>
    <hfield name="hills" nrow="3" ncol="3" size="1 1 0.2 0.1" elevation="0 1 0 1 0 1 0 1 0"/>
  </asset>
  <worldbody>
    <light pos="0 0 3"/>
    <geom name="floor" type="plane" size="2 2 0.1" material="grid"/>
    <geom type="hfield" hfield="hills" pos="3 0 0"/>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" range="-2 2"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.04"/>
      <geom type="mesh" mesh="part"/>
      <body name="lower" pos="0.3 0 0">
        <joint name="elbow" axis="0 1 0" range="-1 2" armature="0.01"/>
        <inertial pos="0.1 0 0" mass="0.5" diaginertia="0.01 0.02 0.02"/>
        <geom type="box" size="0.1 0.02 0.02"/>
        <site name="tip" pos="0.2 0 0"/>
      </body>
    </body>
    <body name="ball" pos="1 0 1"><freejoint/><geom type="mesh" mesh="other" mass="1"/></body>
    <replicate count="3" offset="0 0.2 0"><geom type="sphere" size="0.05" pos="0 1 0"/></replicate>
  </worldbody>
  <equality><joint joint1="elbow" joint2="shoulder" polycoef="0 0.5 0 0 0"/></equality>
  <tendon><fixed name="t"><joint joint="shoulder" coef="1"/>
    <joint joint="elbow" coef="-1"/></fixed></tendon>
  <actuator><motor joint="shoulder" gear="5"/><position joint="elbow" kp="20"/></actuator>
  <sensor><jointpos joint="elbow"/><framepos objtype="site" objname="tip"/></sensor>
  <keyframe><key name="home" qpos="0 0 1 0 1 1 0 0 0"/></keyframe>
</mujoco>
""",
    """<mujoco model="soft">
  <worldbody>
    <flexcomp name="cloth" type="grid" count="4 4 1" spacing="0.1 0.1 0.1" dim="2" radius="0.01"
      mass="0.2">
      <edge equality="true"/>
    </flexcomp>
    <body name="b"><joint type="ball"/><geom type="ellipsoid" size="0.1 0.2 0.3"/></body>
  </worldbody>
</mujoco>
""",
)

_URDF = (
    """<?xml version="1.0"?>
<robot name="arm">
  <material name="blue"><color rgba="0 0 0.8 1"/></material>
  <link name="base">
    <inertial><origin xyz="0 0 0.1" rpy="0 0 0.3"/><mass value="2"/>
      <inertia ixx="0.02" ixy="0.001" ixz="0" iyy="0.03" iyz="0" izz="0.025"/></inertial>
    <visual><geometry><mesh filename="part.stl" scale="0.1 0.1 0.1"/></geometry>
      <material name="blue"/></visual>
    <collision name="hull"><origin xyz="0 0 0.1"/>
      <geometry><box size="0.2 0.2 0.1"/></geometry></collision>
  </link>
  <link name="arm"><collision>
    <geometry><cylinder radius="0.03" length="0.4"/></geometry></collision></link>
  <link name="finger"><collision>
    <geometry><mesh filename="other.obj"/></geometry></collision></link>
  <link name="thumb"><visual><geometry><sphere radius="0.02"/></geometry></visual></link>
  <link name="frame"/>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="arm"/>
    <origin xyz="0 0 0.2" rpy="0.1 0.2 0.3"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="30" velocity="3"/>
    <dynamics damping="0.1" friction="0.2"/></joint>
  <joint name="grip" type="prismatic"><parent link="arm"/><child link="finger"/>
    <axis xyz="1 0 0"/><limit lower="0" upper="0.04" effort="10" velocity="1"/></joint>
  <joint name="follow" type="prismatic"><parent link="arm"/><child link="thumb"/>
    <axis xyz="-1 0 0"/><limit lower="0" upper="0.04" effort="10" velocity="1"/>
    <mimic joint="grip" multiplier="1" offset="0"/></joint>
  <joint name="weld" type="fixed"><parent link="arm"/><child link="frame"/>
    <origin xyz="0 0 0.4"/></joint>
  <transmission name="t"><joint name="shoulder"/><actuator name="m">
    <mechanicalReduction>50</mechanicalReduction></actuator></transmission>
  <gazebo reference="arm"><mu1>0.2</mu1></gazebo>
</robot>
""",
    """<robot name="cart">
  <link name="world"/>
  <link name="cart"><inertial><mass value="1"/>
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial>
    <collision><geometry><mesh filename="scene.dae"/></geometry></collision></link>
  <link name="ball"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
  <joint name="plane" type="planar"><parent link="world"/><child link="cart"/>
    <axis xyz="0 0 1"/></joint>
  <joint name="loose" type="floating"><parent link="cart"/><child link="ball"/></joint>
</robot>
""",
)

_USD = (
    """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Z"
)
def Xform "World"
{
    def PhysicsScene "scene"
    {
        vector3f physics:gravityDirection = (0, 0, -1)
        float physics:gravityMagnitude = 9.81
    }
    def Xform "base" ( prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"] )
    {
        float physics:mass = 2
        double3 xformOp:translate = (0, 0, 1)
        uniform token[] xformOpOrder = ["xformOp:translate"]
        def Cube "box" ( prepend apiSchemas = ["PhysicsCollisionAPI"] )
        {
            double size = 0.2
        }
    }
    def Xform "link" ( prepend apiSchemas = ["PhysicsRigidBodyAPI"] )
    {
        double3 xformOp:translate = (0.5, 0, 1)
        uniform token[] xformOpOrder = ["xformOp:translate"]
        def Mesh "mesh" ( prepend apiSchemas = ["PhysicsCollisionAPI", "PhysicsMeshCollisionAPI"] )
        {
            int[] faceVertexCounts = [3, 3, 3, 3]
            int[] faceVertexIndices = [0, 2, 1, 0, 1, 3, 1, 2, 3, 0, 3, 2]
            point3f[] points = [(0, 0, 0), (0.1, 0, 0), (0, 0.1, 0), (0, 0, 0.1)]
        }
    }
    def PhysicsRevoluteJoint "hinge" ( prepend apiSchemas = ["PhysicsDriveAPI:angular"] )
    {
        rel physics:body0 = </World/base>
        rel physics:body1 = </World/link>
        uniform token physics:axis = "Y"
        point3f physics:localPos0 = (0.25, 0, 0)
        point3f physics:localPos1 = (-0.25, 0, 0)
        float physics:lowerLimit = -90
        float physics:upperLimit = 90
        float drive:angular:physics:stiffness = 10
    }
}
""",
)


def builtin_seeds(reader: str) -> list[Files]:
    """Small scenes that use much of a format."""
    box = trimesh.creation.box((1.0, 0.5, 0.3))
    meshes = {
        "part.stl": box.export(file_type="stl"),
        "other.obj": trimesh.creation.icosphere(1, 0.1).export(file_type="obj").encode(),
        "scene.dae": _COLLADA.read_bytes(),
    }
    if reader == "usd":
        texts = [{"scene.usda": text.encode()} for text in _USD]
        return [*texts, *_as_crate(texts)]
    suffix, texts_of = {"mjcf": ("xml", _MJCF), "urdf": ("urdf", _URDF)}[reader]
    return [
        {f"scene.{suffix}": text.encode()}
        | {name: data for name, data in meshes.items() if name in text}
        for text in texts_of
    ]


def _as_crate(texts: Sequence[Mapping[str, bytes]]) -> Iterator[Files]:
    """The same scenes in USD's binary format, written in a process of its own."""
    program = (
        "import sys; from pxr import Sdf; Sdf.Layer.FindOrOpen(sys.argv[1]).Export(sys.argv[2])"
    )
    for files in texts:
        with tempfile.TemporaryDirectory() as folder:
            text, crate = Path(folder, "scene.usda"), Path(folder, "scene.usdc")
            text.write_bytes(files["scene.usda"])
            done = subprocess.run(
                [sys.executable, "-c", program, text, crate], capture_output=True, check=False
            )
            if done.returncode == 0:
                yield {"scene.usdc": crate.read_bytes()}


def seed_of_file(path: Path) -> Files:
    """A file and those beside and below it."""
    path = path.resolve()
    near = {str(p.relative_to(path.parent)): p for p in path.parent.rglob("*") if p.is_file()}
    near.pop(path.name)
    return {path.name: path.read_bytes(), **near}


def write(files: Files, folder: Path) -> Path:
    """Writes a scene to a folder (unchanged files as links); returns the path of the scene."""
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        if isinstance(data, Path):
            (folder / name).symlink_to(data)
        else:
            (folder / name).write_bytes(data)
    return folder / next(iter(files))
