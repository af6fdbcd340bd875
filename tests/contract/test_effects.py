"""Every effect of the catalogue keeps the contract. A new file in sim/effects/ is tested without a word here."""

import re
from dataclasses import replace
from functools import cache
from typing import get_args

import numpy as np
import pytest
from scipy.signal import bilinear

import sim.effects
from sim import effect
from sim.effect import MARGIN
from sim.effects import CATALOGUE
from sim.errors import EffectError
from sim.harmonic_balance import Responder, time_points
from sim.measured import measured_responses
from sim.reference import reference_rig
from sim.rig import FlexibleMode, Noise, Rig
from sim.stepping import Simulation
from sim.twin import linear_model, with_effects

PATHS = {
    "controller": "controller_mismatch logging_offset",
    "amplifier": "loop_delay amplifier_bandwidth amplifier_voltage_limit channel_crosstalk",
    "plant": "eddy_currents magnetic_saturation magnetic_hysteresis off_centre_rotor thermal_drift "
    "magnetic_cross_coupling rotor_inertia extra_flexible_mode modal_damping gyroscopic_coupling internal_damping "
    "cross_coupled_stiffness support_resonance touchdown_contact sensor_lag sensor_gain sensor_position",
    "additive": "mains_interference runout",
}
"""What files and reports may name, and the path of the loop where it acts."""

TONES_HZ = np.array([11.0, 47.0, 173.0, 489.0, 733.0, 991.0])
SPEED_RAD_S = 2 * np.pi * 17
OF_A_TURNING_ROTOR = ("by_speed_ns_per_m", "inverse_whirl_ratio")
"""Parameters that a rotor at rest does not show, of effects that it does."""
"""A whole number of turns in a second, at no tone, so that runout stays out of a one-second window."""

every_effect = pytest.mark.parametrize("one", CATALOGUE.values(), ids=CATALOGUE.keys())


def rig_for(one: effect.Effect) -> Rig:
    return reference_rig(speed_rad_s=SPEED_RAD_S if one.needs_speed else 0.0)


def plane_of(rig: Rig) -> Rig:
    """The x plane of a rig as a rig of its own."""

    def halved(part):
        arrays = {k: v[:2] for k, v in vars(part).items() if isinstance(v, np.ndarray)}
        return replace(part, **arrays)

    amplifiers = replace(halved(rig.amplifiers), crosstalk=rig.amplifiers.crosstalk[:2, :2])
    return replace(
        rig,
        axes=rig.axes[:2],
        rotor=replace(rig.rotor, modes=rig.rotor.modes[:1]),
        magnets=halved(rig.magnets),
        amplifiers=amplifiers,
        sensors=halved(rig.sensors),
    )


