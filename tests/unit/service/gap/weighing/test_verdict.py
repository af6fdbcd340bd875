"""From what explanations leave to a verdict: what is told when an explanation does not explain."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from service.gap.document import sentence
from service.gap.fitting.candidates import Candidate
from service.gap.fitting.fitted import Fit
from service.gap.weighing.alike import ALIKE_LOG_EVIDENCE
from service.gap.weighing.ranking import Ranked, ranked
from service.gap.weighing.verdict import HeldOut, Verdict, decide
from sim.effect import End
from sim.effects import CATALOGUE
from sim.reference import reference_rig

RIG = reference_rig()


def explanation(effects: tuple[str, ...], evidence: float, left: float, shares: tuple[float, ...]) -> Ranked:
    groups = ((1.0, 1), (1.0, 1))
    values = tuple({p.name: p.typical for p in CATALOGUE[name].parameters} for name in effects)
    fit = Fit(effects, np.zeros(1), values, RIG, groups, 0.0, np.arange(1), np.eye(1), "converged")
    return Ranked(Candidate(effects, fit, 0.0, tuple({} for _ in effects)), evidence, 0.9, left, shares)


PLAIN = explanation((), -100.0, 1.0, (1.0, 0.0, 1.0, 0.0))


CLOSED = HeldOut(before=21.0, after=2.0, gap=40.0, left=2.0, closes=0.95, support=300.0)
NOT_SHOWN = HeldOut(before=0.9, after=0.9, gap=0.0, left=0.0)


def said(best: Ranked, remaining: float, there: HeldOut = CLOSED) -> str:
    return decide([best, PLAIN], remaining, there, significant=50.0).kind


def test_an_explanation_that_leaves_little_is_named() -> None:
    assert said(explanation(("rotor_inertia",), 0.0, 0.01, (0.01, 0.0, 0.02, 0.0)), remaining=12.0) == "effect"


def test_an_explanation_of_one_sweep_only_is_none() -> None:
    """What answers to the excitation in proportion cannot be there at one amplitude and not at the other."""
    one_only = explanation(("extra_flexible_mode",), 0.0, 0.2, (0.66, 0.0, 0.01, 0.0))
    assert said(one_only, remaining=20.0) == "none_of_these"
    assert said(replace(one_only, shares=(0.01, 0.0, 0.66, 0.0)), remaining=20.0) == "none_of_these"


def test_harmonics_of_another_law_of_the_same_effect_may_be_left() -> None:
    assert said(explanation(("rotor_inertia",), 0.0, 0.01, (0.01, 0.6, 0.01, 0.5)), remaining=12.0) == "effect"


@pytest.mark.parametrize(("end", "said_of_it"), [(None, "effect"), ("low", "none_of_these"), ("high", "none_of_these")])
def test_an_effect_as_strong_as_its_range_allows_must_leave_next_to_nothing(end: End | None, said_of_it: str) -> None:
    """There it bends to what it is not: of a controller that runs at another rate a weaker one explains five sixths."""
    found = explanation(("controller_mismatch",), 0.0, 0.17, (0.17, 0.0))
    ends: dict[tuple[str, str], End] = {("controller_mismatch", "gain_change"): end} if end else {}
    fit = replace(found.candidate.fit, ends=ends)
    assert said(replace(found, candidate=replace(found.candidate, fit=fit)), remaining=20.0) == said_of_it


@pytest.mark.parametrize(("end", "said_of_it"), [("low", "effect"), ("high", "none_of_these")])
def test_one_of_two_laws_that_has_no_part_in_an_effect_is_at_no_end(end: End, said_of_it: str) -> None:
    """Magnets that saturate by their flux alone, at a knee, leave 7 %: not by the current, whose law ends near zero."""
    found = explanation(("magnetic_saturation",), 0.0, 0.07, (0.07, 0.5))
    fit = replace(found.candidate.fit, ends={("magnetic_saturation", "saturation_inverse_per_a"): end})
    assert said(replace(found, candidate=replace(found.candidate, fit=fit)), remaining=20.0) == said_of_it


@pytest.mark.parametrize(
    ("effect", "said_of_it"), [("magnetic_cross_coupling", "none_of_these"), ("eddy_currents", "effect")]
)
def test_an_effect_whose_law_is_a_constant_must_leave_next_to_nothing(effect: str, said_of_it: str) -> None:
    """Of sensors that hear the other plane coupled magnets explain seven eighths; eddy currents have many laws."""
    assert said(explanation((effect,), 0.0, 0.13, (0.13, 0.0, 0.13, 0.0)), remaining=20.0) == said_of_it
    assert said(explanation((effect,), 0.0, 0.03, (0.03, 0.0, 0.03, 0.0)), remaining=20.0) == "effect"


@pytest.mark.parametrize(("left", "said_of_it"), [(0.01, "none_of_these"), (1e-5, "effect")])
def test_a_filter_that_a_controller_is_said_to_have_leaves_nothing(left: float, said_of_it: str) -> None:
    found = explanation(("controller_mismatch",), 0.0, left, (left, 0.0))
    assert said(found, remaining=20.0) == "effect"
    values = ({**found.candidate.fit.values[0], "filter_mid_change": -0.3},)
    fit = replace(found.candidate.fit, values=values)
    assert said(replace(found, candidate=replace(found.candidate, fit=fit)), remaining=20.0) == said_of_it


@pytest.mark.parametrize("remaining", [1.0, 5.0])
def test_what_is_left_must_be_significant_to_count(remaining: float) -> None:
    assert said(explanation(("rotor_inertia",), 0.0, 0.2, (0.4, 0.0)), remaining) == "effect"


def test_nothing_named_and_much_left_is_none_of_these() -> None:
    assert decide([PLAIN], 20.0, NOT_SHOWN, significant=30.0).kind == "none_of_these"
    assert decide([PLAIN], 2.0, NOT_SHOWN, significant=30.0).kind == "no_gap"


@pytest.mark.parametrize(
    ("fitted", "unseen", "said_of_it"), [(9.0, 9.0, "none_of_these"), (30.0, 3.0, "no_gap"), (3.0, 30.0, "no_gap")]
)
def test_a_little_left_everywhere_is_a_gap_where_unseen_data_show_it_too(
    fitted: float, unseen: float, said_of_it: str
) -> None:
    assert decide([PLAIN], 4.0, NOT_SHOWN, significant=4.0, added_up=(fitted, unseen)).kind == said_of_it


def test_what_stands_out_in_a_few_lines_of_both_sweeps_is_a_gap() -> None:
    """Bounded, as outliers are, it looked like 5 deviates: a voltage that the coil's flux induced in its sensor."""
    assert decide([PLAIN], 5.8, NOT_SHOWN, significant=15.0).kind == "no_gap"
    assert decide([PLAIN], 5.8, NOT_SHOWN, significant=15.0, at_few_lines=15.0).kind == "none_of_these"


