"""`FlatStage` to bytes and back: JSON for the structure, `.npy` for the arrays, no pickle."""

from __future__ import annotations

import dataclasses
import io
import json
from collections.abc import Mapping
from typing import Any, BinaryIO

import numpy as np

from orbisim.scene.usd.flat import FlatMesh, FlatPrim, FlatStage, Look, Note, Value

_HEADER_SIZE = 8
"""Bytes of the number that says how long the header is."""


def encode(stage: FlatStage) -> bytes:
    """Serialises a stage."""
    header = dataclasses.asdict(dataclasses.replace(stage, prims=(), meshes=()))
    header["prims"] = [_prim_to_json(prim) for prim in stage.prims]
    header["meshes"] = [mesh.subsets for mesh in stage.meshes]
    text = json.dumps(header).encode()
    out = io.BytesIO()
    out.write(len(text).to_bytes(_HEADER_SIZE, "little"))
    out.write(text)
    for mesh in stage.meshes:
        np.save(out, mesh.points, allow_pickle=False)
        np.save(out, mesh.triangles, allow_pickle=False)
    return out.getvalue()


def decode(data: bytes) -> FlatStage:
    """Inverse of `encode`.

    Raises:
      ValueError: the data is not what `encode` writes.
    """
    stream = io.BytesIO(data)
    size = int.from_bytes(stream.read(_HEADER_SIZE), "little")
    header = json.loads(stream.read(size))
    header["prims"] = tuple(_prim_from_json(prim) for prim in header["prims"])
    header["meshes"] = tuple(
        FlatMesh(_load(stream), _load(stream), subsets) for subsets in header["meshes"]
    )
    header["looks"] = tuple(
        Look(**{**look, "rgba": tuple(look["rgba"])}) for look in header["looks"]
    )
    header["notes"] = tuple(Note(**note) for note in header["notes"])
    return FlatStage(**header)


def _load(stream: BinaryIO) -> Any:
    return np.load(stream, allow_pickle=False)


def _prim_to_json(prim: FlatPrim) -> dict[str, Any]:
    fields = {field.name: getattr(prim, field.name) for field in dataclasses.fields(prim)}
    fields["matrix"], fields["local"] = prim.matrix.tolist(), prim.local.tolist()
    fields["attributes"] = {name: _to_json(value) for name, value in prim.attributes.items()}
    return fields


def _prim_from_json(fields: dict[str, Any]) -> FlatPrim:
    for name in ("matrix", "local"):
        fields[name] = np.array(fields[name], np.float64)
    fields["attributes"] = {name: _from_json(item) for name, item in fields["attributes"].items()}
    fields["relationships"] = _tuples(fields["relationships"])
    for name in ("schemas", "animated", "omitted"):
        fields[name] = tuple(fields[name])
    return FlatPrim(**fields)


def _tuples(lists: Mapping[str, list[str]]) -> dict[str, tuple[str, ...]]:
    return {name: tuple(items) for name, items in lists.items()}


def _to_json(value: Value) -> Any:
    """Plain values as they are; arrays as `{dtype: nested list}`."""
    if isinstance(value, np.ndarray):
        return {value.dtype.str: value.tolist()}
    return value


def _from_json(item: Any) -> Value:
    if isinstance(item, dict):
        ((dtype, values),) = item.items()
        return np.array(values, np.dtype(dtype))
    if isinstance(item, list):
        return tuple(item)
    return item
