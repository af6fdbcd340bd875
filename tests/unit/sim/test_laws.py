"""Laws of the magnets and amplifiers that have more than one form: harmonic balance against the time simulation."""

from dataclasses import replace

import numpy as np
import pytest

from sim import actuator
from sim.effects import effect
from sim.harmonic_balance import Responder
from sim.reference import reference_rig
from sim.rig import Contact, Drift, Noise
from sim.stepping import Simulation

QUIET = reference_rig(noise=Noise())
FS = 1 / QUIET.controller.sample_time_s


def steady(rig, amplitude_a: float, periods: int = 30, samples: int = 250):
    """Amplitudes of u, i and y of one tone on axis xA, harmonics 0 to 3, (4, n) each, and its frequency."""
    k = np.arange(periods * samples)
    r = np.zeros((len(k), rig.n_axes))
    r[:, 0] = amplitude_a * np.cos(2 * np.pi * k / samples)
    record = Simulation(rig, seed=1).advance(r, check_limits=False)
    last = slice(-10 * samples, None)
    basis = np.exp(-2j * np.pi * np.outer([0, 1, 2, 3], k[last]) / samples) / (10 * samples)
    basis[1:] *= 2
    return FS / samples, [basis @ getattr(record, name)[last] for name in "uiy"]


@pytest.mark.parametrize(
    ("name", "values", "tolerance"),
    [
        ("magnetic_hysteresis", {"loss_angle_rad": 0.1, "narrowest_a": 0.1, "widest_inverse_per_a": 10.0}, 0.05),
        ("magnetic_hysteresis", {"loss_angle_rad": 0.1, "narrowest_a": 0.02, "widest_inverse_per_a": 6.0}, 0.05),
        ("magnetic_saturation", {"saturation_inverse_per_a": 0.02, "flux_share": 0.6, "flux_power": 4.0}, 0.05),
        ("touchdown_contact", {"side": 1.0, **{f"clearance_{a}_m": 4e-6 for a in QUIET.axes}}, 0.1),
    ],
)
def test_the_change_that_a_law_makes_is_the_time_simulations(name, values, tolerance) -> None:
    rig = effect(name).on(QUIET, **values)
    hz, (u, _, y) = steady(rig, 0.3)
    answers = [
        Responder(r, np.array([hz]), np.zeros(1, dtype=np.int64)).answer(u[None], rounds=30, seen=y[None]).Y[0]
        for r in (QUIET, rig)
    ]
    for harmonic, shows in ((1, 1e-8), (3, 1e-10)):
        change, missing = y[harmonic, 0] - answers[0][harmonic, 0], y[harmonic, 0] - answers[1][harmonic, 0]
        assert abs(change) > shows, "the law shows"
        assert abs(missing) < tolerance * abs(change), harmonic


def test_a_warming_magnet_has_gone_most_of_its_way_early() -> None:
    change = np.full(4, -0.1)
    slow, fast = Drift(change, change, 100.0), Drift(change, change, 100.0, curvature=3.0)
    share = np.array([0.0, 0.3, 1.0])
    np.testing.assert_allclose(slow.progress(share), share)
    gone = fast.progress(share)
    assert gone[0] == 0
    assert gone[2] == pytest.approx(1.0)
    assert gone[1] == pytest.approx((1 - np.exp(-0.9)) / (1 - np.exp(-3.0)))


def test_flux_saturation_keeps_the_pull_at_the_bias() -> None:
    m = effect("magnetic_saturation").on(QUIET, saturation_inverse_per_a=0.02, flux_share=0.7).magnets
    plain = replace(m, flux_share=np.zeros(4))
    n = QUIET.n_axes
    small, large = np.full(n, 1e-4), np.full(n, 0.8 * m.bias_current_a[0])
    assert np.all(actuator.force(m, large, np.zeros(n)) < 0.9 * actuator.force(plain, large, np.zeros(n)))
    assert np.all(actuator.force(m, small, np.zeros(n)) < actuator.force(plain, small, np.zeros(n)))
    np.testing.assert_allclose(actuator.force(m, np.zeros(n), np.zeros(n)), 0.0, atol=1e-9)


