"""A controller is judged before it is loaded: by the eigenvalues of the loop, and with the model's uncertainty."""

from dataclasses import replace

import numpy as np
import pytest

from service.identification.controller.check import check_controller
from service.identification.loop import margins, predicted
from service.identification.loop.closed_loop import closed_loop_poles, sampled, slowest_decay
from service.identification.loop.margins import computed_response, zone_table
from service.identification.loop.predicted import predicted_closed_loop
from service.identification.measured.points import plane_points
from service.identification.result.saved import saved_planes
from service.identification.statistics.drawn import interval
from sim.errors import AmbError, LevitationError
from sim.reference import reference_rig
from sim.stepping import Simulation
from sim.twin import linear_model
from tests.support.commissioned import AXES, LAW, SHEET, result
from tests.support.planes import plane_model_of, synthetic_sweep
from tests.support.two_axes import sheet_of_one_plane

SOFT = (np.array([18e3 * 0.3]), np.array([1.0]))


@pytest.fixture(scope="module")
def planes():
    return saved_planes(result(), SHEET)


def scaled(gain: float) -> tuple[np.ndarray, np.ndarray]:
    return gain * LAW[0], LAW[1]


@pytest.mark.parametrize("delay_s", [0.0, 37e-6, 100e-6, 237e-6])
def test_the_sampled_loop_has_the_response_of_the_frequency_domain_model(planes, delay_s):
    """Two ways to the same hold and delay: matrix exponentials, and sums over the poles with images."""
    model = planes["x"].model
    theta = model.theta.copy()
    theta[model.layout.delay] = delay_s
    model = model.at(theta)
    omega = 2 * np.pi * np.array([5.0, 80.0, 492.0, 907.0, 1500.0])
    ours = sampled(model).response(omega, SHEET.sample_time_s)
    theirs = model.response(omega)
    assert np.abs(ours - theirs).max(axis=(1, 2)) == pytest.approx(0, abs=5e-4 * np.abs(theirs).max())
    np.testing.assert_allclose(ours[:4], theirs[:4], rtol=2e-5)


@pytest.mark.parametrize("dead_s", [(0.0, 40e-6), (70e-6, 20e-6), (0.0, 100e-6), (250e-6, 10e-6)])
@pytest.mark.parametrize("delay_s", [0.0, 37e-6, 100e-6, 237e-6])
def test_each_sensor_has_its_own_dead_time_in_the_sampled_loop(planes, delay_s, dead_s):
    model = planes["x"].model
    theta = model.theta.copy()
    theta[model.layout.delay] = delay_s
    chain = replace(model.known.chain, sensor_delay_s=np.array(dead_s))
    model = replace(model.at(theta), known=replace(model.known, chain=chain))
    omega = 2 * np.pi * np.array([5.0, 80.0, 492.0, 907.0])
    ours, theirs = sampled(model).response(omega, SHEET.sample_time_s), computed_response(model, omega)
    np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-4 * np.abs(theirs).min())


def test_sensor_lag_and_first_order_amplifiers_are_in_the_loop():
    rig = reference_rig()
    rig = replace(
        rig,
        sensors=replace(rig.sensors, bandwidth_rad_s=np.array([2e4, np.inf, 2e4, np.inf])),
        amplifiers=replace(rig.amplifiers, damping_ratio=None),
    )
    model = plane_model_of(rig, "x")
    omega = 2 * np.pi * np.array([20.0, 300.0, 900.0])
    np.testing.assert_allclose(sampled(model).response(omega, 1e-4), model.response(omega), rtol=2e-3)


@pytest.mark.parametrize("gain", [0.3, 0.45, 0.55, 1.0, 3.0, 7.0, 12.0])
def test_stability_is_what_the_time_simulation_finds(gain):
    """`Simulation` refuses a loop by eigenvalues of its own compiled matrices."""
    rig = reference_rig()
    rig = replace(rig, controller=replace(rig.controller, numerator=gain * rig.controller.numerator))
    try:
        Simulation(rig, seed=0)
        levitates = True
    except LevitationError:
        levitates = False
    decays = [slowest_decay(closed_loop_poles(plane_model_of(rig, p), scaled(gain)), 1e-4) for p in "xy"]
    assert (min(decays) > 0) == levitates


