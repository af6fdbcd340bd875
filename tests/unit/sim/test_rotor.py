"""Rotor and support against closed forms, balances of momentum, and what turning must do."""

from dataclasses import replace

import numpy as np
import pytest

from sim import rotor
from sim.effects import effect
from sim.reference import reference_rig
from sim.rig import Disc, FlexibleMode, Rig

RIG = reference_rig()
RIGID = replace(RIG, rotor=replace(RIG.rotor, modes=((), ())))
OMEGA = 2 * np.pi * np.array([3.0, 40.0, 300.0, 800.0])


def turning(rig: Rig, speed: float) -> Rig:
    return replace(rig, speed_rad_s=speed)


def whirl_poles(rig: Rig) -> np.ndarray:
    """Poles of the free rotor and support, rad/s."""
    m = rotor.mechanics(rig)
    n = len(m.mass)
    a = np.block(
        [[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(m.mass, m.stiffness), -np.linalg.solve(m.mass, m.damping)]]
    )
    return np.linalg.eigvals(a)


def test_the_rigid_rotor_has_the_inverse_mass_matrix_of_the_thesis():
    """M^-1 = [[1/m + dA^2/I, 1/m - dA dB/I], [.., 1/m + dB^2/I]]; Appendix B prints 0.02, -0.012, 0.019."""
    m = rotor.mechanics(RIGID)
    inverse = (m.bearing_map @ np.linalg.solve(m.mass, m.force_map))[:2, :2]
    a, b, mass, inertia = 0.418, 0.404, 280.0, 10.87
    exact = 1 / mass + np.array([[a * a, -a * b], [-a * b, b * b]]) / inertia
    np.testing.assert_allclose(inverse, exact, rtol=1e-12)
    np.testing.assert_allclose(inverse, [[0.02, -0.012], [-0.012, 0.019]], atol=6e-4)


def test_sensors_see_the_exact_rigid_map_and_not_the_diagonal_one():
    """[[1.080, -0.080], [-0.080, 1.080]] from bearing to sensor displacements."""
    bearings, sensors = rotor.plane_maps(RIGID, 0)
    np.testing.assert_allclose(sensors @ np.linalg.inv(bearings), [[1.080, -0.080], [-0.080, 1.080]], atol=5e-4)


def test_a_rigid_rotor_moves_as_newton_says():
    """The sum of the forces is mass times acceleration of the centre of gravity, their moment turns it."""
    at_bearings, _ = rotor.receptances(rotor.mechanics(RIGID), OMEGA)
    force = np.array([3.0, -1.0])
    x = at_bearings[:, :2, :2] @ force
    a, b = RIG.rotor.bearing_from_cog_m
    centre, tilt = (b * x[:, 0] + a * x[:, 1]) / (a + b), (x[:, 0] - x[:, 1]) / (a + b)
    np.testing.assert_allclose(-(OMEGA**2) * 280.0 * centre, force.sum(), rtol=1e-9)
    np.testing.assert_allclose(-(OMEGA**2) * 10.87 * tilt, a * force[0] - b * force[1], rtol=1e-9)


def test_a_flexible_mode_adds_its_residue():
    mode = FlexibleMode(2000.0, 0.01, (0.1, -0.05), (0.12, -0.02))
    rig = replace(RIGID, rotor=replace(RIGID.rotor, modes=((mode,), ())))
    _, rigid = rotor.receptances(rotor.mechanics(RIGID), OMEGA)
    _, flexible = rotor.receptances(rotor.mechanics(rig), OMEGA)
    s = 1j * OMEGA[:, None, None]
    added = np.outer([0.12, -0.02], [0.1, -0.05]) / (s**2 + 2 * 0.01 * 2000.0 * s + 2000.0**2)
    np.testing.assert_allclose((flexible - rigid)[:, :2, :2], added, rtol=1e-9)
    np.testing.assert_array_equal((flexible - rigid)[:, 2:, :], 0)


def test_standing_still_the_planes_do_not_know_of_each_other():
    at_bearings, at_sensors = rotor.receptances(rotor.mechanics(RIG), OMEGA)
    for g in (at_bearings, at_sensors):
        np.testing.assert_array_equal(g[:, :2, 2:], 0)
        np.testing.assert_array_equal(g[:, 2:, :2], 0)


