"""Two effects of one part of the loop: both are named, whatever each of them explains alone."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from service.gap.diagnose import diagnose
from service.gap.fitting.candidates import Candidate, Fitter, Task, fit_task
from service.gap.fitting.fitted import Fit
from service.gap.fitting.stage import EXACT
from service.gap.fitting.unknowns import TOLERANCE_BOUND
from service.gap.weighing.alike import ALIKE_LOG_EVIDENCE
from service.gap.weighing.ranking import Ranked
from service.gap.weighing.verdict import MIXTURE_SHARE
from service.gap.which.mixtures import (
    Extension,
    needs_all_effects,
    refitted_in_turn,
    with_one_more,
    without_superfluous,
)
from service.gap.which.refits import best_of_each, cost
from sim.reference import reference_rig
from sim.twin import with_effects
from tests.support.plant import plant_of
from tests.support.synthetic import experiment, known_datasheet, true_rig
from tests.support.two_axes import one_plane

pytestmark = pytest.mark.slow


RIG = reference_rig()
CROSS, AWAY = "magnetic_cross_coupling", "off_centre_rotor"


def explanation(
    effects: tuple[str, ...], evidence: float, shares: tuple[float, ...], penalty: float = 0.0, off: float = 0.0
) -> Ranked:
    fit = Fit(effects, np.array([off]), (), RIG, (), penalty, np.arange(1), np.eye(1), "converged")
    return Ranked(Candidate(effects, fit, 0.0, ()), evidence, 0.9, max(shares), shares)


def leaving(
    gap: tuple[float, ...], effects: tuple[str, ...], evidence: float, shares: tuple[float, ...], penalty: float = 0.0
) -> Ranked:
    """An explanation that leaves these shares of a gap of that chi-square in each group."""
    r = explanation(effects, evidence, shares, penalty)
    groups = tuple((1000.0 + share * size, 1000) for share, size in zip(shares, gap, strict=True))
    return replace(r, candidate=replace(r.candidate, fit=replace(r.candidate.fit, groups=groups)))


def test_of_two_effects_one_may_make_the_fundamental_s_gap_and_the_other_that_of_the_harmonics() -> None:
    both = explanation((CROSS, AWAY), -10.0, (0.01, 0.01))
    singles = [explanation((CROSS,), -90.0, (0.01, 1.0)), explanation((AWAY,), -99.0, (1.0, 0.01))]
    assert needs_all_effects(both, [both, *singles])


@pytest.mark.parametrize(("first", "lead", "told"), [(CROSS, 40.0, True), (CROSS, 8.0, False), (AWAY, 40.0, False)])
def test_a_second_effect_that_values_of_the_datasheet_made_up_for_is_told_beside_a_coupling(
    first: str, lead: float, told: bool
) -> None:
    """A coupling's law is the same in every program, so that no error of it can have drawn the values away."""
    gap, second = (1e7,), "modal_damping"
    both = leaving(gap, (first, second), -10.0, (0.0,))
    alone = [leaving(gap, (first,), -10.0 - lead, (5e-6,), penalty=2.0), leaving(gap, (second,), -99.0, (0.9,))]
    assert needs_all_effects(both, [both, *alone]) is told


@pytest.mark.parametrize(("gap", "first"), [(1e7, (CROSS, "gyroscopic_coupling")), (1e3, ("sensor_lag",))])
def test_two_effects_that_explain_a_gross_gap_lead_what_leaves_all_of_it(gap: float, first: tuple[str, ...]) -> None:
    """Though their parameters cost more evidence than a law's error of that size can tell."""
    both = leaving((gap,), (CROSS, "gyroscopic_coupling"), -455.0, (0.008,))
    alone = [leaving((gap,), (CROSS,), -487.0, (0.55,)), leaving((gap,), ("gyroscopic_coupling",), -473.0, (0.89,))]
    nothing = [leaving((gap,), ("sensor_lag",), -446.0, (1.0,)), leaving((gap,), (), -451.0, (1.0,))]
    order = without_superfluous([*nothing, both, *alone])
    assert order[0].candidate.effects == first
    assert sum(r.probability for r in order) == pytest.approx(1.0)


def test_a_second_effect_that_one_alone_makes_needless_is_not_worth_it() -> None:
    both = explanation((CROSS, AWAY), -10.0, (0.009, 0.008))
    enough = explanation((CROSS,), -15.0, (0.01, 0.01))
    useless = explanation((AWAY,), -99.0, (1.0, 0.5))
    assert not needs_all_effects(both, [both, enough, useless])


