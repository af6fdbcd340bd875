"""Whatever the rig answers, a planned tone holds whole periods and stays within what the rig may take."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.campaign.aims import STEPS_PER_A, Limits, Profile, aims
from service.campaign.frequencies import clear_grid, mains_harmonics, whole_periods
from service.campaign.knowledge import Knowledge
from service.campaign.noise import NoiseSpectra
from service.campaign.plan import SMALLEST_A, Request, longest_settling, other_amplitude, tones

RATE = 10_000.0
STEP_A = 1 / STEPS_PER_A
positive = st.floats(1e-3, 1e3)


def limits(displacement=80e-6, current=6.0, largest=6.0):
    return Limits(
        n_axes=2,
        sample_rate_hz=RATE,
        max_frequency_hz=4500.0,
        max_samples=100_000,
        max_amplitude_a=largest,
        displacement_limit_m=displacement,
        current_limit_a=current,
        linear_range_m=80e-6,
        bias_current_a=2.75,
        gap_m=4e-4,
    )


def knowledge(noise=1.0, i=(1.0, 1.0), y=(1e-6, 1e-6), settle=0.1):
    f = np.array([1.0, 5000.0])
    level = {"u": 1e-10, "i": 1e-9, "y": 1e-19}
    known = Knowledge(NoiseSpectra(f, {s: np.full((2, 2), v * noise) for s, v in level.items()}), 2)
    for axis in (0, 1):
        for k, x in enumerate((10.0, 1000.0)):
            known.add(axis, x, np.ones(2), np.full(2, i[k]), np.full(2, y[k]), settle)
    return known


@given(frequency=st.floats(2.0, 4400.0), block=st.floats(0.005, 0.5))
def test_a_block_holds_whole_periods_near_the_wanted_frequency(frequency, block):
    periods, samples = whole_periods(frequency, block, RATE)
    assert periods >= 1
    assert samples >= 2
    assert samples / RATE >= min(block, 1 / frequency) * 0.8
    got = periods * RATE / samples
    assert abs(got - frequency) <= frequency * 0.51 / (samples - 1)


@given(frequency=st.floats(200.0, 1000.0))
def test_a_tolerance_is_met_by_a_longer_block(frequency):
    def error(periods, samples):
        assert samples <= 0.1 * RATE + max(0.06 * RATE, 32 * RATE / frequency)
        return abs(periods * RATE / samples - frequency)

    near = error(*whole_periods(frequency, 0.1, RATE, tolerance_hz=0.05))
    anyhow = error(*whole_periods(frequency, 0.1, RATE))
    assert near <= max(0.05, 0.5 * frequency / (1.2 * 0.1 * RATE))
    assert near <= anyhow or near <= 0.05


@given(rate=st.floats(2e3, 50e3), share=st.floats(0.01, 0.45), off=st.floats(0.99, 1.0), block=st.floats(0.005, 0.5))
def test_no_block_comes_out_above_what_the_controller_plays(rate, share, off, block):
    highest = share * rate
    periods, samples = whole_periods(off * highest, block, rate, highest_hz=highest)
    assert periods * rate / samples <= highest * (1 + 1e-12)
    assert abs(periods * rate / samples - off * highest) <= 1.01 * highest / (samples - 1)


@given(
    noise=positive,
    i=st.tuples(positive, positive),
    y=st.tuples(st.floats(1e-10, 1e-2), st.floats(1e-10, 1e-2)),
    frequency=st.floats(10, 1000),
    displacement=st.floats(1e-6, 1e-3),
    current=st.floats(0.1, 20.0),
    largest=st.floats(0.01, 20.0),
    name=st.sampled_from(["coarse", "main", "validation", "amplifier"]),
)
def test_no_tone_is_larger_than_the_rig_may_take(noise, i, y, frequency, displacement, current, largest, name):
    what, known, profile = limits(displacement, current, largest), knowledge(noise, i, y), Profile()
    aim = aims(profile, what)[name]
    both = tones(known, frequency, aim, profile, what)
    assert [t.axis for t in both] == [0, 1]
    assert len({(t.periods, t.samples) for t in both}) == 1
    for t in both:
        response = known.response(t.axis, t.frequency_hz(RATE))
        eps = 1 + 1e-9
        assert 0 < t.amplitude_a <= largest
        assert t.amplitude_a * response.y <= 0.5 * displacement * eps
        assert t.amplitude_a * response.i <= 0.5 * current * eps
        if name != "validation":
            assert t.amplitude_a * response.y <= 0.1 * 80e-6 * eps
        assert t.settle_samples >= RATE / frequency * 0.9


@given(noise=st.floats(0.01, 1.0), frequency=st.floats(10, 1000))
def test_the_amplitude_gives_the_wanted_accuracy_where_nothing_limits_it(noise, frequency):
    what, known, profile = limits(), knowledge(noise), Profile()
    aim = aims(profile, what)["main"]
    tone = tones(known, frequency, aim, profile, what)[0]
    f = tone.frequency_hz(RATE)
    seconds = tone.blocks * tone.samples / RATE
    reached = known.noise_at_unit(0, f) / (tone.amplitude_a * np.sqrt(seconds))
    assert reached == pytest.approx(profile.accuracy, rel=1.1 * STEP_A / tone.amplitude_a)


def test_the_amplitude_follows_equation_318():
    """Twice the noise amplitude, or half the response, asks for twice the excitation."""
    what, profile = limits(), Profile()
    aim = aims(profile, what)["main"]
    one = tones(knowledge(0.01), 100.0, aim, profile, what)[0].amplitude_a
    assert tones(knowledge(0.04), 100.0, aim, profile, what)[0].amplitude_a == pytest.approx(2 * one, abs=2 * STEP_A)
    quiet = knowledge(0.01, y=(1e-9, 1e-9), i=(1e3, 1e3))
    loud = knowledge(0.01, y=(2e-9, 2e-9), i=(1e3, 1e3))
    ratio = quiet.noise_at_unit(0, 100.0) / loud.noise_at_unit(0, 100.0)
    assert ratio == pytest.approx(2, rel=1e-3)


def test_where_the_amplitude_is_limited_time_makes_up_for_it():
    what, profile = limits(), Profile()
    aim = aims(profile, what)["main"]
    free, cut = (tones(knowledge(n), 500.0, aim, profile, what)[0] for n in (0.01, 200.0))
    assert cut.samples > 2 * free.samples


def test_the_first_tone_of_an_axis_is_careful():
    known = Knowledge(knowledge().noise, 2)
    profile = Profile()
    aim = aims(profile, limits())["coarse"]
    assert all(0 < t.amplitude_a <= aim.current_a / 20 for t in tones(known, 1000.0, aim, profile, limits()))


@given(
    noise=positive,
    y=st.tuples(st.floats(1e-9, 1e-3), st.floats(1e-9, 1e-3)),
    frequency=st.floats(10, 1000),
)
def test_the_validation_amplitude_is_another_one(noise, y, frequency):
    what, known, profile = limits(), knowledge(noise, y=y), Profile()
    all_aims = aims(profile, what)
    request = tones(known, frequency, all_aims["validation"], profile, what)[0]
    other = other_amplitude(request, known, all_aims, profile, what)
    main = tones(known, frequency, all_aims["main"], profile, what)[0]
    ratio = other.amplitude_a / main.amplitude_a
    assert not 1 / 1.25 < ratio < 1.25


@given(
    n=st.integers(20, 300),
    resolution=st.floats(0.5, 4.0),
    lines=st.lists(st.floats(10, 1000), max_size=5),
)
def test_a_grid_has_its_number_of_points_and_none_on_a_line(n, resolution, lines):
    f = clear_grid(10.0, 1000.0, n, resolution, tuple(lines))
    assert len(f) == n
    assert f[0] >= 10.0
    assert f[-1] <= 1000.0
    assert np.all(np.diff(f) > 0)
    mains = mains_harmonics(1000.0)
    for line in (*mains, *lines):
        assert np.min(np.abs(f - line)) >= 0.99 * resolution


@given(settle=st.floats(0, 1e4), samples=st.integers(100, 5000))
def test_settling_never_asks_for_more_than_the_controller_takes(settle, samples):
    request = Request(0, 0.1, 5, samples, 6, 100)
    n = longest_settling(request, limits(), settle)
    assert n + 6 * samples <= 100_000
    assert n <= 20 * 6 * samples


def test_caution_after_a_trip_lowers_the_next_tone_and_goes_away_again():
    what, profile = limits(), Profile()
    aim = aims(profile, what)["main"]
    known = knowledge(1e3, y=(1e-4, 1e-4))
    before = tones(known, 100.0, aim, profile, what)[0].amplitude_a
    known.tripped(0)
    after = tones(known, 100.0, aim, profile, what)
    assert after[0].amplitude_a == pytest.approx(0.7 * before, abs=STEP_A)
    assert after[1].amplitude_a == pytest.approx(before)
    for _ in range(10):
        known.held(0)
    assert tones(known, 100.0, aim, profile, what)[0].amplitude_a == pytest.approx(before)


@given(frequency=st.floats(2.0, 4400.0), sweep=st.sampled_from(["coarse", "main", "amplifier"]))
def test_a_rig_without_noise_is_excited_all_the_same(frequency, sweep):
    """A converter coarser than the noise reads none at rest; below the controller's step no amplitude excites."""
    spectra = NoiseSpectra(np.array([1.0, 5000.0]), {s: np.full((2, 2), np.finfo(float).tiny) for s in "uiy"})
    for known in (Knowledge(spectra, 2), knowledge(noise=1e-250)):
        planned = tones(known, frequency, aims(Profile(), limits())[sweep], Profile(), limits())
        assert min(t.amplitude_a for t in planned) >= SMALLEST_A


