"""A hypothesis with a little of what would do the same elsewhere."""

import numpy as np
import pytest

import orbisim
from orbisim.effects import EffectInstance
from orbisim.motion.samples import Samples, prepare_all
from orbisim.shooting.elsewhere import Wide, widened
from orbisim.shooting.fits import Fit
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.testing import inject_effect

FRICTION = EffectInstance("coulomb_friction", "elbow", {"torque": 0.2})
LOAD = EffectInstance(
    "payload", "forearm", {"mass": 0.3, "com_x": 0.0, "com_y": 0.0, "com_z": -0.05}
)


@pytest.fixture(scope="module")
def samples(arm: orbisim.Scene) -> list[Samples]:
    runs = inject_effect(arm, [], duration=1.0, episodes=1, noise=1e-4, seed=1)
    return prepare_all(runs, arm)


def others(wide: Wide) -> dict[tuple[str, str], EffectInstance]:
    return {(e.effect, e.target): e for e in wide.whole.effects[len(wide.found.effects) :]}


def fit_of(values: np.ndarray) -> Fit:
    count = len(values)
    none, eye = np.zeros(0), np.eye(count)
    return Fit(values, none, 1.0, 1, eye, np.zeros((1, 1)), none, eye[None], np.zeros((1, count)))


def test_a_little_of_what_may_be_elsewhere(arm: orbisim.Scene, samples: list[Samples]) -> None:
    wide = widened(arm, samples, Hypothesis((FRICTION, LOAD)), None)
    found = others(wide)
    assert ("coulomb_friction", "shoulder") in found and ("payload", "upper_arm") in found
    assert found["coulomb_friction", "shoulder"].values["torque"] == pytest.approx(2e-4)
    assert found["payload", "upper_arm"].values["mass"] == pytest.approx(3e-4)
    number = list(wide.whole.effects).index(found["payload", "upper_arm"])
    assert wide.size[number, "mass"] == pytest.approx(0.3)
    assert wide.width[number, "com_x"] == 0.1  # as `Parameter.scale` has it


def test_neither_what_is_ruled_out_nor_what_cannot_be(
    arm: orbisim.Scene, samples: list[Samples]
) -> None:
    far = LOAD.replace(com_z=-0.3)  # beyond what the upper arm reaches
    assert ("payload", "upper_arm") not in others(widened(arm, samples, Hypothesis((far,)), None))
    few = widened(arm, samples, Hypothesis((FRICTION, LOAD)), ["coulomb_friction"])
    assert set(others(few)) == {("coulomb_friction", "shoulder")}


def test_a_limit_is_there_all_at_once(arm: orbisim.Scene, samples: list[Samples]) -> None:
    """A little of a limit on another motor would hold that motor."""
    limit = EffectInstance("torque_saturation", "elbow", {"limit": 0.5})
    assert others(widened(arm, samples, Hypothesis((limit,)), None)) == {}


def test_numbers_come_in_the_order_of_the_fit(arm: orbisim.Scene, samples: list[Samples]) -> None:
    """Friction here or there does the same; what is not known of the data ends it."""
    wide = widened(arm, samples, Hypothesis((FRICTION,)), None)
    fit, half = fit_of(np.array([0.2])), np.array([0.0196])
    gram = 1e4 * np.ones((2, 2))
    ties, keys = wide.ties(arm, fit, gram, half)
    assert keys == [(0, "torque"), (1, "torque")]
    (one,) = ties
    assert one.first == 0 and one.others == {1: pytest.approx(1.0)}
    assert wide.ties(arm, fit, np.full((2, 2), np.nan), half)[0] == []
    apart = np.diag(np.diag(gram))
    assert wide.ties(arm, fit, apart, half)[0] == []
    assert wide.ties(arm, fit, -gram + 2 * apart, half)[0] == []  # more here for more there
