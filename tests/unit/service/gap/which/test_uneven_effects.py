"""A controller, a crosstalk or a pedestal that one axis or plane alone has, or filters tuned otherwise."""

from dataclasses import replace

import numpy as np
import pytest

from service.gap.fitting.candidates import Fitter, Task, fit_task
from service.gap.fitting.nuisance import nuisance
from service.gap.fitting.part import Ground, parts
from service.gap.measured.observation import observe
from service.gap.which.explained import Explained
from service.gap.which.search import explain
from service.gap.which.uneven_effects import on_one_side
from sim.effects import CATALOGUE
from sim.imbalance import of_shares, shares
from sim.rig import Rig
from sim.twin import with_effects
from tests.support.synthetic import known_datasheet, lines, sweep, true_rig

pytestmark = pytest.mark.slow


def explained(path: str, effect: str, values: dict[str, float], amplitude_a: float = 0.15) -> tuple[Explained, Rig]:
    """What a part of the loop of a rig with an effect is explained by, and that rig."""
    datasheet, truth = known_datasheet(seed=3)
    nu, rig = nuisance(datasheet), with_effects(true_rig(truth), {effect: values})
    o = observe(sweep(rig, lines(), amplitude_a, seed=1), nu.rig)
    part = next(part for part in parts(nu, (o,)) if part.path == path)
    return explain(Fitter(), Ground(nu, part, (o,), np.zeros(len(nu)))), rig


def test_one_soft_pedestal_of_four_is_told_by_its_axis() -> None:
    """Taken for alike under all bearings it would leave nearly half, and a datasheet that is another rig's."""
    values = {"inverse_mass_per_kg": 8e-4, "frequency_hz": 420.0, "damping_ratio": 0.01, "pedestals": 1.0}
    e, rig = explained("plant", "support_resonance", {**values, "end_imbalance": 1.0, "plane_imbalance": 1.0})
    best = e.order[0].candidate
    assert best.effects == ("support_resonance",)
    assert best.fit.cost < 1.2 * best.fit.n_residuals
    found, true = best.fit.rig.support, rig.support
    assert found is not None
    assert true is not None
    assert found.natural_frequency_rad_s == pytest.approx(true.natural_frequency_rad_s, rel=1e-3)
    mobility = [np.array([s.of_axis(k) for k in range(4)]) / s.mass_kg for s in (found, true)]
    np.testing.assert_allclose(*mobility, atol=0.03 * mobility[1].max())


Y_ALONE = {"plane_imbalance": -1.0}
SAME = {"gain_change": 0.0, "derivative_change": 0.0, "lag_samples": 0.0}
ONE_AXIS = {"end_imbalance": -1.0, "plane_imbalance": 1.0}
TUNED = {"notch_frequency_change": 0.03, "notch_zero_damping_change": 0.0, "notch_pole_damping_change": 0.0}
OTHER = {"notch_frequency_change": 0.0, "notch_zero_damping_change": 0.0, "notch_pole_damping_change": 0.1}


NOTCH_OF_ONE = {"notch_frequency_change": -0.0125, "end_imbalance": -1.0, "plane_imbalance": -1.0}
"""Of yB alone, which is a quarter of the mean; taken for all four alike it explains a fifth of the gap."""


@pytest.mark.parametrize(
    "change", [{"gain_change": -0.00375, **ONE_AXIS}, TUNED, OTHER, NOTCH_OF_ONE, {"integral_change": 1.0}]
)
def test_a_controller_of_one_axis_and_filters_tuned_otherwise_are_a_mismatch(change: dict[str, float]) -> None:
    e, _ = explained("controller", "controller_mismatch", {**SAME, **change})
    best = e.order[0].candidate
    assert best.effects == ("controller_mismatch",)
    assert best.fit.cost < 1.2 * best.fit.n_residuals
    found = best.fit.values[0]
    assert {name: found[name] for name in change} == pytest.approx(change, rel=0.05, abs=2e-3)


