"""Turns measured data sets into recordings.

    python tools/import_measured.py DATA OUT [--set emps --set kuka_kr300 ...]

DATA holds one folder for each data set; OUT gets, for each data set, a folder with its recordings
(`.npz`) and `split.json`: the scene that they belong to, which are for fitting and which are
held out. The scenes, with the sources of every figure, are in mjcf_assets/.

The recordings are data of others: OUT must not lie inside this repository.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import click
import numpy as np
import numpy.typing as npt

from orbisim.recording import Recording

Floats = npt.NDArray[np.float64]
Arrays = Mapping[str, npt.NDArray[Any]]

_REPOSITORY = Path(__file__).resolve().parent.parent
_EVERY_FIFTH = 5


@dataclasses.dataclass(frozen=True)
class Episode:
    """One recording to write.

    Attributes:
      name: of the file, without suffix. recording: what it holds.
      held_out: whether it is kept from fitting.
    """

    name: str
    recording: Recording
    held_out: bool


@dataclasses.dataclass(frozen=True)
class DataSet:
    """A group of recordings that belong to one scene.

    Attributes:
      name: of the group. folder: of the data. scene: folder below mjcf_assets.
      episodes: reads them from the data folder.
      split: in words, how episodes were chosen for fitting.
    """

    name: str
    folder: str
    scene: str
    episodes: Callable[[Path], Iterator[Episode]]
    split: str


def _load(path: Path) -> dict[str, npt.NDArray[Any]]:
    with np.load(path, allow_pickle=False) as file:
        return {name: np.asarray(file[name]) for name in file.files}


def _wide(values: npt.ArrayLike) -> Floats:
    return np.asarray(values, np.float64)


def _recording(time: npt.ArrayLike, signals: Arrays, **metadata: Any) -> Recording:
    return Recording(
        time=_wide(time),
        signals={name: _wide(values) for name, values in signals.items()},
        metadata=metadata,
    )


# -- one function for each data set ----------------------------------------------------------------


def emps(folder: Path) -> Iterator[Episode]:
    """The single episode, cut in two."""
    data = _load(folder / "emps.npz")
    whole = _recording(
        data["time"],
        {"qpos/carriage": data["q"], "ctrl/drive": data["ctrl"]},
        loop="ctrl = kv * (kp * (q_ref - q) - qd)",
        kp=float(data["kp"]),
        kv=float(data["kv"]),
    )
    yield Episode("first_15_s", whole.between(0.0, 15.0), held_out=False)
    yield Episode("last_10_s", whole.between(15.0, np.inf), held_out=True)


def dfki_simple_pendulum(folder: Path) -> Iterator[Episode]:
    """Five controllers."""
    for path in sorted(folder.glob("*.npz")):
        data = _load(path)
        signals = {"qpos/hinge": data["q"], "qvel/hinge": data["qd"], "ctrl/motor": data["tau"]}
        held_out = path.stem in ("ddp", "direct_collocation")
        yield Episode(path.stem, _recording(data["time"], signals), held_out)


def dfki_double_pendulum(folder: Path) -> Iterator[Episode]:
    """Excitation runs, and swing-ups with the shoulder driven only."""
    for path in sorted(folder.glob("*.npz")):
        data = _load(path)
        signals = _by_column(data, ("shoulder", "elbow"), ("shoulder", "elbow"), "tau")
        held_out = path.stem not in {f"sysid_{i:02d}" for i in range(6)}
        yield Episode(path.stem, _recording(data["time"], signals), held_out)


def multiarm_single(folder: Path) -> Iterator[Episode]:
    """Consecutive pieces of one free decay, and a small swing on the cart."""
    for path in sorted(folder.glob("single_*.npz")):
        data = _load(path)
        held_out = path.stem not in ("single_00", "single_02")
        yield Episode(path.stem, _arms(data, ("arm",)), held_out)


def multiarm_double(folder: Path) -> Iterator[Episode]:
    """Consecutive pieces of one free decay."""
    for path in sorted(folder.glob("double_*.npz")):
        data = _load(path)
        yield Episode(path.stem, _arms(data, ("upper", "lower")), int(path.stem[-2:]) % 2 == 1)


def _arms(data: Arrays, joints: tuple[str, ...]) -> Recording:
    return _recording(
        data["time"], _by_column(data, joints, (), ""), start_in_decay_s=float(data["t0"])
    )


def _by_column(
    data: Arrays, joints: tuple[str, ...], motors: tuple[str, ...], torque: str
) -> dict[str, npt.NDArray[Any]]:
    signals = {f"qpos/{joint}": data["q"][:, i] for i, joint in enumerate(joints)}
    if "qd" in data:
        signals |= {f"qvel/{joint}": data["qd"][:, i] for i, joint in enumerate(joints)}
    return signals | {f"ctrl/{motor}": data[torque][:, i] for i, motor in enumerate(motors)}


def contactnets_cube(folder: Path) -> Iterator[Episode]:
    """Four hundred tosses."""
    data = _load(folder / "tosses.npz")
    for number, rows in _episodes(data):
        signals = {
            "xpos/cube": data["pos"][rows],
            "xquat/cube": data["quat"][rows],
            "qvel/cube": np.concatenate([data["linvel"][rows], data["angvel_body"][rows]], axis=1),
        }
        recording = _recording(
            data["time"][rows], signals, source_id=int(data["source_id"][number])
        )
        yield Episode(f"toss_{number:03d}", recording, number % _EVERY_FIFTH == 0)


def table_tennis_ball(folder: Path) -> Iterator[Episode]:
    """Flights; the spin is that before the first bounce, so it is given until then."""
    data = _load(folder / "flights.npz")
    for number, rows in _episodes(data):
        time, pos = data["time"][rows], _wide(data["pos"][rows])
        velocity = np.full((len(time), 6), np.nan)
        velocity[: first_bounce(pos[:, 2]), 3:] = data["spin"][number]
        recording = _recording(
            time,
            {"xpos/ball": pos, "qvel/ball": velocity},
            source_id=int(data["source_id"][number]),
        )
        yield Episode(f"flight_{number:03d}", recording, number % _EVERY_FIFTH == 0)


def first_bounce(height: Floats, near: float = 0.06) -> int:
    """Row of the first low point near the table; the length if there is none."""
    low = (height[1:-1] < height[:-2]) & (height[1:-1] <= height[2:]) & (height[1:-1] < near)
    return int(np.flatnonzero(low)[0]) + 1 if low.any() else len(height)


def _episodes(data: Arrays) -> Iterator[tuple[int, slice]]:
    starts = data["ep_start"]
    for number in range(len(starts) - 1):
        yield number, slice(int(starts[number]), int(starts[number + 1]))


def kuka_kr300(folder: Path) -> Iterator[Episode]:
    """Two excitation trajectories; angles from the start pose become those of the DH model."""
    start = np.deg2rad([0.0, -90.0, 90.0, 0.0, 0.0, 0.0])
    for path in sorted(folder.glob("trajectory_*.npz")):
        data = {name: _wide(values) for name, values in _load(path).items()}
        signals: dict[str, Floats] = {}
        for i in range(6):
            signals[f"qpos/axis_{i + 1}"] = data["q"][:, i] + start[i]
            signals[f"qvel/axis_{i + 1}"] = data["qd"][:, i]
            signals[f"ctrl/motor_{i + 1}"] = data["tau_motor"][:, i]
        for i in range(3):
            signals[f"sensor/link_encoder_{i + 1}"] = data["q_link"][:, i] + start[i]
        yield Episode(path.stem, _recording(data["time"], signals), path.stem.endswith("B"))


def sts3215_backlash(folder: Path) -> Iterator[Episode]:
    """One servo, and two on one lever (the first of them is recorded)."""
    for path in sorted(folder.glob("*.npz")):
        data = _load(path)
        signals = {
            "qpos/shaft": data["q"][:, 0],
            "qvel/shaft": data["qd"][:, 0],
            "ctrl/servo": data["q_target"][:, 0],
            "ctrl/pull": pull(_wide(data["q"][:, -2]), _wide(data["q"][:, -1])),
        }
        recording = _recording(_wide(data["time"]) - data["time"][0], signals)
        yield Episode(path.stem, recording, path.stem.startswith("coupled"))


def pull(first: Floats, second: Floats, full: float = 0.29) -> Floats:
    """Torque of the elastic bands, N*m, taken as proportional to how far each puller has turned.

    Both rest at the far end of their range; at the other end a band pulls with the published
    torque, the first towards negative angles and the second towards positive ones.
    """

    def part(angle: Floats, rest: float) -> Floats:
        travel = np.abs(angle - rest)
        return np.asarray(travel / travel.max())

    return full * (part(second, float(second.max())) - part(first, float(first.min())))


def bam_xl330(folder: Path) -> Iterator[Episode]:
    """Sixteen runs with four gains, each as long as the motor is switched on."""
    data = _load(folder / "runs.npz")
    for number, rows in _episodes(data):
        on = data["torque_enable"][rows]
        rows = slice(rows.start, rows.start + (len(on) if on.all() else int(np.argmin(on))))
        voltage = _wide(data["duty"][rows]) * _wide(data["input_volts"][rows])
        signals = {"qpos/shaft": data["q"][rows], "ctrl/motor": voltage}
        gain = int(data["kp"][number])
        name = f"kp_{gain}_{data['trajectory'][number]}"
        yield Episode(name, _recording(data["time"][rows], signals, kp=gain), gain in (200, 800))


def staubli_tx40(folder: Path) -> Iterator[Episode]:
    """One excitation, cut in two."""
    data = _load(folder / "excitation.npz")
    signals = {f"qpos/joint_{i + 1}": data["q"][:, i] for i in range(6)}
    signals |= {f"ctrl/motor_{i + 1}": data["tau"][:, i] for i in range(6)}
    whole = _recording(data["time"], signals)
    yield Episode("first_4.5_s", whole.between(0.0, 4.5), held_out=False)
    yield Episode("last_4.5_s", whole.between(4.5, np.inf), held_out=True)


def acromonk(folder: Path) -> Iterator[Episode]:
    """Five swings, without their ends: there the free hook meets a bar."""
    for path in sorted(folder.glob("*.npz")):
        data = _load(path)
        signals = _by_column(data, ("shoulder", "elbow"), (), "")
        signals["ctrl/elbow_motor"] = _carried_on(_wide(data["tau_elbow"]))
        new = np.append(True, np.diff(data["time"]) > 0)  # one time stamp stands there twice
        whole = _recording(data["time"][new], {n: v[new] for n, v in signals.items()})
        recording = whole.rows(slice(0, int(0.8 * len(whole))))
        yield Episode(path.stem, recording, path.stem in ("ZB_tvlqr_1x", "BF_tvlqr_1x"))


def _carried_on(values: Floats) -> Floats:
    """Missing values as the last one before; zero before the first."""
    last = np.maximum.accumulate(np.where(np.isfinite(values), np.arange(len(values)), -1))
    return np.where(last >= 0, values[last], 0.0)


def airtrack_oscillator(folder: Path) -> Iterator[Episode]:
    """One run, cut in two; 1 mm for each pixel."""
    data = _load(folder / "single.npz")
    whole = _recording(data["time"], {"qpos/glider": 1e-3 * data["x"]})
    yield Episode("first_18_s", whole.between(0.0, 18.0), held_out=False)
    yield Episode("last_11_s", whole.between(18.0, np.inf), held_out=True)


def rocket_coast(folder: Path) -> Iterator[Episode]:
    """Five coasts."""
    data = _load(folder / "ascents.npz")
    for number, rows in _episodes(data):
        whole = _recording(data["time"][rows], {"qpos/height": data["z"][rows]})
        coast = whole.between(float(data["burn_time"][number]) + 1.5, whole.time[-1] - 1.0)
        name = str(data["rocket"][number])
        yield Episode(name, coast, held_out=name in ("andromeda", "erebus11"))


def schmidt_lipson(folder: Path) -> Iterator[Episode]:
    """One trial, cut in two; the lower angle is made relative."""
    data = _load(folder / "swing.npz")
    upper, lower = data["theta_abs"].T
    whole = _recording(data["time"], {"qpos/upper": upper, "qpos/lower": lower - upper})
    yield Episode("first_5_s", whole.between(0.0, 5.0), held_out=False)
    yield Episode("last_4_s", whole.between(5.0, np.inf), held_out=True)


DATA_SETS = (
    DataSet("emps", "emps", "emps", emps, "the first 15 s of the only episode"),
    DataSet(
        "dfki_simple_pendulum",
        "dfki_simple_pendulum",
        "dfki_simple_pendulum",
        dfki_simple_pendulum,
        "the feedback runs; held out: the planned trajectories ddp and direct_collocation",
    ),
    DataSet(
        "dfki_double_pendulum_A",
        "dfki_double_pendulum_A",
        "dfki_double_pendulum_A",
        dfki_double_pendulum,
        "sysid_00 to sysid_05; held out: the later excitation runs and the pendubot runs",
    ),
    DataSet(
        "multiarm_pendulum_single",
        "multiarm_pendulum",
        "multiarm_pendulum_single",
        multiarm_single,
        "every other piece; held out: the rest and the swing on the cart",
    ),
    DataSet(
        "multiarm_pendulum_double",
        "multiarm_pendulum",
        "multiarm_pendulum_double",
        multiarm_double,
        "every other piece",
    ),
    DataSet(
        "contactnets_cube",
        "contactnets_cube",
        "contactnets_cube",
        contactnets_cube,
        "held out: every fifth toss",
    ),
    DataSet(
        "table_tennis_ball",
        "table_tennis_ball",
        "table_tennis_ball",
        table_tennis_ball,
        "held out: every fifth flight",
    ),
    DataSet("kuka_kr300", "kuka_kr300", "kuka_kr300", kuka_kr300, "trajectory A; held out: B"),
    DataSet(
        "sts3215_backlash",
        "sts3215_backlash",
        "sts3215_backlash",
        sts3215_backlash,
        "one servo; held out: two coupled servos",
    ),
    DataSet(
        "bam_xl330",
        "bam_xl330",
        "bam_xl330",
        bam_xl330,
        "firmware gains 100 and 400; held out: 200 and 800",
    ),
    DataSet(
        "staubli_tx40",
        "staubli_tx40",
        "staubli_tx40",
        staubli_tx40,
        "the first half of the only episode",
    ),
    DataSet(
        "acromonk",
        "acromonk",
        "acromonk",
        acromonk,
        "ZF_tvlqr, ZF_pd and FB_pd; held out: ZB_tvlqr and BF_tvlqr",
    ),
    DataSet(
        "airtrack_oscillator",
        "airtrack_oscillator",
        "airtrack_oscillator",
        airtrack_oscillator,
        "the first 18 s of the only episode",
    ),
    DataSet(
        "rocket_coast",
        "rocket_coast",
        "rocket_coast",
        rocket_coast,
        "ndrt_2020, genesis and camoes; held out: andromeda and erebus11",
    ),
    DataSet(
        "schmidt_lipson_double_pendulum",
        "schmidt_lipson_double_pendulum",
        "schmidt_lipson_double_pendulum",
        schmidt_lipson,
        "the first 5 s of the only episode",
    ),
)


def import_set(data_set: DataSet, data: Path, out: Path) -> list[Path]:
    """Writes the recordings of a data set and `split.json`; returns their paths."""
    folder = out / data_set.name
    folder.mkdir(parents=True, exist_ok=True)
    paths: dict[bool, list[str]] = {False: [], True: []}
    for episode in data_set.episodes(data / data_set.folder):
        episode.recording.save(folder / f"{episode.name}.npz")
        paths[episode.held_out].append(f"{episode.name}.npz")
    split = {
        "scene": f"mjcf_assets/{data_set.scene}/scene.xml",
        "fit": paths[False],
        "held_out": paths[True],
        "how": data_set.split,
    }
    (folder / "split.json").write_text(json.dumps(split, indent=1) + "\n")
    return [folder / name for names in paths.values() for name in names]


@click.command()
@click.argument("data", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.argument("out", type=click.Path(file_okay=False, path_type=Path))
@click.option(
    "--set",
    "wanted",
    multiple=True,
    type=click.Choice([d.name for d in DATA_SETS]),
    help="Only these data sets.",
)
def main(data: Path, out: Path, wanted: tuple[str, ...]) -> None:
    """Turns measured data sets into recordings."""
    if out.resolve().is_relative_to(_REPOSITORY):
        raise click.UsageError(f"{out} lies inside the repository; choose a folder elsewhere")
    for data_set in DATA_SETS:
        if wanted and data_set.name not in wanted:
            continue
        if not (data / data_set.folder).is_dir():
            click.echo(f"{data_set.name}: no folder {data / data_set.folder}; skipped", err=True)
            continue
        paths = import_set(data_set, data, out)
        click.echo(f"{data_set.name}: {len(paths)} recordings in {out / data_set.name}")


if __name__ == "__main__":
    main()
