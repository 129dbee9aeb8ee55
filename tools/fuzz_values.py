"""Ways to damage JSON, arrays, HDF5 and safetensors, for `fuzz_kinds`."""

from __future__ import annotations

import json
import random
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

NUMBERS: Sequence[float] = (
    *(float("nan"), float("inf"), -float("inf"), 1e300, -1e300, 1e-300, 0.0, -1.0, 1e12, 1e30),
    *(2.0**31, -(2.0**63), 0.5, 1e10),
)
_JSON: Sequence[Any] = (
    *(None, True, False, [], {}, [[]], "", "x", "x" * 10_000, "../../etc/passwd", "\0", "NaN"),
    *(-1, 0, 1, 0.5, 1e308, float("nan"), float("inf"), 10**9, 10**18, -(10**18), 10**400),
    *([1] * 1000, {"a": 1}, ["a"], [None], [[1, 2], [3]], "$\\frac{"),
)
_TYPES = ("f4", "f2", "i1", "i8", "u8", "?", "S4", "U4", "c16", "M8[s]", ">f8")


# -- JSON ----------------------------------------------------------------------------------------


def damaged_json(value: Any, rng: random.Random) -> str:
    """A document with something replaced, gone or added somewhere in it."""
    if rng.random() < 0.04:
        return rng.choice(("[", '{"a":')) * rng.choice((10, 1_000, 100_000))
    if rng.random() < 0.04:
        return "[" * 100_000 + "]" * 100_000
    copied = json.loads(json.dumps(value))
    for _ in range(rng.choice((1, 1, 2))):
        copied = _changed(copied, rng)
    text = json.dumps(copied)
    return text[: rng.randrange(len(text) + 1)] if rng.random() < 0.04 else text


def _changed(value: Any, rng: random.Random) -> Any:
    """The value with one of its parts, at any depth, damaged."""
    places = list(_places(value))
    if not places or rng.random() < 0.02:
        return rng.choice(_JSON)
    holder, key = rng.choice(places)
    how = rng.random()
    if how < 0.2:
        del holder[key]
    elif how < 0.3 and isinstance(holder, list):
        holder.extend(holder * rng.choice((1, 1, 1000)) if len(holder) < 100 else [])
    elif how < 0.3:
        holder[f"{key}x"] = holder.pop(key)
    elif how < 0.5 and isinstance(holder[key], (int, float)):
        holder[key] = rng.choice(NUMBERS)
    elif how < 0.6:
        holder[key] = rng.choice(places)[0]
        return json.loads(json.dumps(value)) if _acyclic(value) else None
    else:
        holder[key] = rng.choice(_JSON)
    return value


def _places(value: Any) -> Any:
    keys = value if isinstance(value, dict) else range(len(value))
    for key in list(keys) if isinstance(value, (dict, list)) else ():
        yield value, key
        if isinstance(value[key], (dict, list)):
            yield from _places(value[key])


def _acyclic(value: Any) -> bool:
    try:
        json.dumps(value)
    except (ValueError, RecursionError):
        return False
    return True


# -- arrays --------------------------------------------------------------------------------------


def _put(array: Any, rng: random.Random) -> Any:
    array = np.array(array, np.float64 if array.dtype.kind in "iufb" else array.dtype)
    if array.size and array.dtype.kind == "f":
        flat = array.reshape(-1)
        flat[rng.randrange(array.size) :][: rng.choice((1, 1, 1, 10, array.size))] = rng.choice(
            NUMBERS
        )
    return array


def _typed(array: Any, rng: random.Random) -> Any:
    with np.errstate(all="ignore"):
        return array.astype(rng.choice(_TYPES))


def _shaped(array: Any, rng: random.Random) -> Any:
    how = rng.randrange(7)
    if how == 0:
        return array.reshape(-1)
    if how == 1:
        return array[None]
    if how == 2:
        return array.T
    if how == 3:
        return array[..., None]
    if how == 4:
        return array.reshape(-1)[:1].reshape(()) if array.size else array
    if how == 5:
        return array[:, :-1] if array.ndim > 1 else array[:-1]
    return np.zeros((*array.shape, 3))


