"""Which geoms may touch something between two samples."""

import numpy as np
import pytest

import orbisim
from orbisim.diagnosis.screening import candidates_of
from orbisim.effects import EffectInstance, add_effects, find
from orbisim.motion.closeness import may_touch
from orbisim.motion.linear import IntervalMap, missing_force
from orbisim.motion.regressors import MotionView
from orbisim.motion.samples import prepare_all
from orbisim.shooting.bench import make_bench
from orbisim.shooting.hypothesis import Hypothesis
from orbisim.testing import inject_effect

BALL = """<mujoco><option timestep="0.001"/><worldbody>
<geom name="floor" type="plane" size="1 1 1"/>
<body pos="0 0 {height}"><freejoint name="free"/><geom name="ball" size="0.05" mass="0.1"/></body>
<body pos="0.5 0 0.3"><joint name="hinge" axis="0 1 0"/>
<geom name="rod" type="capsule" fromto="0 0 0 0 0 -0.15" size="0.02"/></body>
</worldbody></mujoco>"""


def _interval(height: float, speed: float, later: float) -> list[bool]:
    """Of the floor, the ball and the rod, over 10 ms."""
    model = orbisim.load_scene(BALL.format(height=0.2)).model
    qpos, qvel = np.tile(model.qpos0, (1, 1)), np.zeros((1, model.nv))
    qpos[0, 2], qvel[0, 2] = height, speed
    after = qpos.copy(), qvel.copy()
    after[0][0, 2], after[1][0, 2] = later, -speed
    return [bool(x) for x in may_touch(model, (qpos, qvel), after, np.array([0.01]))[0]]


def test_what_moves_towards_something_may_touch_it() -> None:
    assert _interval(0.06, -2.0, 0.04) == [True, True, False]
    assert _interval(0.20, -2.0, 0.18) == [False, False, False]
    assert _interval(0.20, -9.0, 0.11) == [True, True, False]


def test_a_bounce_between_two_samples_is_seen() -> None:
    """Both samples have the ball 5 mm above the floor."""
    assert _interval(0.055, -1.0, 0.055) == [True, True, False]


def test_what_rests_touches() -> None:
    assert _interval(0.05 + 2e-4, 0.0, 0.05 + 2e-4) == [True, True, False]


def test_bodies_of_several_geoms_are_told_apart_by_geom() -> None:
    """MuJoCo compares the boxes around bodies first, widened by a margin of their own."""
    row = "".join(f'<geom name="{{0}}{k}" size="0.03" pos="0 0 {0.1 * k}"/>' for k in range(5))
    text = f"""<mujoco><worldbody><body><joint type="slide" axis="0 0 1"/>{row.format("low")}</body>
    <body pos="0 0 0.7"><joint type="slide" axis="0 0 1"/>{row.format("high")}</body></worldbody>
    </mujoco>"""
    model = orbisim.load_scene(text).model
    before = np.zeros((1, 2)), np.array([[8.0, -8.0]])
    after = np.array([[0.08, -0.08]]), before[1]
    found = may_touch(model, before, after, np.array([0.01]))[0]
    names = {model.geom(int(k)).name for k in np.flatnonzero(found)}
    assert {"low4", "high0"} <= names and not {"low0", "high4"} & names


def test_where_there_are_flexible_objects_everything_may_touch() -> None:
    text = """<mujoco><worldbody><geom name="floor" type="plane" size="1 1 1" pos="0 0 -5"/>
    <flexcomp name="cloth" type="grid" count="3 3 1" spacing=".1 .1 .1" dim="2"/>
    </worldbody></mujoco>"""
    model = orbisim.load_scene(text).model
    state = np.tile(model.qpos0, (2, 1)), np.zeros((2, model.nv))
    assert may_touch(model, state, state, np.full(2, 0.01)).all()


def test_of_unknown_states_nothing_is_said() -> None:
    assert _interval(np.nan, 0.0, 0.05) == [False, False, False]


@pytest.mark.parametrize("height", [0.051, 0.4])
def test_no_other_interval_is_changed_by_what_acts_at_contacts(height: float) -> None:
    scene = orbisim.load_scene(BALL.format(height=height))
    runs = inject_effect(scene, [], duration=0.5, episodes=1, noise=1e-4, seed=3)
    samples = prepare_all(runs, scene)
    rows = np.flatnonzero(samples[0].usable[:-1] & samples[0].usable[1:])
    flow = IntervalMap(scene, samples, [rows])
    softer = {"stiffness": 1e3, "damping_ratio": 1.0}
    changed = add_effects(scene, [EffectInstance("contact_compliance", "ball", softer)])
    felt = flow.felt(find("contact_compliance"), "ball")
    assert felt.any() and not flow.felt(find("contact_compliance"), "rod").any()
    assert flow.felt(find("viscous_damping"), "hinge").all()
    base, every = flow.advance(), flow.advance(scene=changed)
    some = flow.advance(scene=changed, only=felt)
    for there, one, part in zip(base, every, some, strict=True):
        # models of two compilations differ by rounding
        np.testing.assert_allclose(one[~felt], there[~felt], rtol=0, atol=1e-12)
        np.testing.assert_array_equal(part[felt], one[felt])
        assert np.isnan(part[~felt]).all()
    assert np.abs(every[1] - base[1]).max() > 1e-3


def test_a_geom_that_touches_nothing_is_not_simulated(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = orbisim.load_scene(BALL.format(height=0.4))
    runs = inject_effect(scene, [], duration=0.5, episodes=2, noise=1e-4, seed=3)
    bench = make_bench(scene, prepare_all(runs, scene), 0.2)
    flow, nothing = bench.flow(Hypothesis()), Hypothesis()
    view = MotionView(flow, bench.samples, missing_force(bench.intervals))
    stepped: list[int] = []
    advance = flow.advance

    def counted(**words: object) -> object:
        stepped.append(int(np.sum(words.get("only", len(flow)))))
        return advance(**words)  # type: ignore[arg-type]

    monkeypatch.setattr(flow, "advance", counted)
    found = candidates_of(view, bench, nothing, flow, ["contact_compliance"])
    assert {one.target for one in found} == {"ball"}
    # the scene as it is, then the ball alone, three times, in the intervals that it may touch in
    assert stepped[0] == len(flow) and len(stepped) == 4
    assert max(stepped[1:]) < 0.8 * len(flow)
