"""One diagnosis for each robot of a fleet, and one table: which robot differs from the others.

Each robot has a folder of recordings. What is done is kept under `OUT/robots/NAME`, so that the
same command goes on where it was stopped; a robot whose recordings are bad does not stop others.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import shutil
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

from orbisim import plugins
from orbisim.diagnosis.run import diagnose
from orbisim.diagnosis.settings import Settings
from orbisim.errors import InputError, OrbiSimError
from orbisim.files.reading import read_json
from orbisim.files.writing import make_folder, write_json, write_text
from orbisim.fleet.cluster import spread
from orbisim.fleet.table import Robot, Row, csv_text, rows_of
from orbisim.host.cpus import usable_cpus
from orbisim.host.progress import track
from orbisim.recording import Recording, load_recordings
from orbisim.scene import Scene, load_scene
from orbisim.tasks import pool
from orbisim.version import VERSION

SCHEMA = "orbisim.fleet/1"
ROBOTS = "robots"
"""Folder, below the output, of the robots' own results."""
_INPUTS, _FAILED = "inputs.json", "failed.json"


@dataclasses.dataclass(frozen=True)
class Options:
    """What every robot's diagnosis is called with; see `orbisim.diagnose`.

    Attributes:
      mapping: which column of the recordings is which signal.
    """

    window: float | None = None
    residual: Literal["motion", "force"] | None = "motion"
    backend: str = "mujoco"
    settings: Settings = dataclasses.field(default_factory=Settings)
    mapping: Path | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class Fleet:
    """Result of `diagnose_fleet`.

    Attributes:
      scene: as the user named it. robots: in the order of their names. rows: of the table.
    """

    scene: str
    robots: tuple[Robot, ...]
    rows: tuple[Row, ...]

    @property
    def outliers(self) -> tuple[str, ...]:
        """Names of the robots that differ from the others."""
        marked = {name for row in self.rows for name, cell in row.cells.items() if cell.outlier}
        return tuple(one.name for one in self.robots if one.name in marked)

    def to_json(self) -> dict[str, Any]:
        """The object of `report.json`."""
        return {
            "schema": SCHEMA,
            "scene": self.scene,
            "robots": [one.to_json() for one in self.robots],
            "effects": [row.to_json() for row in self.rows],
            "outliers": list(self.outliers),
        }


def diagnose_fleet(
    scene: str | Path,
    folder: str | Path,
    out: str | Path,
    options: Options | None = None,
    *,
    workers: int | None = None,
    ray: bool = False,
) -> Fleet:
    """Diagnoses every robot; writes `report.json`, `report.html`, `fleet.csv` and `robots/`.

    Args:
      scene: path or name: all robots as declared.
      folder: has a folder for each robot, with its recordings.
      out: folder for the results. What a former call has left there and what still holds (the same
        scene, recordings, options and version) is not done again.
      workers: processes at once; as many as there are cores if None.
      ray: whether to spread over a Ray cluster instead.

    Raises:
      InputError: there is no folder of a robot, or not at least one worker.
      SceneError: the scene cannot be read.
      OrbiSimError: a worker process was killed; what is done is kept.
    """
    if workers is not None and workers < 1:
        raise InputError(f"need at least one worker; got {workers}")
    options, loaded = options or Options(), load_scene(scene)
    found, results = robots_in(Path(folder)), make_folder(Path(out) / ROBOTS)
    marks = {name: _mark(loaded, files, options) for name, files in found.items()}
    todo = [name for name in found if not _is_done(results / name, marks[name])]
    count = min(workers or usable_cpus(), max(len(todo), 1))
    jobs = [(scene, found[name], results / name, marks[name], options) for name in todo]
    done: Iterable[None] = pool.run(work, jobs, count)
    if ray:
        done = _by_ray(loaded, jobs, count)
    for _ in track(done, "diagnosing robots", len(todo)):
        pass
    robots = tuple(_robot(name, results / name) for name in found)
    fleet = Fleet(str(scene), robots, rows_of(robots, loaded.model))
    write_json(Path(out) / "report.json", fleet.to_json())
    write_text(Path(out) / "fleet.csv", csv_text(fleet.robots, fleet.rows))
    plugins.load("orbisim.reports", "fleet", "report")(fleet, Path(out) / "report.html")
    return fleet


