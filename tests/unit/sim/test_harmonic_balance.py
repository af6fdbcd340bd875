"""The nonlinear rig's answer to a periodic excitation without running it: harmonics 0 to 3, loop closed or open."""

from dataclasses import replace

import numpy as np
import pytest

from sim.effects import effect
from sim.harmonic_balance import Responder, respond_to_excitation, time_points
from sim.reference import reference_rig
from sim.rig import Noise, Rig
from sim.stepping import Simulation
from sim.twin import linear_model, with_effects

QUIET = reference_rig(noise=Noise())
FREQUENCY_HZ = np.array([23.0, 140.0, 610.0])
AMPLITUDE_A = np.array([0.3, 0.7, 0.9])


def in_time(rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """u and y of the rig for a tone on the second axis, harmonics 0 to 3, (P, 4, n)."""
    answers = []
    for frequency_hz, amplitude_a in zip(FREQUENCY_HZ, AMPLITUDE_A, strict=True):
        t = np.arange(40_000) * 1e-4
        r = np.zeros((len(t), rig.n_axes))
        r[:, 1] = amplitude_a * np.sin(np.pi / 2 * np.minimum(t / 2.5, 1.0)) ** 2 * np.cos(2 * np.pi * frequency_hz * t)
        record = Simulation(rig).advance(r, check_limits=False)
        basis = np.exp(-2j * np.pi * frequency_hz * np.outer(np.arange(4), t[-10_000:]))
        basis *= np.array([1, 2, 2, 2])[:, None] / 10_000
        answers.append((basis @ record.u[-10_000:], basis @ record.y[-10_000:]))
    u, y = zip(*answers, strict=True)
    return np.array(u), np.array(y)


@pytest.mark.parametrize(
    "rig",
    [
        QUIET,
        effect("magnetic_saturation").on(QUIET),
        effect("off_centre_rotor").on(QUIET),
        effect("touchdown_contact").on(QUIET, **{f"clearance_{axis}_m": 15e-6 for axis in ("xA", "xB", "yA", "yB")}),
        effect("logging_offset").on(QUIET, samples=2.0),
        reference_rig(gravity_m_per_s2=3.0, noise=Noise()),
    ],
    ids=["plain", "saturation", "off centre", "contact", "log two samples off", "loaded"],
)
def test_the_answer_to_an_excitation_is_what_the_loop_does_in_time(rig):
    u, y = in_time(rig)
    frequency_hz, line = time_points(FREQUENCY_HZ)
    R = np.zeros((3, 4, 4), dtype=complex)
    R[:, 1, 1] = AMPLITUDE_A
    if rig.logging_offset_samples:
        # r is logged with i and y; a lock-in puts the origin of time on it, as here
        shift = np.exp(2j * np.pi * FREQUENCY_HZ[:, None] * 1e-4 * rig.logging_offset_samples * np.arange(4))
        u, y = u * shift[..., None], y * shift[..., None]
    U, answer = respond_to_excitation(Responder(rig, frequency_hz, line), R)
    for found, exact, floor in ((U[:, 1:], u[:, 1:], 2e-5), (answer.Y[:, 1:], y[:, 1:], 1e-9)):
        fundamental = np.abs(exact[:, 0]).max(axis=1)[:, None, None]
        assert np.all(np.abs(found - exact) < floor + 3e-3 * fundamental)


def test_what_a_force_law_shifts_on_average_has_no_phase():
    """The controller's integrator turns a mean by 90 degrees, and of a log with such means amplifiers seem at fault."""
    frequency_hz, line = time_points(FREQUENCY_HZ)
    R = np.zeros((3, 4, 4), dtype=complex)
    R[:, 1, 1] = AMPLITUDE_A
    U, answer = respond_to_excitation(Responder(effect("off_centre_rotor").on(QUIET), frequency_hz, line), R)
    mean = [X[:, 0] for X in (U, answer.I, answer.Y)]
    assert np.abs(mean[0]).max() > 1e-4
    assert not any(np.imag(X).any() for X in mean)


def test_at_small_amplitude_it_is_the_linear_model():
    model = linear_model(QUIET, FREQUENCY_HZ)
    U = np.zeros((3, 4, 4), dtype=complex)
    U[:, 1, 2] = 1e-4
    answer = Responder(QUIET, FREQUENCY_HZ, np.arange(3)).answer(U)
    np.testing.assert_allclose(answer.Y[:, 1], model.y_per_u[:, :, 2] * 1e-4, rtol=1e-6, atol=1e-18)
    np.testing.assert_allclose(answer.I[:, 1], model.i_per_u[:, :, 2] * 1e-4, rtol=1e-9, atol=1e-18)


@pytest.mark.parametrize(
    ("name", "logged"),
    [("off_centre_rotor", (1,)), ("off_centre_rotor", (1, 3)), ("magnetic_saturation", (1,))],
)
def test_what_was_not_logged_of_the_harmonics_happens_all_the_same(name, logged):
    """The mean and the second harmonic of an off-centre rotor bend its fundamental, logged or not."""
    rig = effect(name).on(QUIET)
    u, y = in_time(rig)
    frequency_hz, line = time_points(FREQUENCY_HZ)
    known = list(logged)

    def missed(answer: np.ndarray) -> np.ndarray:
        return np.abs(answer[:, logged.index(1)] - y[:, 1]).max(axis=1)

    answer = Responder(rig, frequency_hz, line, logged).answer(u[:, known], seen=y[:, known]).Y
    unbent = (linear_model(rig, frequency_hz).y_per_u @ u[:, 1, :, None])[:, None, :, 0].repeat(len(logged), axis=1)
    assert answer.shape == (3, len(logged), 4)
    assert np.all(missed(answer) < 0.05 * missed(unbent))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_wall_stiffer_than_the_magnets_is_touched_where_the_measured_rotor_touches_it(side):
    """The mean current that holds against it would draw a free rotor away from it."""
    clearances = {f"clearance_{axis}_m": 15e-6 for axis in ("xA", "xB", "yA", "yB")}
    rig = effect("touchdown_contact").on(QUIET, stiffness_n_per_m=2e7, side=side, **clearances)
    u, y = in_time(rig)
    frequency_hz, line = time_points(FREQUENCY_HZ)
    found = Responder(rig, frequency_hz, line).answer(u, seen=y).Y
    unbent = (linear_model(rig, frequency_hz).y_per_u[0] @ u[0, 1])[None]
    assert np.abs(unbent - y[0, 1]).max() > 0.1 * np.abs(y[0, 1]).max(), "it touches"
    assert np.abs(found[0, 1:] - y[0, 1:]).max() < 0.2 * np.abs(unbent - y[0, 1]).max()


def test_stops_that_are_never_touched_change_nothing():
    drifting = effect("thermal_drift").on(QUIET, ki_change=-0.1, ks_change=-0.1)
    stops = effect("touchdown_contact").on(drifting, **{f"clearance_{axis}_m": 2e-4 for axis in QUIET.axes})
    frequency_hz, line = time_points(FREQUENCY_HZ)
    R = np.zeros((3, 4, 4), dtype=complex)
    R[:, 1, 1] = AMPLITUDE_A
    progress = np.array([0.2, 0.5, 1.0])
    U, answer = respond_to_excitation(Responder(drifting, frequency_hz, line, progress=progress), R)
    U[:, 0] += [[1e-5], [-2e-5], [3e-5]]  # the mean of a current is noisier than that of the displacement

    found, expected = (
        Responder(rig, frequency_hz, line, progress=progress).displacement(U, seen=answer.Y)
        for rig in (stops, drifting)
    )

    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-18)


