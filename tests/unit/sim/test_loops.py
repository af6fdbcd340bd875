"""Hysteresis loops in closed form, against plays stepped through time and what the literature says of them."""

from dataclasses import replace

import numpy as np
import pytest

from sim import actuator, magnetic_force
from sim.effects import effect
from sim.loops import lag
from sim.reference import reference_rig

T = 2048
GRADED = 0.03
"""Share of what all plays add by which the graded few that are stepped for them may miss it, as at 0.5 A."""
PHASE = 2 * np.pi * np.arange(T) / T
IRON = effect("magnetic_hysteresis").on(reference_rig(), loss_angle_rad=0.03).magnets
ALPHA = float(actuator.rayleigh_coefficient(IRON)[0])


def iron(narrowest_a=0.0, widest_inverse_per_a=0.0):
    return replace(IRON, hysteresis_narrowest_a=narrowest_a, hysteresis_widest_inverse_per_a=widest_inverse_per_a)


def wave(amplitude_a, mean_a=0.0):
    return np.repeat((mean_a + amplitude_a * np.cos(PHASE))[None, :, None], 4, axis=2)


def stepped(i, half_widths):
    """Each of these plays over two periods; the second one is steady, (T, R)."""
    at, out = np.zeros(len(half_widths)), []
    for now in np.concatenate([i, i]):
        at = np.clip(at, now - half_widths, now + half_widths)
        out.append(at)
    return np.array(out[len(i) :])


def test_one_play_lags_as_the_literature_says():
    """Its fundamental at twice its width is (1/2 - j/pi) A (Krasnosel'skii and Pokrovskii 1989, chapter 2)."""
    added = lag(iron(0.5, 2.0), wave(1.0, mean_a=5.0))[0, :, 0] / (2 * ALPHA * 0.5)
    assert 2 / T * np.sum(added * np.exp(-1j * PHASE)) == pytest.approx(0.5 - 1j / np.pi, abs=2e-3)
    assert abs(added).max() == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize("amplitude_a", [0.1, 0.5, 1.2])
def test_plays_of_every_width_are_rayleighs_loop(amplitude_a):
    """(1 + alpha A) i +- alpha/2 (A^2 - i^2), + while the current falls (Phil. Mag. 23, 1887)."""
    i = wave(amplitude_a)
    falls = np.where(np.sin(PHASE) >= 0, 1.0, -1.0)[None, :, None]
    law = ALPHA * amplitude_a * i + falls * ALPHA / 2 * (amplitude_a**2 - i**2)
    np.testing.assert_allclose(lag(iron(), i), law, atol=1e-12)


@pytest.mark.parametrize("amplitude_a", [0.05, 0.3, 1.0])
@pytest.mark.parametrize(("narrowest_a", "widest_a"), [(0.0, 0.25), (0.1, 0.25), (0.1, np.inf), (0.2, 0.2)])
def test_a_band_of_plays_is_each_of_them_stepped_through_time(amplitude_a, narrowest_a, widest_a):
    top = min(widest_a, 2.0)
    half_widths = narrowest_a + (top - narrowest_a) * (np.arange(400) + 0.5) / 400
    mean = stepped(amplitude_a * np.cos(PHASE), half_widths).mean(axis=1)
    weight = widest_a if np.isfinite(widest_a) else top - narrowest_a
    found = lag(iron(narrowest_a, 1 / widest_a), wave(amplitude_a))[0, :, 0]
    np.testing.assert_allclose(found, 2 * ALPHA * weight * mean, atol=1e-4 * 2 * ALPHA * amplitude_a)


@pytest.mark.parametrize(("narrowest_a", "widest_inverse_per_a"), [(0.0, 0.0), (0.0, 4.0), (0.1, 0.0), (0.1, 4.0)])
def test_the_time_loops_plays_are_the_same_band(narrowest_a, widest_inverse_per_a):
    m = iron(narrowest_a, widest_inverse_per_a)
    strength, weights, half_widths = actuator.plays(m)
    i = wave(0.5)
    in_time = 2 * strength[0] * stepped(i[0, :, 0], half_widths) @ weights
    np.testing.assert_allclose(in_time, lag(m, i)[0, :, 0], atol=GRADED * np.abs(in_time).max())


@pytest.mark.parametrize(("narrowest_a", "widest_inverse_per_a"), [(0.0, 0.0), (0.1, 4.0), (0.2, 5.0)])
def test_plays_stepped_over_a_current_of_many_turns_are_the_loops_where_it_turns_once(
    narrowest_a, widest_inverse_per_a
):
    m = replace(iron(narrowest_a, widest_inverse_per_a), saturation_current_a=np.full(4, np.inf))
    i = wave(0.5, mean_a=0.1)
    added = magnetic_force.effective(m, i) - i
    np.testing.assert_allclose(
        magnetic_force.effective(m, i, many_turns=True) - i, added, atol=GRADED * np.abs(added).max()
    )


@pytest.mark.parametrize("amplitude_a", [0.04, 0.3, 1.0])
def test_plays_denser_at_some_widths_are_those_plays_in_closed_form_and_in_time(amplitude_a):
    density = (0.0, 20.0, 0.0, 0.0, 5.0, 0.0, 1.5)
    m = replace(iron(0.3, 1 / 0.3), hysteresis_density=density)
    edges = 2.75 * actuator.PLAY_EDGES
    i, expected = amplitude_a * np.cos(PHASE), lag(iron(0.3, 1 / 0.3), wave(amplitude_a))[0, :, 0]
    for more, inner, outer in zip(density, edges[:-1], edges[1:], strict=False):
        half_widths = inner + (outer - inner) * (np.arange(100) + 0.5) / 100
        expected = expected + 2 * ALPHA * more * (outer - inner) * stepped(i, half_widths).mean(axis=1)
    np.testing.assert_allclose(lag(m, wave(amplitude_a))[0, :, 0], expected, atol=2e-4 * np.abs(expected).max())
    strength, weights, half_widths = actuator.plays(m)
    in_time = 2 * strength[0] * stepped(i, half_widths) @ weights
    np.testing.assert_allclose(in_time, expected, atol=GRADED * np.abs(expected).max())


def test_a_band_that_narrows_becomes_one_play():
    i = wave(0.5)
    np.testing.assert_allclose(lag(iron(0.1, 1 / 0.10001), i), lag(iron(0.1, 10.0), i), atol=1e-5)
    np.testing.assert_array_equal(lag(iron(0.1, 40.0), i), lag(iron(0.1, 10.0), i))


def test_plays_that_are_never_crossed_do_not_move():
    assert not lag(iron(0.5, 1.0), wave(0.3)).any()


def test_more_lag_than_any_loop_has_is_the_densest_loop_and_not_one_that_gains():
    """The lag of a Rayleigh loop comes near atan(4 / (3 pi)) (Phil. Mag. 23, 1887); ranges scale beyond it."""
    angles = np.array([0.3, 0.37, 0.41, 0.9])
    dense = actuator.rayleigh_coefficient(replace(IRON, hysteresis_rad=angles))
    assert np.all(np.diff(dense) >= 0)
    assert np.all(dense > 0)
