"""What changes shape: flexes, skins, tendons and contacts.

Each gives vertices in the world's frame for every frame. The page has two commands for them
beyond meshcat's own: `set_vertices` (now) and `vertex_track` (over the time of an animation).
"""

from __future__ import annotations

import abc
from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.view.materials import flattened, ghostly, line_material, phong
from orbisim.view.options import Look, ViewOptions
from orbisim.view.parts import Appearance, node_name, own_appearance
from orbisim.view.three import DOUBLE, Json, buffers, drawable, floats

Vertices = npt.NDArray[np.float32]
Indices = npt.NDArray[np.integer[Any]]


class Deforming(abc.ABC):
    """Something whose vertices are given anew for every frame.

    Attributes:
      path: in the viewer's tree.
    """

    kind = "Mesh"

    def __init__(self, path: str, material: Json) -> None:
        self.path, self._material = path, material

    @abc.abstractmethod
    def vertices(self, data: mujoco.MjData) -> Vertices:
        """[n, 3] in the world's frame."""

    def index(self) -> Indices | None:
        """[m, 3] triangles or [m, 2] lines; None if vertices follow in order."""
        return None

    def create(self, data: mujoco.MjData) -> Json:
        """The command that draws it as it is now."""
        geometry = buffers(self.vertices(data), self.index())
        shadow = {"castShadow": self.kind == "Mesh"}
        return drawable(
            self.path,
            geometry,
            self._material,
            kind=self.kind,
            frustumCulled=False,
            userData=shadow,
        )

    def update(self, data: mujoco.MjData) -> Json:
        """The command that moves its vertices to where they are now."""
        return {
            "type": "set_vertices",
            "path": self.path,
            "positions": floats(self.vertices(data)),
        }


def deforming_parts(model: mujoco.MjModel, options: ViewOptions, look: Look) -> Iterator[Deforming]:
    """Everything deformable that the options ask for; tendons and contacts have no ghosts."""
    for flex in range(model.nflex):
        if int(model.flex_group[flex]) in options.groups:
            yield Flex(model, flex, look)
    if options.skins:
        scene = mujoco.MjvScene(model, model.nskin + 10)
        for skin in range(model.nskin):
            if int(model.skin_group[skin]) in options.groups:
                yield Skin(model, skin, look, scene)
    if look.ghost:
        return
    if options.tendons:
        for tendon in range(model.ntendon):
            if int(model.tendon_group[tendon]) in options.groups:
                yield Tendon(model, tendon, look)
    if options.contacts:
        yield Contacts(model, look)


def _surface(model: mujoco.MjModel, appearance: Appearance, look: Look) -> Json:
    if look.ghost:
        return ghostly(look)
    return phong(flattened(model, appearance), side=DOUBLE)


class Flex(Deforming):
    """A flex: its edges, triangles or outer triangles (1D, 2D, 3D), without its thickness."""

    def __init__(self, model: mujoco.MjModel, flex: int, look: Look) -> None:
        name = node_name(model, mujoco.mjtObj.mjOBJ_FLEX, flex)
        appearance = own_appearance(model, model.flex_rgba[flex], int(model.flex_matid[flex]))
        dimension = int(model.flex_dim[flex])
        if dimension == 1:
            self.kind = "LineSegments"
            rgb = look.tint if look.tint is not None else appearance.rgba[:3]
            material = line_material(rgb, look.opacity if look.ghost else 1.0)
        else:
            material = _surface(model, appearance, look)
        super().__init__(f"{look.root}/{name}", material)
        start = int(model.flex_vertadr[flex])
        self._rows = slice(start, start + int(model.flex_vertnum[flex]))
        self._index = _flex_index(model, flex, dimension)

    def index(self) -> Indices:
        """Edges or triangles."""
        return self._index

    def vertices(self, data: mujoco.MjData) -> Vertices:
        """Of the flex, [n, 3]."""
        return np.asarray(data.flexvert_xpos[self._rows], np.float32)


