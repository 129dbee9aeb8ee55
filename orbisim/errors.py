"""Errors: what was got, what was expected, what to do.

Every error that OrbiSim raises on purpose derives from `OrbiSimError` and fits on one line, so
that the command line can print it as it is. `exit_status` is what the command line returns:
2 for wrong input, 1 for work that failed.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence


class OrbiSimError(Exception):
    """Base of all errors raised by OrbiSim."""

    exit_status = 1


class InputError(OrbiSimError, ValueError):
    """The input (file, name, argument) is wrong; nothing was computed."""

    exit_status = 2


class OutputError(OrbiSimError):
    """A file cannot be written although its place is right: the disk is full, or broken."""


class SceneError(InputError):
    """A scene cannot be read.

    Args:
      source: the file, as the user named it.
      problem: what is wrong and what was expected.
      element: the element inside the file (tag and name, or prim path), if one is to blame.
      remedy: what would be right.
    """

    def __init__(
        self, source: str, problem: str, *, element: str | None = None, remedy: str | None = None
    ) -> None:
        self.source, self.problem, self.element, self.remedy = source, problem, element, remedy
        super().__init__(_one_line(source, problem, element, remedy))

    def __reduce__(self) -> tuple[object, ...]:
        return (_rebuild, (type(self), self.source, self.problem, self.element, self.remedy))


class UnsupportedSceneError(SceneError):
    """A backend cannot simulate something that the scene contains."""


class RecordingError(SceneError):
    """A recording cannot be read, or does not fit the scene."""


class UnknownNameError(InputError, LookupError):
    """A name (backend, renderer, task, joint ...) is not among the known ones."""

    def __init__(self, kind: str, name: str, known: Iterable[str], remedy: str = "") -> None:
        self.kind, self.name, self.known, self.remedy = kind, name, sorted(known), remedy
        close = difflib.get_close_matches(name, self.known, n=3)
        shown: Sequence[str] = close or self.known[:12]
        more = "" if len(self.known) <= len(shown) or close else ", ..."
        hint = (
            f"did you mean {' or '.join(repr(c) for c in close)}?"
            if close
            else f"known: {', '.join(shown) or 'none'}{more}"
        )
        super().__init__(f"unknown {kind} {name!r}; {hint}{'; ' + remedy if remedy else ''}")

    def __reduce__(self) -> tuple[object, ...]:
        return (type(self), (self.kind, self.name, self.known, self.remedy))


class MissingDependencyError(OrbiSimError, ImportError):
    """An optional dependency is not installed.

    Args:
      what: cannot be used. extra: of OrbiSim, that installs what is missing.
      cause: what is missing.
      command: that installs it, where no extra does.
    """

    def __init__(self, what: str, extra: str, cause: str = "", command: str = "") -> None:
        self.what, self.extra, self.cause, self.command = what, extra, cause, command
        because = f" ({cause})" if cause else ""
        command = command or f"pip install 'orbisim[{extra}]'"
        super().__init__(f"packages for {what} are not installed{because}; run: {command}")

    def __reduce__(self) -> tuple[object, ...]:
        return (type(self), (self.what, self.extra, self.cause, self.command))


def missing_module(what: str, error: ImportError, extra: str) -> MissingDependencyError:
    """What to do about a module that cannot be imported.

    Args:
      what: cannot be used. extra: of OrbiSim, that installs it.
    """
    if (error.name or "").partition(".")[0] == "dm_control":  # see pyproject.toml
        command = "pip install --no-deps 'dm-control>=1.0.50,<2'"
        return MissingDependencyError(what, extra, "no module 'dm_control'", command)
    return MissingDependencyError(what, extra, f"no module {error.name or str(error)!r}")


class RenderingUnavailableError(OrbiSimError):
    """No OpenGL implementation is usable on this machine."""


class DivergedError(OrbiSimError):
    """The simulation became non-finite or unstable.

    Attributes:
      worlds: indices of the worlds that diverged.
    """

    def __init__(self, message: str, worlds: Sequence[int] = ()) -> None:
        self.worlds = tuple(int(w) for w in worlds)
        super().__init__(message)

    def __reduce__(self) -> tuple[object, ...]:
        return (type(self), (str(self), self.worlds))


class EngineError(OrbiSimError):
    """An engine does not do what it claims: nothing moves although forces act."""


class CapacityError(OrbiSimError):
    """A preallocated buffer (contacts, constraints) was too small; results are not usable."""


def _one_line(source: str, problem: str, element: str | None, remedy: str | None) -> str:
    where = f"{source}: " if source else ""
    what = f"{element}: {problem}" if element else problem
    text = where + what + (f"; {remedy}" if remedy else "")
    return " ".join(text.split())


def _rebuild(
    cls: type[SceneError], source: str, problem: str, element: str | None, remedy: str | None
) -> SceneError:
    return cls(source, problem, element=element, remedy=remedy)