def differences(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """|a - b| per frequency relative to |b|, of matrices (F, n, n)."""
    return np.linalg.norm(a - b, axis=(1, 2)) / np.linalg.norm(b, axis=(1, 2))


def shaking(n: int) -> np.ndarray:
    """Every axis at its own frequency, at the usual displacement where it is low and near 5 kA/s where it is high."""
    t = np.arange(n)[:, None] * 1e-4
    return np.array([0.4, 0.5, 0.8, 1.2]) * np.sin(2 * np.pi * np.array([13.0, 40.0, 190.0, 700.0]) * t)


@cache
def shaken(rig_id: str, applied: bool, speed: bool) -> np.ndarray:
    """u, i, y of a quarter second of shaking with every axis at its own frequency, (3, N, 4)."""
    rig = reference_rig(speed_rad_s=SPEED_RAD_S if speed else 0.0)
    rig = with_effects(rig, {rig_id: {} if applied else CATALOGUE[rig_id].null()})
    r = shaking(2500)
    record = Simulation(rig, seed=3).advance(r, check_limits=False)
    return np.stack([record.u, record.i, record.y])


@pytest.mark.parametrize(("path", "ids"), PATHS.items())
def test_the_ids_that_files_and_reports_name_are_all_there_on_their_path(path, ids):
    assert set(ids.split()) <= {name for name, one in CATALOGUE.items() if one.path == path}


def test_the_catalogue_has_no_path_that_reports_do_not_know():
    assert {one.path for one in CATALOGUE.values()} <= set(get_args(effect.Path)) == set(PATHS)


def test_an_unknown_effect_is_refused_with_the_list_of_known_ones():
    with pytest.raises(EffectError, match=r"no effect 'loop_dealy' .*loop_delay"):
        sim.effects.effect("loop_dealy")


@every_effect
def test_the_id_is_the_name_of_the_file(one):
    assert CATALOGUE[one.id] is one
    assert re.fullmatch(r"[a-z][a-z0-9_]*", one.id)


@every_effect
def test_the_words_are_there(one):
    for words in (one.law, one.signature, one.separated_by, one.source):
        assert len(words) > 10, words
    assert re.search(r"\d|Khader", one.source), "the source is a citation"
    for p in one.parameters:
        assert p.unit, p.name


@every_effect
def test_aliases_are_other_effects_and_mutual(one):
    for alias in one.aliases:
        assert alias in CATALOGUE
        assert one.id in CATALOGUE[alias].aliases, f"{alias} does not name {one.id} in turn"
        assert alias != one.id


def vanishes_plainly(p: effect.Parameter) -> bool:
    """Null lies in the range, or is the zero below one that spreads over decades; what is typical is another value."""
    below = p.scale == "log" and p.null == 0 < p.low
    return p.null != p.typical and (p.low <= p.null <= p.high or below)


@every_effect
def test_parameters_have_a_range_that_holds_their_typical_value(one):
    assert len({p.name for p in one.parameters}) == len(one.parameters) > 0
    for p in one.parameters:
        assert p.low < p.high, p.name
        assert p.low <= p.typical <= p.high, p.name
        assert p.scale == "linear" or p.low > 0, f"{p.name} spreads over decades, so its range starts above zero"
        assert not p.strength or vanishes_plainly(p), p.name
    assert any(p.strength for p in one.parameters), "some parameter makes it vanish"


@pytest.mark.parametrize(
    ("low", "null", "scale"), [(0.1, 0.0, "linear"), (0.1, 2.0, "linear"), (0.1, -1.0, "log"), (0.1, 0.5, "log")]
)
def test_a_null_that_no_range_reaches_or_that_is_typical_would_be_seen(low, null, scale):
    assert not vanishes_plainly(effect.Parameter("share", "1", low, 1.0, 0.5, null, scale))


@every_effect
def test_a_name_ends_in_its_unit(one):
    """``delay_s`` is in seconds; ratios and signed shares carry none."""
    endings = {"s": "_s", "m": "_m", "rad": "_rad", "Hz": "_hz", "N/m": "_n_per_m", "kg m2": "_kgm2", "A": "_a"}
    for p in one.parameters:
        assert p.unit not in endings or p.name.endswith(endings[p.unit]), p.name


@every_effect
def test_at_its_null_values_the_linear_model_is_as_before(one):
    before = rig_for(one)
    a, b = linear_model(before, TONES_HZ), linear_model(one.on(before, **one.null()), TONES_HZ)
    for name in ("i_per_u", "y_per_u", "y_per_i", "u_per_r"):
        np.testing.assert_allclose(getattr(b, name), getattr(a, name), rtol=1e-12, atol=0, err_msg=name)


@every_effect
def test_at_its_null_values_the_rig_runs_as_before(one):
    rig = rig_for(one)
    r = shaking(2500)
    plain = Simulation(rig, seed=3).advance(r, check_limits=False)
    for before, now in zip((plain.u, plain.i, plain.y), shaken(one.id, False, one.needs_speed), strict=True):
        np.testing.assert_allclose(now, before, rtol=0, atol=1e-9 * np.abs(before).max())


@every_effect
def test_at_its_typical_values_it_shows(one):
    """Somewhere u, i or y move by more than the noise of the sensors (20 nm) or of the current (2 mA)."""
    before, after = (shaken(one.id, applied, one.needs_speed) for applied in (False, True))
    current, displacement = np.abs(after - before)[:2].max(), np.abs(after - before)[2].max()
    assert current > 2e-3 or displacement > 20e-9


def with_low_pass(rig: Rig) -> Rig:
    """The rig with a low-pass filter of 4.8 kHz in its controllers."""
    w = 2 * np.pi * 4800.0
    b, a = bilinear([1.0], [1 / w**2, 0.6 / w, 1.0], 1 / rig.controller.sample_time_s)
    law = replace(rig.controller, numerator=np.polymul(rig.controller.numerator, b))
    return replace(rig, controller=replace(law, denominator=np.polymul(rig.controller.denominator, a)))


def with_slow_sensors(rig: Rig) -> Rig:
    """The rig with a pole of 50 kHz in its sensors."""
    return replace(rig, sensors=replace(rig.sensors, bandwidth_rad_s=np.full(rig.n_axes, 2 * np.pi * 50e3)))


def with_a_third_mode(rig: Rig) -> Rig:
    mode = FlexibleMode(2 * np.pi * 1400, 0.005, (0.05, -0.04), (0.05, -0.04))
    return replace(rig, rotor=replace(rig.rotor, modes=tuple((*modes, mode) for modes in rig.rotor.modes)))


ROCKS = ("frequency_ratio", "damping_quotient", "plane_quotient", "imbalance")


@every_effect
def test_each_of_its_parameters_counts(one):
    """Strengths set to null and shapes moved, one at a time, beside typical values of the others.

    In the linear model, in time, or in the balance of 1.2 A at 700 Hz: in time a rig has the noise that another states.
    """
    of_pedestals = {"pedestals": 0.5} if one.id == "support_resonance" else {}  # where there are any
    beside = dict.fromkeys(("frequency_ratio", "damping_quotient", "end_imbalance"), of_pedestals)
    beside |= {f"rocking_{name}": {"rocking": 2.0} for name in ROCKS}
    beside["coupling_imbalance"] = {"mode_coupling": 0.02}
    beside |= {shape: {"filter_mid_change": -0.2} for shape in ("filter_frequency_hz", "filter_damping_ratio")}
    beside["opposite_share"] = {"end_imbalance": 0.5}
    beside["overhang"] = {"end_imbalance": 0.5, "between": 1.0}
    beside["turned_whole"] = {"rotation_rad": 0.04}
    beside |= {
        f"centre_{axis}": {f"clearance_{axis}_m": 1e-6} for axis in ("xA", "xB", "yA", "yB")
    }  # else out of reach

    tone = np.zeros((1, 4, 4), dtype=complex)
    tone[0, 1] = 1.2

    def answer(rig: Rig) -> tuple[np.ndarray, ...]:
        model = linear_model(rig, TONES_HZ)
        record = Simulation(replace(rig, noise=Noise())).advance(shaking(1500), check_limits=False)
        balance = Responder(rig, np.array([700.0]), np.array([0])).answer(tone[:, :, : rig.n_axes])
        return (
            np.stack([model.i_per_u, model.y_per_u, model.u_per_r]),
            np.stack([record.u, record.i, record.y]),
            np.stack([balance.I, balance.Y]),
        )

    for p in one.parameters:
        rig = reference_rig(speed_rad_s=SPEED_RAD_S) if p.name in OF_A_TURNING_ROTOR else rig_for(one)
        rig = with_low_pass(rig) if p.name.startswith("lowpass") else rig
        rig = with_slow_sensors(rig) if p.name == "moved_share" else rig
        rig = of_first_order(rig) if p.name == "second_order_term" else rig
        rig = with_a_third_mode(rig) if "mode3" in p.name else rig
        others = beside.get(p.name, {})
        typical = answer(one.on(rig, **others))
        # shapes only a little: what one axis alone has is four times as strong there, and the loop need not hold it
        moved = p.null if p.strength else 0.1 * p.typical or 0.02 * p.high
        changed = answer(one.on(rig, **others, **{p.name: min(max(moved, min(p.low, p.null)), p.high)}))
        assert any(np.any(np.abs(a - b) > 1e-9 * np.abs(b).max()) for a, b in zip(changed, typical, strict=True)), (
            p.name
        )


@every_effect
def test_the_linear_model_is_what_the_rig_shows_at_small_amplitude(one):
    check_linear_model(one.on(rig_for(one)))


def test_the_linear_model_has_the_lag_of_the_flux_that_a_moving_rotor_makes():
    laminated = {"time_constant_s": 4e-6, "end_imbalance": -0.4, "displacement_share": 1.0}
    rig = with_effects(reference_rig(), {"eddy_currents": laminated, "magnetic_cross_coupling": {}})
    check_linear_model(rig)
    check_harmonic_balance(rig, np.full(3, 2e-3))


def test_the_harmonic_balance_has_plays_that_follow_the_flux_of_a_moving_rotor_too():
    rig = with_effects(reference_rig(), {"magnetic_hysteresis": {"loss_angle_rad": 0.03, "displacement_share": 1.0}})
    check_harmonic_balance(rig, np.full(3, 2e-3))


def check_linear_model(rig: Rig) -> None:
    """Responses from u and the loop's against those that a campaign measures."""
    model = linear_model(rig, TONES_HZ)
    found = measured_responses(rig, TONES_HZ)
    # Drift moves ki and ks while the experiment runs; a forced whirl of 2 um makes the magnets a little stiffer.
    tolerance = 2e-3 if rig.drift else 4e-4 if rig.disturbances else 2e-4
    assert differences(found.i_per_u, model.i_per_u).max() < 1e-5
    assert differences(found.y_per_u, model.y_per_u).max() < tolerance
    assert differences(found.u_per_r, model.u_per_r).max() < 2 * tolerance


def lock_in(rig: Rig, frequency_hz: float, amplitude_a: float, substeps: int = 4) -> np.ndarray:
    """Harmonics 0 to 3 of u, i and y after a smooth start of a tone on the first axis, (3, 4, n)."""
    period, n_window, n_settle = rig.controller.sample_time_s, 10_000, 30_000
    t = np.arange(n_settle + n_window) * period
    r = np.zeros((len(t), rig.n_axes))
    grown = np.sin(np.pi / 2 * np.minimum(t / (0.75 * n_settle * period), 1.0)) ** 2
    r[:, 0] = amplitude_a * grown * np.cos(2 * np.pi * frequency_hz * t)
    record = Simulation(replace(rig, noise=Noise()), substeps=substeps).advance(r, check_limits=False)
    h = np.arange(4)
    basis = np.exp(-2j * np.pi * frequency_hz * np.outer(h, t[-n_window:]))
    basis *= np.where(h == 0, 1.0, 2.0)[:, None] / n_window
    return np.stack([basis @ x[-n_window:] for x in (record.u, record.i, record.y)])


def of_first_order(rig: Rig, lag_s: float = 0.0, delay_s: float = 0.0) -> Rig:
    """The rig with amplifiers of which the datasheet states a bandwidth and no more."""
    delay = np.full(rig.n_axes, delay_s)
    return replace(rig, amplifiers=replace(rig.amplifiers, damping_ratio=None, lag_s=lag_s, delay_s=delay))


def check_harmonic_balance(rig: Rig, share: np.ndarray, at_700_hz_a: float = 1.1) -> None:
    """Fundamental and harmonics 0, 2 and 3 of i and y for the measured u: within a share of the fundamental."""
    frequency_hz = np.array([21.0, 137.0, 700.0])
    found = np.array(
        [lock_in(rig, f, a) for f, a in zip(frequency_hz, (0.3, 0.8, at_700_hz_a), strict=True)]
    )  # (P, signal, H, n)
    distinct, line = time_points(frequency_hz)
    answer = Responder(rig, distinct, line).answer(found[:, 0])
    for k, (signal, predicted, floor) in enumerate((("i", answer.I, 2e-5), ("y", answer.Y, 1e-9)), start=1):
        error = np.abs(predicted - found[:, k]).max(axis=2)
        fundamental = np.abs(found[:, k, 1]).max(axis=1)
        assert np.all(error < floor + (share * fundamental)[:, None]), (signal, error / fundamental[:, None])


@every_effect
def test_the_harmonic_balance_is_what_the_rig_shows_at_the_usual_amplitude(one):
    check_harmonic_balance(one.on(rig_for(one)), np.full(3, 2e-3))


@pytest.mark.parametrize(
    ("lag_s", "delay_s", "amplitude_a", "share"),
    [(0.0, 0.0, 1.1, 1e-3), (0.0, 1e-5, 1.1, 1e-3), (0.0, 1e-5, 2.2, 5e-3), (5e-6, 0.0, 1.1, 8e-3)],
)
def test_the_harmonic_balance_has_the_voltage_limit_of_first_order_amplifiers(lag_s, delay_s, amplitude_a, share):
    """At its limit such an amplifier is asked for steps of slope by u, wherever within a step of the integration.

    At 2.2 A u has more harmonics than are logged; of a lag a few steps know only so much.
    """
    rig = CATALOGUE["amplifier_voltage_limit"].on(of_first_order(reference_rig(), lag_s, delay_s))
    check_harmonic_balance(rig, np.array([1e-3, 1e-3, share]), amplitude_a)


@pytest.mark.parametrize(("rig", "off"), [(reference_rig(), 0.15), (of_first_order(reference_rig()), 0.4)])
def test_noise_takes_an_amplifier_to_a_limit_that_its_tone_does_not_reach(rig, off):
    """0.2 um of noise, at 700 Hz and 0.85 A. Through a sample the noise of a first-order amplifier falls off."""
    noise_m, hz, amplitude_a = 2e-7, 700.0, 0.85
    limited = CATALOGUE["amplifier_voltage_limit"].on(rig)
    t = np.arange(150_000) * rig.controller.sample_time_s
    r = np.zeros((len(t), rig.n_axes))
    r[:, 0] = amplitude_a * np.minimum(t, 1.0) * np.cos(2 * np.pi * hz * t)
    record = Simulation(replace(limited, noise=Noise(displacement_m=noise_m)), seed=3).advance(r, check_limits=False)
    tone = 2 / 130_000 * np.exp(-2j * np.pi * hz * t[20_000:])
    U, I = (np.tile(tone @ x[20_000:], (1, 1, 1)) for x in (record.u, record.i))

    def current(share: float, of: Rig = limited) -> complex:
        noisy = replace(of, amplifiers=replace(of.amplifiers, slope_noise_share=share))
        return Responder(noisy, np.array([hz]), np.array([0]), (1,)).current(U)[0, 0, 0]

    share = slope_noise_a_per_s(rig, noise_m) / limited.amplifiers.slew_limit_a_per_s[0]
    measured, plain = I[0, 0, 0], current(0.0, rig)
    assert abs(measured - plain) > 5e-3 * abs(plain)
    assert abs(current(share) - measured) < off * abs(plain - measured)
    assert abs(current(0.0) - measured) > 0.8 * abs(plain - measured)


def slope_noise_a_per_s(rig: Rig, noise_m: float) -> float:
    """Root mean square of the slopes of the first coil's current in the loop of a rig with white noise of its sensors.

    Held samples have the spectrum of u at every multiple of their rate, weighted by that of the hold.
    """
    rate = 1 / rig.controller.sample_time_s
    step = rate / 800
    f = np.arange(step / 2, rate / 2, step)
    model, amp = linear_model(rig, f), rig.amplifiers
    C = model.controller[:, None, None]
    u_per_noise = -C * np.linalg.inv(np.eye(rig.n_axes) + model.y_per_u * C)
    density = (np.abs(u_per_noise[:, 0]) ** 2).sum(axis=1) * noise_m**2 / (rate / 2)
    square = 0.0
    for k in range(20):
        for image in (k * rate + f, (k + 1) * rate - f):
            s, w = 2j * np.pi * image, amp.natural_frequency_rad_s[0]
            drive = (
                w / (s + w) if amp.damping_ratio is None else w**2 / (s**2 + 2 * amp.damping_ratio[0] * w * s + w**2)
            )
            square += float(np.sum(np.abs(s * drive * np.sinc(image / rate)) ** 2 * density) * step)
    return square**0.5


@pytest.mark.parametrize("lag_s", [0.0, 5e-6])
def test_a_voltage_that_suffices_changes_nothing_on_first_order_amplifiers(lag_s):
    """1 A at 200 Hz asks for 1.3 kA/s, with the steps of u 2 kA/s, of 4 kA/s.

    Without the converters' steps, of which one would be another where a processor rounds otherwise.
    """
    rig = replace(of_first_order(reference_rig(), lag_s), noise=Noise(displacement_m=2e-9, current_a=2e-4))
    t = np.arange(4000)[:, None] * 1e-4
    r = np.cos(2 * np.pi * 200 * t) * np.minimum(1, t / 0.05) * [1.0, 0, 0, 0]
    plain, limited = (Simulation(one, seed=1).advance(r) for one in (rig, CATALOGUE["amplifier_voltage_limit"].on(rig)))
    assert limited.exceeded == ""
    np.testing.assert_allclose(limited.i, plain.i, atol=1e-9)


@pytest.mark.parametrize("delay_s", [0.0, 1e-5])
def test_a_first_order_amplifier_at_its_voltage_limit_needs_no_finer_steps(delay_s):
    """Nor where its signal steps within one."""
    rig = CATALOGUE["amplifier_voltage_limit"].on(of_first_order(reference_rig(), 0.0, delay_s))
    usual, fine = (lock_in(rig, 700.0, 1.1, substeps)[1, 1, 0] for substeps in (4, 16))
    assert usual == pytest.approx(fine, rel=1e-4)


@pytest.mark.parametrize(
    ("one", "rig_of"),
    [pytest.param(e, rig_for, id=e.id) for e in CATALOGUE.values() if e.nonlinear]
    + [
        pytest.param(
            CATALOGUE["amplifier_voltage_limit"], lambda one: of_first_order(rig_for(one)), id="first_order_voltage"
        )
    ],
)
def test_a_nonlinear_effect_answers_out_of_proportion(one, rig_of):
    """Its describing function moves with amplitude, or harmonics appear; a rig without it does so far less."""

    def distortion(rig: Rig) -> float:
        small, large = lock_in(rig, 700.0, 0.05), lock_in(rig, 700.0, 1.1)
        low = lock_in(rig, 21.0, 0.02), lock_in(rig, 21.0, 0.3)
        worst = 0.0
        for s, l in ((small, large), low):
            gain = [x[1:, 1, 0] / x[0, 1, 0] for x in (s, l)]
            worst = max(worst, np.abs(gain[1] / gain[0] - 1).max(), np.abs(l[2, 2:, 0] / l[2, 1, 0]).max())
        return worst

    assert distortion(one.on(rig_of(one))) > 1.5 * distortion(rig_of(one)) + 1e-3


@every_effect
def test_an_unknown_parameter_is_refused_by_name(one):
    with pytest.raises(EffectError, match=rf"{one.id} has no parameter 'wrong'; it has {one.parameters[0].name}"):
        one.on(rig_for(one), wrong=1.0)


@every_effect
@pytest.mark.parametrize("factor", [-2.0, 3.0])
def test_a_value_out_of_range_is_refused_with_the_range_and_the_unit(one, factor):
    for p in one.of(rig_for(one)).parameters:
        beyond = 1.0 if p.goes_with is None else MARGIN
        outside = beyond * (p.high * factor if factor > 0 else min(p.low, p.null) - abs(p.high))
        with pytest.raises(EffectError, match=rf"{one.id}\.{p.name} = .* is outside .*{re.escape(p.unit)}"):
            one.on(rig_for(one), **{p.name: outside})


@every_effect
def test_a_value_that_is_not_a_number_is_refused(one):
    for p in one.parameters:
        with pytest.raises(EffectError, match=p.name):
            one.on(rig_for(one), **{p.name: float("nan")})


@every_effect
def test_a_rig_of_one_plane_gets_it_or_a_reason(one):
    rig = plane_of(rig_for(one))
    if one.needs_axes > rig.n_axes:
        with pytest.raises(EffectError, match=f"{one.id} needs 4 axes; rig reference has 2"):
            one.on(rig)
        return
    with_it = one.on(rig)
    found, model = measured_responses(with_it, TONES_HZ[:3], settle_s=2.0), linear_model(with_it, TONES_HZ[:3])
    assert differences(found.y_per_u, model.y_per_u).max() < 3e-3


@every_effect
def test_on_a_rig_of_one_plane_and_one_mode_nothing_is_fitted_of_others(one):
    """Its report would else tell a value of a sensor that is not there."""
    rig = plane_of(rig_for(one))
    rig = replace(rig, rotor=replace(rig.rotor, modes=(rig.rotor.modes[0][:1],)))
    awake = {p.name for p in one.of(rig).parameters if not p.dormant}
    assert awake
    assert not [name for name in awake if any(other in name for other in ("_yA", "_yB", "mode2", "mode3"))]
    assert awake <= {p.name for p in one.of(rig_for(one)).parameters}
    if one.needs_axes <= rig.n_axes:
        assert_answers(one.of(rig).on(rig))


def assert_answers(rig: Rig) -> None:
    """Every response of the rig is a finite number and the displacement one that is not zero."""
    model = linear_model(rig, TONES_HZ)
    for response in (model.i_per_u, model.y_per_u, model.y_per_i, model.u_per_r):
        assert np.isfinite(response).all()
    assert np.all(np.einsum("fkk->fk", model.y_per_u) != 0)


@every_effect
def test_a_rig_that_has_it_already_gets_more_of_it_or_a_reason(one):
    """A twin that a diagnosis has completed may be diagnosed again."""
    once = one.on(rig_for(one))
    if one.id in {"support_resonance", "touchdown_contact"}:
        with pytest.raises(EffectError, match="already has"):
            one.on(once)
        return
    assert_answers(one.on(once))


@every_effect
def test_nothing_of_it_added_to_a_rig_that_has_it_changes_nothing(one):
    """Whatever the shape of what is not added: a twin that has the effect keeps the law that it has."""
    rig = rig_for(one)

    def shaped(p):
        """Within the range, off what is typical."""
        typical = one.null()[p.name] if p.scale == "log" else p.typical
        return p.low**0.7 * p.high**0.3 if p.scale == "log" and p.low > 0 else 0.95 * typical + 0.05 * p.high

    has = one.on(rig, **{p.name: shaped(p) for p in one.parameters if not p.strength})
    again = one.on(has, **one.null())
    lines = [linear_model(r, TONES_HZ).y_per_u for r in (again, has)]
    np.testing.assert_allclose(*lines, rtol=1e-12, atol=0)
    records = [Simulation(r, seed=3).advance(shaking(800), check_limits=False).y for r in (has, again)]
    np.testing.assert_array_equal(*records)


@every_effect
def test_a_rotor_without_modes_gets_it_or_a_reason(one):
    rigid = rig_for(one)
    rigid = replace(rigid, rotor=replace(rigid.rotor, modes=((), ())))
    if one.id in {"modal_damping", "internal_damping"}:
        with pytest.raises(EffectError, match="needs a flexible mode"):
            one.on(rigid)
        return
    assert_answers(one.on(rigid))


@every_effect
def test_applying_it_leaves_the_rig_that_was_given_alone(one):
    rig = rig_for(one)
    before = linear_model(rig, TONES_HZ).y_per_u
    one.on(rig)
    np.testing.assert_array_equal(linear_model(rig, TONES_HZ).y_per_u, before)
    assert all(isinstance(m, FlexibleMode) for plane in rig.rotor.modes for m in plane)


@every_effect
def test_an_effect_restated_is_the_same_effect(one):
    """What another set of its parameters suggests changes the words, not the rig."""
    values = {p.name: p.typical for p in one.parameters}
    other = {p.name: float(np.clip(-p.typical, min(p.low, p.null), max(p.high, p.null))) for p in one.parameters}
    again = one.restated(values, other)
    rig = rig_for(one)
    a, b = (linear_model(one.on(rig, **v), TONES_HZ) for v in (values, again))
    assert differences(a.y_per_u, b.y_per_u).max() < 1e-9
    a, b = (one.on(rig, **v).drift for v in (values, again))
    if a is not None and b is not None:
        passed_s = np.array([10.0, 100.0, 1000.0])
        for change in ("ki_change", "ks_change"):
            gone = [np.outer(d.progress(passed_s / d.duration_s), getattr(d, change)) for d in (a, b)]
            assert gone[0] == pytest.approx(gone[1], rel=1e-9)


@every_effect
def test_an_effect_likened_to_its_alias_answers_like_it(one):
    """Where the alias takes a form that both have: a mode that moves bearings and sensors alike, a housing."""
    for name, likened in one.likened.items():
        assert name in one.aliases
        other = CATALOGUE[name]
        alike = {p.name: 0.02 if p.name.endswith("sqrt_kg") else p.typical for p in other.parameters}
        rig = rig_for(one)
        (own,) = likened(alike)
        a, b = (linear_model(r, TONES_HZ) for r in (other.on(rig, **alike), one.on(rig, **own)))
        assert differences(a.y_per_u, b.y_per_u).max() < 1e-9


@every_effect
def test_an_effect_that_includes_another_answers_as_both(one):
    """Bearings and sensors of the other move as one another, as they do where a part of the rig itself moves."""
    for name, alone in one.includes.items():
        rig = rig_for(one)
        (a, b), (sa, sb) = rig.rotor.bearing_from_cog_m, rig.rotor.sensor_from_cog_m
        shape = {"bearing_A": a, "bearing_B": -b, "sensor_A": sa, "sensor_B": -sb}
        typical = {p.name: p.typical for p in one.parameters}
        other = {"frequency_hz": 310.0, "damping_ratio": typical["damping_ratio"]}
        other |= {f"{place}_per_sqrt_kg": 0.05 * size for place, size in shape.items()}
        both = linear_model(CATALOGUE[name].on(one.on(rig, **typical), **other), TONES_HZ)
        # a start for a fit: the mean of both ends, which sensors beside their bearings do not quite have
        started = linear_model(one.on(rig, **alone(typical, other)), TONES_HZ)
        without = linear_model(one.on(rig, **typical), TONES_HZ)
        assert differences(started.y_per_u, both.y_per_u).max() < 0.3 * differences(without.y_per_u, both.y_per_u).max()
        bent = {**other, "bearing_B_per_sqrt_kg": 0.05 * b}
        assert not alone(typical, bent), "both ends move the same way: it translates"


def test_effects_of_a_twin_add_up():
    both = with_effects(reference_rig(), {"loop_delay": {"delay_s": 1e-5}, "rotor_inertia": {"mass_change": 0.1}})
    assert both.amplifiers.delay_s[0] == 1e-5
    assert both.rotor.mass_kg == pytest.approx(308.0)
