"""The reference rig has the figures of its thesis: Khader, System Identification of Active Magnetic Bearing."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import bilinear

from sim import actuator, rotor
from sim.effects import effect
from sim.errors import LevitationError
from sim.reference import pid_with_biquad, reference_datasheet, reference_rig
from sim.rig import ControlLaw
from sim.stepping import Simulation
from sim.twin import linear_model

RIG = reference_rig()


def test_table_5_1_is_the_datasheet():
    sheet = reference_datasheet()
    assert (sheet.mass_kg, sheet.transverse_inertia_kgm2) == (280.0, 10.87)
    assert sheet.bearing_from_cog_m == (0.418, 0.404)
    assert sheet.sensor_from_cog_m == (0.484, 0.470)
    assert sheet.position_stiffness_n_per_m == (2.3e6,) * 4
    assert sheet.current_stiffness_n_per_a == (340.0,) * 4
    assert sheet.bias_current_a == (2.75,) * 4
    assert sheet.linear_range_m == 80e-6


def test_tables_5_3_and_5_5_are_the_rig():
    np.testing.assert_array_equal(RIG.magnets.ks, [1.68e6, 1.73e6, 1.69e6, 1.88e6])
    np.testing.assert_array_equal(RIG.magnets.ki, [181.0, 186.0, 184.0, 198.0])
    frequencies = [[m.natural_frequency_rad_s for m in plane] for plane in RIG.rotor.modes]
    assert frequencies == [[3097.0, 5708.0], [3091.0, 5701.0]]


def test_the_rigid_poles_in_open_loop_are_those_of_the_thesis():
    """+-230.4 and +-110.5 rad/s (x), +-235.6 and +-112.9 (y), from the unrounded stiffness: within 0.2 %."""
    rigid = replace(RIG, rotor=replace(RIG.rotor, modes=((), ())))
    m, point = rotor.mechanics(rigid), actuator.operating_point(rigid)
    squares = np.linalg.eigvals(np.linalg.solve(m.mass, m.force_map * point.ks @ m.bearing_map))
    np.testing.assert_allclose(np.sort(np.sqrt(squares)), [110.5, 112.9, 230.4, 235.6], rtol=2e-3)


def test_the_magnets_give_entries_of_appendix_a():
    """State matrix of the rigid rotor in bearing coordinates: M^-1 Ks has 3.311e4 (x, A)."""
    m, point = rotor.mechanics(RIG), actuator.operating_point(RIG)
    maps, _ = rotor.plane_maps(RIG, 0)
    rigid = maps[:, :2] @ np.linalg.solve(m.mass[:2, :2], maps[:, :2].T)
    assert rigid[0, 0] * point.ks[0] == pytest.approx(3.311e4, rel=0.01)
    assert rigid[0, 1] == pytest.approx(-0.0119, rel=0.01)


def test_the_amplifier_poles_are_those_of_appendix_a():
    a = RIG.amplifiers
    w, z = a.natural_frequency_rad_s, a.damping_ratio
    poles = -z * w + 1j * w * np.sqrt(1 - z**2)
    np.testing.assert_allclose(poles, [-7458 + 5462j, -8008 + 5364j] * 2, rtol=1e-9)


def test_the_flexible_poles_are_those_of_appendix_a():
    modes = [m for plane in RIG.rotor.modes for m in plane]
    decay = [m.damping_ratio * m.natural_frequency_rad_s for m in modes]
    np.testing.assert_allclose(decay, [3.766, 6.071, 3.534, 2.839], rtol=1e-9)


@pytest.mark.parametrize(
    ("mode", "residues"), [(0, [[0.00645, 0.00366], [0.0114, 0.00647]]), (1, [[0.042, 0.0165], [0.00397, 0.00156]])]
)
def test_the_mode_shapes_are_those_that_match_the_residues(mode, residues):
    """Product of shape at sensors (rows) and at bearings (columns), unit modal mass."""
    m = RIG.rotor.modes[0][mode]
    np.testing.assert_allclose(np.outer(m.shape_at_sensors, m.shape_at_bearings), residues, rtol=5e-3)


def test_the_peak_sensitivity_is_about_two_away_from_the_first_resonance():
    """About 2.0 (6 dB) at mode 2. Within 1 % of the barely damped mode 1, at 500 Hz, it is higher, up to 5."""
    frequency_hz = np.geomspace(1, 4000, 20000)
    size = np.abs(linear_model(RIG, frequency_hz).u_per_r)
    diagonal = np.einsum("fii->fi", size)
    away = np.abs(frequency_hz / 500.4 - 1) > 0.01
    assert diagonal[away].max() == pytest.approx(2.1, abs=0.1)
    assert abs(frequency_hz[away][diagonal[away].max(axis=1).argmax()] - 928) < 5
    assert 3 < diagonal.max() < 6


def test_the_loop_levitates_the_rig_and_a_plain_pid_does_not():
    """Without the biquad, amplifier and hold lag leave mode 2, at 908 Hz, undamped."""
    Simulation(RIG)
    wf = 2 * np.pi * 3e3
    b, a = bilinear([18e3 + 80 * wf, 18e3 * wf + 36e3, 36e3 * wf], [1.0, wf, 0.0], 1e4)
    with pytest.raises(LevitationError, match=r"pole at 9\d\d Hz grows"):
        Simulation(replace(RIG, controller=ControlLaw(b, a, 1e-4)))


def test_sixty_microseconds_of_delay_lose_a_flexible_mode_which_the_other_loop_holds():
    delayed = effect("loop_delay").on(RIG, delay_s=60e-6)
    with pytest.raises(LevitationError):
        Simulation(delayed)
    b, a = pid_with_biquad(16e3, 36e3, 60.0, 4e3, 620.0, (0.2, 0.8))
    record = Simulation(replace(delayed, controller=ControlLaw(b, a, 1e-4))).advance(np.zeros((5000, 4)))
    assert record.exceeded == ""


def test_the_weight_at_45_degrees_is_no_small_load():
    """971 N per bearing axis; nominal ki times bias current is 935 N."""
    load = -actuator.static_load(reference_rig(gravity_m_per_s2=9.81))
    assert load.mean() == pytest.approx(971, abs=1)
    assert 340 * 2.75 == 935


def test_the_gap_follows_from_bias_current_and_factors():
    """About 300 um: 15 um of it is the usual amplitude."""
    np.testing.assert_allclose(RIG.magnets.gap_m, 300e-6, rtol=0.05)


@pytest.mark.parametrize(("ratio", "change"), [("bias", 2.0), ("gap", 1.5), ("area", 1.0)])
def test_the_ratio_of_the_errors_of_ks_and_ki_tells_where_they_come_from(ratio, change):
    """dln ks/dln ki: bias 2, gap 3/2, magnet area or turns 1 (ki = 4 k i0/s0^2, ks = 4 k i0^2/s0^3)."""

    def factors(k: float, i0: float, s0: float) -> np.ndarray:
        return np.log([4 * k * i0 / s0**2, 4 * k * i0**2 / s0**3])

    values = {"area": 1.4e-6, "bias": 2.75, "gap": 3e-4}
    before = factors(*values.values())
    values[ratio] *= 1 + 1e-6
    ki, ks = factors(*values.values()) - before
    assert ks / ki == pytest.approx(change, rel=1e-3)


def test_the_controller_is_discretised_by_tustins_rule() -> None:
    """At every frequency, the discrete controller is the continuous one at 2/T tan(w T/2)."""
    wf, wn, period = 2 * np.pi * 3e3, 2 * np.pi * 750.0, 1e-4
    b, a = pid_with_biquad(18e3, 36e3, 80.0, 3e3, 750.0, (0.2, 0.7), period)
    omega = 2 * np.pi * np.geomspace(1.0, 4900.0, 40)
    z, s = np.exp(1j * omega * period), 2j / period * np.tan(omega * period / 2)
    pid = 18e3 + 36e3 / s + 80.0 * s * wf / (s + wf)
    notch = (s**2 + 0.4 * wn * s + wn**2) / (s**2 + 1.4 * wn * s + wn**2)
    np.testing.assert_allclose(np.polyval(b, z) / np.polyval(a, z), pid * notch, rtol=1e-7)


def test_tustins_rule_is_to_the_last_bit_that_of_scipy() -> None:
    """A rig drawn anew must be the one that seeds and practice cases name."""
    wf, wn = 2 * np.pi * 3e3, 2 * np.pi * 750.0
    pid = [18e3 + 80 * wf, 18e3 * wf + 36e3, 36e3 * wf]
    numerator = np.polymul(pid, [1.0, 0.4 * wn, wn**2])
    denominator = np.polymul([1.0, wf, 0.0], [1.0, 1.4 * wn, wn**2])
    for own, other in zip(pid_with_biquad(), bilinear(numerator, denominator, 1e4), strict=True):
        np.testing.assert_array_equal(own, other)
