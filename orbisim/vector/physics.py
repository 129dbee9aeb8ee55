"""dm_control's `Physics` over many worlds, for the functions of tasks that only read it.

`batched(physics, ...)` is of the task's own subclass of `Physics`: its methods (`torso_height`)
run as they are, over `physics.data`, `physics.named.data`, `physics.model` and
`physics.named.model` whose arrays are `Worlds`.
"""

from __future__ import annotations

from typing import Any, Protocol

import mujoco
import numpy as np
import numpy.typing as npt
from dm_control.mujoco import engine

from orbisim.vector.overrides import methods_for
from orbisim.vector.worlds import ManyWorlds, NotBatchedError, Worlds

Ids = npt.NDArray[np.int64]


class Fields(Protocol):
    """What gives a field of MjData in every world."""

    model: mujoco.MjModel

    def field(self, name: str) -> Any:
        """[nworld, ...]."""


class Chosen(Protocol):
    """What makes arrays of the rows of a field."""

    def of(self, rows: Any) -> Any:
        """A `Worlds`, or a `TensorWorlds` of a tensor."""


class Selection:
    """The worlds that are looked at; None for all of them."""

    def __init__(self) -> None:
        self.ids: Ids | None = None

    def of(self, rows: npt.NDArray[Any]) -> Worlds:
        """Their rows, read-only."""
        chosen = rows[self.ids] if self.ids is not None else rows.view()
        chosen.flags.writeable = False
        return Worlds(chosen)


class BatchedData:
    """`physics.data` over many worlds."""

    def __init__(self, fields: Fields, model: BatchedModel, selection: Chosen) -> None:
        self._fields, self.model, self._selection = fields, model, selection

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return self._selection.of(self._fields.field(name))

    def object_velocity(
        self, object_id: int | str, object_type: int | str, local_frame: bool = False
    ) -> Any:
        """Linear and angular velocity [2, 3] of an object by `mj_objectVelocity`."""
        return _object_velocity(self, object_id, object_type, local_frame)


class BatchedModel:
    """`physics.model` over many worlds: what is the same in all of them is as it is in one."""

    def __init__(self, model: Any, varied: dict[str, Any], selection: Chosen) -> None:
        self._model, self._varied, self._selection = model, varied, selection

    def __getattr__(self, name: str) -> Any:
        if name in ("ptr", "_model") or name.startswith("__"):
            raise NotBatchedError(f"physics.model.{name}")
        if name in self._varied:
            return self._selection.of(self._varied[name])
        if name == "opt" and any(n.startswith("opt.") for n in self._varied):
            return _Options(self._model.opt, self._varied, self._selection)
        return getattr(self._model, name)


class _Options:
    """`physics.model.opt` where options differ between worlds."""

    def __init__(self, options: Any, varied: dict[str, Any], selection: Chosen) -> None:
        self._options, self._varied, self._selection = options, varied, selection

    def __getattr__(self, name: str) -> Any:
        rows = self._varied.get(f"opt.{name}")
        return getattr(self._options, name) if rows is None else self._selection.of(rows)


class Named:
    """`physics.named.data` or `physics.named.model`: fields that are indexed by names."""

    def __init__(self, indexers: Any, arrays: Any) -> None:
        self._indexers, self._arrays = indexers, arrays

    def __getattr__(self, name: str) -> Any:
        indexer = getattr(self._indexers, name)
        array = getattr(self._arrays, name)
        return NamedField(indexer, array) if isinstance(array, ManyWorlds) else indexer


class NamedField:
    """One field, indexed by names or numbers."""

    def __init__(self, indexer: Any, worlds: Any) -> None:
        self._indexer, self._worlds = indexer, worlds

    def __getitem__(self, key: Any) -> Any:
        return self._worlds[self._indexer._convert_key(key)]

    def __setitem__(self, key: Any, value: Any) -> None:
        raise NotBatchedError("a task that writes into the physics when it is asked for a value")

    def __getattr__(self, name: str) -> Any:
        return getattr(self._worlds, name)

    def __array__(self, *args: Any, **kwargs: Any) -> Any:
        raise NotBatchedError("a whole named field as an array")


