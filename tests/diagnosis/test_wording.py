"""A diagnosis in one sentence."""

from __future__ import annotations

from typing import Any

import pytest

from orbisim.diagnosis.wording import interval, sentence


@pytest.mark.parametrize(
    ("verdict", "after", "left", "said"),
    [
        ("explained", 0.005, 0.997, "estimated starts 0.997 times the noise is left"),
        ("explained", 0.0004, 0.997, ""),
        ("explained", 0.005, None, ""),
        ("partly_explained", 0.005, 3.0, "something structured remains"),
    ],
)
def test_an_error_far_above_the_noise_is_accounted_for(
    verdict: Any, after: float, left: float | None, said: str
) -> None:
    text = sentence(
        verdict=verdict,
        effects=[],
        retuned=[],
        error={
            "unit": "rad",
            "noise_floor": 0.00028,
            "held_out": {"before": 0.03, "after": after},
        },
        residual={"ratio_to_noise": 51.0, "ratio_after": left},
        of_sensors=False,
    )
    end = text.partition("(measurement noise 0.00028 rad)")[2]
    assert said in end and (end == "." if not said else end.startswith("; "))


@pytest.mark.parametrize(
    ("cut_short", "said", "not_said"),
    [(False, "no effect of the catalogue", "--patience"), (True, "--patience", "no effect of")],
)
def test_a_search_whose_time_was_up_does_not_speak_of_the_whole_catalogue(
    cut_short: bool, said: str, not_said: str
) -> None:
    error = {"unit": "rad", "noise_floor": 1e-3, "held_out": {"before": 0.03, "after": 0.03}}
    text = sentence(
        verdict="unexplained",
        effects=[],
        retuned=[],
        error=error,
        residual={"ratio_to_noise": 30.0},
        of_sensors=False,
        cut_short=cut_short,
    )
    assert said in text and not_said not in text


def test_the_ends_of_an_interval_differ() -> None:
    assert interval(0.119993, 0.120013) == "0.119993 to 0.120013"
    assert interval(0.3, 0.4) == "0.3 to 0.4"
    assert interval(-1e-6, 1e-6) == "-1e-06 to 1e-06"
    assert interval(0.12, 0.12) == "0.12 to 0.12"
