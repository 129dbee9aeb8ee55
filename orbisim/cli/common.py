"""Options and output that the commands share."""

from __future__ import annotations

import contextlib
import functools
import json
import logging
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

import click

from orbisim.errors import InputError
from orbisim.files.writing import check_folder

F = TypeVar("F", bound=Callable[..., Any])


def json_option(function: F) -> F:
    """Adds --json."""
    return click.option(
        "--json", "as_json", is_flag=True, help="Print one JSON object and nothing else."
    )(function)


def seed_option(function: F) -> F:
    """Adds --seed."""
    return click.option(
        "--seed",
        type=click.IntRange(min=0),
        default=0,
        show_default=True,
        help="Of all random numbers.",
    )(function)


def trusted_option(function: F) -> F:
    """Adds --trusted."""
    return click.option(
        "--trusted",
        is_flag=True,
        help="Read the scene without bounds on time and memory.",
    )(function)


def scene_options(argument: str = "scene") -> Callable[[F], F]:
    """Adds --actuators, --floating-base and --package; the command gets them in the scene's name.

    Args:
      argument: of the command, that names the scene.
    """

    def decorate(function: F) -> F:
        @functools.wraps(function)
        def wrapped(*args: Any, **kwargs: Any) -> Any:
            from orbisim.scene.query import with_options, without_options

            options: dict[str, Any] = {}
            if (kind := kwargs.pop("actuators")) is not None:
                options |= {"actuators": kind, "actuate": "all"}
            if kwargs.pop("floating_base"):
                options["floating_base"] = True
            if pairs := kwargs.pop("packages"):
                options["package_paths"] = dict(map(_package, pairs))
            scene = kwargs[argument]
            if options:
                path, given = without_options(scene or "")
                if Path(path).suffix.lower() not in (".urdf", ".zip"):
                    raise InputError(
                        f"--actuators, --floating-base and --package are for URDF; got {scene}"
                    )
                kwargs[argument] = with_options(path, {**given, **options})
            return function(*args, **kwargs)

        for option in reversed(_SCENE_OPTIONS):
            wrapped = option(wrapped)
        return wrapped  # type: ignore[return-value]

    return decorate


_SCENE_OPTIONS = (
    click.option(
        "--actuators",
        type=click.Choice(["motor", "position", "velocity"]),
        default=None,
        help="Of URDF: an actuator at every joint that moves and mimics none. Default: none.",
    ),
    click.option(
        "--floating-base", is_flag=True, help="Of URDF: the root link is not fixed to the world."
    ),
    click.option(
        "--package",
        "packages",
        multiple=True,
        metavar="NAME=DIR",
        help="Of URDF: where package://NAME leads; repeatable.",
    ),
)


def _package(text: str) -> tuple[str, str]:
    name, equals, folder = text.partition("=")
    if not (name and equals and Path(folder).is_dir()):
        raise InputError(f"--package is NAME=DIR, of a folder that is there; got {text!r}")
    return name, str(Path(folder).resolve())


def warn_undriven(nu: int, scene: str, so: str = "controls do nothing") -> None:
    """Says what follows in a scene without actuators."""
    if not nu:
        urdf = Path(scene.partition("?")[0]).suffix.lower() == ".urdf"
        note(
            f"warning: the scene has no actuators, so {so}"
            + ("; --actuators position adds them" if urdf else "")
        )


def torch_device(name: str | None) -> str:
    """A device of torch by its name; the GPU if there is one where none is named.

    Raises:
      InputError: this machine does not have it.
    """
    import torch

    if name is None:
        return "cuda" if torch.cuda.is_available() else "cpu"
    kind, _, number = name.partition(":")
    count = {"cpu": 1, "cuda": torch.cuda.device_count()}.get(kind, 0)
    if not (number or "0").isdigit() or int(number or 0) >= count:
        raise InputError(
            f"this machine has no device {name!r} (see: orbisim doctor); use --device cpu"
        )
    return name