def test_the_running_controller_is_stable_with_all_models_and_its_peak_is_the_true_one(planes):
    found = check_controller("reference", planes, LAW, SHEET.sample_time_s)
    assert found.stable
    assert found.stable_share == 1.0
    f = np.linspace(480, 520, 4001)
    true = np.abs(linear_model(reference_rig(), f).u_per_r).max(axis=0)
    for k, axis in enumerate(found.axes):
        assert axis.axis == AXES[k]
        p = axis.sensitivity_peak
        assert p.low <= p.value <= p.high
        assert p.low - 0.01 * p.value < true[k, k] < p.high + 0.01 * p.value
        assert axis.gain_margin_down_db.value == pytest.approx(-6.1, abs=0.2)
        assert 10 < axis.phase_margin_deg.value < 16
        assert 60e-6 < axis.delay_margin_s.value < 90e-6


def test_the_verdict_follows_the_table_of_zones(planes):
    refused = check_controller("reference", planes, LAW)
    assert not refused.safe
    assert all("zone" in reason for reason in refused.reasons)
    generous = check_controller("reference", planes, LAW, zones=zone_table("ok=20,bad"), accepted_zone="ok")
    assert generous.safe
    assert generous.reasons == ()
    assert generous.document()["verdict"] == "safe"


def test_the_verdict_is_that_of_the_highest_peak_that_the_data_allow(planes):
    """A zone that the best model just keeps to, and models as likely do not, is not kept to."""
    free = check_controller("reference", planes, LAW, zones=zone_table("ok=20,bad"), accepted_zone="ok")
    decibel = [20 * np.log10([a.sensitivity_peak.value, a.sensitivity_peak.high]) for a in free.axes]
    widest = max(decibel, key=lambda ends: ends[1])
    assert widest[1] > max(value for value, _ in decibel), "else no limit lies between"
    limit = 0.5 * (max(value for value, _ in decibel) + widest[1])
    found = check_controller("reference", planes, LAW, zones=zone_table(f"ok={limit},bad"), accepted_zone="ok")
    assert not found.safe


GENEROUS = {"zones": zone_table("ok=20,bad"), "accepted_zone": "ok"}


def test_of_a_model_that_does_not_describe_the_rig_nothing_is_known(planes):
    """What it lacks may be the mode that the law leaves undamped, however calm its own loop is."""
    poor = planes | {"y": replace(planes["y"], adequate=False, rms_over_sigma=85.3)}
    found = check_controller("reference", poor, LAW, **GENEROUS)
    assert found.verdict == "not known"
    assert not found.safe
    assert found.reasons == ()
    (why,) = found.not_known
    assert why.startswith("plane y: the model leaves residuals 85 times the noise: it does not describe the rig")
    assert found.document()["verdict"] == "not known"
    assert found.document()["not_known"] == [why]
    assert check_controller("reference", poor, scaled(0.4), **GENEROUS).verdict == "unsafe"


def test_a_model_that_did_not_hold_on_the_unseen_sweep_is_told():
    document = result()
    own = document["planes"]
    later = own | {
        "x": own["x"] | {"cross_validation_passed": False},
        "y": own["y"] | {"cross_validation_passed": True},
    }
    found = check_controller("reference", saved_planes(document | {"planes": later}, SHEET), LAW, draws=5, **GENEROUS)
    (told,) = [w for w in found.warnings if "no fit has seen" in w]
    assert told.startswith("plane x: its model did not hold")


def test_a_model_with_an_error_that_was_allowed_for_does_not_describe_the_rig_either(planes):
    """Its residuals are small in units of noise and that error together."""
    poor = planes | {"x": replace(planes["x"], adequate=False, rms_over_sigma=0.8)}
    (why,) = check_controller("reference", poor, LAW, draws=5, **GENEROUS).not_known
    assert "an error that had to be allowed for" in why
    assert "0.8" not in why


