"""The group of commands, and what every command does the same way."""

from __future__ import annotations

import contextlib
import importlib
import logging
import os
import sys
import warnings
from collections.abc import Iterator
from typing import Any, NoReturn

import click

from orbisim.errors import OrbiSimError, UnknownNameError, missing_module

COMMANDS = {
    "info": "read a scene and print its static descriptors",
    "sim": "simulate a scene; write the trajectory and a video",
    "compare": "run the same episodes through two backends and report the differences",
    "replay": "free-running simulation against a recording",
    "diagnose": "find the physical effect that a scene lacks, from recordings",
    "identify": "system identification: descriptors of a scene from recordings",
    "recording": "what a log holds; a first mapping file",
    "collect": "collect episodes of a task, or of a scene of your own, for training",
    "train": "train a learned model",
    "eval": "measure a learned model",
    "infer": "read the states that a video shows; write them as a recording",
    "view": "interactive viewer in the browser",
    "doctor": "try what is installed; what a bug report needs",
}
"""Commands in the order of the help text, each a module of this package."""


class _Lazy(click.Group):
    """Loads a command's module when the command is used, so that --help stays fast."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"orbisim.cli.{cmd_name}")
        command: click.Command = module.command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        if args and args[0] not in COMMANDS:
            raise UnknownNameError("command", args[0], COMMANDS)
        return super().resolve_command(ctx, args)


@click.command(cls=_Lazy, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="orbisim")
def cli() -> None:
    """A hybrid robot simulator: classical and learned physics behind one interface.

    SCENE is a path to MJCF (.xml), URDF, USD (.usd, .usda, .usdc, .usdz), or a task name such as
    suite:cheetah-run.
    """


def main() -> NoReturn:
    """Runs the command line; the exit status is 0, 1 (work failed) or 2 (input wrong)."""
    with in_one_line():
        status = run(sys.argv[1:])
    sys.exit(status)


_MOST_ALIKE = 3
"""Warnings of one kind that are shown: of hundreds of worlds all may say the same."""


@contextlib.contextmanager
def in_one_line() -> Iterator[None]:
    """OrbiSim's own warnings as lines on standard error, without where in its source they arise;
    what it logs, too, in whatever way packages have set up logging by then."""
    count: dict[type[Warning], int] = {}
    with warnings.catch_warnings(), _logged_as_notes():
        others = warnings.showwarning

        def show(message: Any, category: type[Warning], *where: Any, **more: Any) -> None:
            if not category.__module__.startswith("orbisim"):
                others(message, category, *where, **more)
                return
            count[category] = count.get(category, 0) + 1
            if count[category] <= _MOST_ALIKE:
                click.echo(f"warning: {' '.join(str(message).split())}", err=True)

        warnings.showwarning = show
        yield
    for category, number in count.items():
        if number > _MOST_ALIKE:
            name = category.__name__
            click.echo(f"warning: {number - _MOST_ALIKE} more of the kind ({name})", err=True)


@contextlib.contextmanager
def _logged_as_notes() -> Iterator[None]:
    log, handler = logging.getLogger("orbisim"), _Notes(logging.WARNING)
    propagate, log.propagate = log.propagate, False
    log.addHandler(handler)
    try:
        yield
    finally:
        log.removeHandler(handler)
        log.propagate = propagate


class _Notes(logging.Handler):
    """Writes messages as lines on standard error."""

    def emit(self, record: logging.LogRecord) -> None:
        """Writes one."""
        click.echo(f"note: {' '.join(record.getMessage().split())}", err=True)


def run(arguments: list[str]) -> int:
    """Runs the command line on `arguments`; returns the exit status."""
    try:
        result = cli.main(arguments, prog_name="orbisim", standalone_mode=False)
        return result if isinstance(result, int) else 0
    except OrbiSimError as error:
        _complain(str(error))
        return error.exit_status
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.ctx.get_help() if error.ctx else "", err=True)
        return 2
    except click.ClickException as error:
        _complain(_usage(error))
        return 2
    except (KeyboardInterrupt, click.exceptions.Abort):
        _complain("interrupted")
        return 130
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as error:
        if os.environ.get("ORBISIM_DEBUG"):
            raise
        if isinstance(error, ModuleNotFoundError) and error.name == "dm_control":
            lacking = missing_module("this command", error, "all")
            _complain(str(lacking))
            return lacking.exit_status
        where = f"{type(error).__name__}: {error}"
        _complain(f"a fault in OrbiSim: {where} (set ORBISIM_DEBUG=1 for the traceback)")
        return 1


def _usage(error: click.ClickException) -> str:
    text = error.format_message()
    ctx = getattr(error, "ctx", None)
    if ctx is not None:
        text += f" (see {ctx.command_path} --help)"
    return text


def _complain(text: str) -> None:
    click.echo(f"error: {' '.join(text.split())}", err=True)
