"""What is compiled of the force law is the law, and small signals meet what they meet of it."""

from dataclasses import replace

import numpy as np
import pytest

from sim import actuator, magnetic_force
from sim.effects import CATALOGUE
from sim.reference import reference_rig
from sim.rig import Drift, Rig
from sim.twin import linear_model, small_signal, with_effects

RIG = reference_rig()
OFF_CENTRE = {"offset_xA_m": 30e-6, "offset_yB_m": -20e-6}


@pytest.mark.parametrize(
    "rig",
    [
        RIG,
        with_effects(RIG, {"off_centre_rotor": OFF_CENTRE}),
        with_effects(RIG, {"magnetic_saturation": {"flux_share": 0.0}}),
        with_effects(RIG, {"magnetic_saturation": {"flux_share": 0.6, "flux_power": 4.0}}),
        with_effects(RIG, {"magnetic_saturation": {"flux_share": 0.6, "flux_power": 5.5}}),
        reference_rig(gravity_m_per_s2=2.0),
        with_effects(RIG, {"magnetic_cross_coupling": {}}),
        replace(RIG, drift=Drift(np.full(4, -0.2), np.full(4, 0.1), 100.0)),
    ],
    ids=["plain", "off centre", "by current", "by flux", "by flux, another power", "loaded", "turned", "drifting"],
)
def test_the_compiled_force_is_the_law_less_its_linear_part(rig: Rig) -> None:
    """In a coil that is asked for a current below none, too, and beyond a pole, where a fit may try to put a rotor."""
    rng = np.random.default_rng(2)
    i, x = rng.uniform(-4.0, 4.0, (3, 8, 4)), rng.uniform(-5e-5, 5e-5, (3, 8, 4))
    x[2, -1] = 1.3 * rig.magnets.gap_m
    point, passed = actuator.operating_point(rig), np.array([0.0, 0.4, 1.0])[:, None, None]
    effective = magnetic_force.effective(rig.magnets, i)
    force = actuator.pull(rig.magnets, effective, x)
    if rig.drift is not None:
        ki, ks = (1 + change * passed for change in (rig.drift.ki_change, rig.drift.ks_change))
        force = ki * force + (ks - ki) * point.ks * x
    own = force - point.ki * (i - point.current_a) - point.ks * x
    expected = own @ actuator.force_rotation(rig).T + point.load_n
    found = magnetic_force.beyond_linear(rig, point, i, effective, x, passed)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(force).max())


@pytest.mark.parametrize("name", CATALOGUE)
@pytest.mark.parametrize(
    "base",
    [RIG, with_effects(RIG, {"off_centre_rotor": OFF_CENTRE}), reference_rig(gravity_m_per_s2=2.0, speed_rad_s=200.0)],
    ids=["centred", "off centre", "loaded, turning"],
)
def test_rigs_that_share_a_small_signal_answer_have_the_same(name: str, base: Rig) -> None:
    """What is left out for it may change the answer of no rig."""
    rig, f = CATALOGUE[name].on(base), np.array([0.01, 30.0, 700.0])
    whole, shared = linear_model(rig, f), linear_model(small_signal(rig), f)
    for of in ("y_per_u", "i_per_u", "bearing_per_force", "flux_per_u", "bearing_per_u"):
        np.testing.assert_allclose(getattr(shared, of), getattr(whole, of), rtol=1e-12, atol=0)
    np.testing.assert_allclose([shared.point.ki, shared.point.ks], [whole.point.ki, whole.point.ks], rtol=1e-12)


def test_rigs_that_differ_in_their_iron_alone_share_one_small_signal_answer() -> None:
    f = np.array([30.0, 700.0])
    one, other = (with_effects(RIG, {"magnetic_hysteresis": {"loss_angle_rad": angle}}) for angle in (0.05, 0.1))
    assert linear_model(small_signal(one), f) is linear_model(small_signal(other), f)
