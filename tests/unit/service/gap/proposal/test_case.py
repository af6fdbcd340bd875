"""An option is predicted as it is submitted: its tones, within limits, its noise, and nothing measured twice."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Sweep
from service.gap.measured.condition import ANOTHER_AMPLITUDE
from service.gap.measured.observation import MODEL_FLOOR, observe
from service.gap.proposal.case import Case, Grounds, amplitude_there, case, limits_of, measured_already
from service.gap.proposal.options import LOUD, Option, options
from service.gap.proposal.rehearsal import BegunCampaign
from service.gap.proposal.sensor_noise import SensorNoise
from sim.errors import LevitationError
from tests.support.synthetic import known_datasheet, sweep, true_rig

SHEET, TRUTH = known_datasheet(seed=1)
RIG = true_rig(TRUTH)


def grounds(sweeps: Sequence[Sweep]) -> Grounds:
    return Grounds(tuple(observe(s, RIG) for s in sweeps), SensorNoise.of(sweeps[0], RIG), True, limits_of(SHEET))


def swept(amplitude: float, seed: int = 3) -> Sweep:
    return sweep(RIG, np.geomspace(10.0, 950.0, 16), amplitude, seed)


KNOWN = grounds([swept(0.04), swept(0.1, 4)])
"""A standard campaign's sweeps: the second one at 2.5 times the amplitude of the first."""
OPTIONS = {o.name: o for o in options(KNOWN.sweeps, RIG, KNOWN.limits)}


@pytest.fixture(scope="module")
def cases() -> dict[str, Case]:
    found = {name: case(o, RIG, RIG, KNOWN) for name, o in OPTIONS.items()}
    return {name: c for name, c in found.items() if c is not None}


def test_every_case_rises_within_limits_and_is_no_condition_that_was_measured(cases: dict[str, Case]) -> None:
    assert {"larger_amplitude", "wide_band", "low_frequency", "set_point", "speed"} <= set(cases)
    for name, c in cases.items():
        plan, limits = c.option.plan(), KNOWN.limits
        assert np.all(np.diff(c.main.frequency_hz) > 0), name
        assert c.main.frequency_hz[0] >= 0.99 * plan.from_hz, name
        assert c.main.frequency_hz[-1] <= min(1.01 * plan.to_hz, limits.max_frequency_hz), name
        points = [p for p in c.campaign.main if p.excited]
        assert np.mean([measured_already(c.option, p, KNOWN.sweeps) for p in points]) <= 0.5, name
        f = c.main.fundamental
        assert max(p.request.amplitude_a for p in points) <= limits.max_amplitude_a
        assert np.abs(c.main.Y[:, f]).max() < 0.5 * limits.linear_range_m, name
        assert c.main.I is not None
        assert np.abs(c.main.I[:, f]).max() < 0.6 * limits.current_limit_a, name
        assert c.main.speed_rad_s == c.option.speed_rad_s


def test_larger_means_larger_than_the_second_sweep_too(cases: dict[str, Case]) -> None:
    points = [p for p in cases["larger_amplitude"].campaign.main if p.excited]
    ratios = [p.request.amplitude_a / amplitude_there(KNOWN.sweeps[1], p.request.axis, p.frequency_hz) for p in points]
    assert np.median(ratios) > ANOTHER_AMPLITUDE


def test_smaller_means_smaller_than_the_first_sweep_too(cases: dict[str, Case]) -> None:
    points = [p for p in cases["smaller_amplitude"].campaign.main if p.excited]
    ratios = [p.request.amplitude_a / amplitude_there(KNOWN.sweeps[0], p.request.axis, p.frequency_hz) for p in points]
    assert np.median(ratios) < 1 / ANOTHER_AMPLITUDE


def test_what_has_been_run_is_not_proposed_again(cases: dict[str, Case]) -> None:
    for name in ("wide_band", "low_frequency", "speed"):
        done = replace(KNOWN, sweeps=(KNOWN.sweeps[0], cases[name].main))
        assert case(OPTIONS[name], RIG, RIG, done) is None, name
        others = {"wide_band", "low_frequency", "speed"} - {name}
        assert all(case(OPTIONS[other], RIG, RIG, done) is not None for other in others), name


