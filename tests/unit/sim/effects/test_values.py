"""Each parameter of an effect moves the figure of the rig that it names, in its unit and by its value."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import bilinear

from sim import actuator, amplifier, control_law, sensor
from sim.effects import CATALOGUE, effect
from sim.effects.controller_mismatch import corners_rad_s
from sim.errors import EffectError
from sim.imbalance import of_shares
from sim.measured import measured_responses
from sim.reference import pid_with_biquad, reference_rig
from sim.rig import ControlLaw, Rig
from sim.twin import linear_model

RIG = reference_rig()


def alone(name: str, rig: Rig = RIG, **values: float) -> Rig:
    """The rig with an effect of which only the given parameters differ from null."""
    return effect(name).on(rig, **{**CATALOGUE[name].null(), **values})


def test_controller_gain_is_of_the_whole_controller():
    changed = control_law.response(alone("controller_mismatch", gain_change=0.1).controller, np.array([50.0, 5000.0]))
    np.testing.assert_allclose(changed, 1.1 * control_law.response(RIG.controller, np.array([50.0, 5000.0])), rtol=1e-9)


@pytest.mark.parametrize(
    ("change", "tuned"),
    [("derivative_change", {"derivative_as_per_m": 88.0}), ("integral_change", {"integral_a_per_ms": 1.1 * 36e3})],
)
def test_controller_parts_are_those_of_the_pid(change: str, tuned: dict[str, float]):
    """Of the reference PID, Kd/Kp = 80/18e3 s and Ki/Kp = 2/s: its zeros are near 225 and 2 rad/s."""
    assert corners_rad_s(RIG.controller) == pytest.approx((2.0, 18e3 / 80), rel=0.05)
    omega = 2 * np.pi * np.array([0.1, 0.5, 2.0, 20.0, 60.0, 200.0, 800.0])
    changed = control_law.response(alone("controller_mismatch", **{change: 0.1}).controller, omega)
    exact = control_law.response(ControlLaw(*pid_with_biquad(**tuned), 1e-4), omega)
    before = control_law.response(RIG.controller, omega)
    assert np.all(np.abs(changed - exact) < 0.03 * np.abs(exact - before) + 1e-4 * np.abs(before))


def test_a_controller_that_never_leads_or_lags_still_has_corners():
    assert corners_rad_s(ControlLaw(np.array([5.0]), np.array([1.0]), 1e-4)) == pytest.approx((6.283, 628.3), rel=1e-3)


def test_controller_lag_is_a_share_of_a_sample():
    omega = np.array([2 * np.pi * 20.0])
    lagged = control_law.response(alone("controller_mismatch", lag_samples=0.2).controller, omega)
    ratio = lagged / control_law.response(RIG.controller, omega)
    assert np.angle(ratio[0]) == pytest.approx(-0.2 * omega[0] * 1e-4, rel=1e-3)


def test_controller_filters_are_tuned_to_another_frequency_and_damping():
    omega = 2 * np.pi * np.array([2.0, 200.0, 700.0, 780.0, 2000.0])
    damping = {"notch_zero_damping_change": 0.5, "notch_pole_damping_change": -0.2}
    tuned = {"notch_frequency_change": 0.04, **damping}
    changed = control_law.response(alone("controller_mismatch", **tuned).controller, omega)
    b, a = pid_with_biquad(notch_hz=1.04 * 750.0, notch_damping=(1.5 * 0.2, 0.8 * 0.7))
    np.testing.assert_allclose(changed, control_law.response(ControlLaw(b, a, 1e-4), omega), rtol=1e-6)


@pytest.mark.parametrize(
    ("change", "tuned"),
    [
        ({"notch_frequency_change": 0.1}, {"notch_hz": 1.1 * 440.0}),
        ({"lowpass_frequency_change": -0.1}, {"lowpass_hz": 0.9 * 1800.0}),
        ({"lowpass_damping_change": 0.2}, {"lowpass_damping": 1.2 * 0.6}),
        ({"rolloff_frequency_change": 0.5}, {"rolloff_hz": 1.5 * 1200.0}),
    ],
)
def test_each_filter_of_a_controller_is_tuned_by_itself(change: dict[str, float], tuned: dict[str, float]):
    """A PID with a low-pass filter, a notch and the roll-off of its derivative part, each written in s."""
    rig = replace(RIG, controller=_pid_with_filters())
    changed = alone("controller_mismatch", rig, **change).controller
    omega = 2 * np.pi * np.array([2.0, 100.0, 430.0, 500.0, 1500.0, 3000.0])
    expected = control_law.response(_pid_with_filters(**tuned), omega)
    np.testing.assert_allclose(control_law.response(changed, omega), expected, rtol=1e-6)


def _pid_with_filters(
    notch_hz: float = 440.0, lowpass_hz: float = 1800.0, lowpass_damping: float = 0.6, rolloff_hz: float = 1200.0
) -> ControlLaw:
    """K (1 + wi/s) (s/wd + 1) / (s/wr + 1) with a notch and a low-pass filter, by Tustin's rule at 10 kHz."""
    wi, wd, wr, wn, wl = 2 * np.pi * np.array([0.5, 40.0, rolloff_hz, notch_hz, lowpass_hz])
    numerator, denominator = 3e4 * np.polymul([1.0, wi], [1 / wd, 1.0]), np.array([1 / wr, 1.0, 0.0])
    numerator = np.polymul(numerator, [1 / wn**2, 2 * 0.05 / wn, 1.0])
    denominator = np.polymul(denominator, [1 / wn**2, 2 * 0.4 / wn, 1.0])
    denominator = np.polymul(denominator, [1 / wl**2, 2 * lowpass_damping / wl, 1.0])
    b, a = bilinear(numerator, denominator, 1e4)
    return ControlLaw(np.asarray(b), np.asarray(a), 1e-4)


