"""How a scene carries effects: native MJCF, or JSON in `<custom><text name="orbisim:effects">`."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Sequence
from pathlib import Path

import mujoco

from orbisim.effects import plain
from orbisim.effects.base import EffectInstance, Hook
from orbisim.effects.catalogue import find
from orbisim.effects.flags import lift
from orbisim.effects.residual_network import rest_hooks
from orbisim.errors import InputError, OrbiSimError, SceneError
from orbisim.files.writing import write_text
from orbisim.scene import Scene
from orbisim.scene.texts import read_text, replace_text

TEXT_NAME = "orbisim:effects"
PLAIN = "effects.py"
"""Beside a saved scene: what makes plain MuJoCo apply the effects that it carries."""


def add_effects(scene: Scene, instances: Iterable[EffectInstance]) -> Scene:
    """The scene with effects added: natively where MJCF can, else carried as text.

    Raises:
      InputError: an effect is unknown, or does not fit the scene; or the scene was made from a
        compiled model and cannot be edited.
    """
    spec = edited(scene, instances)
    return Scene.from_spec(spec, source=scene.source, unsupported=scene.unsupported)


def edited(scene: Scene, instances: Iterable[EffectInstance]) -> mujoco.MjSpec:
    """The scene's document with effects added, not yet compiled. Errors as `add_effects`."""
    spec = scene.spec
    carried = list(carried_effects(scene.model))
    for instance in instances:
        effect = find(instance.effect)
        effect.check(scene.model, instance)
        lift(spec, effect.needs)
        if effect.native:
            try:
                effect.edit(spec, instance)
            except OrbiSimError:
                raise
            except ValueError as error:  # of MuJoCo: two changes of a body may not go together
                raise SceneError(scene.source, f"{instance} cannot be written: {error}") from None
        else:
            carried.append(instance)
    write_carried(spec, carried)
    return spec


def write_carried(spec: mujoco.MjSpec, instances: Sequence[EffectInstance]) -> None:
    """Replaces the effects that the document carries as text."""
    entries = [instance.to_json() for instance in instances]
    replace_text(spec, TEXT_NAME, entries or None)


def carried_effects(model: mujoco.MjModel, source: str = "scene") -> tuple[EffectInstance, ...]:
    """The effects that a compiled model carries as text.

    Raises:
      SceneError: the text is not what `write_carried` writes, or does not fit the scene.
    """
    try:
        entries = read_text(model, TEXT_NAME)
        if entries is None:
            return ()
        if not isinstance(entries, list):
            raise InputError(f"expected a list of effects, got {type(entries).__name__}")
        instances = tuple(EffectInstance.from_json(entry) for entry in entries)
        for instance in instances:
            find(instance.effect).check(model, instance)
    except (ValueError, OrbiSimError) as error:
        raise SceneError(source, str(error), element=f"<custom><text name='{TEXT_NAME}'>") from None
    return instances


def hooks_of(model: mujoco.MjModel) -> list[Hook]:
    """Hooks for a learned residual force and for the carried effects that act on the simulation."""
    return rest_hooks(model) + [
        find(instance.effect).hook(model, instance)
        for instance in carried_effects(model)
        if not find(instance.effect).measurement
    ]


def save_with_effects(scene: Scene, folder: Path) -> Path:
    """Writes the scene with its files, and `effects.py` for plain MuJoCo; gives the scene's path.

    Raises:
      OutputError: the folder cannot be written.
    """
    path = scene.save(folder)
    write_text(folder / PLAIN, inspect.getsource(plain))
    return path
