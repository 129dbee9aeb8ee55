"""The kinds of files for `fuzz_files`: how to write one, damage it, and read it."""

from __future__ import annotations

import dataclasses
import functools
import json
import random
import struct
import sys
import zipfile
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from fuzz_mutations import BYTES, TOKENS
from fuzz_seeds import builtin_seeds
from fuzz_values import damage_hdf5, damage_safetensors, damaged_array, damaged_json

import orbisim
from orbisim.recording import capture
from orbisim.trajectory import Trajectory

SCENE = """
<mujoco model="arm">
  <option timestep="0.005" integrator="implicitfast"/>
  <worldbody>
    <body name="arm"><joint name="hinge" axis="0 1 0" damping="0.05"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.4" size=".02" mass=".5"/>
      <body name="tip" pos="0 0 -.4"><geom name="tip" size=".03" mass=".1"/></body></body>
    <body name="box" pos="1 0 1"><freejoint name="box"/><geom size=".1" mass="1"/></body>
  </worldbody>
  <actuator><motor name="motor" joint="hinge" ctrlrange="-1 1"/></actuator>
  <sensor><jointpos name="encoder" joint="hinge"/></sensor>
  <custom>%s</custom>
</mujoco>
"""


@dataclasses.dataclass(frozen=True)
class Kind:
    """One kind of file.

    Attributes:
      make: writes undamaged files to a folder.
      damage: damages what the format means, in place.
      read: reads what is in the folder, as a user would have it read.
      whole: pattern of the files whose bytes are damaged, too.
    """

    make: Callable[[Path], None]
    damage: Callable[[Path, random.Random], None]
    read: Callable[[Path], None]
    whole: str = "*"

    def damage_bytes(self, folder: Path, rng: random.Random) -> None:
        """Damages bytes of one file."""
        paths = sorted(p for p in folder.glob(self.whole) if p.is_file())
        if not paths:
            return
        path = rng.choice(paths)
        path.write_bytes(rng.choice(BYTES)(path.read_bytes() or b"\n", rng))


@functools.cache
def _scene() -> orbisim.Scene:
    return orbisim.load_scene(SCENE % "", trusted=True)


@functools.cache
def _engine() -> Any:
    return orbisim.make_backend("mujoco", _scene())


def _rollout(steps: int) -> Trajectory:
    engine = _engine()
    rng = np.random.default_rng(0)
    state = engine.reset(1)
    state = state.replace(qvel=rng.standard_normal(state.qvel.shape))
    return engine.rollout(state, 0.1 * rng.standard_normal((steps, 1)).cumsum(0))


# -- recordings ----------------------------------------------------------------------------------