def test_a_controller_without_filters_has_none_to_tune():
    law = ControlLaw(np.array([3.0, -2.0]), np.array([1.0, -0.5]), 1e-4)
    tuned = alone("controller_mismatch", replace(RIG, controller=law), notch_frequency_change=0.04).controller
    omega = np.array([50.0, 5000.0])
    np.testing.assert_allclose(control_law.response(tuned, omega), control_law.response(law, omega), rtol=1e-12)


def test_a_controller_of_one_axis_alone_runs_as_its_linear_model_says():
    one = {"gain_change": 0.01, "derivative_change": 0.01, "lag_samples": 0.01, "notch_frequency_change": 0.01}
    rig = alone("controller_mismatch", **one, end_imbalance=-1.0, plane_imbalance=1.0)
    hz = np.array([47.0, 489.0])
    changed = np.abs(linear_model(rig, hz).controllers / linear_model(RIG, hz).controllers - 1)
    assert np.all(changed[:, 1] > 0.02)
    np.testing.assert_allclose(changed[:, [0, 2, 3]], 0.0, atol=1e-8)
    found, model = measured_responses(rig, hz), linear_model(rig, hz)
    np.testing.assert_allclose(found.u_per_r, model.u_per_r, atol=1e-3 * np.abs(model.u_per_r).max())


def test_magnets_turned_as_a_whole_push_along_turned_axes_of_a_rotor_that_is_alike_in_both():
    """Where x and y are alike, turned axes pull with displacement as before, and only currents act across."""
    alike = replace(RIG.magnets, ki=np.tile(RIG.magnets.ki[:2], 2), ks=np.tile(RIG.magnets.ks[:2], 2))
    rig, hz, angle = replace(RIG, magnets=alike), np.array([14.0, 90.0, 480.0]), 0.03
    c, s = np.cos(angle), np.sin(angle)
    turn = np.kron(np.array([[c, s], [-s, c]]), np.eye(2))
    whole = alone("magnetic_cross_coupling", rig, rotation_rad=angle, turned_whole=1.0)
    before = linear_model(rig, hz).y_per_i
    np.testing.assert_allclose(linear_model(whole, hz).y_per_i, before @ turn, atol=1e-9 * np.abs(before).max())


def test_a_sensor_elsewhere_sees_a_mode_by_its_shape_there():
    moved = alone("sensor_position", shift_A_m=0.01, shift_B_m=-0.02, mode2_slope_A_per_m_sqrt_kg=1.5)
    for before, after in zip(RIG.rotor.modes, moved.rotor.modes, strict=True):
        changes = np.subtract([m.shape_at_sensors for m in after], [m.shape_at_sensors for m in before])
        np.testing.assert_allclose(changes, [[0.0, 0.0], [0.015, 0.0]], atol=1e-15)


