"""USD: broken and hostile files end in one clear line, soon, and in no other way."""

from __future__ import annotations

import builtins
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from orbisim.errors import MissingDependencyError, OrbiSimError, SceneError
from orbisim.files.budget import Limits
from orbisim.scene import load_scene
from orbisim.scene.usd import process, read_usd
from orbisim.scene.usd.process import dump_stage
from tests.clock import Stopwatch
from tests.scene.usd.usd_text import DATA, body, stage, write

pytest.importorskip("pxr")

SECONDS = 5.0
DEPTH = 200_000


def refused(path: Path, match: str | None = None, limit: float = SECONDS) -> str:
    """The message with which a file is refused, after checking its form."""
    watch = Stopwatch()
    with pytest.raises(SceneError, match=match) as caught:
        load_scene(path)
    assert watch.seconds < limit
    message = str(caught.value)
    assert message.startswith(str(path)) and "\n" not in message
    return message


NOISE = np.random.default_rng(0).bytes(3000)


@pytest.mark.parametrize("suffix", ["usd", "usda", "usdc", "usdz"])
@pytest.mark.parametrize(
    "content", [NOISE, b"\0", b"#usda 1.0", b"PXR-USDC" + NOISE, b"PK\x03\x04" + NOISE, b"{}"]
)
def test_garbage_with_the_right_suffix(tmp_path: Path, suffix: str, content: bytes) -> None:
    path = tmp_path / f"scene.{suffix}"
    path.write_bytes(content)
    refused(path)


@pytest.fixture(scope="module")
def crate(tmp_path_factory) -> bytes:
    """A sound binary file."""
    path = tmp_path_factory.mktemp("crate") / "scene.usdc"
    program = (
        "import sys; from pxr import Sdf; Sdf.Layer.FindOrOpen(sys.argv[1]).Export(sys.argv[2])"
    )
    subprocess.run(
        [sys.executable, "-c", program, str(DATA / "mujoco.usda"), str(path)], check=True
    )
    return path.read_bytes()


@pytest.mark.parametrize("share", [0.02, 0.5, 0.99])
def test_truncated_crates(tmp_path: Path, crate: bytes, share: float) -> None:
    path = tmp_path / "scene.usdc"
    path.write_bytes(crate[: int(len(crate) * share)])
    refused(path)


def mutated(content: bytes, seed: int) -> bytes:
    """The content with a few bytes replaced, removed or repeated."""
    draw = np.random.default_rng(seed)
    changed = bytearray(content)
    for _ in range(draw.integers(1, 8)):
        where = int(draw.integers(len(changed)))
        kind = draw.integers(3)
        if kind == 0:
            changed[where] = int(draw.integers(256))
        elif kind == 1:
            del changed[where : where + int(draw.integers(1, 16))]
        else:
            changed[where:where] = changed[where : where + int(draw.integers(1, 64))]
    return bytes(changed)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("form", ["usda", "usdc"])
def test_mutated_files_load_or_are_refused(
    tmp_path: Path, crate: bytes, form: str, seed: int
) -> None:
    original = crate if form == "usdc" else (DATA / "mujoco.usda").read_bytes()
    path = tmp_path / f"scene.{form}"
    path.write_bytes(mutated(original, seed))
    watch = Stopwatch()
    try:
        scene = load_scene(path)
    except OrbiSimError as error:
        assert "\n" not in str(error)
    else:
        assert np.isfinite(scene.model.body_mass).all()
    assert watch.seconds < SECONDS


def test_deep_nesting(tmp_path: Path) -> None:
    nested = "".join(f'def "a{i}" {{\n' for i in range(DEPTH)) + "}\n" * DEPTH
    refused(write(tmp_path, "#usda 1.0\n" + nested), limit=SECONDS + 10)
    values = "#usda 1.0\n(\ncustomLayerData = {\n" + "dictionary a = {\n" * DEPTH + "}\n" * DEPTH
    refused(write(tmp_path, values + "}\n)\n"), limit=SECONDS + 10)


