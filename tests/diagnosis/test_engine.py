"""What the engine may know of effects, and the constants by which it accepts and rejects."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import re
from pathlib import Path

import pytest

import orbisim
from orbisim.diagnosis import Settings
from orbisim.effects import effect_names

ROOT = Path(orbisim.__file__).parent
ENGINE = sorted(
    path
    for part in ("diagnosis", "learned_rest", "motion", "sensing", "shooting")
    for path in (ROOT / part).rglob("*.py")
)
ELEMENTS = {("retune.py", "armature")}
"""Attributes of MJCF that effects are named after, too."""
TABLE = ROOT.parent / "docs" / "diagnosis.md"


@pytest.mark.parametrize("path", ENGINE, ids=lambda path: f"{path.parent.name}.{path.stem}")
def test_no_effect_is_named(path: Path) -> None:
    """What an effect means stands in its class alone, so that one of a package is sought as one of
    the catalogue."""
    names = {
        node.value
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }
    found = {(path.name, name) for name in names & set(effect_names())}
    assert not found - ELEMENTS


def _listed(title: str) -> list[tuple[str, str, str]]:
    """Constant, its value as the table below a title has it, and the module."""
    text = TABLE.read_text().partition(f"## {title}")[2].partition("\n## ")[0]
    found = []
    for names, values, modules in re.findall(r"^\| (`[^|]+) \| ([^|]+) \| ([^|]+) \|", text, re.M):
        every, where = re.findall(r"`([^`]+)`", names), re.findall(r"`([^`]+)`", modules)
        assert len(every) == len(values.split(", ")), f"one value for each of {names}"
        where = where * len(every) if len(where) == 1 else where
        found += list(zip(every, values.split(", "), where, strict=True))
    return found


DECIDE = _listed("What accepts and rejects")
MOST = 25
"""Constants that accept or reject: more than a reader keeps in mind."""


def test_few_constants_accept_or_reject() -> None:
    assert 0 < len(DECIDE) <= MOST


@pytest.mark.parametrize(("name", "value", "module"), [*DECIDE, *_listed("What bounds the effort")])
def test_constants_are_those_of_the_table(name: str, value: str, module: str) -> None:
    if module == "settings":
        defaults = {field.name: field.default for field in dataclasses.fields(Settings)}
        own = defaults[name]
    else:
        part = module.partition(".")[0]
        elsewhere = part != module or (ROOT / f"{part}.py").is_file()
        package = "orbisim" if elsewhere else "orbisim.diagnosis"
        own = getattr(importlib.import_module(f"{package}.{module}"), name)
    number = float(value.removesuffix(" %")) / (100 if value.endswith("%") else 1)
    assert own == pytest.approx(number)
