"""The geoms of a scene that a camera sees, as rows with named columns and as poses over time."""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

COLUMNS = (*("type", "size_x", "size_y", "size_z", "red", "green", "blue", "entity", "geom"),)
"""MuJoCo's number of the geom's type and its sizes (m), its colour, what it belongs to (`STATIC`,
`ROBOT`, or from 1 on the number of the free body in the order of the joints), its number."""

LIGHT_COLUMNS = (
    *("pos_x", "pos_y", "pos_z", "dir_x", "dir_y", "dir_z", "directional", "cutoff", "shadow"),
)
"""Where a light is in the world frame, m, and where it points; whether it shines from infinitely
far; half angle of a spot light's cone, degrees; whether what it shines on throws shadows."""

STATIC, ROBOT = -1, 0
"""Of the column `entity`: what no joint moves, what hangs on a joint that is not free."""

_HIDDEN_FROM = 3
"""MuJoCo shows the groups 0 to 2 unless it is told otherwise."""


def seen(model: mujoco.MjModel) -> list[int]:
    """Numbers of the geoms that MuJoCo's renderer shows by default."""
    return [
        geom
        for geom in range(model.ngeom)
        if model.geom_group[geom] < _HIDDEN_FROM and colour(model, geom)[3] > 0
    ]


def rows(model: mujoco.MjModel) -> Floats:
    """[G, columns]: `COLUMNS` of each geom that is seen."""
    entities = entity_of_body(model)
    found = [
        (
            float(model.geom_type[geom]),
            *model.geom_size[geom],
            *colour(model, geom)[:3],
            float(entities[model.geom_bodyid[geom]]),
            float(geom),
        )
        for geom in seen(model)
    ]
    return np.array(found, np.float64).reshape(len(found), len(COLUMNS))


def colour(model: mujoco.MjModel, geom: int) -> Floats:
    """[4]: of its material, if it has one, as MuJoCo's renderer does; else its own."""
    material = int(model.geom_matid[geom])
    rgba = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
    return np.asarray(rgba, np.float64)


def lights(model: mujoco.MjModel) -> Floats:
    """[L, columns]: `LIGHT_COLUMNS` of each light that is on, as the scene stands at `qpos0`."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_camlight(model, data)
    directional = int(mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
    found = [
        (
            *data.light_xpos[light],
            *data.light_xdir[light],
            float(model.light_type[light] == directional),
            float(model.light_cutoff[light]),
            float(model.light_castshadow[light]),
        )
        for light in range(model.nlight)
        if model.light_active[light]
    ]
    return np.array(found, np.float64).reshape(len(found), len(LIGHT_COLUMNS))


def entity_of_body(model: mujoco.MjModel) -> npt.NDArray[np.int64]:
    """[nbody]: the column `entity` of the geoms of each body."""
    free = [int(b) for b in model.jnt_bodyid[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE]]
    found = np.full(model.nbody, STATIC)
    for body in range(1, model.nbody):
        root = int(model.body_rootid[body])
        if root in free:
            found[body] = 1 + free.index(root)
        elif model.body_weldid[body] != 0:
            found[body] = ROBOT
    return found


def poses(model: mujoco.MjModel, qpos: Floats) -> dict[str, npt.NDArray[np.float32]]:
    """Centres `geoms/pos` [T, G, 3], m, and `geoms/quat` [T, G, 4] for coordinates [T, nq]."""
    shown, data = seen(model), mujoco.MjData(model)
    pos = np.zeros((len(qpos), len(shown), 3), np.float32)
    quat = np.zeros((len(qpos), len(shown), 4), np.float32)
    one = np.zeros(4)
    for t, row in enumerate(qpos):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        pos[t] = data.geom_xpos[shown]
        for i, geom in enumerate(shown):
            mujoco.mju_mat2Quat(one, data.geom_xmat[geom])
            quat[t, i] = one
    return {"geoms/pos": pos, "geoms/quat": quat}
