"""Pages from templates."""

from __future__ import annotations

import jinja2
import pytest
from markupsafe import Markup

from orbisim.report.page import number, raw, render_page, si
from orbisim.version import VERSION

NONE = "\N{EN DASH}"


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.0021, "m", "2.1 mm"), (0.0, "s", "0 s"), (12345.0, "N", "12.3 kN"), (1.0, "", "1"),
        (-0.5, "rad", "-500 mrad"), (3e-7, "m", "300 nm"), (2e6, "Hz", "2 MHz"), (None, "m", NONE),
        (float("nan"), "m", NONE), (0.9999, "s", "1 s"), (4e-12, "m", "4e-12 m"),
        (2e-6, "s", "2 µs"),
    ],
)  # fmt: skip
def test_prefixes(value: float | None, unit: str, text: str) -> None:
    assert si(value, unit) == text


def test_numbers() -> None:
    assert [number(0.123456), number(None), number(12345.6, 6)] == ["0.123", NONE, "12345.6"]


@pytest.fixture
def template(monkeypatch: pytest.MonkeyPatch) -> None:
    loader = jinja2.DictLoader({"t.html": "{{ version }}|{{ text }}|{{ size | si('m') }}"})
    monkeypatch.setattr(jinja2, "PackageLoader", lambda package: loader)


@pytest.mark.usefixtures("template")
def test_strings_are_escaped_and_markup_is_not() -> None:
    page = render_page("t.html", text="<b>", size=0.01)
    assert page == f"{VERSION}|&lt;b&gt;|10 mm"
    assert "|<b>|" in render_page("t.html", text=raw("<b>"), size=0.01)
    assert isinstance(raw("<b>"), Markup)


@pytest.mark.usefixtures("template")
def test_what_is_missing_is_an_error() -> None:
    with pytest.raises(jinja2.UndefinedError, match="text"):
        render_page("t.html", size=1.0)
