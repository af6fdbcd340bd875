"""A parameter's range goes with the rig where it is one of size, and its name ends with its unit."""

from dataclasses import replace

import numpy as np
import pytest

from sim.effect import SUFFIXES, Parameter
from sim.effects import CATALOGUE
from sim.errors import EffectError
from sim.reference import reference_rig
from sim.rig import Rig
from sim.sizes import AIR_GAP, BIAS, INERTIA, MASS, SLOPE, SPAN, STIFFNESS

RIG = reference_rig()


def of_mass(kg: float) -> Rig:
    return replace(RIG, rotor=replace(RIG.rotor, mass_kg=kg))


@pytest.mark.parametrize("p", [p for e in CATALOGUE.values() for p in e.parameters if p.unit not in ("1", "samples")])
def test_a_name_ends_with_its_unit_and_the_words_do_not(p: Parameter) -> None:
    assert p.name == p.words.replace(" ", "_") + SUFFIXES[p.unit]


@pytest.mark.parametrize("size", [MASS, INERTIA, SPAN, BIAS, STIFFNESS, AIR_GAP, SLOPE], ids=str)
def test_ranges_are_stated_for_the_reference_rig(size) -> None:
    assert size.ratio(RIG) == pytest.approx(1.0, rel=0.01)


def test_a_housing_may_be_as_light_for_a_light_rotor_as_for_a_heavy_one() -> None:
    inverse_mass = next(p for p in CATALOGUE["support_resonance"].parameters if p.name == "inverse_mass_per_kg")
    light = inverse_mass.of(of_mass(2.8))
    assert (light.low, light.high, light.typical) == pytest.approx((1e-4, 2.0, 1 / 9))
    assert light.null == 0.0
    assert light.of(of_mass(2.8)) == light
    assert light.of(of_mass(280.0)).high == pytest.approx(inverse_mass.high)


def test_a_rig_may_have_somewhat_more_than_a_range_that_goes_with_its_size_and_no_more_than_one_that_does_not() -> None:
    """The size itself is uncertain: a fit has moved it since the range was taken."""
    support, delay = CATALOGUE["support_resonance"], CATALOGUE["loop_delay"]
    assert support.on(of_mass(2.8), inverse_mass_per_kg=3.0).support is not None
    with pytest.raises(EffectError, match=r"inverse_mass_per_kg = 30.0 1/kg is outside 0.0001 to 2 1/kg"):
        support.on(of_mass(2.8), inverse_mass_per_kg=30.0)
    with pytest.raises(EffectError, match=r"outside 0 to 0\.0003 s"):
        delay.on(RIG, delay_s=3.1e-4)


def test_a_rotor_is_not_off_its_centre_by_more_than_the_air_gap() -> None:
    away = CATALOGUE["off_centre_rotor"]
    with pytest.raises(EffectError, match=r"xA of rig reference would be 0\.0004 m off, in an air gap of 0\.000296 m"):
        away.on(RIG, offset_xA_m=4e-4)


def test_an_effect_that_is_not_told_how_strong_is_typical_for_the_rig() -> None:
    light = CATALOGUE["support_resonance"].on(of_mass(2.8)).support
    assert light is not None
    assert light.mass_kg == pytest.approx(9.0)


def test_what_shapes_a_part_that_a_rig_has_not_never_wakes() -> None:
    """A fit would have one parameter more, that nothing measured says anything of."""
    (moved,) = (p for p in CATALOGUE["sensor_lag"].parameters if p.name == "moved_share")
    slow = replace(RIG, sensors=replace(RIG.sensors, bandwidth_rad_s=np.full(4, 7e4)))
    assert (moved.of(slow).wakes, moved.of(RIG).wakes) == ((0.9,), ())
    (second,) = (p for p in CATALOGUE["amplifier_bandwidth"].parameters if p.name == "first_order_share")
    first = replace(RIG, amplifiers=replace(RIG.amplifiers, damping_ratio=None))
    assert (second.of(RIG).wakes, second.of(first).wakes) == ((0.9,), ())
    (more,) = (p for p in CATALOGUE["amplifier_bandwidth"].parameters if p.name == "second_order_term")
    assert (more.of(RIG).wakes, more.of(first).wakes) == ((), (0.5,))