def test_crosstalk_of_one_plane_alone_leaves_the_other_without():
    crosstalk = alone("channel_crosstalk", share_ab=0.02, share_ba=0.01, plane_imbalance=-1.0).amplifiers.crosstalk
    np.testing.assert_array_equal(crosstalk[:2, :2], np.eye(2))
    np.testing.assert_allclose(crosstalk[2:, 2:], [[1.0, 0.04], [0.02, 1.0]])


def test_amplifiers_change_in_frequency_and_damping():
    a = alone("amplifier_bandwidth", frequency_change=-0.13).amplifiers
    np.testing.assert_allclose(a.natural_frequency_rad_s, 0.87 * RIG.amplifiers.natural_frequency_rad_s)
    np.testing.assert_array_equal(a.damping_ratio, RIG.amplifiers.damping_ratio)
    b = alone("amplifier_bandwidth", damping_change=0.2).amplifiers
    np.testing.assert_allclose(b.damping_ratio, 1.2 * RIG.amplifiers.damping_ratio)


def test_first_order_amplifiers_have_no_damping_to_change():
    first = replace(RIG, amplifiers=replace(RIG.amplifiers, damping_ratio=None))
    changed = alone("amplifier_bandwidth", first, frequency_change=0.1, damping_change=0.3)
    assert changed.amplifiers.damping_ratio is None


def test_the_voltage_limit_is_the_inverse_of_its_parameter_and_the_tighter_one_counts():
    limited = alone("amplifier_voltage_limit", slew_inverse_s_per_a=5e-4)
    np.testing.assert_allclose(limited.amplifiers.slew_limit_a_per_s, 2000.0)
    again = alone("amplifier_voltage_limit", limited, slew_inverse_s_per_a=1e-4)
    np.testing.assert_allclose(again.amplifiers.slew_limit_a_per_s, 2000.0)


def test_crosstalk_ab_is_what_u_of_b_does_to_the_current_of_a():
    model = linear_model(alone("channel_crosstalk", share_ab=0.03), np.array([10.0]))
    ratio = model.i_per_u[0] / np.diag(model.i_per_u[0])[:, None]
    expected = np.eye(4)
    expected[0, 1] = expected[2, 3] = 0.03
    np.testing.assert_allclose(np.abs(ratio), expected, atol=1e-12)


def test_eddy_currents_in_series_add_the_roots_of_their_time_constants():
    twice = alone("eddy_currents", alone("eddy_currents", time_constant_s=1e-6), time_constant_s=4e-6)
    np.testing.assert_allclose(twice.magnets.eddy_time_constant_s, 9e-6)


def test_saturations_in_series_add_their_cubic_terms():
    twice = alone("magnetic_saturation", alone("magnetic_saturation", saturation_inverse_per_a=0.3),
                  saturation_inverse_per_a=0.4)  # fmt: skip
    np.testing.assert_allclose(twice.magnets.saturation_current_a, 2.0)


def test_offsets_and_gains_are_those_of_their_axis():
    np.testing.assert_array_equal(alone("off_centre_rotor", offset_xB_m=2e-5).magnets.offset_m, [0, 2e-5, 0, 0])
    np.testing.assert_allclose(alone("sensor_gain", gain_change_yA=-0.05).sensors.gain, [1, 1, 0.95, 1])


def test_mass_and_inertia_change_apart():
    heavier = alone("rotor_inertia", mass_change=0.1).rotor
    assert (heavier.mass_kg, heavier.transverse_inertia_kgm2) == pytest.approx((308.0, 10.87))
    longer = alone("rotor_inertia", inertia_change=0.1).rotor
    assert (longer.mass_kg, longer.transverse_inertia_kgm2) == pytest.approx((280.0, 11.957))


def test_a_centre_of_gravity_nearer_to_a_is_farther_from_b():
    overhung = alone("rotor_inertia", centre_shift_m=0.01).rotor
    for places in ("bearing_from_cog_m", "sensor_from_cog_m"):
        (a, b), (own_a, own_b) = getattr(RIG.rotor, places), getattr(overhung, places)
        assert (own_a, own_b) == pytest.approx((a - 0.01, b + 0.01))


def test_sensors_move_away_from_the_centre_of_gravity():
    rotor = effect("sensor_position").on(RIG, shift_A_m=0.01, shift_B_m=0.02).rotor
    assert rotor.sensor_from_cog_m == pytest.approx((0.494, 0.49))
    assert rotor.bearing_from_cog_m == RIG.rotor.bearing_from_cog_m
    assert rotor.modes == RIG.rotor.modes


