"""Scores say what happened: each is checked on outcomes whose score is known by hand."""

import math
from dataclasses import replace
from typing import Any

import pytest

from service.cli.gap import _told
from service.gap.trial.scoring import Outcome, calibration, case_in_words, score


def outcome(
    kind: str,
    effects: tuple[str, ...] = (),
    said: str = "no_gap",
    named: tuple[str, ...] = (),
    alike: tuple[tuple[str, ...], ...] = (),
    probability: float = 1.0,
    detectability: float = 100.0,
    closure: float | None = 0.9,
    candidates: tuple[dict[str, Any], ...] = (),
    parameters: dict[str, dict[str, float]] | None = None,
    path: str = "plant",
) -> Outcome:
    report = {
        "where": {"path": path},
        "verdict": {
            "kind": said,
            "effects": list(named),
            "indistinguishable": [list(a) for a in alike],
            "probability": probability,
        },
        "candidates": list(candidates),
        "shrinkage": {"closure": closure},
    }
    return Outcome(0, kind, effects, parameters or {}, "a law", detectability, report, 1.0)


def candidate(*effects: str, closure: float = 1.0, **parameters: tuple[float, float | None]) -> dict[str, Any]:
    values = {k: {"value": v, "std": sd} for k, (v, sd) in parameters.items()}
    return {"effect": "+".join(effects), "closure": closure, "parameters": values}


SINGLE = ("single", ("loop_delay",))


def test_the_right_effect_is_top1_and_a_wrong_one_is_not() -> None:
    right = outcome(*SINGLE, said="effect", named=("loop_delay",))
    wrong = outcome(*SINGLE, said="effect", named=("sensor_lag",))
    assert score([right, right, right, wrong])["single"]["top1"] == pytest.approx(0.75)


def test_an_alias_class_counts_by_class_only() -> None:
    alike = outcome(*SINGLE, said="effect", named=("sensor_lag",), alike=(("sensor_lag", "loop_delay"),))
    single = score([alike])["single"]
    assert (single["top1"], single["top1_by_class"]) == (0.0, 1.0)


def test_a_class_of_four_is_no_answer() -> None:
    four = ("sensor_lag", "loop_delay", "eddy_currents", "amplifier_bandwidth")
    assert not outcome(*SINGLE, said="effect", named=("sensor_lag",), alike=(four,)).right


def test_a_class_that_holds_no_named_effect_is_no_answer() -> None:
    o = outcome(*SINGLE, said="effect", named=("runout",), alike=(("sensor_lag", "loop_delay"),))
    assert not o.right


def test_a_second_effect_that_is_not_there_makes_a_verdict_wrong_but_not_its_first() -> None:
    o = outcome(*SINGLE, said="effects", named=("loop_delay", "sensor_lag"))
    single = score([o])["single"]
    assert (single["top1"], single["verdict_right"]) == (1.0, 0.0)


def test_names_beside_an_abstention_count_for_nothing() -> None:
    o = outcome(*SINGLE, said="none_of_these", named=("loop_delay",))
    assert score([o])["single"]["top1"] == 0.0


def test_undetectable_effects_are_not_asked_for_and_not_finding_them_is_right() -> None:
    faint = outcome(*SINGLE, said="no_gap", detectability=2.0)
    assert score([faint])["single"]["top1"] is None
    assert faint.right
    assert not outcome(*SINGLE, said="no_gap").right


def test_a_verdict_whose_gap_the_unseen_sweep_does_not_show_has_no_closure_to_score() -> None:
    faint = outcome(*SINGLE, said="effect", named=("loop_delay",), closure=None)
    assert score([faint])["closure"]["median_where_right"] is None


def test_a_mixture_needs_both() -> None:
    effects = ("loop_delay", "support_resonance")
    both = outcome("mixture", effects, said="effects", named=effects[::-1])
    half = outcome("mixture", effects, said="effect", named=effects[:1])
    mixture = score([both, half])["mixture"]
    assert mixture == {"all_visible": 2, "both_found": 0.5, "both_found_of_all": 0.5, "one_found": 1.0}
    assert (both.right, half.right) == (True, False)


def test_what_a_datasheets_tolerance_hides_beside_the_other_effect_is_not_asked_for() -> None:
    effects = ("loop_delay", "sensor_position")
    faint = {"loop_delay": 300.0, "sensor_position": 2.0}
    one = replace(outcome("mixture", effects, said="effect", named=effects[:1]), each=faint)
    wrong = replace(outcome("mixture", effects, said="effects", named=("loop_delay", "eddy_currents")), each=faint)
    other = replace(outcome("mixture", effects, said="effect", named=effects[1:]), each=faint)
    assert (one.right, wrong.right, other.right) == (True, False, False)
    mixture = score([one, wrong, other])["mixture"]
    assert mixture == {"all_visible": 0, "both_found": None, "both_found_of_all": 0.0, "one_found": 1.0}


