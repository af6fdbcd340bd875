"""Steady states of amplifiers at their slew limit, against what is known in closed form."""

import numpy as np
import pytest

from sim.periodic import held_slewing, slewing

T = 2048
PHASE = 2 * np.pi * np.arange(T) / T


def fundamental(x):
    return 2 / T * np.sum(x * np.exp(-1j * PHASE))


def test_far_beyond_its_limit_an_amplifier_makes_a_triangle():
    """A current that slews all the time is a triangle of slope s: amplitude s T / 4, fundamental 8/pi^2 of it."""
    hz, w, damping, limit = 2000.0, 9244.0, 1.6 * 9244.0, np.array([1000.0])
    asked = 6.0 * limit[0] * np.cos(PHASE)[None, :, None]
    taken = slewing(asked, np.array([1 / hz / T]), np.array([w]), np.array([damping]), 0.0, limit, False)
    s = 2j * np.pi * hz
    per_slew = (s + damping) / (s**2 + damping * s + w**2)
    i = fundamental(asked[0, :, 0]) / s + per_slew * fundamental(taken[0, :, 0])
    assert abs(i) == pytest.approx(limit[0] / (4 * hz) * 8 / np.pi**2, rel=0.02)


def stepped_held(asked, period, late, lag_s, w, limit, steps):
    """The same first-order amplifier with and without its limit by many short steps, at the samples."""
    dt, i, free, lagged, out = period / steps, asked[0], asked[0], asked[0], []
    for k in range(len(asked) - 1):
        out.append(i - free)
        for s in range(steps):
            goal = asked[k] if (s + 0.5) * dt < late else asked[k + 1]
            lagged = goal + (lagged - goal) * np.exp(-dt / lag_s) if lag_s else goal
            i += dt * min(max(w * (lagged - i), -limit), limit)
            free += dt * w * (lagged - free)
    return np.array(out)


@pytest.mark.parametrize("late", [0.0, 13e-6, 80e-6])
@pytest.mark.parametrize(
    ("lag_s", "limit", "off_a"), [(0.0, 4000.0, 3e-4), (5e-6, 4000.0, 3e-3), (40e-6, 4000.0, 1e-3), (0.0, 400.0, 3e-4)]
)
def test_a_first_order_amplifier_slews_as_its_held_signal_steps(late, lag_s, limit, off_a):
    """At 400 A/s it is at its limit nearly always, and forgets where it began only after many periods."""
    asked, w, settling = 1.1 * np.cos(2 * np.pi * 700.0 * 1e-4 * np.arange(-1, 1030)), 9244.0, 1000
    expected = stepped_held(asked, 1e-4, late, lag_s, w, limit, 1000)[settling:]
    two, limits = asked[:, None] * np.ones(2), np.array([limit, np.inf])
    found = held_slewing(two, settling, 1e-4, np.full(2, late), lag_s, np.full(2, w), limits, 16, np.zeros(2))
    assert np.abs(expected).max() > 0.03
    np.testing.assert_allclose(found[::16, 0], expected, rtol=0, atol=off_a)
    assert np.all(found[:, 1] == 0.0)


def test_below_its_limit_nothing_is_taken():
    asked = 900.0 * np.cos(PHASE)[None, :, None]
    dt = np.array([1 / 200.0 / T])
    assert np.all(
        slewing(asked, dt, np.array([9244.0]), np.array([1.6 * 9244.0]), 0.5, np.array([1000.0]), False) == 0.0
    )


@pytest.mark.parametrize(("tone", "share"), [(0.7, 0.1), (0.95, 0.1), (1.4, 0.2), (0.4, 0.4)])
def test_noise_reaches_a_limit_that_the_tone_alone_does_not(tone, share):
    """What is taken off is the mean over the noise: by many draws of it."""
    limit, fast = 1000.0, 1e-3  # of a loop so slow that what is taken off changes nothing of what it asks for
    asked = tone * limit * np.cos(PHASE[::64])[None, :, None]
    taken = slewing(
        asked, np.array([1e-6]), np.array([fast]), np.array([fast]), 0.0, np.array([limit]), False, share * limit
    )
    drawn = asked + share * limit * np.random.default_rng(5).standard_normal((40_000, 1, 1))
    mean = (np.clip(drawn, -limit, limit) - drawn).mean(axis=0)
    np.testing.assert_allclose(taken[0], mean, rtol=0, atol=4 * share * limit / 200)
    assert np.abs(mean).max() > 10 * share * limit / 200 or tone < 0.8


def stepped(hz, amplitude_a, w, zeta, limit, i, q, periods=40, steps=4000):
    """The same amplifier by explicit Euler of its own equations, q' = w^2 (u - i) - 2 zeta w i', i' = clip(q)."""
    dt, out = 1 / hz / steps, np.empty(steps)
    for n in range(periods * steps):
        slope = min(max(q, -limit), limit)
        q += dt * (w**2 * (amplitude_a * np.cos(2 * np.pi * hz * n * dt) - i) - 2 * zeta * w * slope)
        i += dt * slope
        out[n % steps] = i
    return 2 * np.mean(out * np.exp(-2j * np.pi * np.arange(steps) / steps))


@pytest.mark.parametrize("opposed", [False, True])
def test_a_loop_that_winds_up_settles_in_two_ways_and_both_are_found(opposed):
    """A fifth beyond its limit it lags by 30 degrees as it came from below, by 144 when it was disturbed."""
    hz, u, w, zeta, limit = 425.0, 0.817, 9244.0, 0.8, 1816.0
    s = 2j * np.pi * hz
    without = w**2 / (s**2 + 2 * zeta * w * s + w**2) * u
    asked = (without * s * np.exp(1j * PHASE)).real[None, :, None]
    taken = slewing(
        asked, np.array([1 / hz / T]), np.array([w]), np.array([2 * zeta * w]), 1.0, np.array([limit]), opposed
    )
    i = without + s / (s**2 + 2 * zeta * w * s + w**2) * fundamental(taken[0, :, 0])
    begin = (0.0, 0.0) if opposed else (without.real, (without * s).real)
    assert i == pytest.approx(stepped(hz, u, w, zeta, limit, *begin, periods=25), abs=0.01)
    assert np.degrees(np.angle(i)) == pytest.approx(-144 if opposed else -30, abs=2)


@pytest.mark.parametrize(("over", "seen"), [(0.97, 1.0), (0.97, 0.5), (1.2, 0.0)])
@pytest.mark.parametrize("hz", [100.0, 425.0, 900.0])
def test_below_its_limit_or_without_seeing_it_a_loop_settles_in_one_way(hz, over, seen):
    """The other one is not searched for there."""
    w, dt, asked = np.array([9244.0]), np.array([1 / hz / T]), over * 1000.0 * np.cos(PHASE)[None, :, None]
    one, other = (slewing(asked, dt, w, 1.6 * w, seen, np.array([1000.0]), opposed) for opposed in (False, True))
    np.testing.assert_allclose(other, one, rtol=0, atol=2.0)


def test_an_axis_that_does_not_reach_its_limit_is_not_stepped():
    asked = 1500.0 * np.cos(PHASE)[None, :, None] * np.ones(2)
    two = (np.array([1 / 200.0 / T]), np.full(2, 9244.0), np.full(2, 1.6 * 9244.0), 0.5, np.full(2, 1000.0), False)
    taken = slewing(asked, *two, reached=np.array([[True, False]]))
    assert np.abs(taken[..., 0]).max() > 100.0
    np.testing.assert_array_equal(taken[..., 1], 0.0)
