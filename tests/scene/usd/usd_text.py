"""Small USD stages as text."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import orbisim.scene.usd as usd
from orbisim.scene import Scene
from orbisim.scene.usd.wire import decode, encode

DATA = Path(__file__).parent / "data"

GRAVITY = """
def PhysicsScene "Physics"
{
}
"""


def stage(body: str, *, meters: float = 1.0, kilograms: float = 1.0, up: str = "Z") -> str:
    """A stage with units and earth gravity around some prims."""
    return (
        "#usda 1.0\n"
        f"(\n    metersPerUnit = {meters}\n    kilogramsPerUnit = {kilograms}\n"
        f'    upAxis = "{up}"\n)\n' + GRAVITY + body
    )


def write(folder: Path, text: str, name: str = "scene.usda") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def load(folder: Path, body: str, *, options: dict[str, Any] | None = None, **units: Any) -> Scene:
    """Loads prims given as text, with OpenUSD in this process.

    `load_scene` starts a process for each file; what is in it does not depend on that.
    """
    from orbisim.scene.usd.dump.opening import open_stage
    from orbisim.scene.usd.dump.stage import StageDumper

    path = str(write(folder, stage(body, **units)))
    flat = StageDumper(open_stage(path, lambda _: None), path).dump()
    return Scene.from_read(usd._convert(decode(encode(flat)), path, **(options or {})), path)


def schemas(*names: str) -> str:
    listed = ", ".join(f'"{name}"' for name in names)
    return f"prepend apiSchemas = [{listed}]"


def numbers(values: Iterable[float]) -> str:
    """A tuple of numbers as USD writes it."""
    return f"({', '.join(repr(float(value)) for value in values)})"


def place(
    pos: tuple[float, float, float] = (0, 0, 0),
    quat: tuple[float, float, float, float] | None = None,
    scale: tuple[float, float, float] | None = None,
) -> str:
    """Transform ops; the quaternion is (w, x, y, z)."""
    lines = [f"double3 xformOp:translate = {numbers(pos)}"]
    order = ["xformOp:translate"]
    if quat is not None:
        lines.append(f"quatd xformOp:orient = {numbers(quat)}")
        order.append("xformOp:orient")
    if scale is not None:
        lines.append(f"double3 xformOp:scale = {numbers(scale)}")
        order.append("xformOp:scale")
    listed = ", ".join(f'"{op}"' for op in order)
    return "\n".join([*lines, f"uniform token[] xformOpOrder = [{listed}]"])


def body(
    name: str,
    content: str = "",
    *,
    pos: tuple[float, float, float] = (0, 0, 0),
    quat: tuple[float, float, float, float] | None = None,
    scale: tuple[float, float, float] | None = None,
    mass: str = "float physics:mass = 1\nfloat3 physics:diagonalInertia = (0.01, 0.01, 0.01)",
    extra: tuple[str, ...] = (),
) -> str:
    """A rigid body; by default of 1 kg with a round inertia of 0.01 kg m^2."""
    applied = schemas("PhysicsRigidBodyAPI", "PhysicsMassAPI", *extra)
    return f'def Xform "{name}" ({applied})\n{{\n{mass}\n{place(pos, quat, scale)}\n{content}\n}}\n'


def joint(kind: str, name: str, content: str = "", *, extra: tuple[str, ...] = ()) -> str:
    """A joint prim such as `PhysicsRevoluteJoint`."""
    applied = f" ({schemas(*extra)})" if extra else ""
    return f'def {kind} "{name}"{applied}\n{{\n{content}\n}}\n'


def joins(
    body0: str | None,
    body1: str | None,
    pos0: tuple[float, ...] = (0, 0, 0),
    pos1: tuple[float, ...] = (0, 0, 0),
    rot0: tuple[float, ...] = (1, 0, 0, 0),
    rot1: tuple[float, ...] = (1, 0, 0, 0),
) -> str:
    """What a joint joins and where its frames are."""
    lines = [
        *([f"rel physics:body0 = <{body0}>"] if body0 else []),
        *([f"rel physics:body1 = <{body1}>"] if body1 else []),
        f"point3f physics:localPos0 = {numbers(pos0)}",
        f"point3f physics:localPos1 = {numbers(pos1)}",
        f"quatf physics:localRot0 = {numbers(rot0)}",
        f"quatf physics:localRot1 = {numbers(rot1)}",
    ]
    return "\n".join(lines)
