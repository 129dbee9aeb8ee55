"""What else may change while an effect is looked for."""

from __future__ import annotations

import numpy as np
import pytest

import orbisim
from orbisim.diagnosis.nuisance import OwnColumns, own_columns
from orbisim.diagnosis.screening import screen
from orbisim.effects import EffectInstance
from orbisim.motion.linear import linearize
from orbisim.motion.regressors import _peaks
from orbisim.motion.samples import prepare_all
from orbisim.shooting.bench import make_bench
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.shooting.regress import fit, normal_of
from orbisim.testing import inject_effect

DAMPING = EffectInstance("viscous_damping", "elbow", {"coefficient": 0.05})
FRICTION = EffectInstance("coulomb_friction", "elbow", {"torque": 0.1})


def test_own_parameters_move_as_in_one_fit_of_all() -> None:
    rng = np.random.default_rng(0)
    design = rng.standard_normal((40, 5))
    design[:, 2] = design[:, 3] - 2 * design[:, 4]  # says nothing that the own ones do not say
    target = rng.standard_normal(40)
    own = OwnColumns((), (0, 2), 3)
    apart = own.apart(normal_of(design, target, 40), [3, 4])
    assert not apart.normal.gram[2].any() and apart.normal.moment[2] == 0
    together = np.linalg.lstsq(design[:, [0, 1, 3, 4]], target, rcond=None)[0]
    found, left = fit(apart.normal, [0, 1])
    assert found == pytest.approx(together[:2])
    assert left == pytest.approx(((target - design[:, [0, 1, 3, 4]] @ together) ** 2).sum())
    moved = apart.moved([0, 1], found)
    assert moved[[0, 2]] == pytest.approx(together[2:]) and moved[1] == 0


def test_a_second_effect_is_seen_although_the_first_has_taken_part_of_it(
    arm: orbisim.Scene,
) -> None:
    """Friction fitted alone takes part of what damping does; with both free, damping comes out."""
    runs = inject_effect(arm, [DAMPING, FRICTION], duration=5.0, episodes=3, noise=1e-5, seed=4)
    bench = make_bench(arm, prepare_all(runs, arm), 0.5)
    alone = Hypothesis((FRICTION.replace(torque=0.16),))
    intervals = linearize(bench.flow(alone))
    found = screen(bench, alone, intervals, ["viscous_damping"])
    best = next(s for s in found.suspects if s.instance.target == "elbow")
    assert best.instance.values["coefficient"] == pytest.approx(0.05, rel=0.15)
    assert best.moved is not None
    assert 0.16 + best.moved[0] == pytest.approx(0.1, rel=0.15)


def test_columns_of_sensors_and_of_forces(arm: orbisim.Scene) -> None:
    runs = inject_effect(arm, [DAMPING], duration=3.0, episodes=2, noise=1e-5, seed=4)
    bench = make_bench(arm, prepare_all(runs, arm), 0.5)
    bias = EffectInstance("sensor_bias", "elbow", {"offset": 0.01})
    play = EffectInstance("backlash", "elbow", {"width": 0.02})
    both = Hypothesis((DAMPING, bias))
    own = own_columns(bench, both, bench.flow(both))
    assert [c.kind for c in own.columns] == ["state", "signal"] and own.which == (0, 1)
    hidden = Hypothesis((play, DAMPING))
    assert own_columns(bench, hidden, bench.flow(hidden)).which == (1,)
    assert own_columns(bench, Hypothesis(), bench.flow(Hypothesis())).count == 0


def test_a_wave_stands_out_among_impacts() -> None:
    """A few samples in which something strikes must not outweigh what all others say."""
    rng = np.random.default_rng(5)
    angle = rng.uniform(-0.6, 0.6, 2000)
    force = 0.5 * np.sin(19.0 * angle + 0.4) + 0.3 * rng.normal(size=2000)
    struck = rng.choice(2000, 60, replace=False)
    force[struck] += 40.0 * np.sin(61.0 * angle[struck]) + 10.0 * rng.normal(size=60)
    assert abs(_peaks(angle, force, np.arange(5.0, 120.0, 0.25))[0] - 19.0) < 0.5