def test_an_extra_mode_is_in_both_planes_behind_the_others():
    rotor = effect("extra_flexible_mode").on(RIG, frequency_hz=300.0, bearing_A_per_sqrt_kg=0.05).rotor
    for plane in rotor.modes:
        assert len(plane) == 3
        assert plane[-1].natural_frequency_rad_s == pytest.approx(2 * np.pi * 300.0)
        assert plane[-1].shape_at_bearings == (0.05, -0.02)


def test_damping_changes_by_the_exponential_of_its_parameter_mode_by_mode():
    for first, second, plane in zip(
        alone("modal_damping", mode1_log_ratio=1.1).rotor.modes,
        alone("modal_damping", mode2_log_ratio=-0.5).rotor.modes,
        RIG.rotor.modes,
        strict=True,
    ):
        ratios = [m.damping_ratio / k.damping_ratio for m, k in zip(first, plane, strict=True)]
        assert ratios == pytest.approx([np.exp(1.1), 1.0])
        ratios = [m.damping_ratio / k.damping_ratio for m, k in zip(second, plane, strict=True)]
        assert ratios == pytest.approx([1.0, np.exp(-0.5)])


def test_drifts_add_their_rates():
    once = alone("thermal_drift", ki_change=-0.1, duration_s=100.0)
    twice = alone("thermal_drift", once, ks_change=0.04, duration_s=200.0)
    assert twice.drift is not None
    gone = twice.drift.over(200.0)
    assert gone.ki_change == pytest.approx(np.full(4, -0.2))
    assert gone.ks_change == pytest.approx(np.full(4, 0.04))


def test_a_drift_that_levels_off_levels_off_with_more_of_it_too():
    once = alone("thermal_drift", ki_change=-0.1, ks_change=0.0, duration_s=100.0, curvature=3.0)
    more = alone("thermal_drift", once, ki_change=-0.02, ks_change=0.0, duration_s=50.0)
    assert once.drift is not None
    assert more.drift is not None
    assert more.drift.over(50.0).ki_change == pytest.approx(once.drift.over(50.0).ki_change - 0.02)
    assert (more.drift.duration_s, more.drift.curvature) == (100.0, 3.0)


def test_one_amplifier_alone_may_be_slower():
    """What is stated is the largest change, so that no imbalance makes it one that no amplifier has."""
    rig = alone("amplifier_bandwidth", frequency_change=-0.2, end_imbalance=-1.0, plane_imbalance=-1.0)
    ratio = rig.amplifiers.natural_frequency_rad_s / RIG.amplifiers.natural_frequency_rad_s
    assert ratio == pytest.approx([1.0, 1.0, 1.0, 0.8])
    half = alone("amplifier_bandwidth", frequency_change=0.4, end_imbalance=1 / 3).amplifiers
    ratio = half.natural_frequency_rad_s / RIG.amplifiers.natural_frequency_rad_s
    assert ratio == pytest.approx([1.4, 1.2, 1.4, 1.2])


def test_amplifiers_may_each_have_changed_on_their_own_and_the_other_way():
    """xA slower by a fifth, xB not at all, yA slower by a tenth, yB faster by a twentieth."""
    over = np.array([-0.2, 0.0, -0.1, 0.05]) / -0.2
    shapes = of_shares(dict(zip(RIG.axes, (over + 0.25) / 1.25, strict=True)))
    rig = alone("amplifier_bandwidth", frequency_change=-0.2, opposite_share=0.25, **shapes)
    ratio = rig.amplifiers.natural_frequency_rad_s / RIG.amplifiers.natural_frequency_rad_s
    assert ratio == pytest.approx([0.8, 1.0, 0.9, 1.05])
    far = alone("amplifier_bandwidth", frequency_change=2.0, end_imbalance=1.0, opposite_share=1.0).amplifiers
    assert far.natural_frequency_rad_s.min() > 0, "an amplifier that is slower is no rig that cannot be"


@pytest.mark.parametrize(
    ("end", "plane", "of_axes"),
    [(0.0, 0.0, (1, 1, 1, 1)), (1.0, 0.0, (2, 0, 2, 0)), (0.0, -1.0, (0, 0, 2, 2)), (-1.0, 1.0, (0, 4, 0, 0))],
)
def test_a_drift_may_be_of_one_end_or_plane_or_axis(end, plane, of_axes):
    """What is stated is the mean of all axes: xA, xB, yA, yB."""
    rig = alone("thermal_drift", ki_change=-0.01, ks_change=-0.02, end_imbalance=end, plane_imbalance=plane)
    assert rig.drift is not None
    assert rig.drift.ki_change == pytest.approx(-0.01 * np.array(of_axes))
    assert rig.drift.ks_change == pytest.approx(-0.02 * np.array(of_axes))