@given(slew=st.floats(0.0, 1e3), noise=positive)
def test_a_current_that_is_distorted_however_small_leaves_tones_that_can_be_measured(slew, noise):
    """Where a loop that is hardly damped still rings, every current seems to be beyond what the supply can follow."""
    what, known, profile = limits(), knowledge(noise), Profile()
    known.saturated(slew)
    aim = aims(profile, what)["main"]
    free = tones(knowledge(noise), 500.0, aim, profile, what)
    for request, wanted in zip(tones(known, 500.0, aim, profile, what), free, strict=True):
        # a longer block tells as much with less
        told, asked = (tone.amplitude_a**2 * tone.samples for tone in (request, wanted))
        assert 0.02 * aim.current_a <= request.amplitude_a or told >= asked * (1 - 1e-3)


@given(
    frequency=st.floats(20.0, 1000.0),
    most=st.integers(5_000, 65_535),
    settle=st.floats(0.01, 20.0),
    y=st.tuples(st.floats(1e-10, 1e-2), st.floats(1e-10, 1e-2)),
    tolerance=st.floats(1e-3, 10.0),
)
def test_no_tone_is_longer_than_the_controller_takes(frequency, most, settle, y, tolerance):
    few = replace(limits(), max_samples=most)
    profile = Profile()
    for aim in aims(profile, few).values():
        for request in tones(knowledge(y=y, settle=settle), frequency, aim, profile, few, tolerance):
            assert request.settle_samples >= 0
            assert request.settle_samples + request.blocks * request.samples <= most
