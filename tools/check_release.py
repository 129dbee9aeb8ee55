"""Builds what is released, installs it into empty environments, and tries it there.

    python tools/check_release.py --out out/release                 # every Python and extra found
    python tools/check_release.py --python 3.12 --extra core --extra warp
    python tools/check_release.py --hashes                          # what docs/zoo.md lists

Wheel and sdist are built from the files that git tracks, the wheel once more from the sdist; both
must hold the same files. Then each Python gets an environment of its own for each extra: nothing in
it but the wheel, the extra and what they require, a home of its own, an empty working folder
(--together: one environment for all extras). There
run `orbisim doctor`, `sim`, `compare` and `diagnose`, and what the extra is there for. One line
each; the exit status is 1 if one of them fails.
"""

from __future__ import annotations

import argparse
import configparser
import dataclasses
import hashlib
import itertools
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
import tomllib
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PYTHONS = ("3.11", "3.12", "3.13")
CORE = "core"
"""Name of the environment without extras."""
LIMIT_MB = 100.0
"""What package indexes accept as one file by default."""
WEIGHTS = ".safetensors"
PACKAGED = re.compile(r"(orbisim|backends/orbisim_\w+|mjcf_assets)/")
"""Of the names of tracked files: what is installed."""
NO_DEPENDENCIES = {"3.13": ("dm-control>=1.0.50,<2",)}
"""What is installed beside the wheel without what it requires (docs/compatibility.md)."""


@dataclasses.dataclass(frozen=True)
class Row:
    """What came of one environment.

    Attributes:
      python, extra: of the environment.
      installed_s: time of `pip install`. size_mb: of the environment.
      steps: name of each trial and what went wrong with it, empty where nothing did.
    """

    python: str
    extra: str
    installed_s: float
    size_mb: float
    steps: dict[str, str]


def build(out: Path) -> tuple[Path, Path]:
    """Wheel and sdist of the files that git tracks, in `out`."""
    out.mkdir(parents=True, exist_ok=True)
    for old in (*out.glob("*.whl"), *out.glob("*.tar.gz")):
        old.unlink()
    with tempfile.TemporaryDirectory() as folder:
        tree, again = Path(folder, "tree"), Path(folder, "again")
        copy_tracked(tree)
        sdist = build_one(tree, "build_sdist", out)
        with tarfile.open(sdist) as archive:
            archive.extractall(again, filter="data")
        (unpacked,) = again.iterdir()
        wheel = build_one(tree, "build_wheel", out)
        other = build_one(unpacked, "build_wheel", again)
        if (a := contents(wheel)) != (b := contents(other)):
            differ = sorted(name for name in {*a, *b} if a.get(name) != b.get(name))
            raise SystemExit(f"error: the sdist builds another wheel: {', '.join(differ[:5])}")
    return wheel, sdist


def copy_tracked(tree: Path) -> None:
    """Nothing that lies about may get into a build."""
    for name in tracked():
        target = tree / name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, target)


def tracked() -> list[str]:
    """Files that git tracks and that are there."""
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True, text=True
    )
    return [name for name in listed.stdout.split("\0") if name and (ROOT / name).is_file()]


def build_one(tree: Path, hook: str, out: Path) -> Path:
    """The file that the build backend writes into `out`; `hook` as PEP 517 has it."""
    code = f"from setuptools import build_meta as b; print(b.{hook}({str(out.resolve())!r}))"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tree, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise SystemExit(f"error: {hook}: {done.stderr.strip()[-2000:]}")
    return out / done.stdout.strip().splitlines()[-1]


def contents(wheel: Path) -> dict[str, str]:
    """SHA-256 of each file of a wheel; of RECORD, which lists them, nothing."""
    with zipfile.ZipFile(wheel) as archive:
        return {
            name: hashlib.sha256(archive.read(name)).hexdigest()
            for name in archive.namelist()
            if not name.endswith("/RECORD")
        }