@pytest.mark.parametrize(("hz", "ratio"), [(186.0, 1.02), (82.4, 1.25), (186.0, 0.8)])
def test_a_mode_that_is_softer_in_one_plane_is_told_with_both_frequencies(hz: float, ratio: float) -> None:
    """At the ends of the ratio's range the two resonances lie farther than a line from each other."""
    shape = {"bearing_A_per_sqrt_kg": 0.0165, "bearing_B_per_sqrt_kg": -0.0132}
    at_sensors = {"sensor_A_per_sqrt_kg": 0.0225, "sensor_B_per_sqrt_kg": -0.019}
    values = {"frequency_hz": hz, "damping_ratio": 0.0135, **shape, **at_sensors, "plane_frequency_ratio": ratio}
    e, _ = explained("plant", "extra_flexible_mode", values)
    best = e.order[0].candidate
    assert best.effects == ("extra_flexible_mode",)
    assert best.fit.cost < 1.2 * best.fit.n_residuals
    (found,) = best.fit.values
    assert found["frequency_hz"] == pytest.approx(hz, rel=2e-3)
    assert found["plane_frequency_ratio"] == pytest.approx(ratio, abs=2e-3)


@pytest.mark.parametrize("quotient", [1.0, 0.5])
def test_a_heavy_housing_that_rocks_too_is_told_though_each_of_its_resonances_leaves_the_other(quotient: float) -> None:
    """One per cent in a few lines, below the floor of the rough stages of a fit."""
    values = {"inverse_mass_per_kg": 5.3e-5, "frequency_hz": 71.4, "damping_ratio": 0.044}
    rocks = {"rocking": 1.17, "rocking_frequency_ratio": 2.0, "rocking_damping_quotient": quotient}
    e, _ = explained("plant", "support_resonance", values | rocks, 0.6)
    best = e.order[0].candidate
    assert best.effects == ("support_resonance",)
    assert best.fit.cost < 1.2 * best.fit.n_residuals
    (found,) = best.fit.values
    assert found["inverse_mass_per_kg"] == pytest.approx(5.3e-5, rel=0.05)
    assert found["rocking_frequency_ratio"] == pytest.approx(2.0, rel=0.01)
    assert found["rocking_damping_quotient"] == pytest.approx(quotient, rel=0.1)


def test_a_ladder_of_lags_is_told_as_eddy_currents_with_the_share_that_is_free_of_them() -> None:
    """Three per cent of the flux lag; the law of solid iron would leave most of it, as it goes on falling."""
    e, _ = explained(
        "plant", "eddy_currents", {"time_constant_s": 1e-5, "corner_rad_s": 300.0, "free_share": 0.97}, amplitude_a=0.6
    )
    best = e.order[0].candidate
    assert best.effects == ("eddy_currents",)
    assert best.fit.cost < 1.2 * best.fit.n_residuals
    assert best.fit.values[0]["free_share"] == pytest.approx(0.97, abs=0.005)


def test_eddy_currents_that_hold_back_the_flux_of_a_moving_rotor_too_are_told_so() -> None:
    """ks x lags as ki i does; the lag of ki i alone would leave a fifth of it, as of none of these."""
    e, _ = explained("plant", "eddy_currents", {"time_constant_s": 4e-5, "displacement_share": 1.0}, amplitude_a=0.6)
    best = e.order[0].candidate
    assert best.effects == ("eddy_currents",)
    assert best.fit.cost < 1.2 * best.fit.n_residuals
    (found,) = best.fit.values
    assert found["time_constant_s"] == pytest.approx(4e-5, rel=0.05)
    assert found["displacement_share"] == pytest.approx(1.0, abs=0.1)