@pytest.mark.parametrize(
    ("linear", "left", "worth"),
    [
        ("eddy_currents", (0.005, 0.0, 0.07, 0.0), True),
        ("eddy_currents", (0.07, 0.0, 0.07, 0.0), False),
        ("magnetic_saturation", (0.005, 0.0, 0.07, 0.0), False),
    ],
)
def test_what_a_linear_effect_leaves_at_one_amplitude_alone_is_no_other_law_of_it(
    linear: str, left: tuple[float, ...], worth: bool
) -> None:
    """An alias beside it would make up for another program's law, which is as far off at any amplitude."""
    both = explanation((linear, "magnetic_hysteresis"), -10.0, (0.001, 0.0, 0.004, 0.0))
    singles = [explanation((linear,), -90.0, left), explanation(("magnetic_hysteresis",), -99.0, (0.9, 0.5, 0.9, 0.5))]
    assert needs_all_effects(both, [both, *singles]) is worth


@pytest.mark.parametrize(("harmonics", "worth"), [(200.0, False), (9_000.0, True)])
def test_a_law_s_error_goes_with_the_whole_effect_in_a_group_that_holds_little_of_the_gap(
    harmonics: float, worth: bool
) -> None:
    """Half of what harmonics show is another law of hysteresis where that is 3 in 1000 of the gap, and eddy currents
    beside it where it is an eighth."""
    gap = (30_000.0, harmonics)
    both = leaving(gap, ("magnetic_hysteresis", "eddy_currents"), -10.0, (0.0, 0.0))
    singles = [
        leaving(gap, ("magnetic_hysteresis",), -90.0, (0.03, 0.5)),
        leaving(gap, ("eddy_currents",), -99.0, (0.5, 0.9)),
    ]
    assert needs_all_effects(both, [both, *singles, leaving(gap, (), -200.0, (1.0, 1.0))]) is worth


@pytest.mark.parametrize(
    ("second", "both_leave", "worth"),
    [("magnetic_saturation", 0.001, True), ("magnetic_saturation", 0.02, False), ("eddy_currents", 0.001, False)],
)
def test_two_nonlinear_aliases_that_leave_next_to_nothing_of_what_one_leaves_are_both_there(
    second: str, both_leave: float, worth: bool
) -> None:
    """Iron with hysteresis that saturates: hysteresis alone left a twelfth, as another law of it may. A linear lag
    beside it bends to the error of a law far better."""
    gap = (1e6, 3e4)
    both = leaving(gap, ("magnetic_hysteresis", second), -10.0, (both_leave, 0.0))
    singles = [
        leaving(gap, ("magnetic_hysteresis",), -300.0, (0.08, 0.1)),
        leaving(gap, (second,), -500.0, (0.9, 0.9)),
    ]
    assert needs_all_effects(both, [both, *singles, leaving(gap, (), -600.0, (1.0, 1.0))]) is worth


@pytest.mark.parametrize(
    ("first", "penalty", "worth"),
    [
        ("magnetic_hysteresis", 200.0, False),
        ("magnetic_hysteresis", 900.0, True),
        ("sensor_lag", 200.0, True),
    ],
)
def test_values_that_bear_less_of_a_nonlinear_law_s_error_than_the_data_show_ask_for_no_second_effect(
    first: str, penalty: float, worth: bool
) -> None:
    """Three plays in the place of a band of them left 0.007 of the gap, and 0.0002 went into the datasheet's values."""
    gap = (100_000.0, 3_000.0)
    both = leaving(gap, (first, "eddy_currents"), -10.0, (0.002, 0.0))
    singles = [
        leaving(gap, (first,), -90.0, (0.007, 0.0), penalty),
        leaving(gap, ("eddy_currents",), -99.0, (0.5, 0.9)),
    ]
    assert needs_all_effects(both, [both, *singles, leaving(gap, (), -200.0, (1.0, 1.0))]) is worth


@pytest.mark.parametrize(
    ("first", "noise_left", "worth"),
    [(CROSS, 0.0, True), ("eddy_currents", 0.0, True), (CROSS, 0.2, False), ("eddy_currents", 0.2, False)],
)
def test_a_second_effect_that_explains_a_hundredth_of_the_gap_to_noise_is_told(
    first: str, noise_left: float, worth: bool
) -> None:
    """An error of the first one's law would be taken up in part only."""
    gap = (100_000.0, 0.0)
    both = leaving(gap, (first, "internal_damping"), -10.0, (0.01 * noise_left, 0.0))
    singles = [
        leaving(gap, (first,), -90.0, (0.01, 0.0)),
        leaving(gap, ("internal_damping",), -99.0, (0.9, 0.0)),
    ]
    assert needs_all_effects(both, [both, *singles, leaving(gap, (), -200.0, (1.0, 0.0))]) is worth


