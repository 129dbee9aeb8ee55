"""Writing episodes to HDF5 such that the same episodes give the same bytes."""

from __future__ import annotations

import importlib.metadata
import json
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from orbisim.errors import InputError, MissingDependencyError, OutputError
from orbisim.files.writing import check_place, writing
from orbisim.tasks.episode import Episode
from orbisim.tasks.schema import IMAGES, SCHEMA

_LIBVER = ("v110", "v110")
_PACKAGES = ("orbisim", "mujoco", "numpy", "dm-control", "h5py")


def _h5py() -> Any:
    try:
        import h5py
    except ImportError as error:
        raise MissingDependencyError("episode files", "learned", "no module 'h5py'") from error
    return h5py


def check_destination(path: Path) -> None:
    """Raises `InputError` if a file cannot be written there, `MissingDependencyError` by h5py."""
    _h5py()
    if path.suffix not in (".h5", ".hdf5"):
        raise InputError(f"{path}: a file of episodes ends in .h5 or .hdf5")
    if path.exists():
        raise InputError(f"{path}: already exists; remove it or choose another name")
    check_place(path)


def _check_room(path: Path, nbytes: int) -> None:
    """Raises `OutputError` if a file of that size has no room on the disk."""
    room = shutil.disk_usage(path.parent).free
    if room < nbytes:
        raise OutputError(
            f"{path}: needs {nbytes} bytes and the disk has {room} left; make room and run the "
            "same command again"
        )


def versions() -> dict[str, str]:
    """Versions of the packages that an episode depends on."""
    found = {}
    for name in _PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "unknown"
    return found


def write_episodes(path: Path, episodes: Iterable[tuple[int, Episode]]) -> None:
    """Writes episodes with their numbers to a file.

    It is made in memory: where a disk is full, HDF5 cannot even close a file without complaint.
    """
    memory: dict[str, Any] = {"driver": "core", "backing_store": False}
    with _h5py().File(path, "w", libver=_LIBVER, **memory) as file:
        for number, episode in episodes:
            write_episode(file.create_group(f"{number:06d}"), episode)
        file.flush()
        image = file.id.get_file_image()
    path.write_bytes(image)


def write_episode(group: Any, episode: Episode) -> None:
    """Writes one episode into a group."""
    group.attrs["subtask"] = episode.subtask
    group.attrs["seed"] = episode.seed
    group.attrs["scene_hash"] = episode.scene_hash
    group.attrs["success"] = -1 if episode.success is None else int(episode.success)
    for name in sorted(episode.arrays):
        array = episode.arrays[name]
        options: dict[str, Any] = {}
        if name.startswith(IMAGES):
            options = {"chunks": (min(16, len(array)), *array.shape[1:]), "compression": "gzip"}
        dataset = group.create_dataset(name, data=array, track_times=False, **options)
        if name in episode.columns:
            dataset.attrs["columns"] = json.dumps(list(episode.columns[name]))


def assemble(path: Path, chunks: Iterable[Path], attributes: Mapping[str, Any]) -> None:
    """Joins chunks into one file, which appears only when it is whole."""
    h5py = _h5py()
    chunks = list(chunks)
    _check_room(path, sum(chunk.stat().st_size for chunk in chunks))
    with writing(path) as part, h5py.File(part, "w", libver=_LIBVER) as file:
        file.attrs["schema"] = SCHEMA
        for name, value in attributes.items():
            file.attrs[name] = value
        into = file.create_group("episodes")
        for chunk in chunks:
            with h5py.File(chunk, "r") as source:
                for key in source:
                    source.copy(source[key], into, name=key)
        file.attrs["complete"] = True
