"""Offset, scale and delay of a sensor whose true readings are known."""

from types import SimpleNamespace

import numpy as np
import pytest

from orbisim.sensing.forms import SensorData, fit_form, left_over
from orbisim.sensing.readings import Readings

TIME = np.linspace(0, 4, 401)


def _course(time: np.ndarray) -> np.ndarray:
    return np.stack([np.sin(3 * time), np.cos(2 * time)], axis=1)


@pytest.fixture(scope="module")
def data() -> SensorData:
    """Two components, the second with an offset of its own, read 15 ms late and 10 % too large."""
    noise = 1e-3 * np.random.default_rng(0).standard_normal((len(TIME), 2))
    measured = 1.1 * _course(TIME - 0.015) + [0.0, 0.2] + noise
    sensor = SimpleNamespace(place=slice(0, 2), width=2)
    readings = Readings(TIME, measured, _course(TIME), np.zeros(2))
    return SensorData(sensor, [readings])  # type: ignore[arg-type]


def test_all_numbers_are_found_with_their_uncertainty(data: SensorData) -> None:
    noise, size = data.weighted()
    np.testing.assert_allclose(noise, 1e-3, rtol=0.15)
    found = fit_form(data, ("scale", "offset 1", "delay"), size)
    truth = {"scale": 1.1, "offset 1": 0.2, "delay": 0.015}
    assert found.values.keys() == truth.keys()
    for name, value in truth.items():
        assert abs(found.values[name] - value) < 4 * found.std[name] < 0.01
    assert np.sqrt(np.mean(left_over(data, found.values) ** 2)) == pytest.approx(1e-3, rel=0.1)


def test_nothing_is_fitted_where_nothing_is_asked_for(data: SensorData) -> None:
    assert fit_form(data, (), np.ones(2)).values == {}
    expected = data.measured - data.expected()
    np.testing.assert_array_equal(left_over(data, {}), expected)