@pytest.mark.parametrize(("both_leave", "lead", "worth"), [(0.0, 80.0, True), (0.0006, 80.0, False), (0.0, 8.0, False)])
def test_what_explains_nearly_all_that_a_stop_leaves_is_told_however_small_a_share_of_the_gap_it_is(
    both_leave: float, lead: float, worth: bool
) -> None:
    """An error of the stop's law would be taken up in part: a housing beside it left a seventieth of what it left."""
    gap, first, second = (2e7,), "touchdown_contact", "support_resonance"
    both = leaving(gap, (first, second), -10.0, (both_leave,))
    alone = [leaving(gap, (first,), -10.0 - lead, (0.004,)), leaving(gap, (second,), -200.0, (0.9,))]
    assert needs_all_effects(both, [both, *alone, leaving(gap, (), -300.0, (1.0,))]) is worth


@pytest.mark.parametrize(("hz", "worth"), [(700.0, True), (160.0, False)])
def test_a_second_resonance_far_from_the_first_is_no_error_of_its_law(hz: float, worth: bool) -> None:
    def resonances(effects: tuple[str, ...], evidence: float, left: float, *found_hz: float) -> Ranked:
        r = explanation(effects, evidence, (left, 0.0))
        fit = replace(r.candidate.fit, values=tuple({"frequency_hz": f} for f in found_hz))
        return replace(r, candidate=replace(r.candidate, fit=fit))

    both = resonances(("support_resonance", "extra_flexible_mode"), -10.0, 0.0, 150.0, hz)
    one = resonances(("support_resonance",), -90.0, 0.05, 150.0)
    assert needs_all_effects(both, [both, one]) is worth


def test_one_effect_beside_values_that_no_datasheet_allows_makes_two_not_needless() -> None:
    both = explanation(("rotor_inertia", "sensor_position"), -10.0, (0.01, 0.01))
    singles = [explanation(("rotor_inertia",), -90.0, (0.3, 0.3)), explanation(("sensor_position",), -99.0, (0.9, 0.9))]
    for penalty, worth in ((60.0, True), (1.0, False)):
        mode = explanation(("extra_flexible_mode",), -80.0, (0.05, 0.05), penalty)
        assert needs_all_effects(both, [both, mode, *singles]) is worth


def test_one_effect_beside_a_value_as_far_off_as_any_may_be_makes_two_not_needless() -> None:
    both = explanation(("eddy_currents", "sensor_gain"), -10.0, (0.003, 0.003))
    for off, worth in ((TOLERANCE_BOUND, True), (3.0, False)):
        single = explanation(("eddy_currents",), -50.0, (0.007, 0.007), off=off)
        assert needs_all_effects(both, [both, single]) is worth


def test_a_value_that_the_error_of_a_stop_s_law_drew_to_its_bound_asks_for_no_second_effect() -> None:
    """Of a stop by Hertz's law 0.0025 was left, with a sensor 4 mm off, and drifting magnets took a third of that."""
    both = explanation(("touchdown_contact", "thermal_drift"), -10.0, (0.34, 0.001))
    for left, worth in ((0.0025, False), (0.06, True)):
        single = explanation(("touchdown_contact",), -50.0, (0.55, 0.001), off=TOLERANCE_BOUND)
        assert needs_all_effects(both, [both, replace(single, unexplained=left)]) is worth


def test_what_couples_the_planes_is_found_beside_what_makes_a_gap_fifty_times_as_large() -> None:
    datasheet, truth = known_datasheet(seed=55)
    both = {
        "support_resonance": {"inverse_mass_per_kg": 5e-4, "frequency_hz": 67.6, "damping_ratio": 0.013},
        "cross_coupled_stiffness": {"stiffness_n_per_m": 7e3},
    }
    e = plant_of(experiment(with_effects(true_rig(truth), both)), datasheet, most=2)
    alone = next(r for r in e.order if r.candidate.effects == ("support_resonance",))
    assert max(alone.shares) < MIXTURE_SHARE
    assert set(e.order[0].candidate.effects) == set(both)