def test_unknown_laws_are_recalled_and_known_ones_not_abstained_from() -> None:
    cases = [
        outcome("unlisted", said="none_of_these"),
        outcome("unlisted", said="effect", named=("runout",)),
        outcome("unlisted", said="no_gap", detectability=1.0),
        outcome(*SINGLE, said="none_of_these"),
        outcome(*SINGLE, said="effect", named=("loop_delay",)),
        outcome(*SINGLE, said="effect", named=("loop_delay",)),
        outcome(*SINGLE, said="effect", named=("loop_delay",)),
    ]
    unlisted = score(cases)["unlisted"]
    assert unlisted["recall"] == 0.5
    assert unlisted["false_abstention"] == 0.25
    assert unlisted["by_law"]["a law"]["verdicts"] == ["none_of_these", "runout"]


def test_any_gap_on_a_clean_rig_is_a_false_alarm() -> None:
    cases = [
        outcome("clean"),
        outcome("clean"),
        outcome("clean", said="none_of_these"),
        outcome("clean", said="effect"),
    ]
    assert score(cases)["clean"]["false_alarms"] == 0.5


def test_a_forecaster_that_is_as_sure_as_it_is_right_has_no_calibration_error() -> None:
    forecasts = [(0.75, k % 4 != 0) for k in range(400)]
    found = calibration(forecasts)
    assert found["ece"] == pytest.approx(0.0, abs=1e-12)
    assert found["brier"] == pytest.approx(0.75 * 0.25)


def test_an_overconfident_forecaster_is_told_by_how_much() -> None:
    found = calibration([(0.95, k % 2 == 0) for k in range(100)])
    assert found["ece"] == pytest.approx(0.45)
    assert found["bins"] == [{"stated": pytest.approx(0.95), "came_true": 0.5, "cases": 100}]


def test_closure_is_held_against_the_true_effect_refitted() -> None:
    said = {"said": "effect", "named": ("sensor_lag",)}
    worse = outcome(*SINGLE, **said, closure=0.45, candidates=(candidate("loop_delay", closure=0.9),))
    hopeless = outcome(*SINGLE, **said, closure=0.05, candidates=(candidate("loop_delay", closure=0.1),))
    closure = score([worse, hopeless])["closure"]
    assert closure["of_true_effect_median"] == pytest.approx(0.5)
    assert closure["cases"] == 1


def test_parameters_are_compared_and_their_intervals_counted() -> None:
    def measured(value: float, sd: float) -> Outcome:
        return outcome(
            *SINGLE,
            said="effect",
            named=("loop_delay",),
            candidates=(candidate("loop_delay", delay_s=(value, sd)),),
            parameters={"loop_delay": {"delay_s": 2e-5}},
        )

    found = score([measured(2.1e-5, 1e-6), measured(2.6e-5, 1e-6)])["parameters"]
    assert found["values"] == 2
    assert found["relative_error_median"] == pytest.approx((0.05 + 0.3) / 2)
    assert found["within_15_percent"] == 0.5
    assert found["coverage_95"] == 0.5


def test_parameters_of_a_mixture_carry_the_effect_in_their_name() -> None:
    effects = ("loop_delay", "channel_crosstalk")
    values = {"loop_delay.delay_s": (2e-5, 1e-6), "channel_crosstalk.share_ab": (0.01, None)}
    o = outcome(
        "mixture",
        effects,
        said="effects",
        named=effects,
        candidates=(candidate(*effects, **values),),
        parameters={"loop_delay": {"delay_s": 2e-5}, "channel_crosstalk": {"share_ab": 0.02, "share_ba": 0.0}},
    )
    found = score([o])["parameters"]
    assert found["values"] == 2
    assert found["coverage_95"] == 1.0


def test_a_drift_is_compared_over_the_same_time() -> None:
    values = {
        "ki_change": (-0.02, 1e-3),
        "ks_change": (-0.01, 1e-3),
        "duration_s": (300.0, 0.0),
        "curvature": (0.0, 0.1),
    }
    o = outcome(
        "single",
        ("thermal_drift",),
        said="effect",
        named=("thermal_drift",),
        candidates=(candidate("thermal_drift", **values),),
        parameters={"thermal_drift": {"ki_change": -0.04, "ks_change": -0.02, "duration_s": 600.0, "curvature": 0.0}},
    )
    found = score([o])["parameters"]
    assert found["values"] == 2
    assert found["relative_error_median"] == pytest.approx(0.0, abs=1e-9)
    assert found["coverage_95"] == 1.0


def test_parameters_of_an_effect_that_was_not_named_are_not_counted() -> None:
    o = outcome(
        *SINGLE,
        candidates=(candidate("loop_delay", delay_s=(9e-5, 1e-6)),),
        parameters={"loop_delay": {"delay_s": 2e-7}},
        detectability=1.0,
    )
    assert o.right
    assert score([o])["parameters"]["values"] == 0


