"""The catalogue of effects."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from orbisim.effects import catalogue, effect_names, find, register
from orbisim.effects.joints import CoulombFriction
from orbisim.errors import InputError, UnknownNameError


def test_the_catalogue_is_complete() -> None:
    assert len(effect_names()) == 39
    for name in effect_names():
        effect = find(name)
        assert effect.name == name
        assert effect.phrase


class Sticky(CoulombFriction):
    name = "sticky"


@pytest.fixture
def registered(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(catalogue, "_registered", dict(catalogue._registered))
    yield


@pytest.mark.usefixtures("registered")
def test_others_add_their_own() -> None:
    mine = Sticky()
    register(mine)
    assert find("sticky") is mine
    assert effect_names()[-1] == "sticky"


@pytest.mark.usefixtures("registered")
def test_a_name_is_taken_once() -> None:
    class Other(CoulombFriction):
        pass

    with pytest.raises(InputError, match="there is an effect named 'coulomb_friction' already"):
        register(Other())
    register(CoulombFriction())  # the same again is no conflict


def test_what_is_no_effect_is_refused() -> None:
    with pytest.raises(InputError, match="got <class"):
        register(Sticky)  # type: ignore[arg-type]


def test_an_unknown_name_has_a_suggestion() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'backlash'"):
        find("backlsh")
