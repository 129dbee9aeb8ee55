"""`Scene`: a compiled model together with the document it came from."""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import functools
import hashlib
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from orbisim.errors import InputError, SceneError
from orbisim.files.guard import COMPILING
from orbisim.host.engine_log import engine_warnings
from orbisim.scene.descriptor import SceneDescriptor, describe
from orbisim.scene.mjcf import COMPILER_ERRORS, as_scene_error
from orbisim.scene.precision import full_precision
from orbisim.scene.reading import ReadResult, Unsupported
from orbisim.scene.saving import packed, save_spec, unpacked
from orbisim.scene.texts import check_texts


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
    ) -> Scene:
        """Compiles an `MjSpec`; later changes to it do not reach the scene.

        Raises:
          SceneError: MuJoCo cannot compile it, or the compiled model is not finite.
        """
        scene = cls.from_read(ReadResult(spec, tuple(unsupported)), source)
        kept = spec.copy()  # only now: a copy drops references to what is missing, unnoticed
        return dataclasses.replace(scene, _spec=kept)

    @classmethod
    def from_read(cls, read: ReadResult, source: str) -> Scene:
        """Compiles what a reader returned, and keeps it.

        Raises:
          SceneError: as `from_spec`.
        """
        spec = read.spec
        with _collect_warnings() as compiler_warnings:
            try:
                model = spec.compile()
            except COMPILER_ERRORS as error:
                raise as_scene_error(error, source) from None
        _check_finite(model, source)
        found = (*read.warnings, *dict.fromkeys(compiler_warnings))
        check_texts(model, source)
        return cls(spec.modelname or "scene", source, model, read.unsupported, found, spec)

    @classmethod
    def from_model(cls, model: mujoco.MjModel, *, source: str = "MjModel") -> Scene:
        """A scene without a source document: it can be simulated, not edited or saved."""
        name = model.names[: model.names.find(b"\0")].decode() or "scene"
        return cls(name, source, copy.copy(model))

    def __copy__(self) -> Scene:
        return dataclasses.replace(self)

    def __deepcopy__(self, memo: dict[int, Any]) -> Scene:
        """The same scene with a model and a document of its own."""
        spec = None if self._spec is None else self._spec.copy()
        return dataclasses.replace(self, model=copy.deepcopy(self.model), _spec=spec)

    def __getstate__(self) -> dict[str, Any]:
        """For pickle: the model as it is, the document with the files that it refers to.

        Where such a file is gone, the document is left out, and the copy is not editable.
        """
        fields = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        del fields["_spec"]
        try:
            document = None if self._spec is None else packed(self._spec.copy(), self.source)
        except SceneError:
            document = None
        return {**fields, "document": document}

    def __setstate__(self, state: dict[str, Any]) -> None:
        document = state.pop("document")
        spec = None if document is None else unpacked(*document)
        for name, value in {**state, "_spec": spec}.items():
            object.__setattr__(self, name, value)

    @functools.cached_property
    def descriptor(self) -> SceneDescriptor:
        """The static descriptors of the scene (see `orbisim.scene.descriptor`)."""
        return describe(self.model, name=self.name)

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

    def without_images(self) -> Scene:
        """The same scene with textures of one pixel, or itself where there is no document.

        To compile a scene takes a hundred times as long with a skybox. Geoms that are only seen
        stay: they say how large a body is.
        """
        if self._spec is None:
            return self
        spec = self._spec.copy()
        for texture in spec.textures:
            texture.builtin = mujoco.mjtBuiltin.mjBUILTIN_FLAT
            texture.width = texture.height = 1
            texture.file, texture.cubefiles = "", [""] * 6
        return Scene.from_spec(spec, source=self.source, unsupported=self.unsupported)

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
    """Raises `SceneError` naming the first element with a NaN or infinite number.

    And where the timestep is none: MuJoCo compiles such a scene, and then stands still.
    """
    timestep = float(model.opt.timestep)
    if not 0 < timestep < np.inf:
        raise SceneError(
            source,
            f"timestep is {timestep:g}; expected seconds above 0",
            element="<option>",
            remedy='write <option timestep="0.002"/>',
        )
    for kind, field in _FINITE_FIELDS:
        values: Any = getattr(model, field)
        if np.isfinite(values).all():
            continue
        rows = values.reshape(len(values), -1) if len(values) else values.reshape(0, 1)
        index = int(np.flatnonzero(~np.isfinite(rows).all(axis=1))[0])
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
