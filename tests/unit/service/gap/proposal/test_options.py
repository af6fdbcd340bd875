"""What could be measured next, and that the service takes it: bands that rise, within limits, none empty."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.api.resources.options import checked_options
from service.gap.measured.observation import Observation, observe
from service.gap.proposal.case import limits_of
from service.gap.proposal.options import SPEED, options
from tests.support.synthetic import known_datasheet, sweep, true_rig

SHEET, TRUTH = known_datasheet(seed=1)
RIG = true_rig(TRUTH)
MEASURED = observe(sweep(RIG, np.geomspace(10.0, 950.0, 8), 0.1, seed=3), RIG)


def seen(low_hz: float, high_hz: float, speed_rad_s: float = 0.0) -> Observation:
    band = np.geomspace(low_hz, high_hz, len(MEASURED.frequency_hz))
    return replace(MEASURED, frequency_hz=band, speed_rad_s=speed_rad_s)


@given(
    low=st.floats(0.05, 300.0),
    width=st.floats(1.2, 300.0),
    sample_time=st.floats(2e-5, 2e-3),
)
def test_every_band_rises_within_limits_and_the_service_takes_it(low: float, width: float, sample_time: float) -> None:
    limits = limits_of(replace(SHEET, sample_time_s=sample_time))
    high = min(low * width, 0.45 / sample_time)
    for option in options([seen(low, max(high, 1.2 * low))], RIG, limits):
        plan = option.plan()
        assert plan.from_hz < plan.to_hz <= limits.max_frequency_hz + 1e-3, option.name
        asked = {"profile": dict(option.profile)}
        assert checked_options("experiment", asked) == asked


@pytest.mark.parametrize(
    ("low", "high", "sample_rate", "missing"),
    [
        (10.0, 950.0, 2000.0, "wide_band"),
        (0.8, 950.0, 10_000.0, "low_frequency"),
        (10.0, 2900.0, 10_000.0, "wide_band"),
    ],
)
def test_an_empty_band_is_no_option(low: float, high: float, sample_rate: float, missing: str) -> None:
    names = [o.name for o in options([seen(low, high)], RIG, limits_of(replace(SHEET, sample_time_s=1 / sample_rate)))]
    assert missing not in names
    assert "larger_amplitude" in names


def test_new_bands_begin_beyond_what_either_sweep_has() -> None:
    bands = {o.name: o.plan() for o in options([seen(20.0, 500.0), seen(10.0, 900.0)], RIG, limits_of(SHEET))}
    assert bands["wide_band"].from_hz > 900.0
    assert bands["low_frequency"].to_hz < 10.0
    assert (bands["set_point"].from_hz, bands["set_point"].to_hz) == (10.0, 900.0)


def test_a_turning_rotor_stays_at_its_speed_but_where_that_is_the_question() -> None:
    found = {o.name: o for o in options([seen(10.0, 900.0, 100.0)], RIG, limits_of(SHEET))}
    assert found["wide_band"].speed_rad_s == 100.0
    assert "hold the rotor at" in found["wide_band"].by_hand[0]
    assert found["speed"].speed_rad_s == SPEED
    assert found["standstill"].speed_rad_s == 0.0
    assert "standstill" not in [o.name for o in options([seen(10.0, 900.0)], RIG, limits_of(SHEET))]