def test_the_gyroscopic_moment_splits_a_tilt_into_nutation_and_a_rest():
    """A free rigid rotor nutates at Ip/It times its speed (Genta 2005, chapter 3)."""
    rig = turning(replace(RIGID, rotor=replace(RIGID.rotor, polar_inertia_kgm2=1.9)), 500.0)
    fastest = np.abs(whirl_poles(rig)).max()
    assert fastest == pytest.approx(1.9 / 10.87 * 500.0, rel=1e-9)


def whirl_direction(rig: Rig, pole: complex) -> float:
    """Positive when the tilt turns from x towards y, as the rotor does."""
    m = rotor.mechanics(rig)
    dynamic = m.mass * pole**2 + m.damping * pole + m.stiffness
    q = np.linalg.svd(dynamic)[2][-1].conj()
    half = len(rig.rotor.modes[0]) + 2
    x, y = q[1:half], q[half + 1 : 2 * half]
    k = np.argmax(np.abs(x))
    return float(np.imag(x[k] * np.conj(y[k])) * np.sign(pole.imag))


def test_the_nutation_goes_the_way_of_the_rotor():
    rig = turning(replace(RIGID, rotor=replace(RIGID.rotor, polar_inertia_kgm2=1.9)), 500.0)
    pole = 1j * 1.9 / 10.87 * 500.0
    assert whirl_direction(rig, pole) > 0


def symmetric_modes(zeta: float) -> Rig:
    mode = FlexibleMode(3000.0, zeta, (0.08, 0.05), (0.08, 0.14))
    return replace(RIG, rotor=replace(RIG.rotor, modes=((mode,), (mode,)), polar_inertia_kgm2=1.9))


def test_the_moments_of_a_whole_shaft_are_those_of_its_parts():
    """Three discs where modes tilt them otherwise, as one effect: what tilts is coupled by a matrix of any rank."""
    mode = FlexibleMode(2 * np.pi * 1400, 0.005, (0.05, -0.04), (0.05, -0.04))
    rig = replace(RIG, rotor=replace(RIG.rotor, modes=tuple((*modes, mode) for modes in RIG.rotor.modes)))
    parts = ((0.8, (0.2, -0.1, 0.05)), (0.7, (-0.1, 0.3, 0.1)), (0.4, (0.05, 0.1, -0.2)))
    of_parts = replace(rig, rotor=replace(rig.rotor, discs=tuple(Disc(*part) for part in parts)))
    G = sum(inertia * np.outer([1, *slopes], [1, *slopes]) for inertia, slopes in parts)
    inertia, slopes = G[0, 0], G[0, 1:] / G[0, 0]
    more = G[1:, 1:] - inertia * np.outer(slopes, slopes)
    mean = (more[0, 0] + more[1, 1]) / 2
    whole = effect("gyroscopic_coupling").on(
        rig,
        polar_inertia_kgm2=inertia,
        mode_coupling=mean,
        coupling_imbalance=(more[0, 0] - more[1, 1]) / (2 * mean),
        mode3_coupling=more[2, 2] - mean,
        **{f"mode{k + 1}_slope_per_m_sqrt_kg": slope for k, slope in enumerate(slopes)},
        **{f"mode{j + 1}_to_mode{k + 1}_coupling": more[j, k] for j, k in ((0, 1), (0, 2), (1, 2))},
    )
    one, other = (rotor.mechanics(turning(r, 300.0)).damping for r in (whole, of_parts))
    np.testing.assert_allclose(one, other, atol=1e-9 * np.abs(other).max())


def test_the_gyroscopic_coupling_of_a_mode_splits_it_in_proportion_to_speed():
    rig = turning(effect("gyroscopic_coupling").on(symmetric_modes(0.0), mode_coupling=0.02), 600.0)
    poles = whirl_poles(rig)
    high = np.sort(poles[poles.imag > 2000].imag)
    np.testing.assert_allclose(high, 3000.0 + np.array([-0.5, 0.5]) * 0.02 * 600.0, rtol=1e-5)
    forward = whirl_direction(rig, 1j * high[1])
    assert forward > 0, "the forward whirl is the faster one"


