"""What the report says about the shape of what is left, and why candidates were not taken."""

import numpy as np
import pytest
from orbisim.diagnosis.paying import unpaid

from orbisim.diagnosis.bench import Hypothesis
from orbisim.diagnosis.fits import Fit
from orbisim.diagnosis.refine import Judged
from orbisim.diagnosis.settings import Settings


def _judged(checked: list[float], cost: float) -> Judged:
    zero = np.zeros(0)
    fit = Fit(zero, zero, 1.0, 0.0, 1, zero, zero, zero, zero, zero)
    return Judged(Hypothesis(), fit, np.array(checked), 1.0, 1.0, cost, fit, None)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("checked", "cost", "reason"),
    [
        ([110.0, 90.0, 95.0, 108.0], 0.0, "no better"),
        ([99.5, 99.4, 99.6, 99.5], 0.0, "0.51 %"),
        ([150.0, 50.0, 30.0, 120.0], 0.0, "standard errors"),
        ([10.0, 11.0, 9.0, 10.0], 95.0, "information criterion falls by 5, 12 are needed"),
        ([10.0, 11.0, 9.0, 10.0], 0.0, None),
    ],
)
def test_an_effect_that_does_not_pay_gets_a_reason(
    checked: list[float], cost: float, reason: str | None
) -> None:
    found = unpaid(Settings(), _judged([100.0] * 4, 100.0), _judged(checked, cost))
    assert (found is None) if reason is None else (found is not None and reason in found)