def faults(held: Mapping[str, str], entry_points: str, size_mb: float) -> list[str]:
    """What is wrong with what a wheel holds.

    Args:
      held: SHA-256 of each file. entry_points: text of `entry_points.txt`.
    """
    found = []
    if size_mb > LIMIT_MB:
        found.append(f"{size_mb:.0f} MB are more than {LIMIT_MB:g}")
    wanted = {name.removeprefix("backends/") for name in tracked() if PACKAGED.match(name)}
    found += [f"{name}: is missing" for name in sorted(wanted - set(held))]
    strange = {name for name in held if ".dist-info/" not in name} - wanted
    found += [f"{name}: does not belong into a wheel" for name in sorted(strange)]
    if not any(name.endswith(".dist-info/licenses/LICENSE") for name in held):
        found.append("LICENSE: is missing")
    entries = configparser.ConfigParser(delimiters=("=",))
    entries.optionxform = str  # type: ignore[assignment,method-assign]
    entries.read_string(entry_points)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    for group, plugins in {
        **project["entry-points"],
        "console_scripts": project["scripts"],
    }.items():
        for name, target in plugins.items():
            if entries.get(group, name, fallback=None) != target:
                found.append(f"entry point {name} of {group}: is not {target}")
            module = target.partition(":")[0].replace(".", "/")
            if not {f"{module}.py", f"{module}/__init__.py"} & set(held):
                found.append(f"entry point {name} of {group}: there is no module of {target}")
    listed = dict(listed_hashes())
    for name, digest in held.items():
        if name.endswith(WEIGHTS) and listed.pop(name, None) != digest:
            found.append(f"{name}: docs/zoo.md lists another SHA-256, or none (--hashes)")
    return [*found, *(f"{name}: docs/zoo.md lists it, the wheel lacks it" for name in listed)]


def faults_of(wheel: Path) -> list[str]:
    """What is wrong with a wheel."""
    with zipfile.ZipFile(wheel) as archive:
        (place,) = (name for name in archive.namelist() if name.endswith("/entry_points.txt"))
        entry_points = archive.read(place).decode()
    return faults(contents(wheel), entry_points, wheel.stat().st_size / 1e6)


def listed_hashes() -> Iterator[tuple[str, str]]:
    """Names and SHA-256 of weights that docs/zoo.md lists."""
    for digest, name in re.findall(
        r"^([0-9a-f]{64})  (\S+)$", (ROOT / "docs" / "zoo.md").read_text(), re.M
    ):
        yield name, digest


def hashes() -> Iterator[str]:
    """The lines that docs/zoo.md lists, as `sha256sum` writes them."""
    for name in sorted(tracked()):
        if name.endswith(WEIGHTS):
            digest = hashlib.sha256((ROOT / name).read_bytes()).hexdigest()
            yield f"{digest}  {name.removeprefix('backends/')}"


def interpreters(wanted: Sequence[str]) -> dict[str, str | None]:
    """The path of each Python; None where this machine has none."""
    found: dict[str, str | None] = {}
    for version in wanted:
        homes = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"), "versions")
        places = [f"python{version}"]
        places += [str(path / "bin" / "python") for path in homes.glob(f"{version}.*")]
        found[version] = next((place for place in places if _is(place, version)), None)
    return found


def _is(place: str, version: str) -> bool:
    code = "import sys, venv; print('.'.join(map(str, sys.version_info[:2])))"
    try:
        done = subprocess.run([place, "-c", code], capture_output=True, text=True, check=False)
    except OSError:
        return False
    return done.returncode == 0 and done.stdout.strip() == version


_TRIALS = {
    "doctor": "{orbisim} doctor --json",
    "sim": "{orbisim} sim suite:cartpole-swingup --duration 0.2 --out sim",
    "compare": "{orbisim} compare suite:cartpole-swingup --a mujoco --b mujoco --episodes 2"
    " --horizon 0.2 --out compare",
    "diagnose": "{orbisim} diagnose {arm}/scene.xml {arm}/example/run1.npz {arm}/example/run2.npz"
    " --out diagnosis",
}
"""What is tried in every environment."""

