"""Progress: every item passes through; a bar only for someone who looks, and only after a while."""

from __future__ import annotations

import contextlib
import io
import threading

import pytest

from orbisim.host import progress


class Terminal(io.StringIO):
    """A terminal that keeps what was written to it."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def said(monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """Set when something was said; a process that has said nothing yet, and soon loses patience."""
    happened, say = threading.Event(), progress._say
    monkeypatch.delenv(progress.QUIET, raising=False)
    monkeypatch.setattr(progress, "_SAID", set())
    monkeypatch.setattr(progress, "PATIENCE", 0.01)
    monkeypatch.setattr(progress, "_say", lambda text: (say(text), happened.set()))
    return happened


def shown(patience: float, monkeypatch: pytest.MonkeyPatch) -> str:
    """What a terminal shows of three pieces of work."""
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(progress, "PATIENCE", patience)
    with contextlib.redirect_stderr(Terminal()) as terminal:
        assert list(progress.track([1, 2, 3], "forging")) == [1, 2, 3]
    return terminal.getvalue()


def test_long_work_is_named_once(
    said: threading.Event,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    with progress.patient("compiling kernels"):
        assert said.wait(60)
    assert capsys.readouterr().err == "compiling kernels ...\n"
    monkeypatch.setattr(progress, "PATIENCE", 60.0)
    with progress.patient("nothing"):
        pass
    monkeypatch.setenv(progress.QUIET, "1")
    monkeypatch.setattr(progress, "PATIENCE", 0.0)
    with progress.patient("silence"):
        pass
    assert capsys.readouterr().err == ""


def test_long_work_is_named_without_a_terminal_too(
    said: threading.Event, capsys: pytest.CaptureFixture[str]
) -> None:
    for _ in progress.track([1], "forging a chain"):
        assert said.wait(60)
    said.clear()
    with progress.status("searching a haystack"):
        assert said.wait(60)
    assert capsys.readouterr().err == "forging a chain ...\nsearching a haystack ...\n"
    said.clear()
    for _ in progress.track([1], "forging a chain"):  # one piece of work may have many parts
        assert not said.wait(0.1)


def test_short_work_without_a_terminal_is_silent(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(progress, "PATIENCE", 60.0)
    assert list(progress.track(iter("abc"), "work")) == ["a", "b", "c"]
    with progress.status("work") as say:
        say("step")
    assert capsys.readouterr() == ("", "")


def test_long_work_shows_a_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    text = shown(-1.0, monkeypatch)
    assert "forging" in text
    assert "33%" in text
    assert "100%" in text


def test_short_work_shows_none(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "forging" not in shown(1e9, monkeypatch)


def test_a_status_says_what_is_going_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    with contextlib.redirect_stderr(Terminal()) as terminal, progress.status("search") as say:
        say("round 2")
    assert "search: round 2" in terminal.getvalue()
