"""Names of a package that are imported when they are first used."""

from __future__ import annotations

import sys
import types
from collections.abc import Iterator

import pytest

from orbisim.host.lazy import lazy


@pytest.fixture
def package() -> Iterator[types.ModuleType]:
    """A package whose `Fraction` lives in `fractions`, and whose module `tool` may be named."""
    package, tool = types.ModuleType("lazy_package"), types.ModuleType("lazy_package.tool")
    package.__path__ = []
    package.__getattr__, package.__dir__ = lazy(
        "lazy_package", {"Fraction": "fractions", "lost": "lazy_package.missing"}, ("tool",)
    )
    sys.modules |= {"lazy_package": package, "lazy_package.tool": tool}
    yield package
    del sys.modules["lazy_package"], sys.modules["lazy_package.tool"]


def test_names_are_found_where_they_are_defined_and_kept(package: types.ModuleType) -> None:
    import fractions

    assert "Fraction" not in vars(package)
    assert package.Fraction is fractions.Fraction
    assert vars(package)["Fraction"] is fractions.Fraction


def test_modules_can_be_named_without_an_import(package: types.ModuleType) -> None:
    assert package.tool is sys.modules["lazy_package.tool"]


def test_what_there_is_is_listed_before_it_is_used(package: types.ModuleType) -> None:
    assert {"Fraction", "lost", "tool"} <= set(dir(package))


def test_unknown_names_are_attribute_errors(package: types.ModuleType) -> None:
    with pytest.raises(AttributeError, match="'lazy_package' has no attribute 'absent'"):
        package.absent  # noqa: B018
    assert not hasattr(package, "absent")


def test_a_home_that_is_gone_is_not_taken_for_an_unknown_name(package: types.ModuleType) -> None:
    with pytest.raises(ModuleNotFoundError, match=r"lazy_package\.missing"):
        package.lost  # noqa: B018