def test_the_moment_of_a_disc_is_that_of_its_own_tilt_which_modes_have_a_part_in():
    slopes = {"mode1_slope_per_m_sqrt_kg": -0.2, "mode2_slope_per_m_sqrt_kg": 0.7}
    has = effect("gyroscopic_coupling").on(RIG, polar_inertia_kgm2=2.0, mode_coupling=0.0, **slopes)
    damping, plain = (rotor.mechanics(turning(rig, 300.0)).damping for rig in (has, RIG))
    of_disc = damping - plain
    velocity = np.random.default_rng(1).standard_normal(8)
    assert velocity @ of_disc @ velocity == pytest.approx(0.0, abs=1e-9), "it does no work"
    tilts = np.array([[0.0, 1.0, -0.2, 0.7, 0, 0, 0, 0], [0, 0, 0, 0, 0.0, 1.0, -0.2, 0.7]])
    of_x, of_y = tilts @ velocity
    # the moment Ip W (th_y', -th_x') works along virtual tilts of the disc alone
    np.testing.assert_allclose(of_disc @ velocity, 600.0 * (tilts[0] * of_y - tilts[1] * of_x), atol=1e-9)
    still = velocity - np.linalg.pinv(tilts) @ tilts @ velocity
    np.testing.assert_allclose(of_disc @ still, 0.0, atol=1e-9)


def test_a_disc_where_no_mode_tilts_is_polar_inertia_and_the_whole_is_told():
    without = effect("gyroscopic_coupling").on(RIG, polar_inertia_kgm2=2.0, mode_coupling=0.0)
    disc = replace(RIG, rotor=replace(RIG.rotor, discs=(Disc(2.0, (0.0, 0.0)),)))
    one, other = (rotor.mechanics(turning(rig, 300.0)).damping for rig in (without, disc))
    np.testing.assert_allclose(one, other)
    assert disc.rotor.whole_polar_inertia_kgm2 == without.rotor.whole_polar_inertia_kgm2 == pytest.approx(3.9)


def test_internal_damping_takes_from_the_forward_whirl_what_it_gives_to_the_backward_one():
    """zF = ze + zi (1 - W/w), zB = ze + zi (1 + W/w)."""
    ze, zi, w, speed = 0.001, 0.002, 3000.0, 900.0
    rig = turning(effect("internal_damping").on(symmetric_modes(ze), damping_ratio=zi), speed)
    poles = whirl_poles(rig)
    high = poles[poles.imag > 2000]
    by_direction = {whirl_direction(rig, p) > 0: -p.real / abs(p) for p in high}
    assert by_direction[True] == pytest.approx(ze + zi * (1 - speed / w), rel=1e-4)
    assert by_direction[False] == pytest.approx(ze + zi * (1 + speed / w), rel=1e-4)


@pytest.mark.parametrize(
    ("modes", "imbalance", "of_each"),
    [(1, 1.0, [1.0]), (1, -1.0, [1.0]), (2, 1.0, [2.0, 0.0]), (3, -1.0, [0.0, 2.0, 0.0]), (3, 0.0, [1.0, 1.0, 1.0])],
)
def test_internal_damping_is_of_one_mode_or_of_all(modes, imbalance, of_each):
    mode = FlexibleMode(3000.0, 0.001, (0.08, 0.05), (0.08, 0.14))
    rig = replace(RIG, rotor=replace(RIG.rotor, modes=((mode,) * modes,) * 2))
    has = effect("internal_damping").on(rig, damping_ratio=1e-3, mode_imbalance=imbalance)
    for plane in has.rotor.modes:
        assert [m.internal_damping_ratio for m in plane] == pytest.approx([1e-3 * share for share in of_each])


def test_internal_damping_makes_the_forward_whirl_unstable_beyond_its_critical_speed():
    stable, unstable = (
        turning(effect("internal_damping").on(symmetric_modes(0.0), damping_ratio=0.002), w) for w in (2900.0, 3100.0)
    )
    for rig, sign in ((stable, -1), (unstable, 1)):
        poles = whirl_poles(rig)
        assert np.sign(poles[poles.imag > 2000].real.max()) == sign