def robots_in(folder: Path) -> dict[str, list[Path]]:
    """Recordings by robot: everything in its folder that is not hidden.

    Raises:
      InputError: it is no folder, or has no folders in it.
    """
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder; --fleet has a folder for each robot")
    robots = sorted(path for path in folder.iterdir() if path.is_dir() and path.name[0] != ".")
    if not robots:
        raise InputError(
            f"{folder} has no folders; --fleet has a folder for each robot, with its recordings"
        )
    return {
        robot.name: sorted(path for path in robot.iterdir() if path.name[0] != ".")
        for robot in robots
    }


def work(
    scene: str | Path, recordings: Sequence[Path], place: Path, mark: str, options: Options
) -> None:
    """Diagnoses one robot into its folder; what is wrong with it is written there, not raised."""
    place.mkdir(parents=True, exist_ok=True)
    for name in (_INPUTS, _FAILED, "report.json"):  # of a former call
        (place / name).unlink(missing_ok=True)
    problem = attempt(load_scene(scene), recordings, place, options)
    if problem:
        write_json(place / _FAILED, {"problem": problem}, announce=False)
    else:  # last: what has it is done
        _finish(place, mark)


def attempt(
    scene: Scene, recordings: Sequence[Path | Recording], place: Path, options: Options
) -> str:
    """Diagnoses one robot into a folder; what is wrong in one line, or nothing."""
    if not recordings:
        return "no recordings"
    try:
        files = [r for r in recordings if not isinstance(r, Recording)]
        loaded = [r for r in recordings if isinstance(r, Recording)]
        loaded += load_recordings(files, options.mapping)
        diagnose(
            scene,
            loaded,
            window=options.window,
            residual=options.residual,
            backend=options.backend,
            settings=options.settings,
            out=place,
            progress=False,
        )
    except OrbiSimError as error:
        return str(error)
    except Exception as error:  # of one robot: the others must not suffer from it
        return f"a fault in OrbiSim: {type(error).__name__}: {error}"
    return ""


def _by_ray(
    scene: Scene, jobs: Sequence[tuple[Any, list[Path], Path, str, Options]], workers: int
) -> Iterator[None]:
    """As `work`, on a cluster that may share no file system with this machine."""
    tasks = []
    for _, recordings, place, mark, options in jobs:
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir(parents=True)
        try:
            loaded: list[Recording] | str = load_recordings(recordings, options.mapping)
        except OrbiSimError as error:
            loaded = str(error)
        tasks.append((loaded, place, mark, options))
    for place, mark, files, problem in spread(attempt, scene, tasks, workers):
        for name, content in files.items():
            (place / name).parent.mkdir(parents=True, exist_ok=True)
            (place / name).write_bytes(content)
        if problem:
            write_json(place / _FAILED, {"problem": problem}, announce=False)
        else:
            _finish(place, mark)
        yield None


def _mark(scene: Scene, recordings: Sequence[Path], options: Options) -> str:
    """Of all that a result depends on."""
    found = hashlib.sha256(f"{VERSION} {options}".encode())
    if options.mapping is not None:
        found.update(options.mapping.read_bytes())
    found.update(scene.spec.to_xml().encode())
    for path in recordings:
        for file in [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file()):
            found.update(os.fsencode(file.relative_to(path.parent)))
            found.update(file.read_bytes())
    return found.hexdigest()


def _finish(place: Path, mark: str) -> None:
    """Says that a robot is done, and by which report."""
    known = {"mark": mark, "report": _digest(place)}
    write_json(place / _INPUTS, known, announce=False)


def _is_done(place: Path, mark: str) -> bool:
    """Whether it is, and its report is still what was written."""
    try:
        return read_json(place / _INPUTS) == {"mark": mark, "report": _digest(place)}
    except (OSError, InputError):
        return False


def _digest(place: Path) -> str:
    return hashlib.sha256((place / "report.json").read_bytes()).hexdigest()


def _robot(name: str, place: Path) -> Robot:
    """A robot's result from its folder."""
    if (place / _INPUTS).is_file():
        return Robot(name, json.loads((place / "report.json").read_text()), "")
    failed = place / _FAILED
    known = json.loads(failed.read_text()) if failed.is_file() else {"problem": "not done"}
    return Robot(name, None, str(known["problem"]))
