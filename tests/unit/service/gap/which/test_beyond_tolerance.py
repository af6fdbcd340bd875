"""A value of the datasheet that is farther off than its tolerance lets one believe is an effect."""

from dataclasses import replace

import numpy as np
import pytest

from service.gap.diagnose import diagnose
from service.gap.document import gap_document
from service.gap.fitting.candidates import Candidate, Fitter
from service.gap.fitting.fitted import Fit
from service.gap.fitting.nuisance import nuisance
from service.gap.fitting.part import Ground, parts
from service.gap.measured.observation import observe
from service.gap.weighing.ranking import Ranked, ranked
from service.gap.which.beyond_tolerance import beyond_tolerance, others_strained
from service.gap.which.search import explain, plain_twin
from sim.reference import reference_rig
from sim.twin import with_effects
from tests.support.synthetic import experiment, known_datasheet, lines, sweep, true_rig
from tests.support.two_axes import one_plane

pytestmark = pytest.mark.slow
TOLERANCE_M = 1e-3
FIT = Fit(("eddy_currents",), np.zeros(40), (), reference_rig(), (), 0.0, np.arange(40), np.eye(40), "converged")


def weighed(effects: dict[str, dict[str, float]], stated: bool = True, turns: bool = False) -> list[Ranked]:
    """The plain twin of such a rig, and what is said beside it; of one that ``turns`` with the shaft's own damping."""
    datasheet, truth = known_datasheet(seed=4)
    tolerance = replace(datasheet.tolerance, sensor_position_m=TOLERANCE_M, sensor_gain=0.01)
    nu = nuisance(replace(datasheet, tolerance=tolerance, tolerance_stated=stated))
    o = observe(sweep(with_effects(true_rig(truth), effects), lines(30), 0.4, 3), nu.rig)
    part = parts(nu, (o,))[-1]
    part = replace(part, effects=(*part.effects, "internal_damping")) if turns else part
    ground = Ground(nu, part, (o,), np.zeros(len(nu)))
    with Fitter(1) as fitter:
        null, _ = plain_twin(fitter, ground)
        return beyond_tolerance(fitter, ground, ranked(null, []), most=3)


def moved(tolerances: float) -> dict[str, dict[str, float]]:
    return {"sensor_position": {"shift_A_m": tolerances * TOLERANCE_M, "shift_B_m": 0.0}}


def test_a_sensor_that_is_nearly_four_tolerances_away_is_named() -> None:
    best, *others = weighed(moved(3.8))
    assert best.candidate.effects == ("sensor_position",)
    assert best.probability > 0.5
    assert [r.candidate.effects for r in others] == [()]
    (values,), (deviations,) = best.candidate.fit.values, best.candidate.standard_deviations
    assert values["shift_A_m"] == pytest.approx(3.8e-3, abs=3 * deviations["shift_A_m"])
    assert values["shift_B_m"] == 0
    assert deviations["shift_B_m"] == pytest.approx(TOLERANCE_M)


@pytest.mark.parametrize("tolerances", [0.0, 2.5])
def test_one_within_what_a_tolerance_allows_is_not(tolerances: float) -> None:
    assert [r.candidate.effects for r in weighed(moved(tolerances))] == [()]


def test_tolerances_that_are_only_assumed_prove_nothing() -> None:
    assert [r.candidate.effects for r in weighed(moved(3.8), stated=False)] == [()]


def test_of_two_sensors_in_a_plane_either_may_be_the_one() -> None:
    """A gain of both is one of the magnets: what is told is their ratio."""
    gains = {f"gain_change_{axis}": 0.07 if axis == "xA" else 0.0 for axis in ("xA", "xB", "yA", "yB")}
    best = weighed({"sensor_gain": gains})[0]
    assert best.candidate.effects == ("sensor_gain",)
    (values,), (deviations,) = best.candidate.fit.values, best.candidate.standard_deviations
    assert values["gain_change_xA"] - values["gain_change_xB"] == pytest.approx(0.07, abs=0.01)
    assert abs(values["gain_change_xA"] - 0.07) < 2 * deviations["gain_change_xA"]


@pytest.mark.parametrize("log_ratio", [-1.8, 2.0])
def test_damping_that_both_planes_show_far_off_is_named(log_ratio: float) -> None:
    """Each plane is 3.5 to 4 tolerances off by itself: by one alone a datasheet would hardly be believed less."""
    best, *_ = weighed({"modal_damping": {"mode1_log_ratio": log_ratio, "mode2_log_ratio": 0.0}})
    assert best.candidate.effects == ("modal_damping",)
    (values,), (deviations,) = best.candidate.fit.values, best.candidate.standard_deviations
    within = 3 * deviations["mode1_log_ratio"] + 0.5  # the datasheet itself is off by up to a tolerance
    assert values["mode1_log_ratio"] == pytest.approx(log_ratio, abs=within)
    assert values["mode2_log_ratio"] == 0.0


