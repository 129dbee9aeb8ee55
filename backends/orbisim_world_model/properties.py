"""Descriptors by name, coupled as they are in the world: a density has a mass and an inertia."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from orbisim.errors import InputError, UnknownNameError
from orbisim_world_model.layout import Layout

Values = Mapping[str, object]
DENSITY = "density"
_INERTIA = ("inertia_x", "inertia_y", "inertia_z")
_COUPLED = ("half_", "type_", "com_", *_INERTIA)
"""Beginnings of columns that are not set alone: they change the mass distribution with them."""
_SHAPES = {
    "type_box": 8.0,
    "type_sphere": 4.0 / 3.0 * math.pi,
    "type_ellipsoid": 4.0 / 3.0 * math.pi,
    "type_cylinder": 2.0 * math.pi,
}
"""Volume of a shape over the product of its half sizes."""


def with_object(attributes: Tensor, layout: Layout, name: str, changes: Values) -> Tensor:
    """Attributes [B, N, D] with properties of one object changed.

    `mass` (kg) takes the principal inertia with it in proportion; `density` (kg/m^3) is the mass
    over the volume of the shape; friction coefficients and solref are as they are called. Values
    are numbers or [B], and may carry gradients.

    Raises:
      UnknownNameError: there is no such object or property.
      InputError: the property cannot be changed alone, or a value is not above 0.
    """
    if name not in layout.objects:
        raise UnknownNameError("object", name, layout.objects)
    index, columns = layout.objects.index(name), layout.attributes
    rows = attributes[:, index]
    for what, value in changes.items():
        if what not in (*columns, DENSITY):
            raise UnknownNameError("property", what, [*columns, DENSITY])
        if what.startswith(_COUPLED):
            raise InputError(
                f"{what} of {name!r} changes the shape and with it mass and inertia; edit the scene"
            )
        rows = _changed(rows, columns, name, what, _worlds(value, rows, f"{what} of {name!r}"))
    parts = [rows if i == index else attributes[:, i] for i in range(attributes.shape[1])]
    return torch.stack(parts, dim=1)


def with_world(settings: Tensor, layout: Layout, changes: Values) -> Tensor:
    """Settings [B, W] with some of `layout.settings` changed.

    Raises:
      UnknownNameError: there is no such setting.
    """
    for what, value in changes.items():
        if what not in layout.settings:
            raise UnknownNameError("world setting", what, layout.settings)
        settings = _put(settings, layout.settings.index(what), _worlds(value, settings, what, None))
    return settings


def volume(rows: Tensor, columns: tuple[str, ...]) -> Tensor:
    """Volumes [B], m^3, of rows of attributes [B, D].

    Raises:
      InputError: the shape is none whose volume follows from its half sizes.
    """
    sizes = [rows[:, columns.index(f"half_{axis}")] for axis in "xyz"]
    shares = {kind: rows[:, columns.index(kind)] for kind in _SHAPES if kind in columns}
    known = sum(shares.values(), rows.new_zeros(len(rows)))
    if not bool((known > 0.5).all()):
        raise InputError("density needs a box, sphere, ellipsoid or cylinder; change the mass")
    factor = sum((_SHAPES[kind] * share for kind, share in shares.items()), rows.new_zeros(()))
    return factor * sizes[0] * sizes[1] * sizes[2]


def _changed(rows: Tensor, columns: tuple[str, ...], name: str, what: str, value: Tensor) -> Tensor:
    if what == DENSITY:
        what, value = "mass", value * volume(rows, columns)
    if what == "mass":
        ratio = value / rows[:, columns.index("mass")]
        for axis in _INERTIA:
            if axis in columns:
                place = columns.index(axis)
                rows = _put(rows, place, rows[:, place] * ratio)
    return _put(rows, columns.index(what), value)


def _put(rows: Tensor, place: int, value: Tensor) -> Tensor:
    return torch.cat([rows[:, :place], value[:, None], rows[:, place + 1 :]], dim=1)


def _worlds(value: object, like: Tensor, what: str, least: float | None = 0.0) -> Tensor:
    """A value as [B]."""
    found = torch.as_tensor(value, dtype=like.dtype, device=like.device)
    if found.dim() > 1 or (found.dim() == 1 and len(found) not in (1, len(like))):
        raise InputError(f"{what} is a number, or one for each of {len(like)} worlds")
    wrong = ~torch.isfinite(found.detach()) | (
        found.detach() <= least if least is not None and not what.startswith("solref") else False
    )
    if bool(wrong.any()):
        raise InputError(f"{what} must be finite and above 0")
    return found.expand(len(like))
