"""The rig in time: what a record says, what persists, what stops it, and that it is linear theory when it is small."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from sim.effects import effect
from sim.errors import EffectError, LevitationError
from sim.loop import Loop
from sim.measured import measured_responses
from sim.reference import pid_with_biquad, reference_rig
from sim.rig import ControlLaw, Disturbance, Noise, Rig
from sim.stepping import Simulation
from sim.twin import linear_model

QUIET = reference_rig(noise=Noise())


def tone(n: int, frequency_hz: float, amplitude_a: float, axis: int = 0) -> np.ndarray:
    r = np.zeros((n, 4))
    r[:, axis] = amplitude_a * np.sin(2 * np.pi * frequency_hz * np.arange(n) * 1e-4)
    return r


def test_equal_seeds_and_excitations_give_equal_records():
    r = tone(3000, 30.0, 0.3)
    one, same, other = (Simulation(reference_rig(), seed).advance(r) for seed in (7, 7, 8))
    np.testing.assert_array_equal(one.y, same.y)
    np.testing.assert_array_equal(one.i, same.i)
    assert not np.array_equal(one.y, other.y)


@pytest.mark.parametrize("name", ["", "loop_delay", "magnetic_hysteresis", "logging_offset", "mains_interference"])
def test_a_record_does_not_depend_on_where_it_is_cut(name):
    rig = effect(name).on(QUIET) if name else QUIET
    r = tone(3000, 30.0, 0.3)
    whole = Simulation(rig).advance(r)
    cut = Simulation(rig)
    parts = [cut.advance(part) for part in np.split(r, [1, 700, 701])]
    for signal in "ruiy":
        np.testing.assert_allclose(np.vstack([getattr(p, signal) for p in parts]), getattr(whole, signal), atol=1e-15)
    assert cut.time_s == pytest.approx(0.3)


def test_the_controller_runs_as_the_difference_equation_of_its_datasheet():
    """u = C(z)(-y) + r at the sample that measured y."""
    record = Simulation(reference_rig(), 1).advance(tone(2000, 80.0, 0.4, axis=2))
    b, a = QUIET.controller.numerator, QUIET.controller.denominator
    np.testing.assert_allclose(record.u - record.r, lfilter(b, a, -record.y, axis=0), atol=1e-9)


def test_left_alone_it_rests():
    record = Simulation(QUIET).advance(np.zeros((2000, 4)))
    assert np.abs(record.y).max() < 1e-15
    loaded = Simulation(reference_rig(gravity_m_per_s2=4.0, noise=Noise())).advance(np.zeros((2000, 4)))
    assert np.abs(loaded.y).max() < 1e-14
    assert np.all(loaded.i[-1] > 1.0), "the magnets carry the weight"


def test_noise_and_steps_are_those_of_the_rig():
    noise = Noise(displacement_m=50e-9, current_a=5e-3, displacement_step_m=0.0, current_step_a=0.0)
    record = Simulation(reference_rig(noise=noise), 5).advance(np.zeros((20000, 4)))
    calm = Simulation(reference_rig(noise=replace(noise, current_a=0.0)), 5).advance(np.zeros((20000, 4)))
    assert np.std(record.i - calm.i) == pytest.approx(5e-3, rel=0.02)
    assert np.std(calm.y) == pytest.approx(50e-9, rel=0.15)
    coarse = Simulation(reference_rig(noise=replace(noise, current_step_a=0.01)), 5).advance(np.zeros((20000, 4)))
    error = coarse.i - record.i  # of the log alone: no current is fed back
    assert np.abs(error).max() <= 0.005 + 1e-9
    assert abs(error.mean()) < 1e-4, "rounded to the nearest step"
    steps = replace(noise, displacement_step_m=1e-7, current_step_a=1e-3)
    stepped = Simulation(reference_rig(noise=steps), 5).advance(np.zeros((500, 4)))
    for x, step in ((stepped.y, 1e-7), (stepped.i, 1e-3)):
        np.testing.assert_allclose(x / step, np.round(x / step), atol=1e-6)


def test_a_limit_ends_the_record_at_the_sample_that_exceeded_it_and_the_rig_goes_on():
    simulation = Simulation(replace(QUIET, displacement_limit_m=10e-6))
    record = simulation.advance(tone(20000, 12.0, 0.5))
    assert record.exceeded == "displacement"
    assert len(record) < 20000
    assert np.abs(record.y[-1]).max() > 10e-6
    assert np.abs(record.y[:-1]).max() <= 10e-6
    after = simulation.advance(np.zeros((10000, 4)), check_limits=False)
    assert len(after) == 10000
    assert np.abs(after.y[-1]).max() < 1e-6, "still levitated"
    current = Simulation(replace(QUIET, current_limit_a=0.2)).advance(tone(2000, 12.0, 0.5))
    assert current.exceeded == "current"
    # of a rig without noise the coil gives just its limit, and that it is asked for more is what trips
    hard = Simulation(QUIET).advance(tone(2000, 900.0, 3 * QUIET.current_limit_a))
    assert hard.exceeded == "current"
    assert np.abs(hard.i).max() <= QUIET.current_limit_a


def test_a_controller_that_cannot_hold_the_rotor_is_refused_with_frequency_and_remedy():
    b, a = pid_with_biquad(proportional_a_per_m=5e3)
    with pytest.raises(LevitationError, match=r"does not levitate .* grows by .* change the controller"):
        Simulation(replace(QUIET, controller=ControlLaw(b, a, 1e-4)))
    with pytest.raises(LevitationError, match=r"a closed-loop pole at 9\d\d Hz"):
        b, a = pid_with_biquad(notch_damping=(0.7, 0.7))  # a plain PID: mode 2
        Simulation(replace(QUIET, controller=ControlLaw(b, a, 1e-4)))


@pytest.mark.parametrize("delay_s", [35e-6, 60e-6])
@pytest.mark.parametrize("where", [("loop_delay", {}), ("sensor_lag", {"time_constant_s": 1e-9})], ids=lambda x: x[0])
def test_a_rig_that_is_refused_would_have_fallen_and_one_that_is_not_would_not(
    where: tuple[str, dict[str, float]], delay_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The stability that eigenvalues promise is the stability in time, with a dead time of amplifiers or sensors."""
    name, values = where
    rig, refused = effect(name).on(QUIET, **values, delay_s=delay_s), False
    try:
        Simulation(rig)
    except LevitationError:
        refused = True
    monkeypatch.setattr(Loop, "require_stability", lambda self: None)
    simulation = Simulation(rig)
    simulation.advance(tone(2000, 500.0, 0.05))
    early = np.abs(simulation.advance(np.zeros((2000, 4)), check_limits=False).y).max()
    simulation.advance(np.zeros((5000, 4)), check_limits=False)
    late = np.abs(simulation.advance(np.zeros((2000, 4)), check_limits=False).y).max()
    assert refused is bool(late > early) is (delay_s > 50e-6)


