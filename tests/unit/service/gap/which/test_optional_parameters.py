"""Laws that few rigs need are tried where the plain one leaves too much, and cost nothing where it does not."""

from dataclasses import replace

import numpy as np
import pytest

from service.gap.fitting.candidates import Fitter, Task
from service.gap.fitting.nuisance import nuisance
from service.gap.fitting.part import Ground, parts
from service.gap.measured.observation import observe
from service.gap.weighing.alike import ALIKE_LOG_EVIDENCE
from service.gap.which.explained import Explained
from service.gap.which.optional_parameters import on_modes_that_split, with_optional_parameters
from service.gap.which.search import explain
from sim.datasheet import Tolerance
from sim.effects import CATALOGUE
from sim.twin import with_effects
from tests.support.synthetic import known_datasheet, lines, sweep, true_rig

pytestmark = pytest.mark.slow

SPEED_RAD_S = 250.0
OF_A_DISC = ("mode_coupling", "mode1_slope_per_m_sqrt_kg", "mode2_slope_per_m_sqrt_kg")


def explained(
    effects: dict[str, dict[str, float]], polar_inertia_kgm2: float = 1.9, damper_ns_per_m: float = 0.0
) -> Explained:
    """The plant of a turning rig that has these effects, and perhaps dampers at its bearings."""
    with Fitter(1) as fitter:
        return explain(fitter, measured(effects, polar_inertia_kgm2, damper_ns_per_m))


def measured(
    effects: dict[str, dict[str, float]],
    polar_inertia_kgm2: float = 1.9,
    damper_ns_per_m: float = 0.0,
    mode_shape: float = Tolerance.mode_shape,
) -> Ground:
    """What is measured of the plant of such a rig; ``mode_shape`` is the datasheet's tolerance of shapes."""
    datasheet, truth = known_datasheet(seed=15)
    sheet, true = (replace(d, polar_inertia_kgm2=polar_inertia_kgm2) for d in (datasheet, truth))
    nu = nuisance(replace(sheet, tolerance=replace(sheet.tolerance, mode_shape=mode_shape)))
    rig = with_effects(replace(true_rig(true), speed_rad_s=SPEED_RAD_S), effects)
    rig = replace(rig, seal_damping_ns_per_m=rig.seal_damping_ns_per_m + damper_ns_per_m * np.eye(2))
    o = observe(replace(sweep(rig, lines(14), 0.15, seed=1), speed_rad_s=SPEED_RAD_S), nu.rig)
    return Ground(nu, parts(nu, (o,))[-1], (o,), np.zeros(len(nu)))


@pytest.mark.parametrize("imbalance", [1.0, -1.0])
def test_damping_of_one_mode_that_turns_with_the_shaft_is_named(imbalance: float) -> None:
    best = explained({"internal_damping": {"damping_ratio": 5e-3, "mode_imbalance": imbalance}}).order[0].candidate
    assert best.effects == ("internal_damping",)
    assert best.fit.values[0]["damping_ratio"] == pytest.approx(5e-3, rel=0.1)
    assert best.fit.values[0]["mode_imbalance"] == pytest.approx(imbalance, abs=0.1)


def test_an_inertia_that_no_mode_tilts_is_fitted_alone() -> None:
    """With slopes beside it a rotor a fifth lighter, with weaker magnets, was likelier: the same but for its scale."""
    best = explained({"gyroscopic_coupling": {"polar_inertia_kgm2": 0.4, "mode_coupling": 0.0}}).order[0].candidate
    assert best.effects == ("gyroscopic_coupling",)
    assert best.fit.values[0]["polar_inertia_kgm2"] == pytest.approx(0.4, rel=0.05)
    assert [best.fit.values[0][name] for name in OF_A_DISC] == [0.0, 0.0, 0.0]