def test_factors_of_a_saturating_pole_are_slopes_of_its_force() -> None:
    m = effect("magnetic_saturation").on(QUIET, saturation_inverse_per_a=0.02, flux_share=0.6, flux_power=5.0).magnets
    point, zero = actuator.operating_point(replace(QUIET, magnets=m)), np.zeros(QUIET.n_axes)
    di, dx = 1e-4, 1e-9
    ki = (actuator.force(m, zero + di, zero) - actuator.force(m, zero - di, zero)) / (2 * di)
    ks = (actuator.force(m, zero, zero + dx) - actuator.force(m, zero, zero - dx)) / (2 * dx)
    np.testing.assert_allclose(point.ki, ki, rtol=1e-5)
    np.testing.assert_allclose(point.ks, ks, rtol=1e-5)


def test_a_seal_that_damps_does_so_in_time_as_in_frequency() -> None:
    seal, law = effect("cross_coupled_stiffness"), {"stiffness_n_per_m": 1e5, "end_imbalance": 1.0}
    steady_y = []
    for damps in (0.0, 4.0):
        rig = seal.on(replace(QUIET, speed_rad_s=200.0), **law, inverse_whirl_ratio=damps)
        hz, (u, _, y) = steady(rig, 0.02)
        responder = Responder(rig, np.array([hz]), np.zeros(1, dtype=np.int64))
        answer = responder.answer(u[None], rounds=30, seen=y[None]).Y[0]
        np.testing.assert_allclose(answer[1], y[1], atol=2e-3 * np.abs(y[1]).max())
        steady_y.append(y[1])
    undamped, damped = steady_y
    assert np.abs(damped - undamped).max() > 0.02 * np.abs(damped).max(), "the damping shows"


@pytest.mark.parametrize("angle_rad", [0.3, 2.0, -1.2])
def test_a_ring_pushes_along_the_radius_from_its_middle(angle_rad: float) -> None:
    ring = Contact(np.full(4, 20e-6), 1e7, centre_m=np.array([3e-6, 0.0, -5e-6, 0.0]), ring=1.0)
    away = 26e-6 * np.array([np.cos(angle_rad), np.sin(angle_rad)])
    x = np.array([3e-6 + away[0], 0.0, -5e-6 + away[1], 0.0])
    force = actuator.stop_force(actuator.stop_rows(ring, 4, 2), x)
    np.testing.assert_allclose(force[[0, 2]], -1e7 * 6e-6 * away / 26e-6, rtol=1e-12)
    np.testing.assert_allclose(force[[1, 3]], 0.0)


def test_a_ring_is_a_stop_of_one_axis_where_the_other_does_not_move() -> None:
    x = np.outer(np.linspace(-40e-6, 40e-6, 21), [1.0, 0.0, 0.0, 0.0])
    forces = [
        actuator.stop_force(actuator.stop_rows(Contact(np.full(4, 20e-6), 1e7, ring=ring), 4, 2), x)
        for ring in (0.0, 1.0)
    ]
    np.testing.assert_allclose(*forces, atol=1e-9)


def test_a_ring_that_is_not_centred_moves_the_other_plane_in_time_as_in_frequency() -> None:
    """A tone in x alone pushes the rotor along y, too: stops of each axis do not."""
    ring = {"ring": 1.0, "centre_xA": 0.5, "centre_yA": -0.4, **{f"clearance_{axis}_m": 6e-6 for axis in QUIET.axes}}
    rig = effect("touchdown_contact").on(QUIET, **ring)
    hz, (u, _, y) = steady(rig, 0.3)
    found = Responder(rig, np.array([hz]), np.zeros(1, dtype=np.int64)).answer(u[None], rounds=30, seen=y[None]).Y[0]
    across = y[1, 2]
    assert abs(across) > 0.005 * abs(y[1, 0]), "it shows"
    assert abs(found[1, 2] - across) < 0.1 * abs(across)
