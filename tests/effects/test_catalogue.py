"""The catalogue of effects."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

import orbisim
from orbisim.effects import (
    Effect,
    EffectInstance,
    Parameter,
    catalogue,
    effect_names,
    find,
    register,
)
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


def test_one_that_is_asked_once_works_out_its_parameters_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The registered one stays as it was."""
    hinge = """<mujoco><worldbody><body><joint name="hinge"/><geom size=".1"/></body></worldbody>
    </mujoco>"""
    model, count = orbisim.load_scene(hinge).model, 0
    effect = find("viscous_damping")
    whole = type(effect).parameters

    def counted(self: Effect, *words: Any) -> tuple[Parameter, ...]:
        nonlocal count
        count += 1
        return whole(self, *words)

    monkeypatch.setattr(type(effect), "parameters", counted)
    same = catalogue.asked_once("viscous_damping")
    one = EffectInstance("viscous_damping", "hinge", {"coefficient": 0.1})
    assert [same.log_prior(model, one) for _ in range(3)] == [effect.log_prior(model, one)] * 3
    assert count == 2  # by the first of the three, and by the registered one