def test_amplifiers_that_each_changed_on_their_own_are_told_by_axis() -> None:
    """Alike, or more at a bearing or in a plane, they would leave a datasheet that is another rig's."""
    over = np.array([0.95, 0.0, 0.5, -0.25])
    shapes = of_shares(dict(zip(("xA", "xB", "yA", "yB"), (over + 0.25) / 1.2, strict=True)))
    law = {"damping_change": 0.0, "opposite_share": 0.25 / 0.95, **shapes}
    e, rig = explained("amplifier", "amplifier_bandwidth", {"frequency_change": -0.19, **law})
    best = e.order[0].candidate
    assert best.effects == ("amplifier_bandwidth",)
    assert best.fit.cost < 1.2 * best.fit.n_residuals
    found, true = best.fit.rig.amplifiers, rig.amplifiers
    np.testing.assert_allclose(found.natural_frequency_rad_s, true.natural_frequency_rad_s, rtol=0.01)


def test_sensors_of_three_axes_that_lag_are_told_by_axis() -> None:
    of_axes = {"xA": 1.0, "xB": 0.6, "yA": 0.0, "yB": 0.9}
    law = {"time_constant_s": 1.5e-5, **of_shares(of_axes)}
    e, _ = explained("plant", "sensor_lag", law)
    best = e.order[0].candidate
    assert best.effects == ("sensor_lag",)
    assert best.fit.cost < 1.2 * best.fit.n_residuals
    (found,) = best.fit.values
    lags = (found["time_constant_s"] + found["delay_s"]) * shares(e.ground.nuisance.rig, found)
    np.testing.assert_allclose(lags, 1.5e-5 / 0.625 * np.array(list(of_axes.values())), rtol=0.1, atol=5e-7)


def test_crosstalk_from_one_channel_in_one_plane_is_told_with_the_plane() -> None:
    e, rig = explained("amplifier", "channel_crosstalk", {"share_ab": 0.0175, "share_ba": 0.0, "plane_imbalance": 1.0})
    best = e.order[0].candidate
    assert best.effects == ("channel_crosstalk",)
    np.testing.assert_allclose(best.fit.rig.amplifiers.crosstalk, rig.amplifiers.crosstalk, atol=1e-3)


def test_a_mode_that_swings_in_one_plane_alone_is_told_with_the_plane() -> None:
    """A pipe or a cabinet that is fixed to the machine swings in one direction."""
    shape = {"bearing_A_per_sqrt_kg": 0.01, "bearing_B_per_sqrt_kg": 0.008}
    at_sensors = {"sensor_A_per_sqrt_kg": 0.02, "sensor_B_per_sqrt_kg": -0.02}
    values = {"frequency_hz": 380.0, "damping_ratio": 0.004, **shape, **at_sensors, "plane_imbalance": 1.0}
    e, _ = explained("plant", "extra_flexible_mode", values)
    best = e.order[0].candidate
    assert best.effects == ("extra_flexible_mode",)
    assert best.fit.cost < 1.2 * best.fit.n_residuals
    found = best.fit.values[0]
    assert found["plane_imbalance"] == pytest.approx(1.0, abs=0.02)
    assert found["frequency_hz"] == pytest.approx(380.0, rel=1e-3)


@pytest.mark.parametrize(
    "other",
    [
        {"pedestals": 1.0, "frequency_ratio": 0.92, "damping_quotient": 1.5, "plane_frequency_ratio": 0.58},
        {"pedestals": 0.0, "plane_frequency_ratio": 0.8},
        {"pedestals": 0.0, "rocking": 2.5, "rocking_frequency_ratio": 1.7},
    ],
    ids=["pedestals", "a housing", "a housing that rocks"],
)
def test_a_support_whose_frequencies_and_damping_are_unlike_is_one_effect(other: dict[str, float]) -> None:
    values = {"inverse_mass_per_kg": 1.5e-3, "frequency_hz": 170.0, "damping_ratio": 0.02}
    e, _ = explained("plant", "support_resonance", {**values, **other})
    best = e.order[0].candidate
    assert best.effects == ("support_resonance",)
    assert best.fit.cost < 1.2 * best.fit.n_residuals
    found = best.fit.values[0]
    assert {name: found[name] for name in other} == pytest.approx(other, rel=0.05, abs=0.01)