class BatchedPhysics(engine.Physics):
    """`engine.Physics` over many worlds: what reads works, what simulates or renders does not."""

    def get_state(self, sig: Any = None) -> Any:
        """Positions, velocities and activations, without a signature."""
        if sig is not None:
            raise NotBatchedError("physics.get_state(sig)")
        return super().get_state()

    def _refuse(self, *args: Any, **kwargs: Any) -> Any:
        raise NotBatchedError("a task that changes the physics when it is asked for a value")

    set_control = set_state = step = reset = after_reset = forward = render = copy = _refuse


def batched(
    physics: engine.Physics, fields: Fields, varied: dict[str, Any], selection: Chosen
) -> Any:
    """A physics of many worlds with the methods of one.

    Args:
      physics: of one world; its subclass gives the methods, its names the indexing.
      fields: MjData's fields in every world.
      varied: fields of the model that differ between the worlds, each [nworld, ...].
      selection: the worlds to look at; may be changed at any time.
    """
    own = type(physics)
    bases = (BatchedPhysics,) if own is engine.Physics else (own, BatchedPhysics)
    cls: Any = type(f"Batched{own.__name__}", bases, methods_for(own))
    made = cls.__new__(cls)
    made.__dict__ |= {k: v for k, v in vars(physics).items() if k not in _OF_ONE_WORLD}
    model = BatchedModel(physics.model, varied, selection)
    data = BatchedData(fields, model, selection)
    made._data = data
    made._named = engine.NamedIndexStructs(
        model=Named(physics.named.model, model), data=Named(physics.named.data, data)
    )
    return made


_OF_ONE_WORLD = ("_data", "_named", "_warnings", "_warnings_before", "_new_warnings", "_contexts")
"""Attributes of a `Physics` that hold one world's numbers."""

_POSES = {
    "body": ("xpos", "xmat"),
    "geom": ("geom_xpos", "geom_xmat"),
    "site": ("site_xpos", "site_xmat"),
    "camera": ("cam_xpos", "cam_xmat"),
    "xbody": ("xpos", "xmat"),
}
"""What `mj_objectVelocity` reads of each kind of object, besides `cvel` and `subtree_com`."""


def _object_velocity(
    data: BatchedData, object_id: int | str, object_type: int | str, local_frame: bool
) -> Any:
    wrapped, kind = data.model._model, object_type
    if kind not in _POSES:
        raise NotBatchedError(f"physics.data.object_velocity of a {object_type!r}")
    number = wrapped.name2id(object_id, kind) if isinstance(object_id, str) else object_id
    if not isinstance(data.cvel, Worlds):
        return _velocity_at(data, number, kind, local_frame)
    code = mujoco.mju_str2Type(kind)
    names = ("xipos", "ximat", "cvel", "subtree_com", *_POSES[kind])
    rows = {name: getattr(data, name).rows for name in names}
    one, velocities = mujoco.MjData(wrapped.ptr), []
    velocity = np.empty(6)
    for world in range(len(rows["cvel"])):
        for name, values in rows.items():
            getattr(one, name)[...] = values[world]
        mujoco.mj_objectVelocity(wrapped.ptr, one, code, number, velocity, local_frame)
        velocities.append(velocity.reshape(2, 3)[::-1].copy())
    return Worlds(np.stack(velocities))


def _velocity_at(data: BatchedData, number: int, kind: str, local_frame: bool) -> Any:
    """What `mj_objectVelocity` computes, in operations on arrays."""
    model = data.model._model
    body = number if kind in ("body", "xbody") else getattr(model, _BODIES[kind])[number]
    places, frames = ("xipos", "ximat") if kind == "body" else _POSES[kind]
    about = data.subtree_com[int(model.body_rootid[body])]
    turning, moving = data.cvel[int(body), :3], data.cvel[int(body), 3:]
    moving = moving - np.cross(getattr(data, places)[number] - about, turning)
    if local_frame:
        frame = getattr(data, frames)[number].reshape(3, 3)
        moving, turning = moving.dot(frame), turning.dot(frame)
    return np.stack([moving, turning])


_BODIES = {"geom": "geom_bodyid", "site": "site_bodyid", "camera": "cam_bodyid"}
"""Fields of a model that name the body of an object."""
