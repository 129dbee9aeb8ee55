"""Plug-ins are found by group and name; what is missing is named."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import metadata

import pytest

from orbisim import plugins
from orbisim.errors import MissingDependencyError, UnknownNameError

GROUP = "orbisim.test_group"
ENTRIES = {
    "sound": "fractions:Fraction",
    "learned": "no_such_package:Backend",
    "other": "no_such_package.deep:Thing",
    "halfway": "fractions:NoSuchName",
}


@pytest.fixture(autouse=True)
def installed(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A package that offers a few plug-ins is installed."""
    entries = [metadata.EntryPoint(name, value, GROUP) for name, value in ENTRIES.items()]
    monkeypatch.setattr(metadata, "entry_points", lambda group: entries if group == GROUP else [])
    plugins._entry_points.cache_clear()
    yield
    plugins._entry_points.cache_clear()


def test_names_need_no_import() -> None:
    assert plugins.names(GROUP) == tuple(ENTRIES)
    assert plugins.names("orbisim.no_such_group") == ()


def test_a_plugin_is_what_its_entry_point_names() -> None:
    from fractions import Fraction

    assert plugins.load(GROUP, "sound", "fruit") is Fraction


def test_unknown_names_are_said_with_what_there_is() -> None:
    with pytest.raises(UnknownNameError, match="unknown fruit 'sond'; did you mean 'sound'"):
        plugins.load(GROUP, "sond", "fruit")


@pytest.mark.parametrize(("name", "extra"), [("learned", "learned"), ("other", "all")])
def test_a_missing_package_is_named_with_the_extra_that_has_it(name: str, extra: str) -> None:
    with pytest.raises(MissingDependencyError, match="no module 'no_such_package'") as caught:
        plugins.load(GROUP, name, "fruit")
    assert caught.value.extra == extra
    assert isinstance(caught.value.__cause__, ImportError)


def test_an_entry_point_that_names_nothing_is_not_taken_for_a_missing_package() -> None:
    with pytest.raises(AttributeError, match="NoSuchName"):
        plugins.load(GROUP, "halfway", "fruit")