def test_a_delay_longer_than_any_loop_stands_is_refused():
    with pytest.raises(LevitationError, match="cannot be levitated"):
        Simulation(replace(QUIET, controller=replace(QUIET.controller, computing_delay_s=2e-3)))


def test_a_log_that_is_early_by_a_sample_shows_u_one_sample_before_the_rest():
    r = tone(1000, 50.0, 0.3)
    right = Simulation(QUIET).advance(r)
    early = Simulation(effect("logging_offset").on(QUIET, samples=2.0)).advance(r)
    late = Simulation(effect("logging_offset").on(QUIET, samples=-1.0)).advance(r)
    np.testing.assert_array_equal(early.u, right.u)
    np.testing.assert_array_equal(early.y[2:], right.y[:-2])
    np.testing.assert_array_equal(early.r[2:], right.r[:-2])
    np.testing.assert_array_equal(late.u[1:], right.u[:-1])
    np.testing.assert_array_equal(late.i, right.i)


def test_half_a_sample_of_offset_cannot_be_logged():
    with pytest.raises(EffectError, match="whole number"):
        Simulation(effect("logging_offset").on(QUIET, samples=0.5))


def test_a_disturbance_is_on_the_signal_that_it_names():
    amplitude = np.array([1e-7, 0.0, 0.0, 2e-7])
    hum = Disturbance("y", amplitude, np.zeros(4), fixed_hz=100.0)
    record = Simulation(replace(QUIET, disturbances=(hum,))).advance(np.zeros((20000, 4)))
    t = np.arange(10000) * 1e-4
    wave = 2 / 10000 * np.exp(-2j * np.pi * 100.0 * t)
    loop = linear_model(QUIET, np.array([100.0]))
    n = np.eye(4)
    closed = np.linalg.inv(n + loop.y_per_u[0] * loop.controller[0]) @ amplitude
    np.testing.assert_allclose(wave @ record.y[-10000:], closed, atol=2e-10)