def test_a_resonance_in_a_few_lines_is_found_beside_hysteresis() -> None:
    """No band shows it, as each value counts up to a bound only, though it is a fifth of the gap."""
    datasheet, truth = known_datasheet(seed=56)
    both = {
        "magnetic_hysteresis": {"loss_angle_rad": 3.3e-3},
        "support_resonance": {"inverse_mass_per_kg": 1e-4, "frequency_hz": 426.0, "damping_ratio": 0.005},
    }
    e = plant_of(experiment(with_effects(true_rig(truth), both)), datasheet, most=2)
    assert set(e.order[0].candidate.effects) == set(both)


def test_an_effect_that_hardly_shows_is_found_beside_one_that_leaves_no_band_a_gap() -> None:
    datasheet, truth = known_datasheet(seed=51)
    offset = {f"offset_{axis}_m": 0.6e-6 if axis == "xB" else 0.0 for axis in RIG.axes}
    both = {"eddy_currents": {"time_constant_s": 2.7e-8, "corner_rad_s": 1.0}, AWAY: offset}
    e = plant_of(*one_plane(experiment(with_effects(true_rig(truth), both)), datasheet))
    assert set(e.order[0].candidate.effects) == set(both)


def test_iron_that_bends_little_is_found_beside_a_lag_and_so_is_what_else_could_lag() -> None:
    """Its law has three parameters and begins far from where they end; stiffnesses and gains have to follow it."""
    datasheet, truth = known_datasheet(seed=53)
    bent = {"saturation_inverse_per_a": 0.02, "flux_share": 0.55, "flux_power": 4.0}
    both = {"magnetic_saturation": bent, "sensor_lag": {"time_constant_s": 2e-6, "delay_s": 0.0}}
    rig = with_effects(true_rig(truth), both)
    e = plant_of(*one_plane(experiment(rig, amplitude_a=0.2), datasheet))
    found = [set(r.candidate.effects) for r in e.order[:2]]
    assert {"magnetic_saturation", "sensor_lag"} in found
    assert {"magnetic_saturation", "eddy_currents"} in found
    assert abs(e.order[0].log_evidence - e.order[1].log_evidence) < ALIKE_LOG_EVIDENCE


def test_an_effect_that_was_found_first_is_looked_for_anew_beside_the_second() -> None:
    datasheet, truth = known_datasheet(seed=52)
    both = {
        "magnetic_hysteresis": {"loss_angle_rad": 0.007, "narrowest_a": 0.0, "widest_inverse_per_a": 0.0},
        "cross_coupled_stiffness": {"stiffness_n_per_m": -26600.0},
    }
    e = plant_of(experiment(with_effects(true_rig(truth), both)), datasheet)
    wrong = (
        {"loss_angle_rad": 0.0127, "narrowest_a": 0.35, "widest_inverse_per_a": 50.0},
        both["cross_coupled_stiffness"],
    )
    null, singles = e.null.candidate, [r.candidate for r in e.order if len(r.candidate.effects) == 1]
    stuck = fit_task(Task(e.ground, tuple(both), (wrong,), null.fit.theta, (EXACT,)))
    with Fitter() as fitter:
        (better,) = refitted_in_turn(fitter, e.ground, null, stuck, [null, *singles, stuck])
    assert cost(better) < 0.9 * cost(stuck)
    values = dict(zip(better.effects, better.fit.values, strict=True))
    assert values["magnetic_hysteresis"]["loss_angle_rad"] == pytest.approx(0.007, rel=0.02)


def test_beside_an_effect_another_that_explains_most_alone_is_also_fitted_from_where_it_does() -> None:
    """Saturation and a rotor off its centre: beside the one's values of the datasheet the other's fit was stuck."""
    datasheet, truth = known_datasheet(seed=90)
    both = {"magnetic_saturation": {"saturation_inverse_per_a": 0.12}, AWAY: {"offset_xA_m": 4e-5}}
    e = plant_of(*one_plane(experiment(with_effects(true_rig(truth), both)), datasheet), most=1)
    of = {r.candidate.effects: r for r in e.order}
    base, away, fewer = of["magnetic_saturation",], of[AWAY,], of[()]
    assert np.abs(away.candidate.fit.theta - base.candidate.fit.theta).max() > 0.1

    class Asked(Fitter):
        def run(self, tasks: Iterable[Task]) -> list[Candidate]:
            asked.extend(tasks)
            return []

    for unexplained, more in ((0.3, 1), (0.7, 0)):
        asked: list[Task] = []
        order = [base, replace(away, unexplained=unexplained), fewer]
        with_one_more(Asked(), e.ground, order, Extension(base, (AWAY,), False), [base.candidate, away.candidate])
        theirs = [t for t in asked if len(t.effects) == 2 and np.array_equal(t.theta, away.candidate.fit.theta)]
        assert [task.effects for task in theirs] == [("magnetic_saturation", AWAY)] * more
        for task in theirs:
            assert task.all_starts() == ((base.candidate.fit.values[0], away.candidate.fit.values[0]),)