_URDF = """<robot name="a"><link name="l"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""
_USD = '#usda 1.0\n(\n    upAxis = "Z"\n)\ndef Sphere "b"\n(\n    prepend apiSchemas ='
_USD += ' ["PhysicsRigidBodyAPI", "PhysicsCollisionAPI"]\n)\n{\n}\n'
_LOG = "import h5py, numpy; h = h5py.File('log.h5', 'w'); h['time'] = numpy.arange(9) / 9; "
_LOG += "h['qpos/a'] = numpy.zeros(9); h.close()"
_GYM = "import orbisim; e = orbisim.vector.gym('cartpole', 'swingup', nworld=2); e.reset(); "
_GYM += "print(e.step(e.action_space.sample())[1].shape)"
_SB3 = "from orbisim import vector; from stable_baselines3 import PPO; "
_SB3 += "k = {'flat_observation': True}; w = vector.load('cartpole', 'swingup', nworld=2, "
_SB3 += "environment_kwargs=k); e = vector.StableBaselinesVecEnv(w); "
_SB3 += "PPO('MlpPolicy', e, n_steps=8, batch_size=8, device='cpu').learn(16)"
_DIFFUSION = "{orbisim} sim task:push --duration 0.2 --renderer diffusion --out video"

_EXTRAS: dict[str, str] = {
    CORE: "{orbisim} sim suite:cheetah-run --duration 0.1 --renderer mujoco --out video",
    "warp": "{orbisim} sim suite:cartpole-swingup --backend warp --duration 0.1 --out warp",
    "urdf": f"echo {_URDF!r} > a.urdf && {{orbisim}} info a.urdf",
    "usd": f"printf {_USD!r} > a.usda && {{orbisim}} info a.usda",
    "view": "{orbisim} view suite:cartpole-swingup --duration 0.1 --html view.html",
    "learned": "{orbisim} sim suite:cartpole-swingup --backend learned --duration 0.1 --out l",
    "vision": _DIFFUSION,
    "ray": "{orbisim} collect suite:cartpole-swingup --episodes 2 --ray --out episodes.h5",
    "gym": f'{{python}} -c "{_GYM}"',
    "sb3": f'{{python}} -c "{_SB3}"',
    "logs": f'{{python}} -c "{_LOG}" && {{orbisim}} recording info log.h5',
    "all": _DIFFUSION,
}
"""What each extra is there for."""

_WORKING = {
    "warp": {("backend", "warp")},
    "urdf": {("reader", ".urdf")},
    "usd": {("reader", ".usd"), ("reader", ".usda"), ("reader", ".usdz")},
    "learned": {("backend", "learned"), ("renderer", "diffusion")},  # of hybrid no checkpoint ships
    "logs": {("log", "bag"), ("log", "mcap"), ("log", "h5")},
}
_WORKING["all"] = set().union(*_WORKING.values())
_WORKING[CORE] = {("backend", "mujoco"), ("renderer", "mujoco"), ("log", "csv")}
"""What `orbisim doctor` must find to work with each extra; nothing may fail with any."""


def attempts(
    python: str, version: str, extras: Sequence[str], wheel: Path, pip: Sequence[str]
) -> Iterator[Row]:
    """Makes an environment, installs the extras into it one after the other, and tries each."""
    with tempfile.TemporaryDirectory(prefix="release-") as environment:
        for extra in extras:
            yield attempt(python, version, extra, wheel, pip, Path(environment))


def attempt(
    python: str, version: str, extra: str, wheel: Path, pip: Sequence[str], place: Path
) -> Row:
    """Installs an extra into the environment in `place`, which is made if it is not there, and
    tries it."""
    with tempfile.TemporaryDirectory(prefix="release-") as folder:
        home, work = Path(folder, "home"), Path(folder, "work")
        home.mkdir(), work.mkdir()
        environment = {
            name: value
            for name, value in os.environ.items()
            if name not in ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV", "MUJOCO_GL")
        }
        environment |= {"HOME": str(home), "PYTHONNOUSERSITE": "1"}
        if cache := os.environ.get("PIP_CACHE_DIR"):
            environment["PIP_CACHE_DIR"] = cache

        def run(command: str) -> tuple[str, str]:
            """What it prints, and what went wrong."""
            done = subprocess.run(
                command, shell=True, cwd=work, env=environment, capture_output=True, text=True
            )
            last = (done.stderr.strip() or done.stdout.strip() or "nothing said").splitlines()[-1]
            return done.stdout, f"exit status {done.returncode}: {last}" if done.returncode else ""

        venv = place / "venv"
        steps, started = {}, time.monotonic()
        wrong = "" if venv.exists() else run(f"{python} -m venv {venv}")[1]
        install = f"{venv}/bin/python -m pip install -q {' '.join(pip)}"
        what = str(wheel.resolve()) + ("" if extra == CORE else f"[{extra}]")
        for alone in NO_DEPENDENCIES.get(version, ()):
            wrong = wrong or run(f"{install} --no-deps '{alone}'")[1]
        wrong = wrong or run(f"{install} '{what}'")[1]
        took = time.monotonic() - started
        steps["install"] = wrong
        if not wrong:
            arm = run(f"{venv}/bin/python -c 'import mjcf_assets as m; print(m.__path__[0])'")[0]
            places = {
                "orbisim": str(venv / "bin" / "orbisim"),
                "python": str(venv / "bin" / "python"),
                "arm": f"{arm.strip()}/arm2",
            }
            for name, command in (_TRIALS | {"extra": _EXTRAS[extra]}).items():
                for key, value in places.items():
                    command = command.replace(f"{{{key}}}", value)
                said, steps[name] = run(command)
                if name == "doctor":
                    steps[name] = _heard(said, extra) or steps[name]
                elif name == "diagnose" and not steps[name]:
                    report = json.loads((work / "diagnosis" / "report.json").read_text())
                    named = [one["effect"] for one in report["effects"]]
                    if named != ["coulomb_friction"]:
                        steps[name] = f"found {named}"
        size = sum(path.lstat().st_size for path in venv.rglob("*") if path.is_file()) / 1e6
    return Row(version, extra, took, size, steps)


def _heard(said: str, extra: str) -> str:
    """What `orbisim doctor --json` found that should not be."""
    try:
        checks = json.loads(said)["checks"]
    except (ValueError, KeyError):
        return ""
    failed = [f"{c['kind']} {c['name']}: {c['text']}" for c in checks if c["status"] == "failed"]
    working = {(c["kind"], c["name"]) for c in checks if c["status"] == "ok"}
    lacking = _WORKING[CORE] | _WORKING.get(extra, set())
    failed += [f"{kind} {name} is absent" for kind, name in sorted(lacking - working)]
    return "; ".join(failed)


def extras() -> list[str]:
    """Every extra that users are offered: not those of developers."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    return [CORE, *(name for name in project["optional-dependencies"] if name in _EXTRAS)]