def test_a_drifting_magnet_ends_where_its_drift_says():
    rig = effect("thermal_drift").on(QUIET, ki_change=-0.1, ks_change=-0.05, duration_s=3.0)
    end = replace(QUIET, magnets=replace(QUIET.magnets, ki=QUIET.magnets.ki * 0.9, ks=QUIET.magnets.ks * 0.95))
    frequency_hz = 200.0
    r = tone(32000, frequency_hz, 1e-3)
    window = slice(29000, 31000)  # half of it before the three seconds, half after
    wave = np.exp(-2j * np.pi * frequency_hz * np.arange(2000) * 1e-4)
    drifted, ended = (Simulation(x).advance(r) for x in (rig, end))
    gains = [(wave @ x.y[window, 0]) / (wave @ x.u[window, 0]) for x in (drifted, ended)]
    assert gains[0] / gains[1] == pytest.approx(1.0, abs=2e-3)


@pytest.mark.parametrize(
    "rig",
    [
        QUIET,
        reference_rig(speed_rad_s=400.0),
        reference_rig(gravity_m_per_s2=4.0, speed_rad_s=150.0),
        effect("gyroscopic_coupling").on(reference_rig(speed_rad_s=300.0), polar_inertia_kgm2=4.0, mode_coupling=0.05),
        replace(QUIET, sensors=replace(QUIET.sensors, delay_s=np.full(4, 1.3e-5))),
        replace(QUIET, sensors=replace(QUIET.sensors, bandwidth_rad_s=np.full(4, 8e4), lag_s=4e-6 * np.arange(4))),
        replace(QUIET, controller=replace(QUIET.controller, computing_delay_s=2e-5)),
        replace(
            QUIET,
            amplifiers=replace(QUIET.amplifiers, damping_ratio=None, natural_frequency_rad_s=np.full(4, 1.2e4)),
        ),
    ],
    ids=[
        "still",
        "speed",
        "gravity",
        "gyroscopic",
        "sensor delay",
        "two sensor lags",
        "computing delay",
        "first order",
    ],
)
def test_linear_theory_and_the_rig_in_time_agree_to_a_fifth_of_a_per_cent(rig: Rig):
    """Median over 10 to 1000 Hz; found is far less, so the worst line is held to 0.2 % too."""
    frequency_hz = np.unique(np.round(np.geomspace(10, 1000, 40)))
    found, theory = measured_responses(rig, frequency_hz, amplitude_a=2e-5), linear_model(rig, frequency_hz)
    for a, b in ((found.y_per_u, theory.y_per_u), (found.i_per_u, theory.i_per_u), (found.u_per_r, theory.u_per_r)):
        error = np.linalg.norm(a - b, axis=(1, 2)) / np.linalg.norm(b, axis=(1, 2))
        assert np.median(error) < 2e-5
        assert error.max() < 2e-3


def test_what_sampling_folds_onto_a_tone_counts_up_to_a_fifth_of_the_rate() -> None:
    """Displacement above half the rate seems to be at the tone: 6e-4 of it at 1900 Hz, of which one image has 5e-4."""
    frequency_hz = np.array([700.0, 1900.0])
    found, theory = measured_responses(QUIET, frequency_hz, 1e-3).y_per_u, linear_model(QUIET, frequency_hz).y_per_u
    error = np.linalg.norm(found - theory, axis=(1, 2)) / np.linalg.norm(theory, axis=(1, 2))
    assert error[0] < 2e-6
    assert error[1] < 4e-5


def test_the_usual_amplitude_moves_the_frequency_response_by_the_cubic_terms_only():
    """15 um of 300 um gap: 0.02 to 0.1 %; a tenth of it: a hundred times less."""
    frequency_hz = np.array([13.0])
    theory = linear_model(QUIET, frequency_hz).y_per_u[0]
    errors = []
    for amplitude_a in (0.15, 0.015):
        found = measured_responses(QUIET, frequency_hz, amplitude_a=amplitude_a).y_per_u[0]
        errors.append(np.linalg.norm(found - theory) / np.linalg.norm(theory))
    assert 1e-4 < errors[0] < 2e-3
    assert errors[1] == pytest.approx(errors[0] / 100, rel=0.2)


def test_more_steps_a_sample_change_nothing_that_counts():
    r = np.stack([tone(5000, f, 0.4, k)[:, k] for k, f in enumerate((23.0, 71.0, 190.0, 640.0))], axis=1)
    coarse, fine = (Simulation(QUIET, substeps=n).advance(r, check_limits=False) for n in (4, 32))
    assert np.abs(coarse.y - fine.y).max() < 1e-6 * np.abs(fine.y).max()
    single = Simulation(QUIET, substeps=1).advance(r, check_limits=False)
    assert np.abs(single.y - fine.y).max() < 1e-4 * np.abs(fine.y).max()


def test_a_plain_gain_as_controller_is_refused_as_not_levitating() -> None:
    rig = reference_rig()
    law = replace(rig.controller, numerator=np.array([1.0]), denominator=np.array([1.0]))
    with pytest.raises(LevitationError, match="does not levitate"):
        Simulation(replace(rig, controller=law))