NAMED = explanation(("sensor_gain",), 0.0, 0.1, (0.1, 0.0))


def test_an_explanation_that_does_not_close_what_unseen_data_clearly_show_is_none() -> None:
    """The sweep that was fitted leaves nothing significant; only the unseen one tells that it is something else."""
    half = HeldOut(before=1.9, after=1.3, gap=26.0, left=12.0, closes=0.53, support=14.0)
    verdict = decide([NAMED, PLAIN], 3.7, half, significant=15.0)
    assert verdict.kind == "none_of_these"
    assert verdict.reasons == ("the best explanation, sensor gain, leaves 47 % of the gap on unseen data",)


def test_how_strong_a_limit_is_without_which_the_data_are_as_likely_is_left_open() -> None:
    """Amplifiers that nothing drives to their limit have one anywhere above; that is no reason to have one."""

    def fitted(*effects: str, chi_square: float) -> Candidate:
        fit = explanation(effects, 0.0, 0.0, ()).candidate.fit
        return Candidate(effects, replace(fit, groups=((chi_square, 100),)), 0.0, tuple({} for _ in effects))

    found = [
        fitted("loop_delay", chi_square=100.0),
        fitted("amplifier_voltage_limit", chi_square=4990.0),
        fitted("loop_delay", "amplifier_voltage_limit", chi_square=99.0),
        fitted("channel_crosstalk", chi_square=4990.0),  # answers in proportion: as little on any sweep
    ]
    told = {r.candidate.effects: r.open_strength for r in ranked(fitted(chi_square=5000.0), found)}
    assert told == {
        (): (),
        ("loop_delay",): (),
        ("amplifier_voltage_limit",): ("amplifier_voltage_limit",),
        ("loop_delay", "amplifier_voltage_limit"): ("amplifier_voltage_limit",),
        ("channel_crosstalk",): (),
    }