def test_a_seal_pushes_the_way_of_the_rotor():
    """f_x = -k y, f_y = +k x: it feeds the forward whirl."""
    rig = effect("cross_coupled_stiffness").on(RIG, stiffness_n_per_m=1e5)
    m = rotor.mechanics(rig)
    q = np.linalg.pinv(m.bearing_map) @ np.array([1e-6, 1e-6, 0.0, 0.0])  # both bearings to +x
    generalised = -(m.stiffness - rotor.mechanics(RIG).stiffness) @ q
    force = np.linalg.lstsq(m.bearing_map.T, generalised, rcond=None)[0]
    np.testing.assert_allclose(force, [0, 0, 0.1, 0.1], atol=1e-9)
    at_a = rotor.seal_stiffness(effect("cross_coupled_stiffness").on(RIG, stiffness_n_per_m=1e5, end_imbalance=1.0))
    np.testing.assert_allclose(-at_a @ [1e-6, 1e-6, 0.0, 0.0], [0, 0, 0.2, 0.0], atol=1e-9)


def test_a_seal_that_damps_takes_the_power_of_what_moves_in_it():
    """Each way at its own bearing, f = -c v with c = k / (whirl ratio W); between the bearings, at the mean of both."""
    seal, turning = effect("cross_coupled_stiffness"), replace(RIG, speed_rad_s=200.0)
    law = {"stiffness_n_per_m": -3e4, "inverse_whirl_ratio": 2.0}
    at_a = seal.on(turning, **law, end_imbalance=1.0)
    np.testing.assert_allclose(-rotor.seal_damping(at_a) @ [1e-3, 1.0, 0.0, 0.0], [-0.6, 0.0, 0.0, 0.0], atol=1e-9)
    added = rotor.mechanics(at_a).damping - rotor.mechanics(turning).damping
    ends = rotor.mechanics(RIG).bearing_map[[0, 2]]
    np.testing.assert_allclose(added, 600.0 * ends.T @ ends, atol=1e-9)
    between = rotor.seal_damping(seal.on(turning, **law, between=1.0))
    np.testing.assert_allclose(between @ [1.0, -1.0, 0.0, 0.0], 0.0, atol=1e-9)
    np.testing.assert_array_equal(rotor.seal_damping(seal.on(RIG, **law)), 0.0)


def test_a_seal_at_mid_span_pushes_where_a_mode_moves_the_shaft():
    """Its power is that of its force and the motion of the shaft at the seal, whichever way the rotor bends."""
    law = {"stiffness_n_per_m": 1e5, "between": 1.0, "mode1_bow_per_sqrt_kg": -0.25}
    m, plain = rotor.mechanics(effect("cross_coupled_stiffness").on(RIG, **law)), rotor.mechanics(RIG)
    q = 1e-6 * np.random.default_rng(3).standard_normal((2, len(m.mass)))
    starts = np.array([0, 2 + len(RIG.rotor.modes[0])])
    at_seal = [(plain.bearing_map[2 * k : 2 * k + 2] @ q.T).mean(axis=0) - 0.25 * q.T[starts[k] + 2] for k in (0, 1)]
    work = -q[0] @ (m.stiffness - plain.stiffness) @ q[1]  # of the forces of one motion along the other one
    assert work == pytest.approx(2e5 * (at_seal[1][0] * at_seal[0][1] - at_seal[0][0] * at_seal[1][1]), rel=1e-9)


def test_a_seal_that_carries_the_fluid_round_damps_alike_at_all_speeds():
    law = {"stiffness_n_per_m": 0.0, "by_speed_ns_per_m": 150.0, "inverse_whirl_ratio": 2.0}
    for speed in (100.0, 300.0):
        rig = effect("cross_coupled_stiffness").on(replace(RIG, speed_rad_s=speed), **law)
        np.testing.assert_allclose(rotor.seal_damping(rig), 300.0 * np.eye(4))


