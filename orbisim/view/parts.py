"""What a model shows: its visible geoms and sites with their appearance.

MuJoCo itself (`mjv_updateScene`, which needs no OpenGL) decides what is visible and in which
colour; poses come from the model.
"""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.view.kinematics import Kinematics, pose_matrix
from orbisim.view.options import ViewOptions


@dataclasses.dataclass(frozen=True, eq=False)
class Appearance:
    """Colour and material (the meaning of the numbers is that of MJCF's `<material>`).

    Attributes:
      rgba: [4].
      material: number of the material, -1 for none.
    """

    rgba: npt.NDArray[np.float64]
    material: int = -1
    emission: float = 0.0
    specular: float = 0.5
    shininess: float = 0.5


@dataclasses.dataclass(frozen=True, eq=False)
class Part:
    """A geom or a site, fixed to a body.

    Attributes:
      name: unique among the parts of its body.
      kind: `mujoco.mjtGeom`.
      size: [3], as in MjModel.
      data_id: number of the mesh or height field, -1 for none.
      matrix: [4, 4], from the part's frame to the body's.
    """

    name: str
    kind: int
    size: npt.NDArray[np.float64]
    data_id: int
    body: int
    matrix: npt.NDArray[np.float64]
    appearance: Appearance


def visible_parts(kinematics: Kinematics, options: ViewOptions) -> list[Part]:
    """The geoms, and the sites if asked for, that MuJoCo would show."""
    model = kinematics.model
    visible = mujoco.MjvOption()
    visible.flags[:] = 0
    for flag in (mujoco.mjtVisFlag.mjVIS_STATIC, mujoco.mjtVisFlag.mjVIS_TEXTURE):
        visible.flags[flag] = 1
    mask = np.array(options.group_mask(), np.uint8)
    visible.geomgroup[:] = mask
    visible.sitegroup[:] = mask if options.sites else 0
    scene = mujoco.MjvScene(model, model.ngeom + model.nsite + 100)
    everything = int(mujoco.mjtCatBit.mjCAT_ALL)
    mujoco.mjv_updateScene(
        model, kinematics.data, visible, None, mujoco.MjvCamera(), everything, scene
    )
    return [
        _READERS[geom.objtype](model, geom)
        for geom in scene.geoms[: scene.ngeom]
        if geom.objtype in _READERS
    ]


def _geom(model: mujoco.MjModel, drawn: mujoco.MjvGeom) -> Part:
    index = drawn.objid
    return Part(
        name=node_name(model, mujoco.mjtObj.mjOBJ_GEOM, index),
        kind=int(model.geom_type[index]),
        size=model.geom_size[index],
        data_id=int(model.geom_dataid[index]),
        body=int(model.geom_bodyid[index]),
        matrix=pose_matrix(model.geom_pos[index], model.geom_quat[index]),
        appearance=_appearance(drawn),
    )


def _site(model: mujoco.MjModel, drawn: mujoco.MjvGeom) -> Part:
    index = drawn.objid
    return Part(
        name=node_name(model, mujoco.mjtObj.mjOBJ_SITE, index),
        kind=int(model.site_type[index]),
        size=model.site_size[index],
        data_id=-1,
        body=int(model.site_bodyid[index]),
        matrix=pose_matrix(model.site_pos[index], model.site_quat[index]),
        appearance=_appearance(drawn),
    )


_READERS = {int(mujoco.mjtObj.mjOBJ_GEOM): _geom, int(mujoco.mjtObj.mjOBJ_SITE): _site}


def _appearance(drawn: mujoco.MjvGeom) -> Appearance:
    return Appearance(
        rgba=np.array(drawn.rgba, np.float64),
        material=int(drawn.matid),
        emission=float(drawn.emission),
        specular=float(drawn.specular),
        shininess=float(drawn.shininess),
    )


_DEFAULT_RGBA = np.array([0.5, 0.5, 0.5, 1.0], np.float32)


def own_appearance(
    model: mujoco.MjModel, rgba: npt.NDArray[np.float32], material: int
) -> Appearance:
    """Of flexes, skins and tendons: the material's, unless a colour of their own was given."""
    own = np.asarray(rgba, np.float32)
    if material < 0:
        return Appearance(own.astype(np.float64))
    given = not np.array_equal(own, _DEFAULT_RGBA)
    return Appearance(
        rgba=(own if given else model.mat_rgba[material]).astype(np.float64),
        material=int(material),
        emission=float(model.mat_emission[material]),
        specular=float(model.mat_specular[material]),
        shininess=float(model.mat_shininess[material]),
    )


def node_name(model: mujoco.MjModel, kind: mujoco.mjtObj, index: int) -> str:
    """A name for the viewer's tree: unique, and without the characters that it reserves."""
    name = mujoco.mj_id2name(model, kind, index) or kind.name.removeprefix("mjOBJ_").lower()
    return f"{name.translate(str.maketrans('/<>', ':()'))} {index}"