def test_reasons_name_effects_in_words() -> None:
    both = explanation(("support_resonance", "modal_damping"), 0.0, 0.4, (0.4, 0.0))
    told = decide([both, PLAIN], 20.0, CLOSED, significant=50.0).reasons
    assert told == ("the best explanation, support resonance and modal damping, leaves 40 % of the gap",)


def test_a_small_gap_may_be_closed_in_part_only_by_chance() -> None:
    faint = HeldOut(before=1.4, after=1.2, gap=9.0, left=3.0, closes=0.5, support=4.0)
    assert said(NAMED, 2.0, faint) == "effect"


def test_an_effect_that_the_unseen_sweep_cannot_show_keeps_its_probability() -> None:
    verdict = decide([NAMED, PLAIN], 2.0, NOT_SHOWN, significant=50.0)
    assert verdict.effects == ("sensor_gain",)
    assert verdict.probability == NAMED.probability


def test_a_predicted_gap_that_is_absent_costs_probability_and_then_the_verdict() -> None:
    def verdict(support: float, significant: float = 50.0):
        absent = HeldOut(before=0.9, after=1.4, gap=0.0, left=4.0, support=support)
        return decide([NAMED, PLAIN], 2.0, absent, significant)

    assert 0.5 < verdict(-2.0).probability < NAMED.probability
    assert verdict(-2.0).kind == "effect"
    assert verdict(-10.0).kind == "none_of_these"
    assert "that is not there" in verdict(-10.0).reasons[0]
    assert verdict(-10.0, significant=3.0).kind == "no_gap"


@pytest.mark.parametrize(
    ("behind", "told"), [(1.0, "not told apart from amplifier bandwidth"), (12.0, "far less likely")]
)
def test_what_fits_as_well_but_is_far_less_likely_is_told_as_that(behind: float, told: str) -> None:
    """It stays in the class, but "not told apart" beside a probability of 0 % would contradict itself."""
    assert abs(behind - ALIKE_LOG_EVIDENCE) > 1
    order = [
        explanation(("loop_delay",), -50.0, 0.0, (0.0,)),
        explanation(("amplifier_bandwidth",), -50.0 - behind, 0.0, (0.0,)),
    ]
    verdict = Verdict("effect", ("loop_delay",), (("loop_delay", "amplifier_bandwidth"),), 0.97, ())
    shown = {"verdict": verdict, "order": order, "gap_before": 0.01, "shrinkage": SimpleNamespace(closure=1.0)}
    words = sentence(SimpleNamespace(**shown, within_the_datasheet=False))
    assert told in words
    assert "amplifier bandwidth" in words
    assert ("not told apart" in words) == (behind < ALIKE_LOG_EVIDENCE)


@pytest.mark.parametrize(
    ("stretched", "told"),
    [
        ((), "noise and the datasheet's tolerances."),
        (("mass -2 %",), "tolerances, stretched (mass -2 %)."),
        (("mass -2 %", "mode1 damping x +50 %"), "stretched (mass -2 % and 1 more)."),
    ],
)
def test_no_gap_is_not_told_to_lie_within_tolerances_that_are_stretched(stretched: tuple[str, ...], told: str) -> None:
    shown = {"verdict": Verdict("no_gap", (), (), 0.9, ()), "gap_before": 1e-3, "noise_floor": 1e-3}
    d = SimpleNamespace(**shown, shrinkage=None, datasheet_off=(), beyond_tolerance=stretched)
    assert sentence(d).endswith(told)


