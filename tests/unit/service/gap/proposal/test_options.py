"""What could be measured next, and that the service takes it: bands that rise, within limits, none empty."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.api.resources.options import checked_options
from service.campaign.aims import aims
from service.gap.measured.observation import Observation, observe
from service.gap.proposal.case import limits_of
from service.gap.proposal.options import options
from sim.rig import Contact, Rig
from sim.twin import with_effects
from tests.support.synthetic import known_datasheet, sweep, true_rig

SHEET, TRUTH = known_datasheet(seed=1)
RIG = true_rig(TRUTH)
MEASURED = observe(sweep(RIG, np.geomspace(10.0, 950.0, 8), 0.1, seed=3), RIG)


def seen(low_hz: float, high_hz: float, speed_rad_s: float = 0.0) -> Observation:
    band = np.geomspace(low_hz, high_hz, len(MEASURED.frequency_hz))
    return replace(MEASURED, frequency_hz=band, speed_rad_s=speed_rad_s, Y=MEASURED.Y.copy())


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
    assert found["speed"].speed_rad_s == pytest.approx(2 * np.pi * 50)
    assert found["standstill"].speed_rad_s == 0.0
    assert "standstill" not in [o.name for o in options([seen(10.0, 900.0)], RIG, limits_of(SHEET))]


def with_mode_at(hz: float) -> Rig:
    first, *rest = RIG.rotor.modes[0]
    modes = (replace(first, natural_frequency_rad_s=2 * np.pi * hz), *rest)
    return replace(RIG, rotor=replace(RIG.rotor, modes=(modes, modes)))


def speed_of(rig: Rig, rivals: Sequence[Rig] = (), datasheet: Rig | None = None) -> float:
    """Speed that is offered, rev/s; zero for none."""
    found = {o.name: o for o in options([seen(10.0, 900.0)], rig, limits_of(SHEET), rivals, datasheet)}
    if "speed" not in found:
        return 0.0
    speed = found["speed"].speed_rad_s / (2 * np.pi)
    assert f"{speed:.3g} rev/s" in found["speed"].by_hand[0]
    assert f"{speed:.3g} rev/s" in found["speed"].description
    return speed


@pytest.mark.parametrize("hz", [35.0, 50.0, 61.0])
def test_no_rotor_is_brought_to_a_critical_speed_nor_through_one(hz: float) -> None:
    """Whoever says that a mode is there: the explanation, its rival or the datasheet."""
    bent = with_mode_at(hz)
    for speed in (speed_of(bent), speed_of(RIG, [bent]), speed_of(RIG, datasheet=bent)):
        assert 0 < 1.2 * speed < hz
    assert speed_of(RIG, [RIG], RIG) == pytest.approx(50)


def test_where_no_speed_is_safe_none_is_offered() -> None:
    assert speed_of(with_mode_at(9.0)) == 0


def test_a_support_that_swings_at_a_speed_is_a_critical_speed_too() -> None:
    """It is no mode of the rotor; only the loop shows it."""
    softly = {"frequency_hz": 45.0, "damping_ratio": 0.02, "inverse_mass_per_kg": 1 / 400.0}
    assert 0 < speed_of(RIG, [with_effects(RIG, {"support_resonance": softly})]) < 40


def test_no_speed_is_offered_to_a_rotor_that_an_explanation_does_not_hold() -> None:
    unheld = replace(RIG, magnets=replace(RIG.magnets, ks=10 * RIG.magnets.ks))
    assert speed_of(RIG, [unheld]) == 0


def offered_shift(limit_m: float, rivals: Sequence[Rig] = (), now_m: float = 0.0) -> np.ndarray:
    """By how much each set-point is to be moved, m; zero where that is not offered."""
    measured = seen(10.0, 900.0)
    measured.Y[:, measured.harmonics.index(0)] += now_m
    limits = limits_of(replace(SHEET, displacement_limit_m=limit_m))
    found = {o.name: o for o in options([measured], RIG, limits, rivals)}
    if "set_point" not in found:
        return np.zeros(RIG.n_axes)
    option = found["set_point"]
    moved = option.rig(RIG).magnets.offset_m - RIG.magnets.offset_m
    assert all(f"{axis} by {1e6 * m:+.3g} µm" in option.by_hand[-2] for axis, m in zip(RIG.axes, moved, strict=True))
    assert f"{100 * option.offset:.0f} % of the gap" in option.description
    largest = max(a.displacement_m for a in aims(option.plan(), limits).values())
    assert np.all(now_m + moved + largest < limit_m), "what the planner plays about the new set-point has room, too"
    return moved


def test_set_points_are_moved_within_the_limit_of_displacement() -> None:
    """A tenth of the gap where that is free, less where it is not, and not at all where nothing would show."""
    tenth = 0.1 * RIG.magnets.gap_m
    assert offered_shift(80e-6) == pytest.approx(tenth)
    assert np.all((offered_shift(15e-6) > 0) & (offered_shift(15e-6) < 0.5 * tenth))
    assert not np.any(offered_shift(5e-6))


def test_a_rotor_that_hangs_off_its_place_has_less_way() -> None:
    assert np.all(offered_shift(80e-6, now_m=60e-6) < offered_shift(80e-6))
    assert offered_shift(80e-6, now_m=-60e-6) == pytest.approx(offered_shift(80e-6))


@pytest.mark.parametrize(("side", "free"), [(0.0, False), (1.0, False), (-1.0, True)])
def test_no_set_point_is_moved_against_a_stop_that_an_explanation_has(side: float, free: bool) -> None:
    stop = Contact(np.full(4, 18e-6), 1e7, side=side)
    moved = offered_shift(80e-6, [replace(RIG, contact=stop)])
    assert free == bool(np.all(moved > 18e-6))
    assert np.all(moved < 0.11 * RIG.magnets.gap_m)