def test_an_effect_that_is_likely_but_explains_little_is_named_with_the_one_that_explains_the_rest() -> None:
    """Alone the other explains most, by a datasheet that is far off, and so is the less likely of the two."""
    datasheet, truth = known_datasheet(seed=21)
    iron = {"time_constant_s": 1.7e-6, "corner_rad_s": 1.0}
    both = {"eddy_currents": iron, CROSS: {"rotation_rad": 0.0, "symmetric_share": -0.04}}
    d = diagnose(experiment(with_effects(true_rig(truth), both)), datasheet)
    assert set(d.verdict.effects) == set(both)
    assert d.shrinkage.closure is not None
    assert d.shrinkage.closure > 0.95


def test_of_two_fits_with_the_same_effects_the_likelier_is_kept_where_a_law_leaves_much() -> None:
    """One pulls at the datasheet's values as far as it can, which a misfit rewards with a little less of itself."""

    def fit(effects: tuple[str, ...], chi_square: float, penalty: float) -> Candidate:
        own = explanation(effects, 0.0, (0.0,), penalty).candidate
        return replace(own, fit=replace(own.fit, groups=((chi_square, 2000), (4000.0, 6000))))

    null, easy, strained = fit((), 9e6, 300.0), fit((CROSS, AWAY), 52_000.0, 50.0), fit((CROSS, AWAY), 51_900.0, 85.0)
    assert strained.fit.cost < easy.fit.cost
    assert best_of_each(null, [strained, easy]) == [easy]
    # where nothing but noise is left, what leaves less is likelier
    near, nearer = fit((CROSS, AWAY), 2100.0, 5.0), fit((AWAY, CROSS), 2050.0, 8.0)
    assert best_of_each(null, [near, nearer]) == [nearer]
    # a second plain twin would halve the probability of the first
    assert best_of_each(null, [near, replace(null, occam=null.occam + 1.0)]) == [near]


@pytest.mark.parametrize("size", [1.0, 3.0])
def test_a_housing_and_a_mode_are_found_though_either_alone_may_be_no_likelier_than_nothing(size: float) -> None:
    """Alone either explains much of the gap, by values that make up for the other; with the larger mode, by values so
    far off that the plain twin was likelier, and the housing was not extended."""
    datasheet, truth = known_datasheet(seed=57)
    shape = {"bearing_A_per_sqrt_kg": 0.05, "bearing_B_per_sqrt_kg": 0.03}
    shape |= {"sensor_A_per_sqrt_kg": 0.04, "sensor_B_per_sqrt_kg": -0.02}
    mode = {name: size * value for name, value in shape.items()}
    both = {
        "support_resonance": {"inverse_mass_per_kg": 1 / 3000, "frequency_hz": 150.0, "damping_ratio": 0.03},
        "extra_flexible_mode": {"frequency_hz": 700.0, "damping_ratio": 0.006, **mode},
    }
    e = plant_of(*one_plane(experiment(with_effects(true_rig(truth), both)), datasheet), most=2)
    assert set(e.order[0].candidate.effects) == set(both)


def test_a_lag_of_sensors_beside_saturation_is_fitted_to_its_minimum() -> None:
    """Where a strength has no derivative, as flux at zero, a step by its rounding errors ended the fit."""
    datasheet, truth = known_datasheet(seed=58)
    both = {"sensor_lag": {"time_constant_s": 2e-5}, "magnetic_saturation": {"saturation_inverse_per_a": 0.45}}
    e = plant_of(*one_plane(experiment(with_effects(true_rig(truth), both), amplitude_a=0.2), datasheet), most=1)
    begin = (
        {"time_constant_s": 1.9e-5, "delay_s": 0.0},
        {"saturation_inverse_per_a": 0.449, "flux_share": 0.0, "flux_power": 2.0},
    )
    c = fit_task(Task(e.ground, tuple(both), (begin,), np.zeros_like(e.null.candidate.fit.theta), (EXACT,)))
    assert c.fit.cost < 1.2 * c.fit.n_residuals