def test_damping_of_a_rotor_that_turns_is_left_to_effects_with_a_law_of_their_own() -> None:
    """There the shaft's damping is no alias, and is weighed as every effect is."""
    ratios = {"mode1_log_ratio": 2.0, "mode2_log_ratio": 0.0}
    assert [r.candidate.effects for r in weighed({"modal_damping": ratios}, turns=True)] == [()]


@pytest.mark.parametrize("log_ratio", [-1.0, 1.0])
def test_damping_that_a_tolerance_of_half_its_value_allows_is_not(log_ratio: float) -> None:
    ratios = {"mode1_log_ratio": log_ratio, "mode2_log_ratio": log_ratio}
    assert [r.candidate.effects for r in weighed({"modal_damping": ratios})] == [()]


def test_the_diagnosis_says_that_it_is_the_datasheet_that_would_be_off() -> None:
    datasheet, truth = known_datasheet(seed=4)
    datasheet = replace(datasheet, tolerance=replace(datasheet.tolerance, sensor_position_m=TOLERANCE_M))
    measured = experiment(with_effects(true_rig(truth), moved(3.8)), amplitude_a=0.4)
    found = gap_document(diagnose(*one_plane(measured, datasheet)))
    assert found["verdict"]["effects"] == ["sensor_position"]
    assert "only with its datasheet off" in found["verdict"]["sentence"]
    (told,) = [note for note in found["notes"] if "would be off by more than a tolerance" in note]
    assert "sensor position A -3." in told


def test_a_gain_that_no_tolerance_allows_is_named_beside_another_effect() -> None:
    """Of mixtures it was never one, as the other effect with a datasheet far off left nothing."""
    datasheet, truth = known_datasheet(seed=6)
    datasheet = replace(datasheet, tolerance=replace(datasheet.tolerance, sensor_gain=0.01))
    gains = {f"gain_change_{axis}": 0.07 if axis == "xA" else 0.0 for axis in ("xA", "xB", "yA", "yB")}
    both = {"sensor_gain": gains, "eddy_currents": {"time_constant_s": 1e-6, "corner_rad_s": 1.0}}
    named = diagnose(*one_plane(experiment(with_effects(true_rig(truth), both)), datasheet)).verdict.effects
    assert set(named) == set(both)


def test_values_of_all_kinds_that_are_off_beside_an_effect_are_no_sensor_s() -> None:
    """They bear the error of a law: each may be off by as much as one gain that would be named."""
    best = Candidate(("eddy_currents",), replace(FIT, penalty=60.0), 0.0, ())
    assert not others_strained(best, 1, 36.0)
    assert others_strained(replace(best, fit=replace(FIT, penalty=120.0)), 1, 36.0)


@pytest.mark.parametrize("scale", [{"magnetic_saturation": {"saturation_inverse_per_a": 0.6}}])
def test_none_is_named_beside_an_effect_whose_law_gives_the_scale(scale: dict[str, dict[str, float]]) -> None:
    """Of two saturation laws one bends sooner, and so would be that of a rotor of another mass."""
    datasheet, truth = known_datasheet(seed=6)
    heavy = replace(truth, mass_kg=1.03 * truth.mass_kg)
    sheet = replace(datasheet, tolerance=replace(datasheet.tolerance, mass=0.005))
    named = diagnose(*one_plane(experiment(with_effects(true_rig(heavy), scale)), sheet)).verdict.effects
    assert set(named) == set(scale)


def test_beside_it_the_alias_of_what_was_likelier_alone_is_tried() -> None:
    """Alone, a mode of the rotor may fit what a housing does under a rotor that is too heavy, and a housing not.

    A mode's shape has the mass's error in it. The two were told as a mode on a rotor of another inertia.
    """
    datasheet, truth = known_datasheet(seed=4)
    nu = nuisance(
        replace(
            datasheet,
            tolerance=replace(datasheet.tolerance, mass=0.005, transverse_inertia=0.01),
            tolerance_stated=True,
        )
    )
    housing = {"inverse_mass_per_kg": 1 / 1300, "frequency_hz": 165.0, "damping_ratio": 0.03}
    both = {"support_resonance": housing, "rotor_inertia": {"mass_change": 0.06, "inertia_change": 0.0}}
    o = observe(sweep(with_effects(true_rig(truth), both), lines(40), 0.4, 3), nu.rig)
    part = replace(parts(nu, (o,))[-1], effects=("extra_flexible_mode", "support_resonance", "rotor_inertia"))
    ground = Ground(nu, part, (o,), np.zeros(len(nu)))
    with Fitter(1) as fitter:
        order = [r for r in explain(fitter, ground, most=1).order if r.candidate.effects != ("rotor_inertia",)]
        first = max(r.log_evidence for r in order) + 1
        mode_first = sorted(
            (replace(r, log_evidence=first) if "extra_flexible_mode" in r.candidate.effects else r for r in order),
            key=lambda r: -r.log_evidence,
        )
        best, *_ = beyond_tolerance(fitter, ground, mode_first, most=3)
    assert set(best.candidate.effects) == set(both)