def test_axes_that_were_not_commissioned_are_not_known():
    document = result()
    only = saved_planes(document | {"planes": {"x": document["planes"]["x"]}}, SHEET)
    found = check_controller("reference", only, LAW, **GENEROUS)
    assert found.verdict == "not known"
    (why,) = found.not_known
    assert "no model of yA, yB" in why


def test_a_rig_of_one_plane_has_no_further_axes():
    document = result()
    sheet = sheet_of_one_plane(SHEET)
    only = saved_planes(document | {"planes": {"x": document["planes"]["x"]}}, sheet)
    assert check_controller("reference", only, LAW, **GENEROUS).safe


def test_an_unstable_loop_is_told_with_its_motion(planes):
    found = check_controller("reference", planes, scaled(0.4))
    assert not found.safe
    assert not found.stable
    assert found.stable_share == 0.0
    assert "leaves its place" in found.reasons[0]
    ringing = check_controller("reference", planes, scaled(20.0))
    assert "Hz, growing" in ringing.reasons[0]


def test_a_controller_near_the_limit_is_unsafe_when_models_that_fit_as_well_are_unstable(planes):
    low, high = 0.45, 0.6  # unstable, stable
    for _ in range(30):
        middle = 0.5 * (low + high)
        stable = all(slowest_decay(closed_loop_poles(s.model, scaled(middle)), 1e-4) > 0 for s in planes.values())
        low, high = (low, middle) if stable else (middle, high)
    wide = {p: replace(s, covariance=25 * s.covariance) for p, s in planes.items()}
    found = check_controller("reference", wide, scaled(high * 1.0001))
    assert found.stable
    assert 0 < found.stable_share < 1
    assert not found.safe
    assert any("data allow" in r for r in found.reasons)


def test_more_uncertainty_makes_wider_intervals(planes):
    wide = {p: replace(s, covariance=9 * s.covariance) for p, s in planes.items()}
    usual, more = (check_controller("r", x, LAW, draws=60).axes[0].phase_margin_deg for x in (planes, wide))
    assert (more.high - more.low) > 2 * (usual.high - usual.low)


def test_a_plain_gain_and_a_dead_controller_are_judged_too(planes):
    assert not check_controller("r", planes, SOFT, draws=5).stable
    assert not check_controller("r", planes, (np.zeros(1), np.ones(1)), draws=5).stable


@pytest.mark.parametrize(
    ("law", "period", "words"),
    [
        ((np.array([1.0, 2.0]), np.array([1.0])), None, "not causal"),
        ((np.array([1.0]), np.array([0.0, 1.0])), None, "denominator"),
        ((np.array([np.nan]), np.array([1.0])), None, "not finite"),
        (LAW, 5e-5, "discretise"),
    ],
)
def test_what_is_no_controller_of_this_rig_is_refused(planes, law, period, words):
    with pytest.raises(AmbError, match=words):
        check_controller("r", planes, law, period)


def test_a_zone_that_is_not_in_the_table_is_refused(planes):
    with pytest.raises(AmbError, match="zone 'E'"):
        check_controller("r", planes, LAW, accepted_zone="E")
    for wrong in ("A=9,B=8,C", "A=9", "A=x,B", "A=9,A", ""):
        with pytest.raises(AmbError, match="zones"):
            zone_table(wrong)


def test_predicted_against_measured_closed_loop_in_percent():
    truth = {p: plane_model_of(reference_rig(), p) for p in "xy"}
    f = np.geomspace(12, 990, 60)
    sweep = synthetic_sweep(truth, AXES, LAW, f, 1e-3, seed=3, current_noise_a=1e-9, displacement_noise_m=1e-15)
    points = plane_points(sweep, AXES, "x")
    right = predicted_closed_loop(truth["x"], LAW, points)
    assert right is not None
    assert min(right.u_percent.min(), right.y_percent.min()) > 99.9
    theta = truth["x"].theta.copy()
    theta[0] *= 0.9
    wrong = predicted_closed_loop(truth["x"].at(theta), LAW, points)
    assert wrong is not None
    assert wrong.u_percent[0, 0] < 98


