"""A fixed few of the blind trials, and the machinery that makes and scores them.

The whole grid takes about an hour: `python tools/blind_trials.py`.
"""

from __future__ import annotations

import importlib
import json
import sys
from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest

from orbisim import Recording

TOOLS = Path(__file__).resolve().parents[2] / "tools"


@pytest.fixture(scope="module", autouse=True)
def _tools_on_path() -> Iterator[None]:
    sys.path.insert(0, str(TOOLS))
    yield
    sys.path.remove(str(TOOLS))


def tool(name: str) -> Any:
    return importlib.import_module(name)


@pytest.fixture(scope="module")
def trials(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("blind")
    assert (
        tool("blind_trials").main(["generate", "--out", str(out), "--sample", "--workers", "2"])
        == 0
    )
    return out


# -- making ----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_what_the_diagnosis_opens_says_nothing_about_the_effect(trials: Path) -> None:
    rigs = tool("blind.scenes").RIGS
    for folder in sorted((trials / "trials").iterdir()):
        for path in folder.iterdir():
            assert path.name == "scene.xml" or path.name.startswith(("fit_", "held_"))
        wish = json.loads((trials / "truth" / f"{folder.name}.json").read_text())["wish"]
        rig, text = rigs[wish["scene"]], (folder / "scene.xml").read_text()
        if wish["wrong"] == "right":
            assert text == rig.path.read_text()
        else:  # the same elements with other numbers
            one, other = (ElementTree.fromstring(t) for t in (text, rig.path.read_text()))
            assert [e.tag for e in one.iter()] == [e.tag for e in other.iter()]
        recording = Recording.load(folder / "fit_0.npz")
        assert not recording.metadata
        recording.bind(rig.scene())  # no joint that only the true scene has


@pytest.mark.slow
def test_every_injected_effect_shows(trials: Path) -> None:
    for path in sorted((trials / "truth").glob("s*.json")):
        truth = json.loads(path.read_text())
        assert all(shift >= 10 for shift in truth["shift_over_noise"]), path.name


def test_trials_are_made_alike_from_the_same_seed(tmp_path: Path) -> None:
    grid, making = tool("blind.grid"), tool("blind.making")
    wish = grid._one("coulomb_friction", "servo_pendulum", "servo", seed=5)
    for name in ("a", "b"):
        making.make(wish, "t0", tmp_path / name)
    one, two = (np.load(tmp_path / n / "trials" / "t0" / "held_0.npz") for n in ("a", "b"))
    assert all(np.array_equal(one[k], two[k]) for k in one.files if one[k].dtype.kind == "f")


def test_declared_parameters_are_off_by_a_few_percent() -> None:
    rig = tool("blind.scenes").RIGS["arm6"]
    alter = tool("blind.declared").alter
    true = rig.scene().model
    for what, field in (("mass", "body_mass"), ("damping", "dof_damping")):
        text, factors = alter(rig.path.read_text(), what, np.random.default_rng(0))
        model = mujoco.MjModel.from_xml_string(text)
        was, now = np.ravel(getattr(true, field)), np.ravel(getattr(model, field))
        moved = now[was > 0] / was[was > 0]
        assert factors
        assert np.all((np.abs(moved - 1) <= 0.0501) & (np.abs(moved - 1) >= 0.0199))


def test_no_effect_outside_the_catalogue_is_registered() -> None:
    kinds = tool("blind.outside").KINDS
    assert len(kinds) >= 6
    assert not set(kinds) & set(tool("orbisim.effects").effect_names())


# -- when a name is right --------------------------------------------------------------------------


def effect(name: str, target: str, **parameters: float) -> dict[str, Any]:
    return {"effect": name, "target": target, "parameters": parameters}


def test_identities_of_mechanics_are_accepted_and_nothing_else() -> None:
    matching, rigs = tool("blind.matching"), tool("blind.scenes").RIGS
    servo = rigs["servo_pendulum"].scene().model
    arm, cart = rigs["arm2"].scene().model, rigs["cart_pole"].scene().model
    lift = effect("constant_force", "rod", magnitude=1.0, x=0.0, y=0.0, z=1.0)
    aside = effect("constant_force", "rod", magnitude=1.0, x=1.0, y=0.0, z=0.0)
    buoyant = effect("buoyancy", "rod", displaced_mass=0.1)
    assert matching.equivalent(lift, buoyant, servo)
    assert not matching.equivalent(aside, buoyant, servo)
    drag = effect("linear_drag", "rod", coefficient=1.0)
    assert matching.equivalent(drag, effect("viscous_damping", "servo", coefficient=1.0), servo)
    assert not matching.equivalent(
        drag, effect("quadratic_damping", "servo", coefficient=1.0), servo
    )
    forearm = effect("linear_drag", "forearm", coefficient=1.0)
    assert not matching.equivalent(
        forearm, effect("viscous_damping", "elbow", coefficient=1.0), arm
    )
    load = effect("payload", "cart", mass=1.0)
    assert matching.equivalent(load, effect("armature", "cart", inertia=1.0), cart)
    assert not matching.equivalent(
        effect("payload", "rod", mass=1.0), effect("armature", "servo", inertia=1.0), servo
    )


def test_factors_are_judged_by_how_far_they_are_from_one() -> None:
    matching = tool("blind.matching")
    found, truth = (
        effect("clock_skew", "recording", factor=1.03),
        effect("clock_skew", "recording", factor=1.02),
    )
    assert matching.relative_error(found, truth) == pytest.approx(0.5)


# -- the sample ------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_sample_is_diagnosed(trials: Path, tmp_path: Path) -> None:
    import orbisim

    if "diagnose" not in dir(orbisim):
        pytest.skip("there is no diagnosis")
    results = tmp_path / "results.jsonl"
    running, scoring = tool("blind.running"), tool("blind.scoring")
    asked = Namespace(trials=str(trials), out=str(results), sample=True, only=[], limit=0,
                      again=False, workers=2, timeout=300.0)  # fmt: skip
    assert running.run_all(asked, "diagnose") == 0
    outcomes = scoring.outcomes_of(trials, results)
    told = scoring.failures(outcomes)
    assert len(outcomes) == len(tool("blind.grid").SAMPLE)
    assert not [o.failure for o in outcomes if o.failure], told
    assert not [o for o in outcomes if o.kind in ("none", "outside") and not o.right], told
    singles = [o for o in outcomes if o.kind == "single"]
    assert sum(o.right for o in singles) >= len(singles) - 1, told
    assert np.nanmedian([o.relative_error for o in singles if o.right]) < 0.05, told
    # everything that was asked for has been done: a second run has nothing to do
    assert running.names_of(asked) == []