def test_a_disc_so_small_that_only_modes_show_it_is_named() -> None:
    """The rigid body's tilt shows nothing of it, so that by the plain law no effect explained any of the gap."""
    disc = {"polar_inertia_kgm2": 0.02, "mode_coupling": 0.0, **dict(zip(OF_A_DISC[1:], (-0.9, 1.5), strict=True))}
    best = explained({"gyroscopic_coupling": disc}).order[0].candidate
    assert best.effects == ("gyroscopic_coupling",)
    found = best.fit.values[0]
    for name, slope in zip(OF_A_DISC[1:], (-0.9, 1.5), strict=True):  # of its moment the slopes' product tells more
        assert found["polar_inertia_kgm2"] * found[name] ** 2 == pytest.approx(0.02 * slope**2, rel=0.2)


def test_a_pole_of_the_sensors_that_has_moved_is_a_lag_of_the_sensors() -> None:
    """From 12 to 5 kHz: two poles in series are 1 % off at 1 kHz, which eddy currents' law is not."""
    datasheet, truth = (replace(d, sensor_bandwidth_hz=(12e3,) * 4) for d in known_datasheet(seed=16))
    nu, slower_s = nuisance(datasheet), (1 / 5e3 - 1 / 12e3) / (2 * np.pi)
    rig = true_rig(truth)
    rig = replace(rig, sensors=replace(rig.sensors, bandwidth_rad_s=np.full(4, 2 * np.pi * 5e3)))
    o = observe(sweep(rig, lines(30), 0.3, seed=1), nu.rig)
    with Fitter(1) as fitter:
        found = explain(fitter, Ground(nu, parts(nu, (o,))[-1], (o,), np.zeros(len(nu))))
    lag = next(r for r in found.order if r.candidate.effects == ("sensor_lag",))
    assert lag.log_evidence > found.order[0].log_evidence - ALIKE_LOG_EVIDENCE
    (values,) = lag.candidate.fit.values
    assert values["moved_share"] == pytest.approx(1.0, abs=0.1)
    assert values["time_constant_s"] + values["delay_s"] == pytest.approx(slower_s, rel=0.03)


OF_A_SHAFT = {
    "polar_inertia_kgm2": 1.0,
    "mode_coupling": 0.05,
    "coupling_imbalance": -0.3,
    "mode1_slope_per_m_sqrt_kg": 0.15,
    "mode2_slope_per_m_sqrt_kg": 0.2,
    "mode1_to_mode2_coupling": 0.05,
}


@pytest.mark.parametrize("seal", [{}, {"cross_coupled_stiffness": {"stiffness_n_per_m": 3e5, "between": 1.0}}])
def test_the_moments_of_a_whole_shaft_are_told_also_beside_a_seal(seal: dict[str, dict[str, float]]) -> None:
    best = explained({"gyroscopic_coupling": OF_A_SHAFT, **seal}).order[0].candidate
    assert set(best.effects) == {"gyroscopic_coupling", *seal}
    found = best.fit.values[best.effects.index("gyroscopic_coupling")]
    assert found["mode1_to_mode2_coupling"] == pytest.approx(0.05, rel=0.2)


def test_parameters_that_sleep_wake_beside_those_that_were_fitted() -> None:
    """Starts by split peaks wake a disc's slopes: what a whole shaft has more had stayed asleep then."""
    ground = measured({"gyroscopic_coupling": OF_A_SHAFT})
    of_disc = {p.name: p.null for p in CATALOGUE["gyroscopic_coupling"].parameters} | OF_A_SHAFT
    of_disc["mode1_to_mode2_coupling"] = 0.0
    with Fitter(1) as fitter:
        (disc,) = fitter.run([Task(ground, ("gyroscopic_coupling",), ((of_disc,),), ground.theta)])
        (shaft,) = with_optional_parameters(fitter, ground, [disc])
    assert shaft.fit.cost < disc.fit.cost - 100
    assert shaft.fit.values[0]["mode1_to_mode2_coupling"] == pytest.approx(0.05, rel=0.2)