def test_scores_stand_beside_detectability() -> None:
    cases = [
        outcome(*SINGLE, said="no_gap", detectability=1.0),
        outcome(*SINGLE, said="no_gap", detectability=20.0),
        outcome(*SINGLE, said="effect", named=("loop_delay",), detectability=20.0),
        outcome(*SINGLE, said="effect", named=("loop_delay",), detectability=math.inf),
    ]
    rows = {row["from"]: row for row in score(cases)["by_detectability"]}
    assert (rows[0.0]["found"], rows[0.0]["no_gap"]) == (0.0, 1.0)
    assert (rows[10.0]["cases"], rows[10.0]["found"]) == (2, 0.5)


def test_closure_calibration_and_parameters_stand_beside_detectability() -> None:
    def found(detectability: float, value: float, closure: float, probability: float) -> Outcome:
        return outcome(
            *SINGLE,
            said="effect",
            named=("loop_delay",),
            probability=probability,
            detectability=detectability,
            closure=closure,
            candidates=(candidate("loop_delay", closure=1.0, delay_s=(value, 1e-6)),),
            parameters={"loop_delay": {"delay_s": 2e-5}},
        )

    cases = [found(20.0, 2.6e-5, 0.5, 0.6), found(200.0, 2.1e-5, 0.9, 1.0)]
    rows = {row["from"]: row for row in score(cases)["by_detectability"]}
    assert rows[10.0]["parameters"]["relative_error_median"] == pytest.approx(0.3)
    assert (rows[10.0]["parameters"]["coverage_95"], rows[100.0]["parameters"]["coverage_95"]) == (0.0, 1.0)
    assert rows[10.0]["closure_of_true_effect_median"] == pytest.approx(0.5)
    assert rows[100.0]["closure_of_true_effect_median"] == pytest.approx(0.9)
    assert (rows[10.0]["ece"], rows[100.0]["ece"]) == (pytest.approx(0.4), pytest.approx(0.0))


def test_closure_counts_where_the_true_effect_is_not_among_the_listed_ones() -> None:
    """A wrong effect that closes half is then half of what the true one could close at most; it is not left out."""
    wrong = outcome(*SINGLE, said="effect", named=("sensor_lag",), closure=0.5, candidates=())
    closure = score([wrong])["closure"]
    assert (closure["cases"], closure["of_true_effect_median"]) == (1, pytest.approx(0.5))
    left_open = candidate("loop_delay") | {"closure": None}
    assert score([replace(wrong, report=wrong.report | {"candidates": [left_open]})])["closure"] == closure


def test_a_case_is_told_in_words() -> None:
    assert case_in_words(outcome(*SINGLE, said="none_of_these")).endswith(" -> none of these (1.00): wrong")
    assert "-> loop delay (" in case_in_words(outcome(*SINGLE, said="effect", named=("loop_delay",)))


def test_what_a_trial_is_judged_by_is_printed() -> None:
    printed = dict(_told(score([outcome(*SINGLE, said="effect", named=("loop_delay",))])))
    assert {"error of a strength, median", "95 % intervals that hold the true value"} <= set(printed)


def test_a_trial_without_cases_has_scores_without_values() -> None:
    found = score([])
    assert found["single"]["top1"] is None
    assert found["calibration"]["ece"] is None
    assert found["seconds"]["median"] is None


def test_what_could_be_seen_and_was_not_named_closes_nothing() -> None:
    missed = [outcome(*SINGLE, said="no_gap", detectability=d) for d in (50.0, 1.0)]
    closure = score(missed)["closure"]
    assert (closure["cases"], closure["of_true_effect_median"]) == (1, 0.0)


def test_mixtures_and_unlisted_laws_are_scored_by_detectability_too() -> None:
    both = ("loop_delay", "sensor_lag")
    cases = [
        outcome("mixture", both, said="effects", named=both, detectability=50.0),
        outcome("mixture", both, said="effect", named=both[:1], detectability=50.0),
        outcome("unlisted", (), said="none_of_these", detectability=50.0),
    ]
    rows = {row["from"]: row for row in score(cases)["by_detectability"]}
    assert (rows[30.0]["single"], rows[30.0]["mixture"], rows[30.0]["unlisted"]) == (None, 0.5, 1.0)


def test_every_kind_of_verdict_has_its_own_calibration() -> None:
    cases = [
        outcome("unlisted", (), said="none_of_these", probability=0.9),
        outcome(*SINGLE, said="none_of_these", probability=0.7),
        outcome("clean", (), said="no_gap", probability=0.95),
    ]
    by_verdict = score(cases)["calibration_by_verdict"]
    assert by_verdict["none_of_these"] == {"cases": 2, "stated": pytest.approx(0.8), "came_true": 0.5}
    assert by_verdict["no_gap"] == {"cases": 1, "stated": pytest.approx(0.95), "came_true": 1.0}
