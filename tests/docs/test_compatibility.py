"""docs/compatibility.md says what is installed by the lock and allowed by the project."""

from __future__ import annotations

import re
import tomllib

import pytest
import yaml

from orbisim.version import VERSION
from tests.test_layers import REPOSITORY

PAGE = (REPOSITORY / "docs" / "compatibility.md").read_text()
ROWS = re.findall(r"^\| ([\w.-]+) \| ([<>=][^|]+) \| ([\d.]+) \|", PAGE, re.M)
PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
LOCK = (REPOSITORY / "requirements" / "test.lock").read_text()


def plain(name: str) -> str:
    return name.replace("_", "-").lower()


def test_there_is_a_table() -> None:
    assert len(ROWS) >= 14


@pytest.mark.parametrize(("name", "allowed", "tried"), ROWS)
def test_versions(name: str, allowed: str, tried: str) -> None:
    locked = dict(line.split("==") for line in LOCK.splitlines() if "==" in line)
    assert {plain(k): v for k, v in locked.items()}[plain(name)] == tried
    extras = PROJECT["optional-dependencies"].values()
    groups = (PROJECT["dependencies"], *extras)
    wanted = {plain(one.partition(";")[0]) for group in groups for one in group}
    assert f"{plain(name)}{allowed.strip()}" in wanted


def test_the_citation_is_of_this_version() -> None:
    citation = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text())
    assert citation["version"] == VERSION
    assert citation["license"] == PROJECT["license"]