def test_a_condition_is_speed_set_point_band_and_amplitude(cases: dict[str, Case]) -> None:
    (point,) = [p for p in cases["set_point"].campaign.main if p.request.axis == 0 and p.frequency_hz > 80][:1]
    swept_there = amplitude_there(KNOWN.sweeps[0], 0, point.frequency_hz)
    assert swept_there == pytest.approx(0.04)
    point = replace(point, request=point.request.with_amplitude(swept_there))
    here = OPTIONS["larger_amplitude"]
    assert measured_already(here, point, KNOWN.sweeps)
    assert measured_already(here, replace(point, request=point.request.with_amplitude(0.1)), KNOWN.sweeps)
    assert not measured_already(here, replace(point, request=point.request.with_amplitude(0.06)), KNOWN.sweeps)
    assert not measured_already(here, replace(point, frequency_hz=1000.0), KNOWN.sweeps)
    assert not measured_already(here, replace(point, frequency_hz=9.0), KNOWN.sweeps)
    assert not measured_already(OPTIONS["speed"], point, KNOWN.sweeps)
    assert not measured_already(OPTIONS["set_point"], point, KNOWN.sweeps)


def test_what_the_rig_has_done_at_its_limits_is_not_asked_for_again() -> None:
    loudest = BegunCampaign(RIG, KNOWN.limits, replace(OPTIONS["larger_amplitude"].plan(), **LOUD), KNOWN.noise)
    most = max(p.request.amplitude_a for p in loudest.main)
    assert case(OPTIONS["larger_amplitude"], RIG, RIG, grounds([swept(0.04), swept(most)])) is None


def test_a_case_is_the_campaign_of_the_profile_that_is_submitted(cases: dict[str, Case]) -> None:
    c = cases["larger_amplitude"]
    campaign, again = c.campaign.whole(), BegunCampaign(RIG, KNOWN.limits, c.option.plan(), KNOWN.noise).whole()
    assert again.rig_seconds == campaign.rig_seconds
    tones = {name: [(p.frequency_hz, p.request) for p in points] for name, points in again.points.items()}
    assert tones == {name: [(p.frequency_hz, p.request) for p in points] for name, points in campaign.points.items()}
    assert {"preliminary", "main", "validation"} == set(tones), "nothing that no diagnosis uses, and a second sweep"


@pytest.mark.parametrize("times", [0.25, 4.0])
def test_floors_follow_the_planned_signal_and_noise_does_not(times: float) -> None:
    """Where there is hardly any noise, the twin's own error counts; where there is much, that noise."""
    quiet, loud = (replace(KNOWN.noise, of_y=KNOWN.noise.of_y * factor) for factor in (1e-10, 1.0))
    plan = Option("same", "", {**OPTIONS["set_point"].profile, "peak_points": 0}, offset=1e-6)
    sd = {}
    for name, noise in (("quiet", quiet), ("loud", loud)):
        there = replace(KNOWN, noise=noise)
        c = case(replace(plan, profile={**plan.profile, "accuracy": 0.002 * times}), RIG, RIG, there)
        assert c is not None
        f, own = c.main.fundamental, (np.arange(len(c.main.axis)), c.main.axis)
        sd[name] = c.main.sd_y[:, f][own], np.abs(c.main.Y[:, f][own])
    away = np.abs(np.log(sd["quiet"][1] / np.median(sd["quiet"][1]))) < 3
    assert sd["quiet"][0][away] == pytest.approx(MODEL_FLOOR * sd["quiet"][1][away], rel=0.3)
    record_s = [p.request.blocks * p.request.samples / 1e4 for p in c.campaign.main]
    expected = np.sqrt(np.median(KNOWN.noise.of_y) / np.median(record_s))
    assert np.median(np.sqrt(np.maximum(sd["loud"][0] ** 2 - (MODEL_FLOOR * sd["loud"][1]) ** 2, 0))) == pytest.approx(
        expected, rel=0.3
    )


def test_a_rig_that_does_not_levitate_there_is_no_case() -> None:
    with pytest.raises(LevitationError):
        case(replace(OPTIONS["set_point"], offset=0.8), RIG, RIG, KNOWN)


def test_a_moved_set_point_is_displacement_and_no_tone_about_it_exceeds_the_limit(cases: dict[str, Case]) -> None:
    main, shift = cases["set_point"].main, OPTIONS["set_point"].shift_m(RIG)
    assert main.Y[:, main.harmonics.index(0)].real == pytest.approx(np.tile(shift, (len(main.axis), 1)), abs=1e-7)
    tight = replace(KNOWN, limits=limits_of(replace(SHEET, displacement_limit_m=1.02 * float(shift.max()))))
    assert case(OPTIONS["set_point"], RIG, RIG, tight) is None
    (here,) = [o for o in options(KNOWN.sweeps, RIG, tight.limits) if o.name == "set_point"]
    assert here.offset < OPTIONS["set_point"].offset
    assert case(here, RIG, RIG, tight) is not None