@pytest.mark.parametrize(
    "between_planes",
    [{"share_xy_A": 0.03, "share_yx_A": -0.02}, {"share_yx_A": 0.04, "share_yB_xA": 0.025}],
    ids=["both ways", "into both amplifiers of the other plane"],
)
def test_crosstalk_between_the_planes_is_told(between_planes: dict[str, float]) -> None:
    only = {"share_ab": 0.0, "share_ba": 0.0, **between_planes}
    e, rig = explained("amplifier", "channel_crosstalk", only)
    best = e.order[0].candidate
    assert best.effects == ("channel_crosstalk",)
    np.testing.assert_allclose(best.fit.rig.amplifiers.crosstalk, rig.amplifiers.crosstalk, atol=1e-3)


def test_a_wall_that_one_axis_touches_on_one_side_is_a_stop() -> None:
    """Begun in all axes, the fit ended far off, and a force that grows smoothly explained more."""
    wall = {"stiffness_n_per_m": 1e6, "side": 1.0, "clearance_xA_m": 9e-6}
    values = {**wall, **{f"clearance_{axis}_m": 2.5e-4 for axis in ("xB", "yA", "yB")}}
    e, _ = explained("plant", "touchdown_contact", values)
    best = e.order[0].candidate
    assert best.effects == ("touchdown_contact",)
    assert best.fit.cost < 1.2 * best.fit.n_residuals
    assert {name: best.fit.values[0][name] for name in wall} == pytest.approx(wall, rel=0.05)


def test_an_auxiliary_bearing_that_is_not_centred_is_a_stop() -> None:
    """A ring, touched in x on one side and in y on the other; stops of each axis between two like sides left half."""
    ring = {"stiffness_n_per_m": 1e6, "side": 0.0, "ring": 1.0, "centre_xA": -0.3, "centre_yA": 0.12}
    way = {f"clearance_{axis}_m": 9e-6 if axis[1] == "A" else 2.5e-4 for axis in ("xA", "xB", "yA", "yB")}
    e, _ = explained("plant", "touchdown_contact", {**ring, **way})
    best = e.order[0].candidate
    assert best.effects == ("touchdown_contact",)
    assert best.fit.cost < 1.2 * best.fit.n_residuals
    (found,) = best.fit.values
    assert found["ring"] == pytest.approx(1.0, abs=0.1)
    assert [found[name] for name in ("centre_xA", "centre_yA")] == pytest.approx([-0.3, 0.12], abs=0.05)


def test_from_the_datasheet_a_fit_finds_the_one_plane_that_has_an_effect() -> None:
    """Beside an even crosstalk the datasheet's values make up for what y has too much: they are tolerances off."""
    datasheet, truth = known_datasheet(seed=3)
    rig = with_effects(true_rig(truth), {"channel_crosstalk": {"share_ab": 0.0, "share_ba": 0.015, **Y_ALONE}})
    nu = nuisance(datasheet)
    o = observe(replace(sweep(rig, lines(), 0.15, seed=1), I=None), nu.rig)
    (part,) = (part for part in parts(nu, (o,)) if part.path == "plant")
    ground = Ground(nu, part, (o,), np.zeros(len(nu)))
    start = {p.name: p.null for p in CATALOGUE["channel_crosstalk"].of(nu.rig).parameters} | {"share_ba": 0.01}
    even = fit_task(Task(ground, ("channel_crosstalk",), ((start,),), ground.theta))
    assert even.fit.cost > 2 * even.fit.n_residuals
    (task,) = on_one_side(ground, even)
    found = fit_task(task)
    assert found.fit.cost < 1.2 * found.fit.n_residuals
    assert found.fit.values[0]["plane_imbalance"] == pytest.approx(Y_ALONE["plane_imbalance"], abs=0.01)
    assert found.fit.values[0]["share_ba"] == pytest.approx(0.015, rel=0.02)