def device_option(function: F) -> F:
    """Adds --device."""
    return click.option(
        "--device",
        default=None,
        help="Where to compute: cpu, cuda, cuda:1. Default: the backend's.",
    )(function)


def writable_folder(
    context: click.Context, parameter: click.Parameter, value: Path | None
) -> Path | None:
    """Callback of --out: where nothing can be written is said before anything is computed."""
    if value is not None:
        check_folder(value)
    return value


def randomize_option(function: F) -> F:
    """Adds `--randomize`: a diagnosis from which a policy's episodes are drawn."""
    return click.option(
        "--randomize",
        type=click.Path(path_type=Path),
        default=None,
        metavar="REPORT",
        help="report.json of orbisim diagnose: episodes have its effects, from its intervals.",
    )(function)


def map_option(function: F) -> F:
    """Adds --map."""
    return click.option(
        "--map",
        "mapping",
        type=click.Path(path_type=Path),
        default=None,
        metavar="FILE",
        help="Which column of the recordings is which signal (see: orbisim recording init).",
    )(function)


def emit_json(value: dict[str, Any]) -> None:
    """Prints one JSON object; NaN and infinity become null."""
    click.echo(json.dumps(_strict(value), indent=1, allow_nan=False))


def _strict(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _strict(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_strict(item) for item in value]
    if isinstance(value, float) and (value != value or value in (float("inf"), float("-inf"))):
        return None
    return value


def note(text: str) -> None:
    """A line for people, on standard error."""
    click.echo(text, err=True)


def print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Prints a table on standard output; numbers are right-aligned."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title or None, title_justify="left", box=None, pad_edge=False)
    for index, column in enumerate(columns):
        numeric = all(_is_number(row[index]) for row in rows) and bool(rows)
        table.add_column(  # a number in two lines could be read as two
            column, justify="right" if numeric else "left", overflow="fold", no_wrap=numeric
        )
    for row in rows:
        table.add_row(*(_cell(value) for value in row))
    console = Console(soft_wrap=not sys.stdout.isatty(), width=None if sys.stdout.isatty() else 160)
    console.print(table)


def _is_number(value: object) -> bool:
    return value == "-" or (isinstance(value, (int, float)) and not isinstance(value, bool))


def _cell(value: object) -> str:
    from rich.markup import escape

    if isinstance(value, float):
        return f"{value:.4g}"
    return escape(str(value))


@contextlib.contextmanager
def quiet_engine() -> Iterator[None]:
    """Sends MuJoCo's and dm_control's warnings to standard error once each, and to no log file."""
    from orbisim.host.engine_log import engine_warnings

    seen: set[str] = set()

    def once(text: str) -> None:
        kind = text.split(" Time =")[0]
        if kind not in seen:
            seen.add(kind)
            note(f"warning: {text}")

    logging.getLogger("absl").setLevel(logging.ERROR)
    with engine_warnings(once):
        yield


def engine_command(function: F) -> F:
    """For commands that load scenes: `quiet_engine` around them."""

    @functools.wraps(function)
    def wrapped(*args: Any, **kwargs: Any) -> Any:
        with quiet_engine():
            return function(*args, **kwargs)

    return wrapped  # type: ignore[return-value]


@contextlib.contextmanager
def notes_held_back() -> Iterator[list[str]]:
    """Keeps notes about recordings' files, which a result has, too; without one prints them.

    Yields the list that they are kept in.
    """
    log, handler = logging.getLogger("orbisim.recording"), _Kept()
    propagate, log.propagate = log.propagate, False
    log.addHandler(handler)
    try:
        yield handler.texts
    except Exception:
        from orbisim.report.notes import merged  # starts of --help need no reports

        for text in merged(handler.texts):
            note(f"note: {text}")
        raise
    finally:
        log.removeHandler(handler)
        log.propagate = propagate


class _Kept(logging.Handler):
    """Keeps messages."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.texts: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keeps one."""
        self.texts.append(record.getMessage())
