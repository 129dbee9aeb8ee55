"""The page: meshcat's viewer, the scene and a caption in one HTML file that needs no network.

meshcat's own static export starts a server and leaves the order of the commands to the browser;
here they are packed once, compressed, and run in order.
"""

from __future__ import annotations

import base64
import dataclasses
import functools
import importlib.util
import json
import zlib
from collections.abc import Iterable, Sequence
from pathlib import Path

import jinja2

from orbisim.errors import MissingDependencyError
from orbisim.view.options import RGB, Theme
from orbisim.view.three import Json, packed


@dataclasses.dataclass(frozen=True)
class LegendEntry:
    """A line of the legend; `color` None stands for the scene's own colours."""

    label: str
    color: RGB | None = None

    @property
    def css(self) -> str:
        """The colour as CSS; grey for the scene's own."""
        red, green, blue = (round(255 * c) for c in self.color or (0.5, 0.5, 0.5))
        return f"rgb({red},{green},{blue})"


@dataclasses.dataclass(frozen=True)
class Caption:
    """What is written over the picture."""

    title: str
    legend: Sequence[LegendEntry] = ()
    notices: Sequence[str] = ()


def page(
    commands: Iterable[Json], caption: Caption, theme: Theme, *, live: Json | None = None
) -> str:
    """The page as HTML.

    Args:
      commands: meshcat's, and those that page.js adds to them.
      live: what the page offers to change (see `panel`), if it is to open a connection to its
        server.
    """
    payload = zlib.compress(b"".join(packed(command) for command in commands), 9)
    text: str = _template().render(
        caption=caption,
        dark=sum(theme.top) < 1.5,
        viewer=viewer_script(),
        script=(Path(__file__).parent / "page.js").read_text(encoding="utf-8"),
        commands=base64.b64encode(payload).decode("ascii"),
        config=json.dumps({"live": live is not None, "panel": live}).replace("</", "<\\/"),
    )
    return text


@functools.cache
def viewer_script() -> str:
    """meshcat's viewer (with three.js), as its package carries it."""
    found = importlib.util.find_spec("meshcat")
    if found is None or not found.submodule_search_locations:
        raise MissingDependencyError("the viewer", "view", "no module 'meshcat'")
    folder = Path(found.submodule_search_locations[0]) / "viewer" / "dist"
    return (folder / "main.min.js").read_text(encoding="utf-8").replace("</script", "<\\/script")


@functools.cache
def _template() -> jinja2.Template:
    source = (Path(__file__).parent / "page.html").read_text(encoding="utf-8")
    return jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined).from_string(source)