def main() -> int:
    """Builds, checks, installs, tries."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "release")
    parser.add_argument("--python", action="append", help="3.11, 3.12 or 3.13; several times")
    parser.add_argument("--extra", action="append", help="several times; default: all of them")
    parser.add_argument("--pip", action="append", default=[], help="an option for pip install")
    parser.add_argument(
        "--together",
        action="store_true",
        help="each Python's extras one after the other into one environment: where they share "
        "something large, as PyTorch for CUDA is",
    )
    parser.add_argument("--build-only", action="store_true", help="nothing is installed")
    parser.add_argument("--hashes", action="store_true", help="prints what docs/zoo.md lists")
    options = parser.parse_args()
    if options.hashes:
        print("\n".join(hashes()))
        return 0
    wheel, sdist = build(options.out)
    wrong = faults_of(wheel)
    print(f"{wheel.name}: {wheel.stat().st_size / 1e6:.1f} MB, {len(contents(wheel))} files")
    print(f"{sdist.name}: {sdist.stat().st_size / 1e6:.1f} MB")
    for fault in wrong:
        print(f"error: {fault}")
    if options.build_only:
        return 1 if wrong else 0
    results = options.out / "rows.jsonl"
    results.unlink(missing_ok=True)
    for version, python in interpreters(options.python or PYTHONS).items():
        if python is None:
            print(f"| {version} | | | | no such Python on this machine |")
            continue
        chosen = options.extra or extras()
        for row in itertools.chain.from_iterable(
            attempts(python, version, group, wheel, options.pip)
            for group in ([chosen] if options.together else [[extra] for extra in chosen])
        ):
            with results.open("a") as file:
                file.write(json.dumps(dataclasses.asdict(row)) + "\n")
            bad = [f"{name}: {text}" for name, text in row.steps.items() if text]
            wrong += bad
            print(
                f"| {version} | {row.extra} | {row.installed_s:.0f} s | {row.size_mb:.0f} MB | "
                f"{'; '.join(bad) or ', '.join(row.steps)} |",
                flush=True,
            )
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
