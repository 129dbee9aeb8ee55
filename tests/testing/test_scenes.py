"""The scenes of the conformance tests are what their names say."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from orbisim.testing import scenes

NAMES = [n for n in dir(scenes) if n.isupper() and isinstance(getattr(scenes, n), str)]


@pytest.mark.parametrize("name", NAMES)
def test_each_compiles(name: str) -> None:
    assert mujoco.MjModel.from_xml_string(getattr(scenes, name)).nv > 0


def test_the_filtered_one_has_an_activation() -> None:
    assert mujoco.MjModel.from_xml_string(scenes.FILTERED).na == 1


def test_the_pendulum_keeps_its_energy() -> None:
    model = mujoco.MjModel.from_xml_string(scenes.PENDULUM)
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    data = mujoco.MjData(model)
    data.qpos[0] = 1.0
    mujoco.mj_forward(model, data)
    before = data.energy.sum()
    mujoco.mj_step(model, data, 1000)
    mujoco.mj_forward(model, data)
    assert data.energy.sum() == pytest.approx(before, abs=1e-6)


def test_the_resting_box_rests() -> None:
    model = mujoco.MjModel.from_xml_string(scenes.RESTING_BOX)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 500)
    assert np.abs(data.qvel).max() < 1e-3
    assert data.qpos[2] == pytest.approx(0.1, abs=1e-3)