def test_a_support_takes_the_reaction():
    """What the magnets give to the rotor they take from the housing: no net force on both together."""
    rig = effect("support_resonance").on(RIGID, inverse_mass_per_kg=1 / 900.0, frequency_hz=430.0)
    m = rotor.mechanics(rig)
    s = 1j * OMEGA[:, None, None]
    q = np.linalg.solve(m.mass * s**2 + m.damping * s + m.stiffness, m.force_map[None].astype(complex))
    momentum = -(OMEGA[:, None] ** 2) * (280.0 * q[:, 0] + 900.0 * q[:, 4])
    held = (2 * np.pi * 430.0) ** 2 * 900.0 * q[:, 4] + 2 * 0.01 * 2 * np.pi * 430.0 * 900.0 * 1j * OMEGA[:, None] * q[
        :, 4
    ]
    np.testing.assert_allclose(momentum + held, 0, atol=1e-9)
    np.testing.assert_array_equal(m.sensor_map[:2, 4], -1.0)


def test_a_pedestal_moves_under_its_own_bearing_alone():
    """Displacement relative to a pedestal of its own: one more receptance of a mass on a spring on the diagonal."""
    mass, hz, zeta, ratio = 900.0, 110.0, 0.03, 1.1
    rig = effect("support_resonance").on(
        RIG, inverse_mass_per_kg=1 / mass, frequency_hz=hz, damping_ratio=zeta, pedestals=1.0, frequency_ratio=ratio
    )
    (_, free), (_, held) = (rotor.receptances(rotor.mechanics(r), OMEGA) for r in (RIG, rig))
    own = 2 * np.pi * hz * np.array([1.0, ratio, 1.0, ratio])
    of_pedestals = 1 / mass / (own**2 - OMEGA[:, None] ** 2 + 2j * zeta * own * OMEGA[:, None])
    np.testing.assert_allclose(held - free, of_pedestals[:, :, None] * np.eye(4), rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("pedestals", [0.0, 1.0])
def test_what_carries_the_bearings_may_be_softer_in_one_direction(pedestals):
    """A pedestal is stiffer upright than sideways: the y plane as if its own frequency were stated for both."""
    values = {"inverse_mass_per_kg": 1 / 900.0, "damping_ratio": 0.03, "pedestals": pedestals, "frequency_ratio": 1.1}
    in_x, in_y, unlike = (
        rotor.receptances(rotor.mechanics(effect("support_resonance").on(RIG, **values, **own)), OMEGA)[1]
        for own in (
            {"frequency_hz": 90.0},
            {"frequency_hz": 126.0},
            {"frequency_hz": 90.0, "plane_frequency_ratio": 1.4},
        )
    )
    np.testing.assert_allclose(unlike[:, :2, :2], in_x[:, :2, :2], rtol=1e-12)
    np.testing.assert_allclose(unlike[:, 2:, 2:], in_y[:, 2:, 2:], rtol=1e-12)


@pytest.mark.parametrize("imbalance", [0.0, 0.3])
def test_a_housing_that_rocks_turns_about_a_point_between_the_bearings(imbalance):
    """One more receptance of an inertia on a spring, as each bearing and sensor is away from that point."""
    mass, hz, zeta, rocking, ratio, quotient, softer = 900.0, 110.0, 0.03, 2.5, 1.6, 0.4, 1.3
    values = {"inverse_mass_per_kg": 1 / mass, "frequency_hz": hz, "damping_ratio": zeta}
    still, rocks = (
        rotor.receptances(rotor.mechanics(effect("support_resonance").on(RIG, **values, **own)), OMEGA)[1]
        for own in (
            {},
            {
                "rocking": rocking,
                "rocking_frequency_ratio": ratio,
                "rocking_damping_quotient": quotient,
                "rocking_plane_quotient": softer,
                "rocking_imbalance": imbalance,
            },
        )
    )
    (a, b), (sa, sb) = RIG.rotor.bearing_from_cog_m, RIG.rotor.sensor_from_cog_m
    inertia = mass / rocking * ((a + b) / 2) ** 2
    angles = [
        1 / (inertia * (w**2 - OMEGA**2 + 2j * zeta * quotient * w * OMEGA))
        for w in 2 * np.pi * hz * ratio * np.array([1.0, softer])
    ]
    centre = (a - b) / 2 - imbalance * (a + b) / 2  # from the centre of gravity towards A
    arms = np.outer([sa - centre, -sb - centre], [a - centre, -b - centre])
    expected = sum(
        np.kron(np.diag(plane), arms) * angle[:, None, None] for plane, angle in zip(np.eye(2), angles, strict=True)
    )
    np.testing.assert_allclose(rocks - still, expected, rtol=1e-9, atol=1e-15)


def test_what_is_no_pedestal_is_the_housing_of_both():
    half = effect("support_resonance").on(RIG, pedestals=0.5)
    whole, apart = (effect("support_resonance").on(RIG, pedestals=share) for share in (0.0, 1.0))
    _, free = rotor.receptances(rotor.mechanics(RIG), OMEGA)
    a, b, c = (rotor.receptances(rotor.mechanics(r), OMEGA)[1] - free for r in (half, whole, apart))
    np.testing.assert_allclose(a, 0.5 * (b + c), rtol=1e-9, atol=1e-18)


@pytest.mark.parametrize(
    ("pedestals", "end_imbalance", "moves"),
    [
        (1.0, 1.0, [[4.0, 0.0], [0.0, 0.0]]),
        (0.0, 1.0, [[4.0, 0.0], [0.0, 0.0]]),
        (0.0, 0.0, [[2.0, 2.0], [2.0, 2.0]]),
        (0.0, 0.6, [[3.2, 1.6], [1.6, 0.8]]),
        (1.0, 0.6, [[3.2, 0.0], [0.0, 0.8]]),
    ],
)
def test_pedestals_or_a_housing_of_one_plane_may_move_one_end_farther_or_alone(pedestals, end_imbalance, moves):
    """A housing that leans moves both ends at once, so that one answers to a force at the other."""
    mass, hz, zeta, own = 900.0, 110.0, 0.03, {"end_imbalance": end_imbalance, "plane_imbalance": 1.0}
    rig = effect("support_resonance").on(
        RIG, inverse_mass_per_kg=1 / mass, frequency_hz=hz, damping_ratio=zeta, pedestals=pedestals, **own
    )
    (_, free), (_, held) = (rotor.receptances(rotor.mechanics(r), OMEGA) for r in (RIG, rig))
    w = 2 * np.pi * hz
    of_mean = 1 / mass / (w**2 - OMEGA**2 + 2j * zeta * w * OMEGA)
    np.testing.assert_allclose((held - free)[:, 2:], 0.0, atol=1e-15)
    np.testing.assert_allclose((held - free)[:, :2, :2], of_mean[:, None, None] * moves, rtol=1e-9, atol=1e-15)


def test_a_heavy_support_is_none():
    heavy = effect("support_resonance").on(RIG, inverse_mass_per_kg=1e-6)
    _, still = rotor.receptances(rotor.mechanics(RIG), OMEGA)
    _, moved = rotor.receptances(rotor.mechanics(heavy), OMEGA)
    np.testing.assert_allclose(moved, still, rtol=0.02, atol=1e-11)


def test_the_high_frequency_limit_is_what_receptances_tend_to():
    m = rotor.mechanics(RIG)
    omega = np.array([2 * np.pi * 1e6])
    _, at_sensors = rotor.receptances(m, omega)
    np.testing.assert_allclose(at_sensors[0], -m.high_frequency / omega[0] ** 2, rtol=1e-4, atol=1e-22)


def test_an_impeller_outside_the_bearings_pushes_where_it_is():
    """0.6 m from the centre of gravity, beyond bearing B: its power is that of its force and the motion there."""
    a, b = RIGID.rotor.bearing_from_cog_m
    lever = (2 * 0.6 + a - b) / (a + b)  # both ends' weights, (1 -+ lever) / 2, make up the straight line there
    law = {"stiffness_n_per_m": 1e5, "between": 1.0, "end_imbalance": -1.0, "overhang": lever - 1}
    m, plain = rotor.mechanics(effect("cross_coupled_stiffness").on(RIGID, **law)), rotor.mechanics(RIGID)
    q = 1e-6 * np.random.default_rng(4).standard_normal((2, len(m.mass)))
    (x, y), (of_x, of_y) = ((v[0::2] - 0.6 * v[1::2]) for v in q)
    work = -q[0] @ (m.stiffness - plain.stiffness) @ q[1]
    assert work == pytest.approx(2e5 * (y * of_x - x * of_y), rel=1e-9)
