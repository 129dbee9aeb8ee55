"""Errors: one line that says where, what and what to do; whole after a trip between processes."""

from __future__ import annotations

import pickle

import pytest

from orbisim.errors import (
    CapacityError,
    DivergedError,
    InputError,
    MissingDependencyError,
    OrbiSimError,
    RecordingError,
    RenderingUnavailableError,
    SceneError,
    UnknownNameError,
    UnsupportedSceneError,
)


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (SceneError("a.xml", "is empty"), "a.xml: is empty"),
        (SceneError("a.xml", "is heavy", element="body 'b'"), "a.xml: body 'b': is heavy"),
        (SceneError("a.xml", "is\n  late", remedy="hurry\tup"), "a.xml: is late; hurry up"),
        (SceneError("", "is nowhere"), "is nowhere"),
    ],
)
def test_scene_errors_fit_on_one_line(error: SceneError, text: str) -> None:
    assert str(error) == text


@pytest.mark.parametrize(
    "error",
    [
        SceneError("a.xml", "problem", element="e", remedy="r"),
        UnsupportedSceneError("a.xml", "problem", remedy="r"),
        RecordingError("a.csv", "problem"),
        UnknownNameError("joint", "elbo", ["elbow", "wrist"], "look again"),
        MissingDependencyError("reader 'usd'", "usd", "no module 'pxr'"),
        DivergedError("world 3 diverged", [3, 5]),
    ],
    ids=lambda error: type(error).__name__,
)
def test_errors_survive_pickling(error: OrbiSimError) -> None:
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is type(error)
    assert str(again) == str(error)
    assert vars(again) == vars(error)


@pytest.mark.parametrize(
    ("kind", "status", "builtin"),
    [
        (OrbiSimError, 1, Exception),
        (InputError, 2, ValueError),
        (SceneError, 2, ValueError),
        (UnknownNameError, 2, LookupError),
        (MissingDependencyError, 1, ImportError),
        (RenderingUnavailableError, 1, Exception),
        (DivergedError, 1, Exception),
        (CapacityError, 1, Exception),
    ],
)
def test_exit_status_and_kind(kind: type[OrbiSimError], status: int, builtin: type) -> None:
    assert kind.exit_status == status
    assert issubclass(kind, (OrbiSimError, builtin))
    assert issubclass(kind, builtin)


def test_similar_names_are_offered() -> None:
    message = str(UnknownNameError("joint", "elbo", ["wrist", "elbow"]))
    assert message == "unknown joint 'elbo'; did you mean 'elbow'?"


def test_without_a_similar_name_the_first_dozen_are_listed() -> None:
    known = [f"j{i:02d}" for i in range(20)]
    message = str(UnknownNameError("joint", "shoulder", known, "see `info`"))
    assert message == f"unknown joint 'shoulder'; known: {', '.join(known[:12])}, ...; see `info`"
    assert str(UnknownNameError("joint", "a", [])).endswith("known: none")


def test_the_extra_that_is_missing_is_named() -> None:
    message = str(MissingDependencyError("viewing", "view", "no module 'meshcat'"))
    assert "(no module 'meshcat'); run: pip install 'orbisim[view]'" in message


def test_diverged_worlds_are_plain_integers() -> None:
    np = pytest.importorskip("numpy")
    assert DivergedError("d", np.array([1, 4])).worlds == (1, 4)
    assert all(type(world) is int for world in DivergedError("d", np.array([1])).worlds)