def test_a_drift_that_levels_off_is_restated_over_half_its_time():
    """1 - exp(-c t/T) at T/2 for c = 2: (1 - 1/e) / (1 - 1/e^2) of the change, half as much of it levelled off."""
    values = {"ki_change": -0.1, "ks_change": 0.05, "duration_s": 200.0, "curvature": 2.0}
    half = effect("thermal_drift").restated(values, {**values, "duration_s": 100.0})
    share = 1 / (1 + np.exp(-1.0))
    assert half == pytest.approx(
        {"ki_change": -0.1 * share, "ks_change": 0.05 * share, "duration_s": 100.0, "curvature": 1.0}
    )


def test_a_mode_shape_takes_the_sign_of_another():
    p = {q.name: q.typical for q in effect("extra_flexible_mode").parameters}
    flipped = {k: -v if k.endswith("sqrt_kg") else v for k, v in p.items()}
    assert effect("extra_flexible_mode").restated(flipped, p) == p


def test_a_rig_has_one_support_and_one_contact():
    with pytest.raises(EffectError, match="already has a resonant support"):
        effect("support_resonance").on(effect("support_resonance").on(RIG))
    with pytest.raises(EffectError, match="already has a contact"):
        effect("touchdown_contact").on(effect("touchdown_contact").on(RIG))
    support = effect("support_resonance").on(RIG, inverse_mass_per_kg=1 / 500, frequency_hz=100.0).support
    assert support is not None
    assert (support.mass_kg, support.natural_frequency_rad_s) == pytest.approx((500.0, 628.3185))


def test_hum_is_at_multiples_of_the_mains_and_runout_at_the_speed():
    hum = alone("mains_interference", amplitude_m=1e-7, frequency_hz=60.0).disturbances
    assert [d.fixed_hz for d in hum] == [60.0, 120.0, 180.0, 300.0]
    assert {d.target for d in hum} == {"y"}
    np.testing.assert_allclose(hum[0].amplitude, 1e-7)
    (mark,) = alone("runout", amplitude_m=2e-6).disturbances
    assert (mark.order, mark.fixed_hz, mark.target) == (1.0, 0.0, "y")
    np.testing.assert_allclose(mark.phase_rad, [0, 0, -np.pi / 2, -np.pi / 2])


def test_eddy_currents_of_sheets_end_where_all_of_the_reluctance_is_iron():
    """x coth x, x = sqrt(s mu sigma d^2/4), is what sheets of thickness d do to a circuit without an air gap."""
    t = 1e-4  # mu sigma d^2, s
    s = 1j * np.geomspace(1e-2, 3e6, 60) / t
    x = np.sqrt(s * t / 4)
    sheets = np.tanh(x) / x
    exact = alone("eddy_currents", time_constant_s=t / 4, corner_rad_s=9 / t).magnets
    law = actuator.eddy_response(t / 4, exact.eddy_corner_rad_s, s)
    np.testing.assert_allclose((1 - law).imag[0], (1 - sheets).imag[0], rtol=1e-3)  # the same first-order lag low down
    np.testing.assert_allclose(law[-1], sheets[-1], rtol=1e-3)  # and half-order one high up
    assert np.abs(law / sheets - 1).max() < 0.125
    beyond = alone("eddy_currents", time_constant_s=t / 4, corner_rad_s=3e5).magnets
    assert beyond.eddy_corner_rad_s == exact.eddy_corner_rad_s


def test_a_solid_part_beside_laminated_iron_holds_back_its_own_share_of_the_flux_alone():
    """A slab that carries a twentieth of the flux: 0.95 + 0.05 tanh(x)/x."""
    t, share = 8e-3, 0.05
    s = 1j * np.geomspace(1.0, 3e5, 60)
    x = np.sqrt(s * t / 4)
    values = {"time_constant_s": share**2 * t / 4, "corner_rad_s": 9 / t, "free_share": 1 - share}
    m = alone("eddy_currents", **values).magnets
    assert m.eddy_corner_rad_s == pytest.approx(9 / t)
    law = actuator.eddy_factor(m, s.imag)[:, 0]
    assert np.abs(law - (1 - share + share * np.tanh(x) / x)).max() < 0.125 * share
    assert law[-1].real == pytest.approx(1 - share, abs=1e-2)