def test_a_disc_that_modes_tilt_is_found_beside_another_effect() -> None:
    disc = {"polar_inertia_kgm2": 0.3, "mode_coupling": 0.0, **dict(zip(OF_A_DISC[1:], (-0.34, 0.73), strict=True))}
    moved = {"shift_A_m": 0.012, "shift_B_m": 0.012}
    best = explained({"gyroscopic_coupling": disc, "sensor_position": moved}).order[0].candidate
    assert set(best.effects) == {"gyroscopic_coupling", "sensor_position"}
    found = best.fit.values[best.effects.index("gyroscopic_coupling")]
    assert found[OF_A_DISC[2]] == pytest.approx(0.73, abs=0.2)


def test_a_seal_at_mid_span_is_named_alone_though_the_rotor_bends_there() -> None:
    """On a straight line through the bearings, sensors elsewhere or internal damping were needed beside it."""
    seal = {"stiffness_n_per_m": 1e5, "end_imbalance": 0.0, "between": 1.0, "mode1_bow_per_sqrt_kg": -0.25}
    best = explained({"cross_coupled_stiffness": seal}).order[0].candidate
    assert best.effects == ("cross_coupled_stiffness",)
    found = best.fit.values[0]
    assert {name: found[name] for name in seal} == pytest.approx(seal, rel=0.05, abs=0.02)


def test_a_sensor_elsewhere_is_named_alone_though_a_mode_has_a_node_there() -> None:
    """Near a node its place changes a mode's shape by more than any tolerance: another mode was told beside it."""
    moved = {"shift_A_m": 0.0, "shift_B_m": -0.03, "mode2_slope_B_per_m_sqrt_kg": 2.5}
    best = explained({"sensor_position": moved}).order[0].candidate
    assert best.effects == ("sensor_position",)
    assert {name: best.fit.values[0][name] for name in moved} == pytest.approx(moved, rel=0.1, abs=2e-3)


def test_a_sensor_far_off_is_named_with_the_slopes_of_modes_that_their_shapes_would_make_up_for() -> None:
    """Nothing is left either way, but without the slopes mode shapes are many of their tolerances off."""
    slopes = {"mode1_slope_A_per_m_sqrt_kg": 2.0, "mode2_slope_A_per_m_sqrt_kg": 3.0}
    moved = {"sensor_position": {"shift_A_m": -0.019, "shift_B_m": 0.0, **slopes}}
    with Fitter(1) as fitter:
        best = explain(fitter, measured(moved, mode_shape=0.06)).order[0].candidate
    assert best.effects == ("sensor_position",)
    assert best.fit.penalty < len(best.fit.active)
    found = best.fit.values[0]
    assert found["shift_A_m"] == pytest.approx(-0.019, rel=0.05)
    assert {name: found[name] for name in slopes} == pytest.approx(slopes, rel=0.2)


def test_a_centre_of_gravity_that_moved_is_no_gain_of_the_sensors_alone() -> None:
    """Gains of each plane's sensors imitate it: both are told, or it leads."""
    hub = {"mass_change": 0.02, "inertia_change": 0.02, "centre_shift_m": -0.01}
    order = explained({"rotor_inertia": hub}).order
    rotor = next(r for r in order if r.candidate.effects == ("rotor_inertia",))
    assert rotor.log_evidence > order[0].log_evidence - ALIKE_LOG_EVIDENCE
    assert rotor.candidate.fit.values[0]["centre_shift_m"] == pytest.approx(-0.01, rel=0.2)


@pytest.mark.parametrize("damping", [0.0, 0.75])
def test_a_seal_is_named_with_its_damping_or_without_any(damping: float) -> None:
    """By its stiffness alone it drove the datasheet's values to their bounds."""
    seal = {"stiffness_n_per_m": 2e5, "end_imbalance": 1.0, "inverse_whirl_ratio": damping}
    best = explained({"cross_coupled_stiffness": seal}).order[0].candidate
    assert best.effects == ("cross_coupled_stiffness",)
    found = best.fit.values[0]
    assert found["inverse_whirl_ratio"] == pytest.approx(damping, rel=0.1)
    assert found["stiffness_n_per_m"] == pytest.approx(2e5, rel=0.05)
    assert found["end_imbalance"] == pytest.approx(1.0, abs=0.05)


