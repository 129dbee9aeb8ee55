"""How far windows reach."""

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import orbisim
from orbisim.motion.samples import prepare_all
from orbisim.shooting import bench
from orbisim.shooting.cutting import wrongly_lost
from orbisim.shooting.shooter import Variant
from orbisim.shooting.windows import Windows
from orbisim.testing import inject_effect


class _Far(SimpleNamespace):
    """What a shooter is asked for windows that end early."""

    def __len__(self) -> int:
        return len(self.left)

    def simulate(self, variant: Variant, start: np.ndarray) -> None:
        assert start.shape == (len(self), 2)

    def residual(self, simulated: None) -> np.ndarray:
        return np.asarray(self.left)


def test_impacts_that_never_happened_cut_no_window_short() -> None:
    horizon = np.array([[10, 0], [3, 0], [2, 0], [4, 0]])
    windows = Windows(np.arange(4), 10, np.zeros(4, int), horizon)
    noise = (np.array([1e-3]), np.array([np.nan]))
    left = np.array([[1.0], [500.0], [300.0], [2.0]])
    shooter: Any = _Far(nv=1, declared=None, left=left)
    found = wrongly_lost(shooter, windows, noise)
    assert found.horizon is not None
    np.testing.assert_array_equal(found.horizon[:, 0], [10, 10, 10, 4])
    np.testing.assert_array_equal(found.horizon[:, 1], 0)  # no velocity is measured
    near: Any = _Far(nv=1, declared=None, left=left / 100)
    assert wrongly_lost(near, windows, noise) is windows
    few = dataclasses.replace(windows, horizon=np.array([[10, 0], [10, 0], [2, 0], [10, 0]]))
    assert wrongly_lost(shooter, few, noise) is few


SLIDING = """<mujoco><option timestep="0.002"/><worldbody>
<geom name="floor" type="plane" size="5 5 .1"/>
<body pos="0 0 .1"><joint name="slide" type="slide" axis="1 0 0" damping=".2"/>
<joint name="lift" type="slide" axis="0 0 1"/><geom type="sphere" size=".1" mass=".5"/></body>
</worldbody><actuator><motor name="push" joint="slide"/></actuator></mujoco>"""


def test_what_is_not_looked_at_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = orbisim.load_scene(SLIDING)
    runs = inject_effect(scene, [], rate=100.0, duration=2.0, episodes=3, noise=1e-3, seed=0)
    whole = bench.make_bench(scene, prepare_all(runs, scene), 0.25)
    assert whole.contacts and whole.looked_at == 1
    monkeypatch.setattr(bench, "most_intervals", lambda *_: 300)
    some = bench.make_bench(scene, prepare_all(runs, scene), 0.25)
    assert some.looked_at == pytest.approx(0.5, abs=0.1)
    result = orbisim.diagnose(scene, runs[:2], runs[2:], window=0.25, progress=False)
    assert any("% of the recordings are looked at" in note for note in result.notes)