def test_amplifiers_that_lack_the_term_of_second_order_are_of_first_order():
    """With q = 1 wa^2/(s^2 + 2 za wa s + wa^2) would be w/(s + w) with w = wa / (2 za)."""
    slow, omega = alone("amplifier_bandwidth", first_order_share=0.998), 2 * np.pi * np.array([10.0, 200.0, 1000.0])
    s, own = 1j * omega[:, None], RIG.amplifiers
    assert own.damping_ratio is not None
    w = own.natural_frequency_rad_s / (2 * own.damping_ratio)
    np.testing.assert_allclose(amplifier.continuous(slow.amplifiers, omega), own.gain * w / (s + w), rtol=2e-3)


@pytest.mark.parametrize("term", [0.65, 1e-6])
def test_amplifiers_stated_as_of_first_order_have_a_term_of_second(term: float):
    first = replace(RIG, amplifiers=replace(RIG.amplifiers, damping_ratio=None))
    changed, omega = alone("amplifier_bandwidth", first, second_order_term=term), 2 * np.pi * np.array([10.0, 991.0])
    s = 1j * omega[:, None] / RIG.amplifiers.natural_frequency_rad_s
    law = RIG.amplifiers.gain / (term * s**2 + s + 1)
    np.testing.assert_allclose(amplifier.continuous(changed.amplifiers, omega), law, rtol=2e-4)
    damped = alone("amplifier_bandwidth", first, second_order_term=term, damping_change=0.5).amplifiers
    np.testing.assert_array_equal(damped.damping_ratio, changed.amplifiers.damping_ratio)  # none is stated to change
    of_first = alone("amplifier_bandwidth", first, frequency_change=0.1).amplifiers
    assert of_first.damping_ratio is None
    assert alone("amplifier_bandwidth", second_order_term=term).amplifiers.damping_ratio == pytest.approx(
        RIG.amplifiers.damping_ratio
    )


@pytest.mark.parametrize("share", [0.5, 1.0])
def test_a_sensor_pole_that_has_moved_leaves_none_where_it_was(share: float):
    """From 12 to 5 kHz, all of it or half: in time what the frequency-domain model says."""
    rig = replace(RIG, sensors=replace(RIG.sensors, bandwidth_rad_s=np.full(4, 2 * np.pi * 12e3)))
    slower_s = (1 / 5e3 - 1 / 12e3) / (2 * np.pi)
    changed = alone("sensor_lag", rig, time_constant_s=slower_s, moved_share=share)
    omega = 2 * np.pi * np.array([100.0, 991.0, 3000.0])
    s, left_s = 1j * omega[:, None], (1 - share) / (2 * np.pi * 12e3)
    np.testing.assert_allclose(
        sensor.response(changed.sensors, omega) * (1 + s * left_s) * (1 + s * (1 / (2 * np.pi * 5e3) - left_s)),
        np.tile(RIG.sensors.gain, (3, 1)),
        rtol=1e-12,
    )
    found, model = measured_responses(changed, omega[:2] / (2 * np.pi)), linear_model(changed, omega[:2] / (2 * np.pi))
    apart = np.linalg.norm(found.y_per_u - model.y_per_u, axis=(1, 2)) / np.linalg.norm(model.y_per_u, axis=(1, 2))
    assert apart.max() < 2e-4


ONE_PLANE, SOFTER = {"plane_imbalance": -0.9}, {"plane_imbalance": 0.3, "plane_frequency_ratio": 1.2}


@pytest.mark.parametrize("planes", [{}, ONE_PLANE, SOFTER])
@pytest.mark.parametrize(("at_a", "at_b"), [(0.03, 0.01), (0.0, 0.02), (-0.02, -0.03)])
def test_a_support_likened_to_a_mode_leans_as_it_does(at_a: float, at_b: float, planes: dict[str, float]):
    ends = {f"{place}_{end}_per_sqrt_kg": v for place in ("bearing", "sensor") for end, v in (("A", at_a), ("B", at_b))}
    values = {"frequency_hz": 310.0, "damping_ratio": 0.01, **ends, **planes}
    (likened,) = CATALOGUE["support_resonance"].likened["extra_flexible_mode"](values)
    assert_alike({"extra_flexible_mode": values, "support_resonance": likened})