def test_a_damper_alone_is_not_a_seal() -> None:
    """With a damping that is free of the stiffness a seal without any stiffness was named for certain."""
    assert explained({}, damper_ns_per_m=600.0).order[0].candidate.effects == ()


@pytest.mark.parametrize("share", [0.0, 0.2])
def test_a_voltage_limit_that_noise_reaches_too_is_named_with_its_value(share: float) -> None:
    """Without noise in its law such a limit left a quarter of a gap, so that no effect was named."""
    datasheet, truth = known_datasheet(seed=15)
    nu, limit_a_per_s = nuisance(datasheet), 1476.0  # nine tenths of the steepest current
    limit = {"slew_inverse_s_per_a": 1 / limit_a_per_s, "slope_seen": 1.0, "slope_noise_share": share}
    rig = with_effects(true_rig(truth), {"amplifier_voltage_limit": limit})
    o = observe(sweep(rig, lines(14), 0.25, seed=1), nu.rig)
    part = next(p for p in parts(nu, (o,)) if p.path == "amplifier")
    with Fitter(1) as fitter:
        found = explain(fitter, Ground(nu, part, (o,), np.zeros(len(nu))))
    (values,) = found.chosen.fit.values
    assert found.chosen.effects == ("amplifier_voltage_limit",)
    assert found.order[0].unexplained < 0.02
    assert 1 / values["slew_inverse_s_per_a"] == pytest.approx(limit_a_per_s, rel=0.01)
    assert values["slope_noise_share"] == pytest.approx(share, abs=0.02)


def test_every_parameter_that_wakes_is_dormant_and_begins_inside_its_range() -> None:
    waking = [p for effect in CATALOGUE.values() for p in effect.parameters if p.wakes]
    assert waking
    for p in waking:
        assert p.dormant
        assert p.typical == p.null, "what a twin does not name is not there"
        assert all(p.low < at < p.high and at != p.null for at in p.wakes)


@pytest.mark.parametrize(
    "moment",
    [
        {"polar_inertia_kgm2": 1.2, "mode_coupling": -0.15},
        {"polar_inertia_kgm2": 1.2, "mode_coupling": 0.2, "coupling_imbalance": 0.3},
        {"polar_inertia_kgm2": 3.0, "mode1_slope_per_m_sqrt_kg": -0.8, "mode2_slope_per_m_sqrt_kg": 0.9},
        {"polar_inertia_kgm2": -2.0, "mode1_slope_per_m_sqrt_kg": 0.4, "mode2_slope_per_m_sqrt_kg": 0.2},
    ],
    ids=["backward", "unlike modes", "disc", "disc of a rotor that turns from y to x"],
)
def test_peaks_that_are_split_by_many_of_their_widths_are_found_from_unsplit_ones(moment: dict[str, float]) -> None:
    ground = measured({"gyroscopic_coupling": {"mode_coupling": 0.0, **moment}})
    start = {p.name: p.null for p in CATALOGUE["gyroscopic_coupling"].parameters} | {"polar_inertia_kgm2": 0.4}
    with Fitter(1) as fitter:
        (plain_law,) = fitter.run([Task(ground, ("gyroscopic_coupling",), ((start,),), ground.theta)])
        (best,) = fitter.run(on_modes_that_split(ground, [plain_law]))
    assert plain_law.fit.chi_square > 100 * best.fit.n_residuals
    assert best.fit.chi_square < 1.2 * best.fit.n_residuals
    inertia = best.fit.values[0]["polar_inertia_kgm2"]
    assert inertia == pytest.approx(moment["polar_inertia_kgm2"], rel=0.05)