def test_a_drifting_rig_answers_as_of_the_time_of_each_point():
    drifting = effect("thermal_drift").on(QUIET, ki_change=-0.2, ks_change=0.0)
    end = replace(QUIET, magnets=replace(QUIET.magnets, ki=0.8 * QUIET.magnets.ki, ks=QUIET.magnets.ks))
    U = np.zeros((2, 4, 4), dtype=complex)
    U[:, 1, 0] = 1e-3
    line, progress = np.array([0, 0]), np.array([0.0, 1.0])
    answer = Responder(drifting, np.array([150.0]), line, progress=progress).answer(U, rounds=30)
    for k, rig in enumerate((QUIET, end)):
        model = linear_model(rig, np.array([150.0]))
        np.testing.assert_allclose(answer.Y[k, 1], model.y_per_u[0, :, 0] * 1e-3, rtol=2e-3, atol=1e-12)


@pytest.mark.parametrize("harmonics", [(0, 1, 2, 3), (1,), (1, 3)])
@pytest.mark.parametrize("name", ["off_centre_rotor", "amplifier_voltage_limit", "logging_offset"])
def test_what_is_beyond_the_linear_answer_is_all_but_that(name, harmonics):
    rig, rng = effect(name).on(QUIET), np.random.default_rng(3)
    U, Y = (scale * (rng.normal(size=(6, 4, 4)) + 1j * rng.normal(size=(6, 4, 4))) for scale in (0.3, 1e-6))
    frequency_hz, line = np.array([40.0, 700.0]), np.array([0, 1, 0, 1, 1, 0])
    U, Y = U[:, list(harmonics)], Y[:, list(harmonics)]
    of = Responder(rig, frequency_hz, line, harmonics)
    linear = (linear_model(rig, frequency_hz).y_per_u[line] @ U[:, harmonics.index(1), :, None])[..., 0]
    expected = of.displacement(U, seen=Y)
    expected[:, harmonics.index(1)] -= linear
    np.testing.assert_allclose(of.beyond_linear(U, seen=Y), expected, rtol=1e-9, atol=1e-12 * np.abs(linear).max())


@pytest.mark.parametrize(
    "effects",
    [
        {},
        {"magnetic_saturation": {}},
        {"magnetic_hysteresis": {}},
        {"off_centre_rotor": {}},
        {"support_resonance": {}, "magnetic_saturation": {"saturation_inverse_per_a": 0.4}},
    ],
    ids=lambda effects: " + ".join(effects) or "plain",
)
def test_at_a_displacement_that_was_seen_the_force_has_settled(effects):
    """To 1e-6 of the largest signal; off centre to 6e-4, twice what two programs' integrators differ by."""
    rig = with_effects(QUIET, effects)
    frequency_hz, line = np.array([23.0, 140.0, 433.0, 610.0]), np.arange(4)
    R = np.zeros((4, 4, 4), dtype=complex)
    R[:, 1, 1] = 0.3, 0.7, 0.9, 0.9
    responder = Responder(rig, frequency_hz, line)
    U, answer = respond_to_excitation(responder, R)
    seen = answer.Y * np.exp(0.02j)  # not quite where the model has it
    settled = responder.displacement(U, rounds=12, seen=seen)
    size = np.abs(answer.Y[:, 1]).max(axis=1)[:, None, None]
    error = np.abs(responder.displacement(U, seen=seen) - settled) / size
    assert error.max() < (6e-4 if "off_centre_rotor" in effects else 1e-6)
    assert np.abs(responder.displacement(U, rounds=1, seen=seen) - settled).max() > 3 * (error * size).max()
