"""URDF in pieces, for tests."""

from __future__ import annotations

import mujoco
import numpy as np

INERTIAL = (
    "<inertial>{origin}<mass value='{mass}'/>"
    "<inertia ixx='{xx}' ixy='0' ixz='0' iyy='{yy}' iyz='0' izz='{zz}'/></inertial>"
)


def inertial(mass: float = 1.0, moments: tuple[float, float, float] = (1, 1, 1), origin: str = ""):
    xx, yy, zz = moments
    return INERTIAL.format(mass=mass, xx=xx, yy=yy, zz=zz, origin=origin)


def link(name: str, *content: str) -> str:
    """A link; of mass 1 kg unless it has content."""
    return f"<link name='{name}'>{''.join(content) or inertial()}</link>"


def joint(name: str, parent: str, child: str, *content: str, type: str = "revolute") -> str:
    return (
        f"<joint name='{name}' type='{type}'><parent link='{parent}'/><child link='{child}'/>"
        f"{''.join(content)}</joint>"
    )


def collision(shape: str, origin: str = "", name: str = "") -> str:
    attribute = f" name='{name}'" if name else ""
    return f"<collision{attribute}>{origin}<geometry>{shape}</geometry></collision>"


def visual(shape: str, *content: str) -> str:
    return f"<visual><geometry>{shape}</geometry>{''.join(content)}</visual>"


def robot(*content: str) -> str:
    return f"<robot name='r'>{''.join(content)}</robot>"


def two_links(*in_joint: str, type: str = "revolute", child: str = "") -> str:
    """`a` and `b`, with joint `j` between them."""
    return robot(link("a"), child or link("b"), joint("j", "a", "b", *in_joint, type=type))


def tensor(model: mujoco.MjModel, name: str) -> np.ndarray:
    """[3, 3] inertia of a body about its centre of mass, along the body's axes."""
    body = model.body(name).id
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, model.body_iquat[body])
    axes = matrix.reshape(3, 3)
    return (axes * model.body_inertia[body]) @ axes.T
