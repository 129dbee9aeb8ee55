"""Runs dm_control's own tests twice: as they are, and with every `Physics` replaced by OrbiSim's.

    python tools/dm_control_tests.py --out out/dm_control [--only engine_test] [--folder DIR]

The test files are those of the installed dm_control (or of a source tree named by `--folder`);
nothing is fetched. Each is copied to a scratch folder twice, the second time with every
`module.Physics` in its source rewritten to OrbiSim's class, and with the classes that the library
itself looks up (the suite's domains, `mjcf.Physics` for composer) replaced likewise. A test that
passes with theirs has to pass with ours: exit status 1 if one does not.
"""

from __future__ import annotations

import argparse
import importlib.util
import io
import json
import os
import shutil
import subprocess
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

PACKAGES = ("mujoco", "rl", "suite", "mjcf", "composer", "utils", "entities", "locomotion")
HEADER = "from orbisim_replacement import ours as _ours"
CONFTEST = """\
import sys
from unittest import mock

import orbisim  # chooses a way to render without a display, for both sides
from absl import flags

sys.modules.setdefault("mock", mock)  # what the package of this name became
flags.FLAGS.mark_as_parsed()
"""
REPLACEMENT = '''\
"""OrbiSim's class for each `Physics` of dm_control."""

from dm_control import mjcf, mujoco, suite
from dm_control.mujoco import engine

import orbisim


def ours(cls):
    """The class that stands in for one of dm_control's; others are left alone."""
    if cls is engine.Physics:
        return orbisim.Physics
    return orbisim.hybrid(cls) if issubclass(cls, engine.Physics) else cls


mujoco.Physics = ours(mujoco.Physics)
mjcf.Physics = ours(mjcf.Physics)
for domain in suite._DOMAINS.values():
    domain.Physics = ours(domain.Physics)
'''


def main() -> int:
    """Writes `results.json` and a table; exit status 1 if a test passes with theirs only."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/dm_control"))
    parser.add_argument("--folder", type=Path, help="dm_control's sources; the installed ones")
    parser.add_argument("--only", default="", help="test files whose path contains this")
    parser.add_argument("--packages", default=",".join(PACKAGES))
    parser.add_argument("--timeout", type=int, default=300, help="seconds for one test")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    files = list(test_files(options.folder or installed(), options.packages.split(",")))
    chosen = [(root, file) for root, file in files if options.only in str(file)]
    rows = [row for root, file in chosen for row in compare(root, file, options)]
    (options.out / "results.json").write_text(json.dumps(rows, indent=1))
    table = markdown(rows)
    (options.out / "results.md").write_text(table)
    print(table)
    return int(not rows or any(row["theirs"] == "passed" != row["ours"] for row in rows))


def installed() -> Path:
    """The folder of the installed dm_control."""
    spec = importlib.util.find_spec("dm_control")
    if spec is None or not spec.submodule_search_locations:
        raise SystemExit("dm_control is not installed")
    return Path(next(iter(spec.submodule_search_locations)))


def test_files(root: Path, packages: list[str]) -> Iterator[tuple[Path, Path]]:
    """Root and relative path of each test file."""
    for package in packages:
        for path in sorted((root / package).rglob("*_test.py")):
            yield root, path.relative_to(root)


def compare(root: Path, file: Path, options: argparse.Namespace) -> list[dict[str, Any]]:
    """One row for each test of a file: what came of it with theirs and with ours."""
    outcomes = {}
    for side in ("theirs", "ours"):
        scratch = (options.out / side / file).with_suffix("").resolve()
        folder = prepare(root, file, scratch, replaced=side == "ours")
        outcomes[side] = run(folder, file.name, options.timeout)
    rows = [
        {
            "file": str(file),
            "test": test,
            "theirs": outcome,
            "ours": outcomes["ours"].get(test, "missing"),
        }
        for test, outcome in outcomes["theirs"].items()
    ]
    passed = [sum(row[side] == "passed" for row in rows) for side in ("theirs", "ours")]
    print(
        f"{file}: {len(rows)} tests, {passed[0]} pass with theirs, {passed[1]} with ours",
        file=sys.stderr,
        flush=True,
    )
    return rows


def prepare(root: Path, file: Path, scratch: Path, *, replaced: bool) -> Path:
    """The folder of the test file among its package's data, with the replacement if asked for."""
    shutil.rmtree(scratch, ignore_errors=True)
    package = root / file.parts[0]
    for data in (entry for entry in package.rglob("*") if entry.is_file()):
        if data.suffix not in (".py", ".pyc"):
            link = scratch / data.relative_to(root)
            link.parent.mkdir(parents=True, exist_ok=True)
            link.symlink_to(data)
    folder = (scratch / file).parent
    folder.mkdir(parents=True, exist_ok=True)
    source = (root / file).read_text()
    (folder / file.name).write_text(rewritten(source) if replaced else source)
    (folder / "conftest.py").write_text(CONFTEST + ("import orbisim_replacement\n" * replaced))
    if replaced:
        (folder / "orbisim_replacement.py").write_text(REPLACEMENT)
    return folder


