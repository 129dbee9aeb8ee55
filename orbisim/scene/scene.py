"""`Scene`: a compiled model together with the document it came from."""

from __future__ import annotations

import contextlib
import copy
import ctypes
import dataclasses
import functools
import hashlib
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from orbisim.engine_log import engine_warnings
from orbisim.errors import InputError, SceneError
from orbisim.scene.descriptor import SceneDescriptor, describe
from orbisim.scene.guard import COMPILING
from orbisim.scene.mjcf import as_scene_error
from orbisim.scene.reading import ReadResult, Unsupported

if TYPE_CHECKING:
    from orbisim.effects import EffectInstance


@dataclasses.dataclass(frozen=True, eq=False)
class Scene:
    """A scene: read, compiled and validated.

    Treat `model` as read-only; backends and `Physics` work on copies.

    Attributes:
      name: the model's name.
      source: the path, task name or "XML string" that it was loaded from.
      model: the compiled model.
      unsupported: what the source contains and the model does not carry.
      warnings: what the reader or MuJoCo's compiler had to assume.
    """

    name: str
    source: str
    model: mujoco.MjModel
    unsupported: tuple[Unsupported, ...] = ()
    warnings: tuple[str, ...] = ()
    _spec: mujoco.MjSpec | None = dataclasses.field(default=None, repr=False)

    @classmethod
    def from_spec(
        cls,
        spec: mujoco.MjSpec,
        *,
        source: str = "MjSpec",
        unsupported: Sequence[Unsupported] = (),
        reader_warnings: Sequence[str] = (),
    ) -> Scene:
        """Compiles an `MjSpec`; later changes to it do not reach the scene.

        Raises:
          SceneError: MuJoCo cannot compile it, or the compiled model is not finite.
        """
        with _collect_warnings() as compiler_warnings:
            try:
                model = spec.compile()
            except (ValueError, mujoco.FatalError) as error:
                raise as_scene_error(error, source) from None
        _check_finite(model, source)
        found = (*reader_warnings, *dict.fromkeys(compiler_warnings))
        kept = spec.copy()  # only now: a copy drops references to what is missing, unnoticed
        scene = cls(spec.modelname or "scene", source, model, tuple(unsupported), found, kept)
        if any(text.name == "orbisim:effects" for text in kept.texts):
            _ = scene.effects  # raises if they are not readable
        return scene

    @classmethod
    def from_read(cls, read: ReadResult, source: str) -> Scene:
        """Compiles what a reader returned."""
        return cls.from_spec(
            read.spec,
            source=source,
            unsupported=read.unsupported,
            reader_warnings=read.warnings,
        )

    @classmethod
    def from_model(cls, model: mujoco.MjModel, *, source: str = "MjModel") -> Scene:
        """A scene without a source document: it can be simulated, not edited or saved."""
        name = model.names[: model.names.find(b"\0")].decode() or "scene"
        return cls(name, source, copy.copy(model))

    @functools.cached_property
    def descriptor(self) -> SceneDescriptor:
        """The static descriptors of the scene (see `orbisim.scene.descriptor`)."""
        return describe(self.model, name=self.name)

    @functools.cached_property
    def effects(self) -> tuple[EffectInstance, ...]:
        """Effects that the scene carries because MJCF cannot express them.

        Raises:
          SceneError: they are not readable or do not fit the scene.
        """
        from orbisim.effects.carry import carried_effects

        return carried_effects(self.model, self.source)

    @property
    def spec(self) -> mujoco.MjSpec:
        """An editable copy of the document.

        Raises:
          InputError: the scene was made from a compiled model and has no document.
        """
        if self._spec is None:
            raise InputError(
                f"scene {self.name!r} was made from a compiled model ({self.source}) and cannot "
                "be edited or saved; load it from its XML instead"
            )
        return self._spec.copy()

    @property
    def editable(self) -> bool:
        """Whether the scene has a document (`spec`, `to_xml`, `save` work)."""
        return self._spec is not None

    @functools.cached_property
    def fingerprint(self) -> str:
        """A hash of everything the compiled model holds; equal models have equal hashes."""
        return hashlib.sha256(model_bytes(self.model)).hexdigest()

    def with_model(self, model: mujoco.MjModel) -> Scene:
        """The same scene after its compiled model was changed in place (randomised, say)."""
        return dataclasses.replace(self, model=copy.copy(model), _spec=None)

    def replace_source(self, source: str) -> Scene:
        """The same scene under another source (the archive it came from, say)."""
        return dataclasses.replace(self, source=source)

    def to_xml(self) -> str:
        """The scene as MJCF, numbers in full precision.

        Referenced files stay references; `save` writes them too.
        """
        spec = self.spec
        spec.compile()
        with full_precision():
            return str(spec.to_xml())

    def save(self, folder: str | Path, filename: str = "scene.xml") -> Path:
        """Writes the scene as MJCF plus the files it needs; returns the path of the MJCF.

        The folder can be moved or shipped: meshes, textures and height fields are written
        beside the MJCF under `assets/` and referenced relative to it.

        Raises:
          SceneError: a file that the scene refers to is gone.
        """
        from orbisim.scene.saving import save_spec

        return save_spec(self.spec, Path(folder), filename, self.source)


