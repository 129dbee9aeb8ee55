"""Renders a report page from a template."""

from __future__ import annotations

import datetime
from typing import Any

import jinja2
from markupsafe import Markup

from orbisim.version import VERSION

_NONE = "\N{EN DASH}"


def render_page(template: str, **context: Any) -> str:
    """Fills a template of this package; strings are escaped unless they are `Markup`."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("orbisim.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["si"] = si
    environment.filters["number"] = number
    now = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC")
    return environment.get_template(template).render(version=VERSION, made=now, **context)


def number(value: float | None, digits: int = 3) -> str:
    """A number as a person writes it; a dash for none."""
    if value is None or value != value:
        return _NONE
    return f"{value:.{digits}g}"


def si(value: float | None, unit: str = "") -> str:
    """A number with an SI prefix: `si(0.0021, 'm')` is `2.1 mm`."""
    if value is None or value != value:
        return _NONE
    if value == 0:
        return f"0 {unit}".rstrip()
    for scale, prefix in ((1e6, "M"), (1e3, "k"), (1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n")):
        if abs(value) >= scale * 0.9995:
            return f"{value / scale:.3g} {prefix}{unit}".rstrip()
    return f"{value:.2g} {unit}".rstrip()


def raw(text: str) -> Markup:
    """Marks text as HTML that this package made itself."""
    return Markup(text)