def rewritten(source: str) -> str:
    """The source with each `module.Physics` in its code wrapped into `_ours(...)`."""
    tokens = list(tokenize.generate_tokens(io.StringIO(source).readline))
    lines = source.splitlines(keepends=True)
    ends = [
        (first.start, last.end)
        for first, dot, last in zip(tokens, tokens[1:], tokens[2:], strict=False)
        if first.type == tokenize.NAME and dot.string == "." and last.string == "Physics"
    ]
    for (row, start), (_, end) in reversed(ends):
        line = lines[row - 1]
        lines[row - 1] = f"{line[:start]}_ours({line[start:end]}){line[end:]}"
    first_import = next(i for i, line in enumerate(lines) if line.startswith(("import ", "from ")))
    return "".join([*lines[:first_import], HEADER + "\n", *lines[first_import:]])


def run(scratch: Path, name: str, timeout: int) -> dict[str, str]:
    """Outcome of each test of a file, by name."""
    report = scratch / "report.xml"
    command = [
        sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:randomly",
        f"--timeout={timeout}", "--timeout-method=signal", "--rootdir", str(scratch),
        "-c", os.devnull, f"--junitxml={report}", name,
    ]  # fmt: skip
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    try:
        ended = subprocess.run(
            command,
            cwd=scratch,
            env=environment,
            timeout=60 * timeout,
            capture_output=True,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return {"(the file)": f"longer than {60 * timeout} s"}
    (scratch / "output.txt").write_bytes(ended.stdout + ended.stderr)
    if not report.exists():
        return {"(the file)": "no report"}
    return dict(_outcome(case) for case in ElementTree.parse(report).iter("testcase"))


def _outcome(case: ElementTree.Element) -> tuple[str, str]:
    name = f"{case.get('classname', '').rpartition('.')[2]}.{case.get('name')}"
    kinds = {child.tag for child in case}
    for kind in ("failure", "error", "skipped"):
        if kind in kinds:
            return name, {"failure": "failed", "error": "error", "skipped": "skipped"}[kind]
    return name, "passed"


def markdown(rows: list[dict[str, Any]]) -> str:
    """Counts for each package, and every test that passes with theirs only."""
    lines = [
        "| package | tests | pass with dm_control's | pass with OrbiSim's |",
        "| --- | --- | --- | --- |",
    ]
    packages = dict.fromkeys(Path(row["file"]).parts[0] for row in rows)
    for package in [*packages, "all"]:
        mine = [row for row in rows if package in ("all", Path(row["file"]).parts[0])]
        counts = [sum(row[side] == "passed" for row in mine) for side in ("theirs", "ours")]
        lines.append(f"| {package} | {len(mine)} | {counts[0]} | {counts[1]} |")
    lines += [
        f"- {row['file']}, {row['test']}: {row['ours']} with OrbiSim's"
        for row in rows
        if row["theirs"] == "passed" != row["ours"]
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