def model_bytes(model: mujoco.MjModel) -> bytes:
    """The compiled model, serialised."""
    buffer = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer.tobytes()


_FINITE_FIELDS = (
    ("body", "body_mass"),
    ("body", "body_inertia"),
    ("body", "body_pos"),
    ("body", "body_quat"),
    ("body", "body_ipos"),
    ("geom", "geom_size"),
    ("geom", "geom_pos"),
    ("geom", "geom_quat"),
    ("geom", "geom_friction"),
    ("joint", "jnt_axis"),
    ("joint", "jnt_range"),
    ("dof", "dof_damping"),
    ("dof", "dof_armature"),
    ("mesh", "mesh_vert"),
    ("actuator", "actuator_gainprm"),
    ("actuator", "actuator_biasprm"),
)


def _check_finite(model: mujoco.MjModel, source: str) -> None:
    """Raises `SceneError` naming the first element with a NaN or infinite number."""
    for kind, field in _FINITE_FIELDS:
        values: Any = getattr(model, field)
        rows = values.reshape(len(values), -1) if len(values) else values.reshape(0, 1)
        bad = np.flatnonzero(~np.isfinite(rows).all(axis=1))
        if not bad.size:
            continue
        index = int(bad[0])
        if kind == "mesh":  # vertices of all meshes stand in one array
            index = int(np.searchsorted(model.mesh_vertadr, index, side="right") - 1)
        if kind == "dof":
            kind, index = "joint", int(model.dof_jntid[index])
        label = getattr(model, kind)(index).name or f"number {index}"
        raise SceneError(
            source,
            f"{field} is not finite",
            element=f"{kind} {label!r}",
            remedy="replace the NaN or infinite number",
        )


@contextlib.contextmanager
def _collect_warnings() -> Iterator[list[str]]:
    """Collects MuJoCo's warnings, which otherwise go to standard error and a log file."""
    collected: list[str] = []

    with COMPILING, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            with engine_warnings(collected.append):
                yield collected
        finally:
            collected += [" ".join(str(warning.message).split()) for warning in caught]


_FULL_DIGITS = 17


@contextlib.contextmanager
def full_precision() -> Iterator[None]:
    """Makes MuJoCo's XML writer print 17 digits instead of 6.

    The setting is an exported but undocumented function of the library; `tests/scene` checks
    that a saved scene compiles to the same model.
    """
    import glob
    import os

    pattern = os.path.join(os.path.dirname(mujoco.__file__), "libmujoco.so*")  # noqa: PTH118,PTH120
    libraries = sorted(glob.glob(pattern))  # noqa: PTH207
    library = ctypes.CDLL(libraries[0]) if libraries else ctypes.CDLL(None)
    setter = library._mjPRIVATE__set_xml_precision
    getter = library._mjPRIVATE__get_xml_precision
    before = getter()
    setter(_FULL_DIGITS)
    try:
        yield
    finally:
        setter(before)
