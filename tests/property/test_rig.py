"""What holds for any rig: datasheets survive a round trip, physics scales and balances, effects vanish smoothly."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim import actuator, rig_file, rotor
from sim.datasheet import AXES, Datasheet, Mode, Tolerance
from sim.effects import CATALOGUE
from sim.errors import EffectError, LevitationError
from sim.reference import reference_rig
from sim.rig import FlexibleMode, Rig
from sim.twin import linear_model, rig_from_datasheet

RIG = reference_rig()
OMEGA = 2 * np.pi * np.array([4.0, 60.0, 350.0, 900.0])

positive = st.floats(1e-12, 1e12, allow_nan=False)
any_number = st.floats(-1e12, 1e12, allow_nan=False)
up_to = {most: st.floats(1e-12, most) for most in (0.01, 5.0, 1e3)}
distances_m = st.tuples(up_to[5.0], up_to[5.0])
signed_pair = st.tuples(any_number, any_number)
names = st.text(st.characters(blacklist_categories=("Cs",)), min_size=1, max_size=30)
modes = st.builds(Mode, positive, st.floats(0, 0.99), signed_pair, signed_pair)
tolerances = st.builds(lambda values: Tolerance(*values), st.lists(positive, min_size=12, max_size=12))


@st.composite
def datasheets(draw: st.DrawFn) -> Datasheet:
    n = draw(st.sampled_from([2, 4]))
    per_axis = st.tuples(*[positive] * n)
    sample_time_s = draw(positive)
    bandwidths_hz = st.tuples(*[st.floats(1.1e-3 / sample_time_s, 1e16)] * n)  # slower ones are told to be in kHz
    order = draw(st.integers(1, 6))
    denominator = (draw(positive), *draw(st.lists(any_number, min_size=order - 1, max_size=order - 1)))
    stated = draw(st.booleans())
    return Datasheet(
        name=draw(names),
        axes=AXES[:n],
        mass_kg=draw(positive),
        transverse_inertia_kgm2=draw(positive),
        polar_inertia_kgm2=draw(st.none() | positive),
        bearing_from_cog_m=draw(distances_m),
        sensor_from_cog_m=draw(distances_m),
        modes=tuple(sorted(draw(st.lists(modes, max_size=3)), key=lambda m: m.frequency_hz)),
        current_stiffness_n_per_a=draw(per_axis),
        position_stiffness_n_per_m=draw(per_axis),
        bias_current_a=draw(st.tuples(*[up_to[1e3]] * n)),
        linear_range_m=draw(up_to[0.01]),
        amplifier_gain=draw(per_axis),
        amplifier_natural_frequency_hz=draw(bandwidths_hz),
        amplifier_damping_ratio=draw(st.none() | per_axis),
        sensor_gain=draw(per_axis),
        sensor_bandwidth_hz=draw(st.none() | bandwidths_hz),
        sample_time_s=sample_time_s,
        computing_delay_s=draw(st.floats(0, 0.1)),
        numerator=tuple(draw(st.lists(any_number, min_size=1, max_size=order))),
        denominator=denominator,
        displacement_limit_m=draw(up_to[0.01]),
        current_limit_a=draw(up_to[1e3]),
        tolerance=draw(tolerances) if stated else Tolerance(),
        tolerance_stated=stated,
        effects=draw(
            st.sampled_from([(), (("loop_delay", (("delay_s", 2e-5),)), ("sensor_lag", (("time_constant_s", 1e-5),)))])
        ),
    )


@given(datasheets())
def test_any_datasheet_survives_the_round_trip_and_makes_a_rig(sheet):
    assert rig_file.parse(rig_file.to_toml(sheet)) == sheet
    rig = rig_from_datasheet(replace(sheet, effects=()))
    assert rig.magnets.ki.tolist() == list(sheet.current_stiffness_n_per_a)
    assert rig.n_planes == sheet.n_axes // 2


shapes = st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3))


@st.composite
def rigs(draw: st.DrawFn) -> Rig:
    """Rigs of any rotor, with or without support, standing still."""

    def mode() -> FlexibleMode:
        return FlexibleMode(draw(st.floats(200, 9000)), draw(st.floats(1e-4, 0.1)), draw(shapes), draw(shapes))

    distances = st.tuples(st.floats(0.1, 2.0), st.floats(0.1, 2.0))
    body = replace(
        RIG.rotor,
        mass_kg=draw(st.floats(1, 5000)),
        transverse_inertia_kgm2=draw(st.floats(0.01, 500)),
        bearing_from_cog_m=draw(distances),
        sensor_from_cog_m=draw(distances),
        modes=tuple(tuple(mode() for _ in range(draw(st.integers(0, 3)))) for _ in range(2)),
    )
    rig = replace(RIG, rotor=body)
    if draw(st.booleans()):
        support = CATALOGUE["support_resonance"].of(rig)
        inverse_mass = next(p for p in support.parameters if p.name == "inverse_mass_per_kg")
        rig = support.on(rig, inverse_mass_per_kg=draw(st.floats(inverse_mass.low, inverse_mass.high)))
    return rig


@given(rigs())
def test_force_here_and_motion_there_is_motion_here_and_force_there(rig):
    """Reciprocity (Betti, Rayleigh) of receptances at the bearings, standing still."""
    at_bearings, _ = rotor.receptances(rotor.mechanics(rig), OMEGA)
    np.testing.assert_allclose(
        at_bearings, at_bearings.transpose(0, 2, 1), rtol=1e-6, atol=1e-9 * np.abs(at_bearings).max()
    )


@given(rigs(), st.floats(-1000, 1000), st.floats(0, 5))
def test_a_rotor_that_turns_is_reciprocal_to_one_that_turns_the_other_way(rig, speed, polar):
    turning = replace(rig, rotor=replace(rig.rotor, polar_inertia_kgm2=polar, modes=(rig.rotor.modes[0],) * 2))
    one, other = (
        rotor.receptances(rotor.mechanics(replace(turning, speed_rad_s=w)), OMEGA)[0] for w in (speed, -speed)
    )
    np.testing.assert_allclose(one, other.transpose(0, 2, 1), rtol=1e-6, atol=1e-8 * np.abs(one).max())


@given(rigs(), st.floats(-1000, 1000))
def test_a_free_rotor_gives_no_energy_whatever_the_gyroscopes_do(rig, speed):
    """The power that forces put in over a period, Re(F* jw X)/2, is never negative: jw receptance is passive."""
    turning = replace(rig, rotor=replace(rig.rotor, modes=(rig.rotor.modes[0],) * 2), speed_rad_s=speed)
    at_bearings, _ = rotor.receptances(rotor.mechanics(turning), OMEGA)
    mobility = 1j * OMEGA[:, None, None] * at_bearings
    power = np.linalg.eigvalsh(mobility + mobility.conj().transpose(0, 2, 1))
    assert power.min() >= -1e-9 * np.abs(mobility).max()


@given(rigs(), st.floats(0.1, 10))
def test_a_rotor_twice_as_heavy_under_magnets_twice_as_strong_moves_alike(rig, factor):
    """Masses, inertias, ki and ks together scale out of y/u; modes carry it in their unit modal mass."""
    m = rig.magnets
    heavier = replace(
        rig,
        rotor=replace(
            rig.rotor,
            mass_kg=factor * rig.rotor.mass_kg,
            transverse_inertia_kgm2=factor * rig.rotor.transverse_inertia_kgm2,
            modes=tuple(
                tuple(
                    replace(
                        k,
                        shape_at_bearings=tuple(v / factor**0.5 for v in k.shape_at_bearings),
                        shape_at_sensors=tuple(v / factor**0.5 for v in k.shape_at_sensors),
                    )
                    for k in plane
                )
                for plane in rig.rotor.modes
            ),
        ),
        magnets=replace(m, ki=factor * m.ki, ks=factor * m.ks),
        support=None,
    )
    before, after = (linear_model(r, OMEGA / (2 * np.pi)).y_per_u for r in (replace(rig, support=None), heavier))
    np.testing.assert_allclose(after, before, rtol=1e-6, atol=1e-8 * np.abs(before).max())


@given(
    st.lists(st.floats(-2.7, 2.7), min_size=4, max_size=4),
    st.lists(st.floats(-0.5, 0.5), min_size=4, max_size=4),
    st.floats(0.2, 5),
)
def test_the_force_scales_with_the_square_of_currents_over_gap(relative_i, relative_x, factor):
    """Bias and control current times a, gap and displacement times a: the same force."""
    m = RIG.magnets
    i, x = np.array(relative_i), np.array(relative_x) * m.gap_m
    # s0 = i0 ki / ks and k = ki s0^2/(4 i0) keep k when ki goes with 1/a and ks with 1/a
    scaled = replace(
        m, bias_current_a=factor * m.bias_current_a, ki=m.ki / factor, ks=m.ks / factor, current_limit_a=1e3
    )
    np.testing.assert_allclose(scaled.gap_m, factor * m.gap_m)
    before = actuator.force(replace(m, current_limit_a=1e3), i, x)
    np.testing.assert_allclose(actuator.force(scaled, factor * i, factor * x), before, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("one", CATALOGUE.values(), ids=CATALOGUE.keys())
@settings(max_examples=15)
@given(data=st.data())
def test_any_value_in_range_makes_a_rig_with_a_finite_model(one, data):
    speed = 100.0 if one.needs_speed else 0.0
    values = {
        p.name: data.draw(st.floats(min(p.low, p.null), max(p.high, p.null)) | st.just(p.null)) for p in one.parameters
    }
    try:
        rig = one.on(reference_rig(speed_rad_s=speed), **values)
        model = linear_model(rig, OMEGA / (2 * np.pi))
    except LevitationError:
        return  # magnets that cannot carry their own pull off centre
    except EffectError as error:
        pytest.fail(str(error))
    assert np.isfinite(model.y_per_u).all()
    assert np.isfinite(model.i_per_u).all()


@pytest.mark.parametrize("one", CATALOGUE.values(), ids=CATALOGUE.keys())
def test_an_effect_grows_from_nothing(one):
    """Close to its null values it is close to nothing: an optimiser may start there."""
    speed = 100.0 if one.needs_speed else 0.0
    rig = reference_rig(speed_rad_s=speed)
    without = linear_model(rig, OMEGA / (2 * np.pi))
    changes = []
    for share in (1e-2, 1e-4, 1e-6):
        values = {p.name: p.null + share * (p.typical - p.null) if p.strength else p.typical for p in one.parameters}
        model = linear_model(one.on(rig, **values), OMEGA / (2 * np.pi))
        changes.append(np.abs(model.y_per_u - without.y_per_u).max() / np.abs(without.y_per_u).max())
    assert changes[0] < 0.1
    assert changes[2] <= changes[1] <= changes[0]
    assert changes[2] < 1e-3