@pytest.mark.parametrize("planes", [{}, ONE_PLANE, SOFTER])
def test_a_mode_likened_to_a_support_is_its_in_either_plane(planes: dict[str, float]):
    values = {"inverse_mass_per_kg": 9e-4, "frequency_hz": 310.0, "damping_ratio": 0.01, **planes}
    (likened,) = CATALOGUE["extra_flexible_mode"].likened["support_resonance"](values)
    assert_alike({"extra_flexible_mode": likened, "support_resonance": values})


def assert_alike(effects: dict[str, dict[str, float]]) -> None:
    """The rig answers to either of two effects with the same change, on the flanks of a resonance at 310 Hz.

    Nearly so in planes that differ: there a mode's force and displacement at a bearing change alike, which magnets that
    pull on it feel twice.
    """
    hz = np.array([50.0, 280.0, 500.0])
    plain = linear_model(RIG, hz).y_per_u
    one, other = (linear_model(effect(name).on(RIG, **own), hz).y_per_u - plain for name, own in effects.items())
    alike = not any("plane_imbalance" in own for own in effects.values())
    np.testing.assert_allclose(one, other, rtol=0, atol=(1e-7 if alike else 0.04) * np.abs(one).max())


def test_a_mode_that_swings_is_likened_to_what_of_it_translates_and_to_a_housing_that_rocks():
    shape = {"bearing_A_per_sqrt_kg": 0.05, "bearing_B_per_sqrt_kg": -0.02}
    shape |= {"sensor_A_per_sqrt_kg": 0.06, "sensor_B_per_sqrt_kg": -0.02}
    likened = CATALOGUE["support_resonance"].likened["extra_flexible_mode"]
    mean = {"inverse_mass_per_kg": 0.03 * 0.04 / 4, "frequency_hz": 310.0, "damping_ratio": 0.01}
    translates, *rocking = likened({"frequency_hz": 310.0, "damping_ratio": 0.01, **shape})
    assert translates == pytest.approx(mean)
    for own in rocking:
        assert own["rocking"] * own["inverse_mass_per_kg"] == pytest.approx(0.035 * 0.04), "its residue at the ends"
        assert own["frequency_hz"] * own["rocking_frequency_ratio"] == pytest.approx(310.0)
        assert own["damping_ratio"] * own["rocking_damping_quotient"] == pytest.approx(0.01)
    assert min(own["frequency_hz"] for own in rocking) < 200 < 600 < max(own["frequency_hz"] for own in rocking)
    for next_to_nothing in (-1e-5, 1e-5):
        at_a = {**shape, "bearing_B_per_sqrt_kg": -1e-5, "sensor_B_per_sqrt_kg": next_to_nothing}
        (alone,) = likened({"frequency_hz": 310.0, "damping_ratio": 0.01, **at_a})
        assert 0.9999 < alone["end_imbalance"] <= 1.0, "next to nothing at the other end, whichever way"
    against = {**shape, "sensor_A_per_sqrt_kg": -0.06}
    assert not likened({"frequency_hz": 310.0, "damping_ratio": 0.01, **against})


def test_a_housing_likened_to_a_mode_rocks_as_it_swings():
    (a, b), (sa, sb) = RIG.rotor.bearing_from_cog_m, RIG.rotor.sensor_from_cog_m
    shape = {"bearing_A": a, "bearing_B": -b, "sensor_A": sa, "sensor_B": -sb}
    mode = {"frequency_hz": 310.0, "damping_ratio": 0.01}
    mode |= {f"{place}_per_sqrt_kg": 0.02 * size for place, size in shape.items()}
    hz = np.array([250.0, 300.0, 310.0, 320.0, 370.0])
    plain = linear_model(RIG, hz).y_per_u
    swings = linear_model(effect("extra_flexible_mode").on(RIG, **mode), hz).y_per_u - plain
    housings = CATALOGUE["support_resonance"].likened["extra_flexible_mode"](mode)
    rocking = [own for own in housings if own.get("rocking")]
    assert rocking
    for own in rocking:
        rocks = linear_model(effect("support_resonance").on(RIG, **own), hz).y_per_u - plain
        assert np.abs(rocks - swings).max() < 0.3 * np.abs(swings).max(), "the translation is elsewhere"