def _make_recording(suffix: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        capture(_scene(), _rollout(120)).save(folder / f"a{suffix}")

    return make


def _replay(suffix: str) -> Callable[[Path], None]:
    def read(folder: Path) -> None:
        orbisim.replay(_scene(), folder / f"a{suffix}", window=0.1)

    return read


def _damage_npz(path: Path, rng: random.Random) -> None:
    with np.load(path) as file:
        arrays = dict(file)
    name = rng.choice(list(arrays))
    how = rng.random()
    lies: dict[str, bytes] = {}
    if name == "header":
        text = str(arrays[name])
        arrays[name] = np.array(damaged_json(json.loads(text), rng))
    elif how < 0.1:
        del arrays[name]
    elif how < 0.2:
        arrays[rng.choice((f"{name}x", "qpos/nothing", "x", "time", "a/b"))] = arrays.pop(name)
    elif how < 0.3:
        lies[f"{name}.npy"] = _lying(rng)
        del arrays[name]
    else:
        arrays[name] = damaged_array(arrays[name], rng)
    (np.savez_compressed if rng.random() < 0.5 else np.savez)(path, **arrays)
    with zipfile.ZipFile(path, "a") as archive:
        for entry, data in lies.items():
            archive.writestr(entry, data)


def _lying(rng: random.Random) -> bytes:
    """An array that declares more, or something else, than is there."""
    shape = rng.choice(("(10**9,)", "(1000000000000,)", "(-1,)", "(2, 3, 'a')", "(1,)", "(0, 10)"))
    kind = rng.choice(("<f8", "|O", "<U1000000000", "|V8", "<f16", "i", "(3,)f8"))
    text = f"{{'descr': {kind!r}, 'fortran_order': False, 'shape': {shape}, }}"
    if rng.random() < 0.1:
        text = "(" * 5_000
    header = (text.ljust(117) + "\n").encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + bytes(8)


def _damage_csv(path: Path, rng: random.Random) -> None:
    rows = [line.split(",") for line in path.read_text().splitlines()]
    how = rng.randrange(8)
    row, column = rng.randrange(len(rows)), rng.randrange(len(rows[0]))
    if how == 0:
        rows[row][column] = rng.choice(
            ("nan", "inf", "1e300", "-1e300", "", "x", '"', "\0", "1;2", "0x10", "9" * 400, "1_0")
        )
    elif how == 1:
        rows[0][column] = rng.choice(
            ("time", "qpos/", "qpos/nothing", "", "xpos/box/w", "qpos[999999999]", '"', "a" * 10**5)
        )
    elif how == 2:
        rows[row] = rows[row] * rng.choice((0, 2, 1000))
    elif how == 3:
        rows = [one[:column] + one[column + 1 :] for one in rows]
    elif how == 4:
        rows[0] += [f"qpos/x[{i}]" for i in range(rng.choice((10, 20_000)))]
    elif how == 5:
        rows[1:] = reversed(rows[1:])
    elif how == 6:
        factor = 10.0 ** rng.choice((-12, 6, 12, 300))
        for one in rows[1:]:
            one[column] = repr(float(one[column] or "nan") * factor)
    else:
        rows = rows[: rng.choice((0, 1, 2))]
    mark = rng.choice((",", ",", ",", ",", ";", "\t"))
    path.write_text("\n".join(mark.join(one) for one in rows))


def _damage_parquet(path: Path, rng: random.Random) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pq.read_table(path)
    column = rng.randrange(table.num_columns)
    name, values = table.column_names[column], table.column(column).to_numpy()
    how = rng.randrange(5)
    if how == 0:
        table = table.remove_column(column)
    elif how == 1:
        table = table.append_column(rng.choice((name, "", "qpos/x[5]")), table.column(column))
    elif how == 2:
        header = json.loads((table.schema.metadata or {}).get(b"orbisim.recording", b"{}"))
        table = table.replace_schema_metadata({"orbisim.recording": damaged_json(header, rng)})
    else:
        changed = damaged_array(values, rng)
        odd = [
            pa.array([str(v) for v in values]), pa.array([[v] for v in values]),
            pa.array([None] * len(values)), pa.array([{"a": v} for v in values]),
            pa.array([b"x"] * len(values)), pa.array(values).dictionary_encode(),
            pa.array(np.zeros(len(values), "M8[ns]")), pa.array([True] * len(values)),
        ]  # fmt: skip
        fits = changed.shape == values.shape and changed.dtype.kind in "iuf"
        array = pa.array(changed) if fits and rng.random() < 0.6 else rng.choice(odd)
        table = table.set_column(column, name, array)
    pq.write_table(table, path)


# -- states and trajectories ---------------------------------------------------------------------


def _make_trajectory(folder: Path) -> None:
    _rollout(40).save(folder / "a.npz", backend="mujoco", seed=0)


def _read_trajectory(folder: Path) -> None:
    from orbisim.view.saved import trajectory_html

    loaded, notes = Trajectory.load(folder / "a.npz")
    trajectory_html(_scene(), loaded, title=str(notes.get("backend")))


def _make_state(folder: Path) -> None:
    _engine().step(_engine().reset(2)).save(folder / "a.npz")


def _read_state(folder: Path) -> None:
    from orbisim.errors import DivergedError
    from orbisim.state import State

    state = State.load(folder / "a.npz")
    try:
        _engine().step(state)
    except DivergedError:
        return  # the numbers were read, and what they lead to was said


# -- scenes --------------------------------------------------------------------------------------


def _make_texts(folder: Path) -> None:
    (folder / "texts.json").write_text(json.dumps({"orbisim:effects": _working_effects()}))


@functools.cache
def _working_effects() -> list[dict[str, Any]]:
    """One of each effect that a scene carries as text, where this scene can have it."""
    from orbisim.effects import EffectInstance, effect_names, find

    model, kept = _scene().model, []
    for effect in (find(name) for name in effect_names()):
        for target in effect.targets(model)[:1] if not effect.native else ():
            values = {p.name: p.scale for p in effect.parameters(model, target)}
            instance = EffectInstance(effect.name, target, values)
            if not effect.measurement:
                effect.hook(model, instance)
            kept.append(instance.to_json())
    return kept


def _damage_texts(folder: Path, rng: random.Random) -> None:
    path = folder / "texts.json"
    texts = json.loads(path.read_text())
    name = "orbisim:effects"
    document = json.loads(texts[name]) if isinstance(texts[name], str) else texts[name]
    texts[name] = damaged_json(document, rng)
    if rng.random() < 0.2:
        other = rng.choice(("orbisim:rest", "orbisim:hidden"))
        texts[other] = damaged_json(rng.choice((["hinge"], document, {"networks": []})), rng)
    path.write_text(json.dumps(texts))


def _read_texts(folder: Path) -> None:
    texts = json.loads((folder / "texts.json").read_text())
    lines = ""
    for name, value in texts.items():
        data = value if isinstance(value, str) else json.dumps(value)
        lines += f"<text name={quoteattr(name)} data={quoteattr(_printable(data))}/>"
    scene = orbisim.load_scene(SCENE % lines)
    engine = orbisim.make_backend("mujoco", scene)
    engine.step(engine.reset(), None, 3)


def _printable(text: str) -> str:
    return "".join(c if c.isprintable() else "?" for c in text) or " "


def _make_archive(folder: Path) -> None:
    for number, files in enumerate(builtin_seeds("mjcf")):
        with zipfile.ZipFile(folder / f"{number}.zip", "w", zipfile.ZIP_DEFLATED) as archive:
            for name, data in files.items():
                archive.writestr(name, data if isinstance(data, bytes) else data.read_bytes())


def _damage_archive(folder: Path, rng: random.Random) -> None:
    path = rng.choice(sorted(folder.glob("*.zip")))
    with zipfile.ZipFile(path) as archive:
        entries = {entry.filename: archive.read(entry) for entry in archive.infolist()}
    names = list(entries)
    chosen = names[0] if rng.random() < 0.6 else rng.choice(names)
    method = rng.choice(
        (zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)
    )
    how, extra = rng.randrange(7), []
    if how == 0:
        name = rng.choice(
            ("../x.xml", "/x.xml", "a\\..\\..\\x", "C:/x", "", "a" * 300, "\n", "é/x")
        )
        extra.append((name, entries[chosen], 0))
    elif how == 1:
        extra.append((chosen, entries[chosen], 0))
    elif how == 2:
        extra.append(("link.xml", b"/etc/passwd", 0o120777 << 16))
    elif how == 3:
        del entries[chosen]
    elif how == 4:
        extra += [(f"{'d/' * rng.choice((1, 200))}{i}.xml", entries[chosen], 0) for i in range(3)]
    elif how == 5:
        extra.append(("big.bin", bytes(rng.choice((10**6, 10**8))), 0))
    else:
        entries[chosen] = rng.choice(TOKENS)(entries[chosen], rng)
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, data in entries.items():
            archive.writestr(name, data)
        for name, data, mode in extra:
            info = zipfile.ZipInfo(name)
            info.external_attr, info.compress_type = mode, method
            archive.writestr(info, data)


def _read_archive(folder: Path) -> None:
    errors = []
    for path in sorted(folder.glob("*.zip")):
        try:
            orbisim.load_scene(path)
        except orbisim.errors.InputError as error:
            errors.append(error)
    if errors:
        raise errors[0]


def _make_usdz(folder: Path) -> None:
    files = builtin_seeds("usd")[0]
    with zipfile.ZipFile(folder / "0.usdz", "w", zipfile.ZIP_STORED) as archive:
        for name, data in files.items():
            archive.writestr(name, data if isinstance(data, bytes) else data.read_bytes())


def _damage_usdz(folder: Path, rng: random.Random) -> None:
    path = folder / "0.usdz"
    path.rename(folder / "0.zip")
    _damage_archive(folder, rng)
    (folder / "0.zip").rename(path)


def _read_usdz(folder: Path) -> None:
    orbisim.load_scene(folder / "0.usdz")


# -- learning ------------------------------------------------------------------------------------


def _make_hdf5(folder: Path) -> None:
    from orbisim.tasks.collect import collect

    collect("ball", folder / "a.h5", episodes=3, workers=1)


def _read_hdf5(folder: Path) -> None:
    from orbisim_world_model.packing import read_data

    from orbisim.tasks.dataset import EpisodeFile

    with EpisodeFile(folder / "a.h5") as file:
        for index in range(len(file)):
            file.attributes(index)
            file.episode(index)
            file.entities(index)
        file.stack(["qpos", "time"])
    read_data([folder / "a.h5"])


def _make_pack(folder: Path) -> None:
    from orbisim_world_model.packing import pack_file

    _make_hdf5(folder)
    pack_file(folder / "a.h5").save(folder / "a.pack")
    (folder / "a.h5").unlink()


def _read_pack(folder: Path) -> None:
    from orbisim_world_model.packing import read_data

    read_data([folder / "a.pack"])


def _make_checkpoint(folder: Path, of: str = "cartpole") -> None:
    from orbisim_world_model import zoo

    for name in ("manifest.json", "model.safetensors"):
        (folder / name).write_bytes((zoo.FOLDER / of / name).read_bytes())


def _make_cloth(folder: Path) -> None:
    _make_checkpoint(folder, "cloth")


def _damage_checkpoint(folder: Path, rng: random.Random) -> None:
    if rng.random() < 0.3:
        damage_safetensors(folder / "model.safetensors", rng)
        return
    path = folder / "manifest.json"
    path.write_text(damaged_json(json.loads(path.read_text()), rng))


@functools.cache
def _named(name: str) -> orbisim.Scene:
    return orbisim.load_scene(name)


def _read_cloth(folder: Path) -> None:
    _read_checkpoint(folder, "task:drape")


def _read_checkpoint(folder: Path, scene: str = "suite:cartpole-swingup") -> None:
    from orbisim.errors import DivergedError

    engine = orbisim.make_backend(f"learned:{folder}", _named(scene), native=False, device="cpu")
    try:
        engine.step(engine.reset())
    except DivergedError:
        return  # the weights were read, and what they lead to was said


def _file(name: str, damage: Callable[[Path, random.Random], None]) -> Any:
    return lambda folder, rng: damage(folder / name, rng)


KINDS: Mapping[str, Kind] = {
    "hdf5": Kind(_make_hdf5, _file("a.h5", damage_hdf5), _read_hdf5),
    "npz": Kind(_make_recording(".npz"), _file("a.npz", _damage_npz), _replay(".npz")),
    "csv": Kind(_make_recording(".csv"), _file("a.csv", _damage_csv), _replay(".csv")),
    "parquet": Kind(
        _make_recording(".parquet"), _file("a.parquet", _damage_parquet), _replay(".parquet")
    ),
    "trajectory": Kind(_make_trajectory, _file("a.npz", _damage_npz), _read_trajectory),
    "state": Kind(_make_state, _file("a.npz", _damage_npz), _read_state),
    "texts": Kind(_make_texts, _damage_texts, _read_texts, whole="nothing"),
    "archive": Kind(_make_archive, _damage_archive, _read_archive),
    "usdz": Kind(_make_usdz, _damage_usdz, _read_usdz),
    "pack": Kind(_make_pack, _file("a.pack", damage_safetensors), _read_pack),
    "checkpoint": Kind(_make_checkpoint, _damage_checkpoint, _read_checkpoint),
    "cloth": Kind(_make_cloth, _damage_checkpoint, _read_cloth),
}
if find_spec("torch"):  # which trains
    from fuzz_training import PARTS as TRAININGS

    KINDS = {**KINDS, **{name: Kind(*parts) for name, parts in TRAININGS.items()}}
if find_spec("rosbags") and find_spec("mcap"):  # which write the bags
    from fuzz_logs import PARTS

    KINDS = {**KINDS, **{name: Kind(*parts) for name, parts in PARTS.items()}}
