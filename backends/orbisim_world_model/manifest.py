"""The manifest of a checkpoint, checked before anything is built from it.

A manifest comes with weights, from wherever. It says how large a network is, so it is held
against bounds here and against the shapes of the weights (see `checkpoint`) before memory is given
to either.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from orbisim.errors import InputError
from orbisim.files.reading import read_json
from orbisim_world_model.config import ModelConfig
from orbisim_world_model.layout import Layout
from orbisim_world_model.plain import checked

SCHEMA = "orbisim.dynamics/1"
MANIFEST = "manifest.json"
MOST_ROBOTS = 100
"""Of one checkpoint; the largest training had some ten."""
_MOST = {"width": 8192, "layers": 128, "heads": 128, "expansion": 64}
"""Of a network's sizes: far beyond what has been trained (width 144, 4 layers)."""
_MOST_CONTROLS = 10_000
"""Widths of inputs: far beyond any robot's actuators."""
_MOST_RANGE = 1e12
"""Of a range, in its own unit: squares of what is in proportion are still far from infinite."""

Bounds = dict[str, tuple[float, float]]


@dataclasses.dataclass(frozen=True)
class Ranges:
    """What the training data cover: lowest and highest values by column, and largest speeds."""

    joint_speed: float
    object_speed: float
    object_turning: float
    objects: tuple[int, int]
    attributes: Bounds
    settings: Bounds
    joints: Bounds
    object_position: Bounds
    parts: Bounds = dataclasses.field(default_factory=dict)


def read_manifest(folder: str | Path) -> dict[str, Any]:
    """The manifest of a checkpoint.

    Raises:
      InputError: there is none, it is of another kind, or an entry is not what it must be.
    """
    path = Path(folder) / MANIFEST
    try:
        manifest = read_json(path)
    except InputError as error:
        raise InputError(f"{folder}: not a checkpoint of learned dynamics ({error})") from None
    if manifest.get("schema") != SCHEMA:
        raise InputError(f"{path}: not the manifest of learned dynamics ({SCHEMA})")
    _check(manifest, str(path))
    return manifest


def _check(manifest: dict[str, Any], path: str) -> None:
    config = model_config(manifest, path)
    if config.width % config.heads:
        raise InputError(f"{path}: model.width is {config.width}; it must be a multiple of heads")
    checked(str, _entry(_object(manifest, "config", path), "name", path), f"{path}: config.name")
    checked(int, manifest.get("parameters", 0), f"{path}: parameters")
    _check_sources(_object(manifest, "data", path), path)
    if "uncertainty" in manifest:
        _check_uncertainty(_object(manifest, "uncertainty", path), f"{path}: uncertainty")
    robots = manifest.get("variants", [])
    if not isinstance(robots, list) or len(robots) > MOST_ROBOTS:
        raise InputError(f"{path}: variants: expected a list of at most {MOST_ROBOTS} robots")
    for number, robot in enumerate(robots):
        where = f"{path}: variants[{number}]"
        if not isinstance(robot, dict):
            raise InputError(f"{where}: expected an object")
        checked(dict[str, tuple[float, ...]], _entry(robot, "robot", where), f"{where}.robot")
    for number, view in enumerate(variants(manifest)):
        _check_robot(view, f"{path}: variants[{number - 1}]" if number else path)


def _check_uncertainty(known: dict[str, Any], where: str) -> None:
    width = checked(int, _entry(known, "width", where), f"{where}.width")
    if not 1 <= width <= _MOST["width"]:
        raise InputError(f"{where}.width is {width}; expected 1 to {_MOST['width']}")
    floor = checked(float, known.get("floor", 0.0), f"{where}.floor")
    if not 0 <= floor <= _MOST_RANGE:
        raise InputError(f"{where}.floor is {floor:g}; expected 0 to {_MOST_RANGE:g}")
    factor = _object(known, "factor", where)
    for kind in ("robot", "objects"):
        place = f"{where}.factor.{kind}"
        pair = checked(tuple[float, float], _entry(factor, kind, f"{where}.factor"), place)
        if min(pair) <= 0:
            raise InputError(f"{place} is {list(pair)}; expected two numbers above 0")


def _check_sources(data: dict[str, Any], path: str) -> None:
    checked(dict[str, tuple[float, ...]], data.get("robot", {}), f"{path}: data.robot")
    sources = data.get("sources", [])
    if not isinstance(sources, list) or not all(isinstance(one, dict) for one in sources):
        raise InputError(f"{path}: data.sources: expected a list of objects")
    for source in sources:
        checked(str, source.get("task", ""), f"{path}: data.sources, task")


def _check_robot(view: Mapping[str, Any], where: str) -> None:
    """What there is for each robot: layout, number of controls, ranges."""
    layout = Layout.from_dict(_object(view, "layout", where), f"{where}: layout")
    controls = checked(int, _entry(view, "controls", where), f"{where}: controls")
    if not 0 <= controls <= _MOST_CONTROLS:
        raise InputError(f"{where}: controls is {controls}; expected 0 to {_MOST_CONTROLS}")
    ranges = checked(Ranges, _object(view, "ranges", where), f"{where}: ranges")
    joints = tuple(layout.joints[j] for j in layout.robot_joints)
    known = {"settings": layout.settings, "joints": joints}
    if layout.parts:
        known["parts"] = (*layout.part_columns, "count")
    if layout.objects:
        known |= {"attributes": layout.attributes, "object_position": ("x", "y", "z")}
    for group, names in known.items():
        if missing := [name for name in names if name not in getattr(ranges, group)]:
            raise InputError(f"{where}: ranges.{group} has no entry {missing[0]!r}")
    groups = (
        *(ranges.attributes, ranges.settings, ranges.joints),
        *(ranges.object_position, ranges.parts),
    )
    bounds = [number for group in groups for pair in group.values() for number in pair]
    for number in (*bounds, ranges.joint_speed, ranges.object_speed, ranges.object_turning):
        if abs(number) > _MOST_RANGE:
            raise InputError(f"{where}: ranges go to {number:g}; at most {_MOST_RANGE:g} is read")


def model_config(manifest: Mapping[str, Any], path: str) -> ModelConfig:
    """The configuration of the network.

    Raises:
      InputError: an entry is of the wrong type, unknown, or out of bounds.
    """
    config = checked(ModelConfig, _object(manifest, "model", path), f"{path}: model")
    for name, most in _MOST.items():
        if not 1 <= getattr(config, name) <= most:
            value = getattr(config, name)
            raise InputError(f"{path}: model.{name} is {value}; expected 1 to {most}")
    return config


def variants(manifest: dict[str, Any]) -> list[dict[str, Any]]:
    """The manifest as it is for each robot that the checkpoint knows.

    Raises:
      InputError: a robot lacks an entry.
    """
    views = [manifest]
    for number, entry in enumerate(manifest.get("variants", [])):
        where = f"variants[{number}]"
        data = {**manifest["data"], "robot": _entry(entry, "robot", where)}
        own = {name: _entry(entry, name, where) for name in ("layout", "controls", "ranges")}
        views.append({**manifest, **own, "data": data})
    return views


def _entry(values: Mapping[str, Any], name: str, where: str) -> Any:
    if name not in values:
        raise InputError(f"{where}: has no entry {name!r}")
    return values[name]


def _object(values: Mapping[str, Any], name: str, where: str) -> dict[str, Any]:
    value = _entry(values, name, where)
    if not isinstance(value, dict):
        raise InputError(f"{where}: {name}: expected an object; got {type(value).__name__}")
    return value
