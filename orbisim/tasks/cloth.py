"""The flex of a scene: where its vertices are, how much its edges are stretched, what it is in.

A flex of `flexcomp` has a body with three slide joints for each vertex, so that positions of
vertices are generalized coordinates, apart from where they rest.
"""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.errors import InputError

Floats = npt.NDArray[np.float64]


def vertices(model: mujoco.MjModel, qpos: Floats) -> Floats:
    """Positions [..., V, 3] of the vertices of a scene's flex in the world's frame, m.

    Args:
      qpos: [..., nq].

    Raises:
      InputError: the scene has not one flex whose vertices slide along the world's axes.
    """
    address, rest = free_vertices(model)
    return np.asarray(qpos)[..., address] + rest


def coordinates(model: mujoco.MjModel, places: Floats) -> Floats:
    """qpos [..., nq] with vertices at places [..., V, 3]; the inverse of `vertices`.

    Raises:
      InputError: as `vertices`; or other coordinates than the vertices' would stay open.
    """
    address, rest = free_vertices(model)
    if address.size != model.nq:
        raise InputError(f"the scene has {model.nq} coordinates; {address.size} are its flex's")
    found = np.zeros((*places.shape[:-2], model.nq))
    found[..., address] = places - rest
    return found


def free_vertices(model: mujoco.MjModel) -> tuple[npt.NDArray[np.int64], Floats]:
    """Addresses [V, 3] of a flex's vertices in qpos, and where they are at zero [V, 3], m.

    Raises:
      InputError: the scene has not one flex whose vertices slide along the world's axes.
    """
    if model.nflex != 1 or model.flex_interp[0] != 0 or not model.flex_centered[0]:
        raise InputError(f"a scene with one flex of free vertices is needed; got {model.nflex}")
    bodies = np.array(model.flex_vertbodyid)
    parents = model.body_parentid[bodies]
    first = model.body_jntadr[bodies]
    joints = first[:, None] + np.arange(3)
    slides = (model.jnt_type[joints] == int(mujoco.mjtJoint.mjJNT_SLIDE)).all()
    if (model.body_jntnum[bodies] != 3).any() or not slides or model.body_weldid[parents].any():
        raise InputError("the flex's vertices must be free and hang on nothing that moves")
    if not np.allclose(model.jnt_axis[joints], np.eye(3)):
        raise InputError("the flex's vertices must slide along x, y and z")
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    if not np.allclose(data.xquat[bodies], [1, 0, 0, 0]):
        raise InputError("the flex must not be turned in its file: turn it by its vertices")
    address = np.asarray(model.jnt_qposadr[joints], np.int64)
    return address, np.array(data.xpos[bodies]) - np.array(model.qpos0)[address]


def edge_strain(model: mujoco.MjModel, places: Floats) -> Floats:
    """Change of each edge's length over its length at rest, [..., E].

    Args:
      places: [..., V, 3] of the vertices, m.
    """
    edge = np.array(model.flex_edge)
    length = np.linalg.norm(places[..., edge[:, 0], :] - places[..., edge[:, 1], :], axis=-1)
    return np.asarray(length / np.array(model.flexedge_length0) - 1.0)


class Probe:
    """How deep points are within the still geoms of a scene, by MuJoCo's own distances.

    Args:
      spec: of a scene with a flex; a copy gets a ball as thick as the flex.
    """

    def __init__(self, spec: mujoco.MjSpec) -> None:
        whole = spec.copy()
        for key in list(whole.keys):
            whole.delete(key)
        radius = float(whole.compile().flex_radius[0])
        ball = whole.worldbody.add_body(name="probe", mocap=True)
        ball.add_geom(name="probe", size=[radius, 0.0, 0.0])
        self._model = whole.compile()
        self._data = mujoco.MjData(self._model)
        mujoco.mj_forward(self._model, self._data)
        self._ball = self._model.geom("probe").id
        still = self._model.body_weldid[self._model.geom_bodyid] == 0
        self._geoms = [int(g) for g in np.flatnonzero(still) if g != self._ball]

    def depth(self, places: Floats) -> Floats:
        """Depth [...] of each point [..., 3], with the flex's radius, in what it is deepest in, m;
        0 outside."""
        flat = places.reshape(-1, 3)
        found = np.zeros(len(flat))
        for i, point in enumerate(flat):
            self._data.geom_xpos[self._ball] = point
            for geom in self._geoms:
                distance = mujoco.mj_geomDistance(
                    self._model, self._data, self._ball, geom, 0.0, None
                )
                found[i] = max(found[i], -distance)
        return found.reshape(places.shape[:-1])