def test_what_another_part_would_explain_as_well_is_in_the_class_and_shares_its_probability() -> None:
    best, other = explanation(("sensor_gain",), -50.0, 0.0, (0.0,)), explanation(("loop_delay",), -52.0, 0.0, (0.0,))
    alone = decide([best, PLAIN], 2.0, NOT_SHOWN, significant=50.0)
    assert alone.indistinguishable == ()
    shared = decide([best, PLAIN], 2.0, NOT_SHOWN, significant=50.0, elsewhere=[other])
    assert shared.effects == ("sensor_gain",)
    assert shared.indistinguishable == (("sensor_gain", "loop_delay"),)
    far = replace(other, log_evidence=-50.0 - ALIKE_LOG_EVIDENCE - 1)
    assert decide([best, PLAIN], 2.0, NOT_SHOWN, significant=50.0, elsewhere=[far]).indistinguishable == ()


def test_what_the_other_sweep_rejects_is_what_is_fitted_to_half_of_it_first() -> None:
    """A gap that is there, and too much of it left; not what may be chance, before or after, nor a little rest."""
    rejected = HeldOut(before=1.4, after=1.2, gap=26.0, left=12.0, closes=0.5)
    assert rejected.fails
    assert not replace(rejected, gap=0.5).fails
    assert not replace(rejected, left=0.5).fails
    assert not replace(rejected, closes=0.9).fails


def test_an_effect_of_a_mixture_that_an_alias_could_stand_for_is_told_with_it() -> None:
    left = (0.01, 0.0, 0.02, 0.0)
    best = replace(explanation(("eddy_currents", "support_resonance"), 0.0, 0.01, left), probability=0.8)
    like = replace(
        explanation(("support_resonance", "sensor_lag"), -ALIKE_LOG_EVIDENCE / 2, 0.01, left), probability=0.15
    )
    far = replace(
        explanation(("eddy_currents", "extra_flexible_mode"), -2 * ALIKE_LOG_EVIDENCE, 0.01, left), probability=0.01
    )
    other = replace(
        explanation(("eddy_currents", "sensor_gain"), -ALIKE_LOG_EVIDENCE / 2, 0.01, left), probability=0.01
    )
    found = decide([best, like, far, other, PLAIN], 12.0, CLOSED, significant=50.0)
    assert found.effects == best.candidate.effects
    assert found.indistinguishable == (("eddy_currents", "sensor_lag"),)
    assert found.probability == pytest.approx(0.95)


def test_a_class_lists_the_three_likeliest_and_the_others_are_not_lost() -> None:
    verdict = Verdict("effect", ("a",), (), 0.9, ()).with_classes([("a", "b", "c", "d"), ("e", "f")])
    assert verdict.indistinguishable == (("a", "b", "c"), ("e", "f"))
    assert verdict.also_alike == ("d",)
    assert verdict.with_classes([("a", "d", "b", "g")]).also_alike == ("d", "g"), "what was left out before stays told"


@pytest.mark.parametrize(("more", "in_class"), [(1.1, True), (1.4, False)])
def test_an_alias_that_leaves_little_more_of_what_neither_law_explains_is_in_the_class(
    more: float, in_class: bool
) -> None:
    """A ladder of five lags in the place of a slab's law: a delay left 9.8 % of the gap, the lag of a slab 10.8 %."""

    def leaving(effects: tuple[str, ...], evidence: float, chi_square: float) -> Ranked:
        r = explanation(effects, evidence, 0.1, (0.1,))
        return replace(r, candidate=replace(r.candidate, fit=replace(r.candidate.fit, groups=((chi_square, 2000),))))

    best, other = leaving(("sensor_lag",), -600.0, 2e5), leaving(("eddy_currents",), -620.0, more * 2e5)
    plain = leaving((), -900.0, 2e6)
    verdict = decide([best, other, plain], 2.0, CLOSED, significant=50.0)
    assert verdict.effects == ("sensor_lag",)
    assert verdict.indistinguishable == ((("sensor_lag", "eddy_currents"),) if in_class else ())


@pytest.mark.parametrize(
    ("effect", "left", "named"),
    [("touchdown_contact", 0.004, True), ("touchdown_contact", 0.02, False), ("extra_flexible_mode", 0.004, False)],
)
def test_half_of_a_quiet_sweep_s_gap_may_be_the_error_of_a_law_that_a_loud_one_sets(
    effect: str, left: float, named: bool
) -> None:
    best = explanation((effect,), 0.0, left, (0.56, 0.0, 0.001, 0.0))
    assert (said(best, remaining=20.0) == "effect") is named