def test_references_that_multiply(tmp_path: Path) -> None:
    """Ten levels of ten references each would make ten thousand million prims."""
    for level in range(10):
        inner = "".join(
            f'def "r{i}" (prepend references = @./level{level + 1}.usda@)\n{{\n}}\n'
            for i in range(10)
        )
        text = f'#usda 1.0\n(\n    defaultPrim = "P"\n)\ndef Xform "P"\n{{\n{inner}}}\n'
        write(tmp_path, text, f"level{level}.usda")
    leaf = f'#usda 1.0\n(\n    defaultPrim = "P"\n)\ndef Xform "P"\n{{\n{body("B")}}}\n'
    write(tmp_path, leaf, "level10.usda")
    refused(tmp_path / "level0.usda", "took more than|needs more than", limit=SECONDS + 1)


def test_arrays_out_of_proportion_are_not_taken_over(tmp_path: Path, monkeypatch) -> None:
    """A mesh of a few megabytes from a file that may stand for less."""
    count = 20_000
    points = ", ".join(f"({i}, {i % 7}, {i % 11})" for i in range(count))
    mesh = f'def Mesh "M" {{\npoint3f[] points = [{points}]\nint[] faceVertexCounts = [3]\n'
    mesh += "int[] faceVertexIndices = [0, 1, 2]\n}\n"
    path = write(tmp_path, stage(body("B", mesh)))
    monkeypatch.setattr(process, "_MAX_DUMP", 1000)
    monkeypatch.setattr(process, "_PER_BYTE", 0)
    refused(path, "out of proportion")


def test_time_is_bounded() -> None:
    with pytest.raises(SceneError, match="took more than"):
        dump_stage(str(DATA / "car.usda"), Limits(seconds=0.01))


def test_memory_is_bounded(tmp_path: Path) -> None:
    """What 3.6 MB of input would allow on top, less 80 MB."""
    numbers = ", ".join(["(1, 2, 3)"] * 300_000)
    mesh = f'def Mesh "M" {{\npoint3f[] points = [{numbers}]\n}}\n'
    path = write(tmp_path, stage(body("B", mesh)))
    with pytest.raises(SceneError, match=r"needs more than|crashed"):
        dump_stage(str(path), Limits(seconds=20, memory=-80 * 2**20))


def test_other_problems_are_one_line_too(tmp_path: Path) -> None:
    refused(tmp_path / "gone.usda", "no such file")
    (tmp_path / "folder.usda").mkdir()
    with pytest.raises(SceneError, match="is a folder"):
        load_scene(tmp_path / "folder.usda")
    with pytest.raises(SceneError, match="no such file"):
        read_usd(str(tmp_path / "gone.usda"))


def test_openusd_stays_out_of_this_process() -> None:
    program = (
        "import sys\nfrom orbisim.scene import load_scene\n"
        "load_scene(sys.argv[1])\nassert 'pxr' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", program, str(DATA / "car.usda")], check=True)


def test_a_scene_folder_cannot_replace_python_modules(tmp_path: Path) -> None:
    """The process does not import from the folder it is started in."""
    for name in ("numpy", "json", "pxr", "resource"):
        write(tmp_path, "raise SystemExit('hijacked')", f"{name}.py")
    write(tmp_path, stage(body("B")))
    program = (
        "import sys; sys.path.pop(0)\nfrom orbisim.scene import load_scene\n"
        "assert load_scene('scene.usda').model.nbody == 2"
    )
    subprocess.run([sys.executable, "-P", "-c", "import sys\nsys.path.insert(0, '')\n" + program],
                   cwd=tmp_path, check=True)  # fmt: skip


def test_without_openusd(monkeypatch) -> None:
    """Importing the reader works; reading says what to install."""
    import importlib.util

    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util,
        "find_spec",
        lambda name, *rest: None if name == "pxr" else find(name, *rest),
    )
    assert builtins.__import__("orbisim.scene.usd")
    with pytest.raises(MissingDependencyError, match=r"pip install 'orbisim\[usd\]'"):
        load_scene(DATA / "car.usda")


def test_a_broken_interpreter_is_not_blamed_on_the_file(monkeypatch) -> None:
    monkeypatch.setattr(process, "_BOOT", "import sys; sys.exit('no OpenUSD here')")
    with pytest.raises(SceneError, match=r"gave up on it \(no OpenUSD here\)"):
        dump_stage(str(DATA / "car.usda"))
