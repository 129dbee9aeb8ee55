"""dm_control's own tests with `Physics` replaced: the tool, and a sample of them."""

from __future__ import annotations

import argparse
import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

TOOL = Path(__file__).parents[2] / "tools" / "dm_control_tests.py"


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    spec = importlib.util.spec_from_file_location("dm_control_tests", TOOL)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_only_code_is_rewritten(tool: ModuleType) -> None:
    source = '''"""Tests of engine.Physics."""
import os
from dm_control.mujoco import engine

class Test:
  def test(self):  # engine.Physics
    self.physics = engine.Physics.from_xml_string(MODEL, engine.Physics)
    self.text = "engine.Physics"
    return engine.PhysicsError, self.Physics
'''
    found = tool.rewritten(source)
    assert found.count("_ours(engine.Physics)") == 2
    assert "_ours(self.Physics)" in found
    assert 'self.text = "engine.Physics"' in found
    assert found.splitlines()[1] == tool.HEADER
    compile(found, "test.py", "exec")


def test_every_test_file_of_the_packages_is_found(tool: ModuleType) -> None:
    files = {str(file) for _, file in tool.test_files(tool.installed(), list(tool.PACKAGES))}
    assert {"mujoco/engine_test.py", "mjcf/physics_test.py", "rl/control_test.py"} <= files
    assert len(files) > 50


@pytest.mark.parametrize(
    "file",
    ["suite/lqr_test.py", pytest.param("mujoco/thread_safety_test.py", marks=pytest.mark.slow)],
)
def test_a_sample_passes_with_ours(tool: ModuleType, file: str, tmp_path: Path) -> None:
    options = argparse.Namespace(out=tmp_path, timeout=60)
    rows = tool.compare(tool.installed(), Path(file), options)
    assert len(rows) >= 2
    assert {(row["theirs"], row["ours"]) for row in rows} == {("passed", "passed")}
    assert sys.modules.get("orbisim_replacement") is None  # it ran elsewhere


@pytest.mark.slow
def test_a_replacement_that_fails_is_noticed(tool: ModuleType, tmp_path: Path) -> None:
    """A tool that compares nothing would pass."""
    root = tmp_path / "dm_control"
    (root / "mujoco").mkdir(parents=True)
    (root / "mujoco" / "some_test.py").write_text(
        "import unittest\nfrom dm_control import mujoco\n\n"
        "class Test(unittest.TestCase):\n"
        "  def test_module(self):\n"
        "    self.assertIn('dm_control', mujoco.Physics.__module__)\n"
        "  def test_other(self):\n    pass\n"
    )
    options = argparse.Namespace(out=tmp_path / "out", timeout=60)
    rows = tool.compare(root, Path("mujoco/some_test.py"), options)
    assert {row["test"]: (row["theirs"], row["ours"]) for row in rows} == {
        "Test.test_module": ("passed", "failed"),
        "Test.test_other": ("passed", "passed"),
    }
