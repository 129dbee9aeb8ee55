"""The state in MjData, stepped by another backend: what is mirrored, what is not known."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from orbisim import Physics
from orbisim.errors import InputError
from orbisim.physics.mirror import ACCELERATION_FIELDS
from orbisim.state import MEMORY
from tests.physics.test_switching import TOUCH, Drift


@pytest.fixture
def physics() -> Physics:
    return Physics.from_xml_string(TOUCH, backend="drift")


def test_the_fields_that_are_not_known_are_those_of_the_acceleration_stage() -> None:
    """All that MuJoCo computes in a whole step and not in the first half of one, nothing else."""
    filtered = '<motor joint="hinge"/><general joint="hinge" dyntype="filter" dynprm=".1"/>'
    model = mujoco.MjModel.from_xml_string(
        TOUCH.replace('<motor name="m" joint="hinge"/>', filtered)
    )
    data = mujoco.MjData(model)
    given = {"qpos", "qvel", "act", "ctrl", *MEMORY}
    computed = {
        name: value
        for name in dir(data)
        if not name.startswith("_")
        and name not in given
        and isinstance(value := getattr(data, name), np.ndarray)
        and value.dtype == np.float64
        and value.size
    }
    for value in computed.values():
        value[:] = np.nan
    mujoco.mj_step1(model, data)
    unknown = {name for name in computed if np.isnan(getattr(data, name)).any()}
    mujoco.mj_forward(model, data)
    mujoco.mj_rnePostConstraint(model, data)
    mujoco.mj_inverse(model, data)
    found = {name for name in unknown if np.isfinite(getattr(data, name)).all()}
    assert found | {"efc_force"} == {*ACCELERATION_FIELDS, "sensordata"}  # as many as constraints


def test_positions_and_velocities_are_mirrored(physics: Physics) -> None:
    physics.named.data.qvel["hinge"] = 2.0
    physics.step(3)
    assert physics.named.data.qpos["hinge"] == pytest.approx(0.06)
    assert physics.time() == pytest.approx(0.03)
    assert physics.data.sensordata[1] == pytest.approx(0.06)
    tip = physics.data.geom_xpos[2]  # kinematics follow
    np.testing.assert_allclose(tip, [1 - 0.3 * np.sin(0.06), 0, 1 - 0.3 * np.cos(0.06)], atol=1e-9)


def test_unknown_fields_are_nan(physics: Physics) -> None:
    physics.step()
    for name in ACCELERATION_FIELDS:
        field = getattr(physics.data, name)
        assert np.isnan(field).all(), name
    assert np.isnan(physics.data.sensordata[[0, 2, 3, 4]]).all()  # touch, accelerometer


def test_unknown_fields_are_nan_after_a_reset_too(physics: Physics) -> None:
    with physics.reset_context():
        physics.named.data.qpos["hinge"] = 1.0
    assert np.isnan(physics.data.qacc).all()
    assert physics.data.sensordata[1] == pytest.approx(1.0)


def test_going_back_to_mujoco_leaves_no_nan(physics: Physics) -> None:
    physics.step()
    physics.use_backend("mujoco")
    for name in ACCELERATION_FIELDS:
        assert np.isfinite(getattr(physics.data, name)).all(), name
    physics.step(10)
    assert np.isfinite(physics.get_state()).all()


def test_private_memory_is_kept_until_the_state_is_edited(physics: Physics) -> None:
    physics.step(2)
    physics.step(3)
    assert physics.snapshot().memory["steps"] == 5
    physics.named.data.qpos["hinge"] = 0.5
    assert "steps" not in physics.snapshot().memory
    physics.step()
    assert physics.snapshot().memory["steps"] == 1


def test_a_changed_model_is_noticed() -> None:
    physics = Physics.from_xml_string(TOUCH)
    engine = Drift()
    physics.use_backend(engine)
    physics.step()
    assert engine.loads == 1
    physics.named.model.body_mass[2] = 7.0
    physics.step()
    assert engine.loads == 2
    assert engine.model.body_mass[2] == 7.0
    physics.step()
    assert engine.loads == 2


def test_timesteps_must_fit() -> None:
    class Slow(Drift):
        name = "slow"
        timestep = 0.02  # type: ignore[assignment]

    physics = Physics.from_xml_string(TOUCH, backend=Slow())
    physics.step(2)
    with pytest.raises(InputError, match="not a multiple"):
        physics.step(3)


def test_what_the_backend_reports_is_not_lost() -> None:
    class Reporting(Drift):
        """Knows accelerations and sensors."""

        name = "reporting"
        reportable = frozenset({"qacc", "sensordata"})

        def step(self, state, control=None, nstep=1):
            after = super().step(state, control, nstep)
            known = {"qacc": np.full((1, 7), 4.0), "sensordata": np.arange(5.0)[None]}
            return after.with_memory(**{name: known[name] for name in self.report})

    physics = Physics.from_xml_string(TOUCH, backend=Reporting())
    physics.named.data.qvel["hinge"] = 2.0
    physics.step()
    assert (physics.data.qacc == 4.0).all()
    assert np.isnan(physics.data.qfrc_constraint).all()
    # of sensors, those of the acceleration stage; the others are MuJoCo's, at the new state
    assert physics.data.sensordata[[0, 2, 3, 4]].tolist() == [0, 2, 3, 4]
    assert physics.data.sensordata[1] == pytest.approx(0.02)


def test_a_copy_goes_on_by_itself(physics: Physics) -> None:
    physics.step(2)
    copy = physics.copy()
    copy.step(3)
    assert copy.snapshot().memory["steps"] == 5
    assert physics.snapshot().memory["steps"] == 2
