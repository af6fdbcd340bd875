"""A rig with effects that its twin names is identified as it is; without them in the twin the figures are off."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from service.experiment.data import Experiment
from service.exports.linear import of_result
from service.health.compare import Baseline, compare
from service.identification.controller.check import check_controller
from service.identification.fit import identify
from service.identification.loop.closed_loop import closed_loop_poles, sampled
from service.identification.loop.margins import computed_response
from service.identification.measured.etfe import etfe
from service.identification.measured.points import plane_points
from service.identification.plane.model import PlaneModel
from service.identification.result.commissioning import CommissioningResult
from service.identification.result.saved import saved_planes
from service.identification.rotating import whirl
from service.identification.rotating.model import joined
from service.identification.rotating.motion import TurningPoints
from service.identification.rotating.whirl import loop_matrix
from service.identification.synthetic import closed_loop_points
from service.report.commissioning import commissioning_page
from sim.datasheet import Datasheet
from sim.errors import LevitationError
from sim.rig import Rig
from sim.stepping import Simulation
from sim.twin import linear_model, rig_from_datasheet
from tests.support.synthetic import experiment, known_datasheet

pytestmark = pytest.mark.slow


SHEET, TRUTH = known_datasheet()
CHAIN = {
    "loop_delay": {"delay_s": 4e-6},
    "amplifier_bandwidth": {"frequency_change": -0.05, "damping_change": 0.02, "lag_s": 3e-6},
    "channel_crosstalk": {"share_ab": 0.02, "share_ba": -0.01},
    "eddy_currents": {"time_constant_s": 3e-7, "corner_rad_s": 10.0},
    "sensor_lag": {"time_constant_s": 4e-6, "delay_s": 1e-6},
    "logging_offset": {"samples": 1.0},
    "controller_mismatch": {"gain_change": 0.1, "derivative_change": 0.05, "lag_samples": -0.05},
}
"""Every block of the chain at once, the loop still stable."""


def named(sheet: Datasheet, effects: dict[str, dict[str, float]]) -> Datasheet:
    return replace(sheet, effects=tuple((name, tuple(values.items())) for name, values in effects.items()))


def measured(rig: Rig, seed: int = 1) -> Experiment:
    """The plane x of a rig, another sweep beside the main one."""
    whole = experiment(rig, seed)
    return replace(whole, sweeps=tuple(s.select(s.axis < 2) for s in whole.sweeps))


def law_of(rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    return np.array(rig.controller.numerator), np.array(rig.controller.denominator)


@cache
def chained() -> tuple[Rig, Datasheet, CommissioningResult]:
    """A rig with the whole chain, its twin, and what was identified with that."""
    twin = named(SHEET, CHAIN)
    rig = rig_from_datasheet(named(TRUTH, CHAIN))
    return rig, twin, identify(measured(rig), twin)


def wrong(result: CommissioningResult) -> set[str]:
    """Figures of plane x that are off the truth by more than their deviations, flagged, or told to be checked."""
    plane = result.planes["x"]
    truth = {"kiA": 181.0, "kiB": 186.0, "ksA": 1.68e6, "ksB": 1.73e6}
    off = {k: (plane.stiffness[k].value - v) / plane.stiffness[k].std for k, v in truth.items()}
    off["delay"] = plane.delay_s.value / plane.delay_s.std
    rotor = [m for m in plane.modes if m.kind == "rotor"]
    for m, told in zip(rotor, TRUTH.modes, strict=True):
        w, zeta = m.natural_frequency_rad_s, m.damping_ratio
        off["wn"] = max(abs(w.value - 2 * np.pi * told.frequency_hz) / w.std, off.get("wn", 0.0))
        off["zeta"] = max(abs(zeta.value - told.damping_ratio) / zeta.std, off.get("zeta", 0.0))
    found = {name for name, z in off.items() if not abs(z) < 4.0}
    assert plane.closed_loop is not None
    if min(plane.closed_loop.u_percent.min(), plane.closed_loop.y_percent.min()) < 99.0:
        found.add("predicted loop")
    if any("rather wrong than loose" in w for w in result.warnings):
        found.add("value to check")
    return found if plane.adequate else found | {"misfit"}


@pytest.mark.parametrize(
    ("name", "values", "without_it"),
    [
        ("loop_delay", {"delay_s": 15e-6}, "delay"),
        ("amplifier_bandwidth", {"frequency_change": -0.1, "damping_change": 0.05, "lag_s": 4e-6}, "delay"),
        ("channel_crosstalk", {"share_ab": 0.03, "share_ba": 0.02}, "misfit"),
        ("eddy_currents", {"time_constant_s": 1e-6, "corner_rad_s": 10.0}, "misfit"),
        ("sensor_lag", {"time_constant_s": 12e-6, "delay_s": 1e-6}, "misfit"),
        ("controller_mismatch", {"gain_change": 0.1, "derivative_change": 0.05, "lag_samples": 0.05}, "predicted loop"),
        ("sensor_position", {"shift_A_m": 0.012, "shift_B_m": 0.012}, "misfit"),
        ("rotor_inertia", {"mass_change": 0.05, "inertia_change": 0.08}, "kiA"),
        (
            "sensor_gain",
            {"gain_change_xA": 0.05, "gain_change_xB": -0.03},
            "value to check",
        ),
    ],
)
def test_an_effect_that_the_twin_names_does_not_mislead(name, values, without_it):
    data = measured(rig_from_datasheet(named(TRUTH, {name: values})))
    assert wrong(identify(data, named(SHEET, {name: values}))) == set()
    assert without_it in wrong(identify(data, SHEET))


def test_a_log_out_of_step_misleads_neither_with_the_twin_s_word_nor_without():
    effect = {"logging_offset": {"samples": 1.0}}
    data = measured(rig_from_datasheet(named(TRUTH, effect)))
    told, found = identify(data, named(SHEET, effect)), identify(data, SHEET)
    assert wrong(told) == wrong(found) == set()
    assert any("1 sample early" in w for w in found.warnings)
    assert not any("1 sample early" in w for w in told.warnings)


def test_all_of_them_together():
    assert wrong(chained()[2]) == set()


def test_a_delay_that_no_logged_current_shows_is_known_from_the_twin():
    values = {"loop_delay": {"delay_s": 15e-6}}
    data = measured(rig_from_datasheet(named(TRUTH, values)))
    blind = replace(data, sweeps=tuple(replace(s, I=None) for s in data.sweeps))
    assert not identify(blind, SHEET).planes["x"].adequate
    assert identify(blind, named(SHEET, values)).planes["x"].adequate


def test_margins_are_those_of_the_loop_that_runs():
    rig, _, result = chained()
    near = np.linspace(480.0, 510.0, 3001)
    true = np.abs(linear_model(rig, np.concatenate([np.geomspace(10.0, 2000.0, 500), near])).u_per_r).max(axis=0)
    as_logged = np.abs(etfe(plane_points(measured(rig).main, SHEET.axes, "x"), "r->u").value)
    for k, m in enumerate(result.planes["x"].margins.values()):
        assert m.sensitivity_peak == pytest.approx(true[k, k], abs=4 * m.peak_std + 5e-3 * true[k, k])
        assert m.measured_peak == pytest.approx(as_logged[:, k, k].max(), rel=1e-9)


def test_planned_tones_are_those_of_the_loop_with_the_chain():
    """What a health check is planned with: r to u at the amplifiers, and to y."""
    rig, _, result = chained()
    hz = np.array([30.0, 200.0, 800.0])
    theory = linear_model(rig, hz)
    axis, small = np.array([0, 1, 0]), np.full(3, 1e-6)
    u, _, y = closed_loop_points(result.planes["x"].model, law_of(rig), 2 * np.pi * hz, axis, small)
    for k, own in enumerate(axis):
        u_computed, drive = theory.u_per_r[k] * theory.log_phase[k], rig.amplifiers.crosstalk
        assert y[k] == pytest.approx(1e-6 * (theory.y_per_u @ theory.u_per_r)[k, :2, own], rel=3e-3)
        assert u[k] == pytest.approx(1e-6 * (drive @ u_computed)[:2, own], rel=3e-3)


def test_the_loop_in_state_space_has_the_chain_in_it():
    model = chained()[2].planes["x"].model
    omega = 2 * np.pi * np.array([5.0, 80.0, 492.0, 907.0, 1500.0])
    expected = computed_response(model, omega)
    ours = sampled(model).response(omega, SHEET.sample_time_s)
    off = np.linalg.norm(ours - expected, axis=(1, 2)) / np.linalg.norm(expected, axis=(1, 2))
    assert off[:4].max() < 2e-4
    assert off[4] < 2e-2  # of a response that the images reach


def test_a_rotor_that_turns_has_the_chain_in_both_planes():
    """Exact derivatives against differences, and the loop at standstill against that of the planes."""
    model = chained()[2].planes["x"].model
    turning = joined(model, model, tuple((k, k) for k in range(model.layout.n_modes)), 1.9)
    rng = np.random.default_rng(3)
    omega, u = 2 * np.pi * np.array([40.0, 489.0, 950.0]), rng.normal(size=(3, 4)) + 1j * rng.normal(size=(3, 4))
    points = TurningPoints(omega, np.full(3, 200.0), u)
    p = turning.predict(points, gradient=True)
    assert p.d_y is not None
    for name in ("x_delay_s", "y_amplifier_B_natural_frequency_rad_s", "x_ki_A", "y_mode_1_nu_rad_s"):
        k = turning.layout.index(name)
        step = 1e-6 * max(abs(turning.theta[k]), 1e-4)
        ends = [turning.at(turning.theta + s * np.eye(len(turning.theta))[k]).predict(points).y for s in (step, -step)]
        np.testing.assert_allclose(p.d_y[:, :, k], (ends[0] - ends[1]) / (2 * step), rtol=2e-4, atol=1e-12)
    law = law_of(chained()[0])
    whole = np.sort(np.abs(np.linalg.eigvals(loop_matrix(turning, law, 0.0)[0])))
    own = np.sort(np.abs(closed_loop_poles(model, law)))
    np.testing.assert_allclose(whole[-12:], np.repeat(own[-6:], 2), rtol=1e-7)


def dead(dead_s: tuple[float, float]) -> PlaneModel:
    """The plane of a rig without effects whose sensors have these dead times."""
    plain = identify(measured(rig_from_datasheet(TRUTH)), SHEET).planes["x"].model
    chain = replace(plain.known.chain, sensor_delay_s=np.array(dead_s))
    return replace(plain, known=replace(plain.known, chain=chain))


def test_at_standstill_each_sensor_s_own_dead_time_is_in_both_planes_loops():
    model, law = dead((0.0, 40e-6)), law_of(rig_from_datasheet(TRUTH))
    turning = joined(model, model, tuple((k, k) for k in range(model.layout.n_modes)), 1.9)
    whole = np.sort(np.abs(np.linalg.eigvals(loop_matrix(turning, law, 0.0)[0])))
    own = np.sort(np.abs(closed_loop_poles(model, law)))
    np.testing.assert_allclose(whole[-12:], np.repeat(own[-6:], 2), rtol=1e-7)


@pytest.mark.parametrize("speed_rad_s", [0.0, 300.0])
@pytest.mark.parametrize("dead_s", [(0.0, 40e-6, 0.0, 40e-6), (70e-6, 20e-6, 5e-6, 130e-6), (9e-6, 9e-6, 60e-6, 60e-6)])
def test_a_rotor_that_turns_is_seen_as_late_as_each_sensor_is(dead_s, speed_rad_s):
    x, y = dead(dead_s[:2]), dead(dead_s[2:])
    turning = joined(x, y, tuple((k, k) for k in range(x.layout.n_modes)), 1.9)
    omega = 2 * np.pi * np.array([5.0, 80.0, 492.0, 907.0])
    ours = whirl.sampled(turning, speed_rad_s).response(omega, SHEET.sample_time_s)
    theirs = turning.response(omega, speed_rad_s)
    off = np.linalg.norm(ours - theirs, axis=(1, 2)) / np.linalg.norm(theirs, axis=(1, 2))
    assert off.max() < 2e-4


def test_result_json_and_report_say_what_the_model_holds():
    _, twin, result = chained()
    document = result.document()
    assert [e["effect"] for e in document["known_effects"]] == list(CHAIN)
    eddy = next(e for e in document["known_effects"] if e["effect"] == "eddy_currents")
    assert eddy["parameters"] == CHAIN["eddy_currents"]
    assert "per flux-making current" in eddy["in_model"][0]
    page = commissioning_page(result, measured(chained()[0]), twin)
    assert "per flux-making current" in page


def test_an_effect_that_the_model_cannot_have_is_told():
    values = {"touchdown_contact": {"stiffness_n_per_m": 1e6, "clearance_xA_m": 2e-4}}
    result = identify(measured(rig_from_datasheet(TRUTH)), named(SHEET, values))
    (sentence,) = [w for w in result.warnings if "touchdown_contact" in w]
    assert "not in the model" in sentence
    assert "clearance" in sentence
    assert result.document()["known_effects"][0]["in_model"] == []


def test_a_health_check_of_a_twin_with_effects_raises_no_alarm():
    rig, twin, result = chained()
    document = result.document()
    found = compare(Baseline(document), measured(rig, seed=11), twin)
    assert not found.alarm
    (note,) = found.notes
    assert "no model of yA, yB" in note
    for axis, change in found.planes[0].sensitivity_peaks.items():
        assert change.was == pytest.approx(result.planes["x"].margins[axis].sensitivity_peak, rel=1e-6)
    as_logged = np.abs(etfe(plane_points(measured(rig, seed=11).main, SHEET.axes, "x"), "r->u").value)
    assert found.planes[0].measured_peak == pytest.approx(
        (as_logged[:, 0, 0].max(), as_logged[:, 1, 1].max()), rel=1e-9
    )
    # what the check would see of the same rig as another one without them
    forgotten = {k: v for k, v in document.items() if k != "known_effects"}
    assert compare(Baseline(forgotten), measured(rig, seed=11), SHEET).alarm


def test_a_health_check_still_sees_what_changed():
    rig, twin, result = chained()
    weaker = replace(rig, magnets=replace(rig.magnets, ki=0.97 * rig.magnets.ki))
    found = compare(Baseline(result.document()), measured(weaker, seed=12), twin)
    assert {"x.kiA", "x.kiB"} <= set(found.drifted)


def test_a_saved_model_keeps_the_effects_that_it_was_identified_with():
    """Whatever the datasheet says by now: its delay must not count twice."""
    _, twin, result = chained()
    omega = 2 * np.pi * np.array([20.0, 300.0, 905.0])
    for sheet, differs in ((twin, False), (SHEET, True)):
        saved = saved_planes(result.document(), sheet)["x"]
        np.testing.assert_allclose(saved.model.response(omega), result.planes["x"].model.response(omega), rtol=1e-9)
        assert any("identify the experiment once more" in note for note in saved.notes) == differs
    late = named(SHEET, {"loop_delay": {"delay_s": 35e-6}})
    plain = identify(measured(rig_from_datasheet(late)), SHEET)
    saved = saved_planes(plain.document(), late)["x"]
    np.testing.assert_allclose(saved.model.response(omega), plain.planes["x"].model.response(omega), rtol=1e-9)
    assert "identify the experiment once more" in saved.notes[0]


def test_what_is_exported_says_what_it_lacks():
    document = chained()[2].document()
    assert "eddy_currents" in of_result(document, "x", "whole").comment
    assert "effects" not in of_result({**document, "known_effects": []}, "x").comment


def test_a_controller_is_judged_on_the_loop_with_the_chain():
    rig, twin, result = chained()
    saved = saved_planes(result.document(), twin)
    running = check_controller("rig", saved, law_of(rig))
    assert running.stable
    assert any("judged as it is written" in w for w in running.warnings)
    near = np.linspace(480.0, 510.0, 3001)
    true = np.abs(linear_model(rig, near).u_per_r).max(axis=0)
    for k, axis in enumerate(running.axes):
        p = axis.sensitivity_peak
        assert p.low - 0.01 * p.value < true[k, k] < p.high + 0.01 * p.value


@pytest.mark.parametrize("lag_samples", [-0.03, 0.01, 0.05])
def test_stability_with_the_chain_is_what_the_time_simulation_finds(lag_samples):
    """Later and later a controller: `Simulation` refuses a loop by eigenvalues of its own compiled matrices."""
    _, _, result = chained()
    late = {**CHAIN, "controller_mismatch": {**CHAIN["controller_mismatch"], "lag_samples": lag_samples}}
    rig = rig_from_datasheet(named(TRUTH, late))
    try:
        Simulation(rig, seed=0)
        levitates = True
    except LevitationError:
        levitates = False
    poles = closed_loop_poles(result.planes["x"].model, law_of(rig))
    assert (np.abs(poles).max() < 1.0) == levitates
