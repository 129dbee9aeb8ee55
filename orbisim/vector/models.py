"""What differs from world to world in the model: targets, sizes, gains, terrains."""

from __future__ import annotations

import ctypes
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from orbisim.errors import InputError

Floats = npt.NDArray[Any]

_ASSETS = ("mesh_", "tex_", "skin_", "bvh_", "names", "paths", "text_", "tuple_", "key_", "oct_")
"""Parts of a model that no task changes at run time."""


COSMETIC = ("rgba", "light_", "mat_", "cam_", "vis.", "_group", "_user", "hfield_size")
"""Parts of the names of fields that no step reads."""


_OPTIONS = tuple(name for name in dir(mujoco.MjOption) if not name.startswith("_"))

_PADDING = 64
"""Bytes between two arrays of a model."""

_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)


def _moves_or_touches(model: mujoco.MjModel, body: int) -> bool:
    """Whether a body, or one that it carries, has a joint or a geom that touches something."""
    below = [body]
    for other in range(body + 1, model.nbody):
        if model.body_parentid[other] in below:
            below.append(other)
    touches = _touching(model)[np.isin(model.geom_bodyid, below)]
    return bool(touches.any() or model.body_dofnum[below].any() or model.body_weldid[body] != 0)


def _touching(model: mujoco.MjModel) -> npt.NDArray[np.bool_]:
    """[ngeom]: which geoms can touch others."""
    kinds = mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    on = not model.opt.disableflags & int(kinds)
    return np.asarray((model.geom_contype | model.geom_conaffinity) != 0) & on


def numbers(model: mujoco.MjModel) -> dict[str, Floats]:
    """Every array of a model and of its options by name (`geom_pos`, `opt.gravity`), as views."""
    found = {}
    for prefix, part in (("", model), ("opt.", model.opt)):
        for name in dir(part):
            if name.startswith(("_", *_ASSETS)):
                continue
            value = getattr(part, name)
            if isinstance(value, np.ndarray) and value.size:
                found[prefix + name] = value
    return found


def _scalars(model: mujoco.MjModel) -> dict[str, Any]:
    """The options that are single numbers; actuation is switched off for moments in a reset."""
    values = {f"opt.{n}": getattr(model.opt, n) for n in _OPTIONS}
    values["opt.disableflags"] &= ~int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    return {n: v for n, v in values.items() if np.isscalar(v)}


class _Region:
    """A stretch of memory that holds several arrays: compared at once, which is sooner.

    Args:
      views: the arrays, in the order of their addresses.
    """

    def __init__(self, views: list[Floats]) -> None:
        self._begin, last = _address(views[0]), views[-1]
        size = _address(last) + last.nbytes - self._begin
        memory = (ctypes.c_uint8 * size).from_address(self._begin)
        self._bytes: npt.NDArray[np.uint8] = np.ctypeslib.as_array(memory)
        self._expected = self._bytes.copy()

    def expect(self, view: Floats, value: Floats) -> None:
        """What an array is to hold, if it is one of these."""
        at = _address(view) - self._begin
        if 0 <= at < len(self._expected):
            self._expected[at : at + view.nbytes] = np.frombuffer(value.tobytes(), np.uint8)

    def changed(self) -> bool:
        """Whether one of the arrays holds something else."""
        return self._bytes.tobytes() != self._expected.tobytes()


def _address(view: Floats) -> int:
    return int(view.__array_interface__["data"][0])


def _adjacent(views: list[Floats]) -> list[list[Floats]]:
    """Arrays in groups between which there is nothing but padding."""
    groups: list[list[Floats]] = []
    for view in sorted(views, key=_address):
        last = groups[-1][-1] if groups else None
        if last is not None and _address(view) - _address(last) - last.nbytes <= _PADDING:
            groups[-1].append(view)
        else:
            groups.append([view])
    return groups