def of_axes_excited_at_once():
    """Points of one plane with the same excitation in both experiments."""
    truth = {p: plane_model_of(reference_rig(), p) for p in "xy"}
    points = plane_points(synthetic_sweep(truth, AXES, LAW, np.geomspace(12, 990, 20), 1e-3, seed=3), AXES, "x")
    return truth["x"], replace(points, R=np.ones_like(points.R))


CALLERS = {
    predicted: lambda model, points: predicted.predicted_closed_loop(model, LAW, points),
    margins: lambda _, points: margins.measured_sensitivity(points),
}
callers = pytest.mark.parametrize(("module", "ask"), CALLERS.items(), ids=lambda x: getattr(x, "__name__", ""))


@callers
def test_axes_that_were_excited_at_once_have_no_measured_sensitivity(module, ask):
    assert ask(*of_axes_excited_at_once()) is None


@callers
@pytest.mark.parametrize("error", [ValueError("operands could not be broadcast together"), AmbError("of another kind")])
def test_any_other_error_of_a_measured_sensitivity_is_told(module, ask, error, monkeypatch):
    def failing(*_):
        raise error

    monkeypatch.setattr(module, "etfe", failing)
    with pytest.raises(type(error), match=str(error)):
        ask(*of_axes_excited_at_once())


def test_the_result_tells_the_prediction_on_the_unseen_sweep():
    fits = result()["planes"]["x"]["margins"]["closed_loop_fit_percent"]
    assert np.array(fits["r_to_u"]).shape == (2, 2)
    assert np.min(fits["r_to_y"]) > 99


def test_a_controller_that_computes_longer_is_judged_with_its_delay(planes):
    """As the time simulation does, which refuses a rig that it does not hold."""
    rig = reference_rig()
    held, lost = 0.0, 2e-4
    for _ in range(8):
        delay = 0.5 * (held + lost)
        try:
            Simulation(replace(rig, controller=replace(rig.controller, computing_delay_s=delay)))
            held = delay
        except LevitationError:
            lost = delay
    found = {d: check_controller("r", planes, LAW, draws=5, computing_delay_s=d) for d in (0.9 * held, 1.1 * lost)}
    assert [c.stable for c in found.values()] == [True, False]
    plain, same = (check_controller("r", planes, LAW, draws=5, computing_delay_s=d) for d in (None, 0.0))
    assert plain == same
    assert plain.delay_of_both_axes_s["x"] == pytest.approx(held, rel=0.1)
    assert min(a.delay_margin_s.value for a in plain.axes) > plain.delay_of_both_axes_s["x"], "each alone bears more"
    assert plain.axes[0].sensitivity_peak.value < found[0.9 * held].axes[0].sensitivity_peak.value
    with pytest.raises(AmbError, match="cannot compute for -1 us"):
        check_controller("r", planes, LAW, computing_delay_s=-1e-6)


@pytest.mark.parametrize(
    ("value", "others", "none", "ends"),
    [
        (None, [5.0] * 60 + [None] * 40, np.inf, (5.0, None)),
        (None, [-3.0] * 60 + [None] * 40, -np.inf, (None, -3.0)),
        (None, [None] * 100, np.inf, (None, None)),
        (6.0, [5.0] * 60 + [None] * 40, np.inf, (5.0, None)),
        (-6.0, [-5.0] * 60 + [None] * 40, -np.inf, (None, -5.0)),
        (6.0, [], np.inf, (None, None)),
    ],
)
def test_a_margin_that_only_other_models_have_is_not_said_to_be_unbounded(value, others, none, ends):
    found = interval(value, others, none)
    assert (found.value, found.low, found.high) == (value, *ends)


def test_without_a_model_of_the_turning_rotor_nothing_is_known_at_speed(planes):
    generous = check_controller("reference", planes, LAW, zones=zone_table("ok=20,bad"), accepted_zone="ok")
    assert generous.at_speed is None
    assert generous.document()["at_speed"] is None
    (warning,) = [w for w in generous.warnings if "at speed" in w]
    assert "ISO 14839-3" in warning
    assert "not known" in warning
