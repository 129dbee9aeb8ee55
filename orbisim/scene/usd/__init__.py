"""USD scenes: UsdPhysics (with MuJoCo's, Newton's and PhysX's additions) into an `MjSpec`.

A stage is read in two steps. `dump` runs OpenUSD in a process of its own, with bounded time and
memory, and hands over the composed stage in plain numbers (`flat`). Everything else turns these
into a MuJoCo model without OpenUSD: `bodies`, `geoms`, `joints` and `mass` say what the stage
means, `tree` arranges bodies and joints in trees, `build` puts the spec together.

What follows from the schemas:

- The joint coordinates are UsdPhysics': zero where the joint frames coincide. The authored pose
  is MuJoCo's reference pose, at which a joint has the value of its `ref`.
- Drives are actuators whose control is the target (m, rad; a velocity for drives without
  stiffness). Authored targets and initial velocities are in the keyframe "initial".
- Float32 attributes are read as the shortest decimals that round to them (`decimals`).
- `mjc:` attributes mean what they mean in MJCF; where they are authored they have precedence.
- Bodies are named by display name or prim name, with parents' names only where needed.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from orbisim.errors import InputError, SceneError
from orbisim.files.budget import Limits
from orbisim.files.guard import guarded
from orbisim.scene.reading import Reader, ReadResult
from orbisim.scene.scene import Scene
from orbisim.scene.usd.attributes import prims_of
from orbisim.scene.usd.build import build
from orbisim.scene.usd.context import Context
from orbisim.scene.usd.flat import FlatStage
from orbisim.scene.usd.process import dump_stage
from orbisim.scene.usd.units import units_of

__all__ = ["UsdReader", "read_usd"]

_PRIM_SIZE = 1000  # bytes that a prim comes to in a typical file
_OPTIONS = ("decompose", "meters_per_unit", "up_axis")


class UsdReader(Reader):
    """USD files; OpenUSD runs in a process of its own."""

    format = "USD"
    suffix = ".usd"
    isolated = True

    def read(self, path: str, **options: Any) -> ReadResult:
        """See `read_usd`."""
        return read_usd(path, **options)


def read_usd(path: str, **options: Any) -> ReadResult:
    """Reads a USD file (`.usd`, `.usda`, `.usdc`, `.usdz`).

    Args:
      path: the file.
      **options:
        decompose (bool, default False): split meshes whose collision approximation is "none"
          and that are not convex into convex parts, instead of taking their hull.
        meters_per_unit (float): length of the stage's unit, in place of its metadata.
        up_axis ("Y" or "Z"): the stage's up axis, in place of its metadata.

    Raises:
      SceneError: the file cannot be read, holds no physics, or holds something that makes no
        sense; the message names the prim.
      MissingDependencyError: OpenUSD is not installed.
      InputError: an option is unknown or wrong.
    """
    unknown = sorted(set(options) - set(_OPTIONS))
    if unknown:
        raise InputError(
            f"the USD reader has no option {unknown[0]!r}; it has {', '.join(_OPTIONS)}"
        )
    if not Path(path).is_file():
        raise SceneError(path, "no such file")
    stage = dump_stage(path)
    size = _PRIM_SIZE * len(stage.prims)
    size += sum(mesh.points.nbytes + mesh.triangles.nbytes for mesh in stage.meshes)
    guarded(lambda: _compile(stage, path, options), path, Limits().for_input_of(size))
    return _convert(stage, path, **options)


def _convert(
    stage: FlatStage,
    path: str,
    *,
    decompose: bool = False,
    meters_per_unit: float | None = None,
    up_axis: str | None = None,
) -> ReadResult:
    """Turns a dumped stage into a spec."""
    units, warnings = units_of(stage, path, meters_per_unit, up_axis)
    context = Context(path, stage, prims_of(stage, path), units, decompose)
    for warning in warnings:
        context.warn(warning)
    return build(context)


def _compile(stage: FlatStage, path: str, options: dict[str, Any]) -> object:
    return Scene.from_read(_convert(stage, path, **options), path)