def _rows(array: Any, rng: random.Random) -> Any:
    if not array.ndim:
        return np.zeros(3)
    how = rng.randrange(6)
    changed = (
        array[:0], array[:1], array[: len(array) // 2], array[::-1],
        np.concatenate([array, array]), np.repeat(array, rng.choice((2, 50)), axis=0),
    )  # fmt: skip
    return changed[how]


def _scaled(array: Any, rng: random.Random) -> Any:
    if array.dtype.kind not in "iuf":
        return array
    with np.errstate(all="ignore"):
        return array * 10.0 ** rng.choice((-300, -12, -3, 3, 6, 9, 12, 15, 200, 300))


def _other(array: Any, rng: random.Random) -> Any:
    if rng.random() < 0.1:
        return np.zeros((rng.choice((10**6, 10**7)), 3))  # compresses to nothing
    return rng.choice(
        (np.array("x"), np.array(0.0), np.zeros((0, 0)), np.zeros((1,) * 20), np.array([b"\xff"]))
    )


_ARRAYS: Sequence[Callable[[Any, random.Random], Any]] = (
    *(_put, _put, _put, _typed, _shaped, _rows, _scaled, _other),
)


def damaged_array(array: Any, rng: random.Random) -> Any:
    """An array with other numbers, of another type, or of another shape."""
    return rng.choice(_ARRAYS)(np.asarray(array), rng)


# -- HDF5 ----------------------------------------------------------------------------------------


def damage_hdf5(path: Path, rng: random.Random) -> None:
    """Damages one dataset, group or attribute of a file."""
    import h5py

    with h5py.File(path, "r+") as file:
        datasets: list[str] = []
        file.visititems(lambda n, o: datasets.append(n) if isinstance(o, h5py.Dataset) else None)
        holders = ["/", *datasets]
        file.visititems(lambda n, o: holders.append(n) if isinstance(o, h5py.Group) else None)
        if rng.random() < 0.35:
            _damage_attribute(file[rng.choice(holders[:1] * len(holders) + holders)], rng)
        else:
            _damage_dataset(file, rng.choice(datasets), path, rng)


def _damage_attribute(item: Any, rng: random.Random) -> None:
    import h5py

    names = list(item.attrs)
    if not names:
        return
    name = rng.choice(names)
    value = item.attrs[name]
    del item.attrs[name]
    how = rng.randrange(5)
    if how == 0:
        return
    if how == 1:
        item.attrs[name] = rng.choice(
            (b"\xff", -1, 0, 2**62, 1.5, float("nan"), float("inf"), np.zeros(3), "", "x", True)
        )
    elif how == 2 and isinstance(value, str) and value[:1] in "[{":
        item.attrs[name] = damaged_json(json.loads(value), rng)[:60_000]
    elif how == 3:
        item.attrs[name] = h5py.Empty("f8")
    else:
        item.attrs[f"{name}x"] = value


def _damage_dataset(file: Any, name: str, path: Path, rng: random.Random) -> None:
    import h5py

    values = file[name][()]
    del file[name]
    how = rng.randrange(14)
    if how == 0:
        return
    if how == 1:
        file[name] = rng.choice(
            (
                h5py.ExternalLink(str(path), f"/{name}x"), h5py.ExternalLink("/etc/passwd", "/x"),
                h5py.SoftLink("/"), h5py.SoftLink(f"/{name}"), h5py.SoftLink("/nothing"),
            )
        )  # fmt: skip
    elif how == 2:
        file.create_dataset(name, (8,), "f8", external=[("/etc/passwd", 0, 64)])
    elif how == 3:
        layout = h5py.VirtualLayout(values.shape or (1,), "f8")
        layout[...] = h5py.VirtualSource(str(path), "other", values.shape or (1,))
        file.create_virtual_dataset(name, layout)
    elif how == 4:
        shape = rng.choice(((10**9, 10**6), (2**40,), (10**7,), (1000,) * 4))
        file.create_dataset(name, shape, "f8", chunks=tuple(min(n, 8) for n in shape))
    elif how == 5:
        place = name
        for depth in range(rng.choice((1, 10, 200))):
            place += f"/{depth}"
        file[place] = values
    elif how == 6:
        group = file.create_group(name)
        group["circle"] = group
    elif how == 7:
        odd = rng.choice(
            (
                np.zeros(3, [("a", "f8"), ("b", "i4")]), np.array(["a", "b"], "S2"),
                h5py.Empty("f8"), np.zeros(3, "V8"), np.zeros((1,) * 12),
            )
        )  # fmt: skip
        file[name] = odd
    elif how == 8:
        file.create_dataset(name, (2,), h5py.string_dtype())
    elif how == 9:
        file.create_dataset(name, (2,), h5py.ref_dtype)
    else:
        changed = damaged_array(values, rng)
        file[name] = changed if changed.dtype.kind not in "UM" else values.tobytes()[:64]


# -- safetensors ----------------------------------------------------------------------------------


def damage_safetensors(path: Path, rng: random.Random) -> None:
    """Damages the header, documents in it, or numbers."""
    raw = path.read_bytes()
    size = struct.unpack("<Q", raw[:8])[0]
    header, data = json.loads(raw[8 : 8 + size]), raw[8 + size :]
    how = rng.random()
    metadata = header.get("__metadata__", {})
    documents = [key for key, text in metadata.items() if text[:1] in ("{", "[")]
    if how < 0.4 and documents:
        key = rng.choice(documents)
        metadata[key] = damaged_json(json.loads(metadata[key]), rng)
        text = json.dumps(header)
    elif how < 0.7:
        text = damaged_json(header, rng)
    else:
        numbers = np.frombuffer(data[: len(data) // 4 * 4], np.float32).copy()
        start = rng.randrange(len(numbers))
        numbers[start : start + rng.choice((1, 100, len(numbers)))] = rng.choice(
            (np.nan, np.inf, 1e30, -1e38, 0)
        )
        data, text = numbers.tobytes() + data[len(data) // 4 * 4 :], json.dumps(header)
    encoded = text.encode()
    length = len(encoded) if rng.random() < 0.95 else rng.choice((0, 2**40, 2**63, len(raw)))
    path.write_bytes(struct.pack("<Q", length) + encoded + data)