def _flex_index(model: mujoco.MjModel, flex: int, dimension: int) -> Indices:
    if dimension == 3:
        start, count = int(model.flex_shelldataadr[flex]), int(model.flex_shellnum[flex])
        return np.asarray(model.flex_shell[start : start + 3 * count]).reshape(-1, 3)
    start, count = int(model.flex_elemdataadr[flex]), int(model.flex_elemnum[flex])
    corners = dimension + 1
    return np.asarray(model.flex_elem[start : start + corners * count]).reshape(-1, corners)


class Skin(Deforming):
    """A skin, bent by MuJoCo as part of `mjv_updateScene`."""

    def __init__(
        self, model: mujoco.MjModel, skin: int, look: Look, scene: mujoco.MjvScene
    ) -> None:
        name = node_name(model, mujoco.mjtObj.mjOBJ_SKIN, skin)
        appearance = own_appearance(model, model.skin_rgba[skin], int(model.skin_matid[skin]))
        super().__init__(f"{look.root}/{name}", _surface(model, appearance, look))
        self._model, self._scene = model, scene
        self._only_skins = mujoco.MjvOption()
        self._only_skins.flags[:] = 0
        self._only_skins.flags[mujoco.mjtVisFlag.mjVIS_SKIN] = 1
        self._only_skins.geomgroup[:] = 0
        self._only_skins.sitegroup[:] = 0
        self._only_skins.skingroup[:] = 1
        start = int(model.skin_vertadr[skin])
        self._rows = slice(start, start + int(model.skin_vertnum[skin]))
        first = int(model.skin_faceadr[skin])
        self._index: Indices = model.skin_face[first : first + int(model.skin_facenum[skin])]

    def index(self) -> Indices:
        """Triangles."""
        return self._index

    def vertices(self, data: mujoco.MjData) -> Vertices:
        """Of the skin, [n, 3]."""
        camera, everything = mujoco.MjvCamera(), int(mujoco.mjtCatBit.mjCAT_ALL)
        mujoco.mjv_updateScene(
            self._model, data, self._only_skins, None, camera, everything, self._scene
        )
        every = np.asarray(self._scene.skinvert, np.float32).reshape(-1, 3)
        return every[self._rows].copy()


class Tendon(Deforming):
    """The path of a tendon."""

    kind = "LineSegments"

    def __init__(self, model: mujoco.MjModel, tendon: int, look: Look) -> None:
        name = node_name(model, mujoco.mjtObj.mjOBJ_TENDON, tendon)
        rgba, material = model.tendon_rgba[tendon], int(model.tendon_matid[tendon])
        rgb = own_appearance(model, rgba, material).rgba[:3]
        super().__init__(f"{look.root}/{name}", line_material(rgb))
        self._tendon = tendon

    def vertices(self, data: mujoco.MjData) -> Vertices:
        """Ends of the segments, [2 n, 3]; there is none across a pulley."""
        start, count = int(data.ten_wrapadr[self._tendon]), int(data.ten_wrapnum[self._tendon])
        points = data.wrap_xpos.reshape(-1, 3)[start : start + count]
        objects = data.wrap_obj.ravel()[start : start + count]
        joined = (objects[:-1] != _PULLEY) & (objects[1:] != _PULLEY)
        pairs = np.stack([points[:-1], points[1:]], axis=1)[joined]
        return np.asarray(pairs.reshape(-1, 3), np.float32)


_PULLEY = -2
"""Marks a pulley in `MjData.wrap_obj`."""


class Contacts(Deforming):
    """Contact normals as lines, from both sides of each contact."""

    kind = "LineSegments"

    def __init__(self, model: mujoco.MjModel, look: Look) -> None:
        super().__init__(f"{look.root}/contacts", line_material((0.9, 0.1, 0.1)))
        self._half = 0.02 * float(model.stat.extent)

    def vertices(self, data: mujoco.MjData) -> Vertices:
        """Ends of the normals, [2 n, 3]."""
        if not data.ncon:
            return np.zeros((0, 3), np.float32)
        normal = data.contact.frame[:, :3] * self._half
        ends = np.stack([data.contact.pos - normal, data.contact.pos + normal], axis=1)
        return np.asarray(ends.reshape(-1, 3), np.float32)