class ModelFields:
    """The fields of a model that tasks have changed, with their values in every world.

    Args:
      model: the model that every world starts with; read only.
      working: its copy that tasks change, one world after the other.
      nworld: number of worlds.

    Attributes:
      varied: values by name, each [nworld, ...].
    """

    def __init__(self, model: mujoco.MjModel, working: mujoco.MjModel, nworld: int) -> None:
        self._working, self._nworld = working, nworld
        self._base = {name: np.array(value) for name, value in numbers(model).items()}
        self._base |= {name: np.array(value) for name, value in _scalars(model).items()}
        self._views = numbers(working)
        self.varied: dict[str, Floats] = {}
        self._watch()

    def place(self, world: int) -> None:
        """Gives the working model a world's values."""
        for name, rows in self.varied.items():
            self._assign(name, rows[world])

    def take(self, world: int) -> bool:
        """Keeps what a task made of the working model as a world's; whether fields are new."""
        changed = self._changed()
        for name in changed:
            self.vary(name)
        for name, rows in self.varied.items():
            rows[world] = self._value(name)
        if changed:
            self._watch()
        return bool(changed)

    def changed(self) -> bool:
        """Whether the working model is not what every world starts with, where nothing varies."""
        return bool(self._changed())

    def vary(self, name: str) -> Floats:
        """Gives a field a value for each world, [nworld, ...]; the model's own to begin with."""
        if name not in self.varied:
            base = self._base[name]
            self.varied[name] = np.repeat(base[None], self._nworld, axis=0)
            self._watch()
        return self.varied[name]

    def forget(self) -> None:
        """Gives the working model what every world starts with."""
        for name in self._changed():
            self._assign(name, self._base[name])

    def copy_from(self, model: mujoco.MjModel, world: int) -> None:
        """Keeps what a model of its own says of a world.

        Raises:
          InputError: it is a model of something else.
        """
        sizes = [mujoco.mj_stateSize(m, _STATE) for m in (model, self._working)]
        if sizes[0] != sizes[1]:
            raise InputError(
                f"world {world} has another model than world 0: its state has {sizes[0]} numbers, "
                f"not {sizes[1]}; all worlds need the same joints, activations and histories of "
                "delayed controls (nsample)"
            )
        theirs = {n: np.array(v) for n, v in (numbers(model) | _scalars(model)).items()}
        for name, base in self._base.items():
            value = theirs.get(name)
            if value is None or value.shape != base.shape:
                raise InputError(
                    f"world {world} has another model than world 0: {name!r} has shape "
                    f"{None if value is None else value.shape}, not {base.shape}; all worlds "
                    "need the same bodies, joints, geoms and actuators"
                )
            if name in self.varied or not np.array_equal(value, base, equal_nan=True):
                self.vary(name)[world] = value

    def write(self, world: int, model: mujoco.MjModel) -> None:
        """Writes a world's values into a model of its own."""
        views = numbers(model)
        for name, rows in self.varied.items():
            if name in views:
                views[name][...] = rows[world]
            else:
                setattr(model.opt, name.removeprefix("opt."), rows[world].item())

    def harmless(self, name: str) -> bool:
        """Whether what differs in a field is seen and sensed only, and moves nothing.

        Colours, lights, cameras and sites; geoms that touch nothing; bodies that cannot move and
        carry no geom that touches something.
        """
        if any(part in name for part in COSMETIC) or name.startswith("site_"):
            return True
        rows = self.varied[name]
        differ = (rows != self._base[name]).reshape(
            len(rows), rows.shape[1] if rows.ndim > 1 else 1, -1
        )
        numbers_of = np.flatnonzero(differ.any(axis=(0, 2)))
        model = self._working
        if name in ("geom_pos", "geom_quat", "geom_size"):
            return not _touching(model)[numbers_of].any()
        if name in ("body_pos", "body_quat"):
            return not any(_moves_or_touches(model, int(body)) for body in numbers_of)
        return False

    def _value(self, name: str) -> Any:
        view = self._views.get(name)
        return _scalars(self._working)[name] if view is None else view

    def _assign(self, name: str, value: Floats) -> None:
        view = self._views.get(name)
        if view is None:
            setattr(self._working.opt, name.removeprefix("opt."), value.item())
        else:
            view[...] = value

    def _watch(self) -> None:
        """What must stay as it is: the memory of the arrays that do not vary."""
        views = {n: v for n, v in self._views.items() if n not in self.varied}
        self._regions = [_Region(part) for part in _adjacent(list(views.values()))]
        for name, view in views.items():
            for region in self._regions:
                region.expect(view, self._base[name])
        self._options = {
            n: self._base[n].item() for n in _scalars(self._working) if n not in self.varied
        }

    def _changed(self) -> list[str]:
        scalars = _scalars(self._working)
        names = [n for n, v in self._options.items() if scalars[n] != v]
        if any(region.changed() for region in self._regions):
            names += [
                n
                for n, view in self._views.items()
                if n not in self.varied and view.tobytes() != self._base[n].tobytes()
            ]
        return names
