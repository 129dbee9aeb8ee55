"""`orbisim info`."""

from __future__ import annotations

from typing import Any

import click

from orbisim.cli.common import (
    emit_json,
    engine_command,
    json_option,
    note,
    print_table,
    scene_options,
    trusted_option,
)


@click.command("info", epilog="Example: orbisim info robot.urdf --json")
@click.argument("scene")
@json_option
@trusted_option
@scene_options()
@engine_command
def command(scene: str, as_json: bool, trusted: bool) -> None:
    """Read SCENE and print its static descriptors.

    Entities, geometry, mass, inertia, friction, joints, actuators and world configuration; and what
    the file contains that the scene cannot carry.
    """
    from orbisim.scene import load_scene

    loaded = load_scene(scene, trusted=trusted)
    descriptor = loaded.descriptor.to_dict()
    if as_json:
        emit_json(
            {
                "schema": "orbisim.info/1",
                "scene": scene,
                **descriptor,
                "unsupported": [vars(item) for item in loaded.unsupported],
                "warnings": list(loaded.warnings),
            }
        )
        return
    _print(descriptor)
    for warning in loaded.warnings:
        note(f"warning: {warning}")
    for item in loaded.unsupported:
        note(f"unsupported: {item}")


def _print(descriptor: dict[str, Any]) -> None:
    counts = ", ".join(f"{value} {name}" for name, value in descriptor["counts"].items() if value)
    click.echo(f"{descriptor['name']}: {counts}\n")
    parts = [(entity, part) for entity in descriptor["entities"] for part in entity["parts"]]
    print_table(
        "Entities",
        ("entity", "kind", "parts", "joints", "geometries", "mass (kg)"),
        [
            (
                entity["name"],
                entity["kind"],
                len(entity["parts"]),
                sum(len(part["joints"]) for part in entity["parts"]),
                sum(len(part["geometries"]) for part in entity["parts"]),
                sum(part["mass"] for part in entity["parts"]),
            )
            for entity in descriptor["entities"]
        ],
    )
    print_table(
        "\nParts",
        ("part", "parent", "mass (kg)", "inertia (kg m^2)", "centre of mass (m)"),
        [
            (
                part["name"],
                part["parent"],
                part["mass"],
                *map(_row, (part["inertia"], part["ipos"])),
            )
            for _, part in parts
            if part["parent"] is not None
        ],
    )
    print_table(
        "\nJoints",
        ("joint", "type", "parent", "child", "axis", "range", "damping", "friction", "armature"),
        [
            (
                joint["name"],
                joint["type"],
                joint["parent"],
                joint["child"],
                _row(joint["axis"]),
                _row(joint["range"]) if joint["limited"] else "unlimited",
                _row(_trimmed(joint["damping"])),
                joint["frictionloss"],
                joint["armature"],
            )
            for _, part in parts
            for joint in part["joints"]
        ],
    )
    print_table(
        "\nGeometries",
        ("geometry", "part", "type", "size (m)", "friction", "collides"),
        [
            (
                geometry["name"],
                part["name"],
                (geometry["mesh"] and f"mesh {geometry['mesh']}") or geometry["type"],
                _row(geometry["size"]),
                _row(geometry["friction"]),
                "yes" if geometry["contype"] or geometry["conaffinity"] else "no",
            )
            for _, part in parts
            for geometry in part["geometries"]
        ],
    )
    if descriptor["actuators"]:
        print_table(
            "\nActuators",
            ("actuator", "acts on", "dynamics", "gain", "bias", "control range", "force range"),
            [
                (
                    actuator["name"],
                    f"{actuator['transmission']} {actuator['target']}",
                    actuator["dynamics"],
                    _row(_trimmed(actuator["gainprm"])),
                    _row(_trimmed(actuator["biasprm"])),
                    _row(actuator["ctrlrange"]) if actuator["ctrllimited"] else "unlimited",
                    _row(actuator["forcerange"]) if actuator["forcelimited"] else "unlimited",
                )
                for actuator in descriptor["actuators"]
            ],
        )
    world = descriptor["world"]
    print_table(
        "\nWorld",
        ("setting", "value"),
        [(name, _row(v) if isinstance(v, list) else v) for name, v in world.items()],
    )


def _row(values: list[Any]) -> str:
    return " ".join(v if isinstance(v, str) else f"{v:.4g}" for v in values) or "none"


def _trimmed(values: list[float]) -> list[float]:
    """Without trailing zeros, but with at least one entry."""
    last = max((i for i, v in enumerate(values) if v), default=0)
    return values[: last + 1]
