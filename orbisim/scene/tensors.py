"""Descriptors as tensors, and back without loss.

`to_tensors` writes every numeric field of a descriptor to a matrix with one row for each part,
geometry, joint, flex and actuator, and one row for the world. `from_tensors` puts such
numbers back into a descriptor of the same structure; gradients and optimisers work in between.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from orbisim.errors import InputError
from orbisim.scene.descriptor import (
    ActuatorDescriptor,
    FlexDescriptor,
    GeometryDescriptor,
    JointDescriptor,
    PartDescriptor,
    SceneDescriptor,
    WorldDescriptor,
)
from orbisim.scene.surface import POINTS, Surface

Tensors = Mapping[str, npt.NDArray[np.float64]]
T = TypeVar("T")

TABLES: Mapping[str, type] = {
    "part": PartDescriptor,
    "geometry": GeometryDescriptor,
    "joint": JointDescriptor,
    "flex": FlexDescriptor,
    "actuator": ActuatorDescriptor,
    "world": WorldDescriptor,
}
"""Name of each table and the descriptor that is one row of it."""


def columns(table: str) -> tuple[str, ...]:
    """Names of a table's columns: `friction/0`, `friction/1`, ..., `margin`.

    Raises:
      KeyError: there is no such table.
    """
    names: list[str] = []
    for name, width in _numeric_fields(TABLES[table]):
        names += [name] if width == 1 else [f"{name}/{i}" for i in range(width)]
    return tuple(names)


def to_tensors(descriptor: SceneDescriptor) -> dict[str, npt.NDArray[np.float64]]:
    """All numbers of a descriptor.

    Returns:
      For each name in `TABLES` an array [rows, len(columns(name))]; and `surface_points`,
      `surface_normals` [surfaces, n, 3] and `surface_area` [surfaces] for the geometries that
      have a surface, in order.
    """
    rows: dict[str, list[npt.NDArray[np.float64]]] = {name: [] for name in TABLES}
    surfaces: list[Surface] = []
    for table, row in _rows(descriptor):
        rows[table].append(_row(row))
        if isinstance(row, GeometryDescriptor) and row.surface is not None:
            surfaces.append(row.surface)
    tensors = {
        name: np.array(rows[name], np.float64).reshape(len(rows[name]), len(columns(name)))
        for name in TABLES
    }
    shape = (len(surfaces), POINTS, 3)
    tensors["surface_points"] = np.array([s.points for s in surfaces]).reshape(shape)
    tensors["surface_normals"] = np.array([s.normals for s in surfaces]).reshape(shape)
    tensors["surface_area"] = np.array([s.area for s in surfaces], np.float64)
    return tensors


def from_tensors(tensors: Tensors, structure: SceneDescriptor) -> SceneDescriptor:
    """The descriptor with the given numbers and the names and types of `structure`.

    Raises:
      InputError: a table is missing or does not have as many rows and columns as `structure`.
    """
    expected = to_tensors(structure)
    for name, like in expected.items():
        if name not in tensors:
            raise InputError(f"descriptor tensors lack the table {name!r}")
        if np.shape(tensors[name]) != like.shape:
            raise InputError(
                f"descriptor table {name!r} has shape {np.shape(tensors[name])}; "
                f"scene {structure.name!r} needs {like.shape}"
            )
    source = _RowReader(tensors)
    entities = tuple(
        dataclasses.replace(
            entity,
            parts=tuple(
                source.fill(
                    "part",
                    dataclasses.replace(
                        part,
                        geometries=tuple(source.geometry(g) for g in part.geometries),
                        joints=tuple(source.fill("joint", joint) for joint in part.joints),
                    ),
                )
                for part in entity.parts
            ),
            flexes=tuple(source.fill("flex", flex) for flex in entity.flexes),
        )
        for entity in structure.entities
    )
    actuators = tuple(source.fill("actuator", actuator) for actuator in structure.actuators)
    world = source.fill("world", structure.world)
    return dataclasses.replace(structure, entities=entities, actuators=actuators, world=world)


def _rows(descriptor: SceneDescriptor) -> Iterator[tuple[str, Any]]:
    """All rows of all tables, in the order in which `from_tensors` reads them."""
    for entity in descriptor.entities:
        for part in entity.parts:
            yield from (("geometry", geometry) for geometry in part.geometries)
            yield from (("joint", joint) for joint in part.joints)
            yield "part", part
        yield from (("flex", flex) for flex in entity.flexes)
    yield from (("actuator", actuator) for actuator in descriptor.actuators)
    yield "world", descriptor.world


def _numeric_fields(cls: type) -> tuple[tuple[str, int], ...]:
    return tuple(
        (field.name, field.metadata["width"])
        for field in dataclasses.fields(cls)
        if "width" in field.metadata
    )


def _row(descriptor: Any) -> npt.NDArray[np.float64]:
    return np.concatenate(
        [np.atleast_1d(getattr(descriptor, name)) for name, _ in _numeric_fields(type(descriptor))]
    ).astype(np.float64)


class _RowReader:
    """Hands out the rows of each table one after the other."""

    def __init__(self, tensors: Tensors) -> None:
        self._tensors = tensors
        self._next = dict.fromkeys(tensors, 0)

    def _take(self, table: str) -> Any:
        index = self._next[table]
        self._next[table] += 1
        return self._tensors[table][index]

    def fill(self, table: str, row: T) -> T:
        numbers = np.asarray(self._take(table))
        changes: dict[str, Any] = {}
        start = 0
        for name, width in _numeric_fields(type(row)):
            chunk = numbers[start : start + width]
            changes[name] = float(chunk[0]) if width == 1 else tuple(float(x) for x in chunk)
            start += width
        return dataclasses.replace(row, **changes)  # type: ignore[type-var]

    def geometry(self, geometry: GeometryDescriptor) -> GeometryDescriptor:
        filled = self.fill("geometry", geometry)
        if geometry.surface is None:
            return filled
        surface = Surface(
            np.asarray(self._take("surface_points"), np.float64),
            np.asarray(self._take("surface_normals"), np.float64),
            float(self._take("surface_area")),
        )
        return dataclasses.replace(filled, surface=surface)
