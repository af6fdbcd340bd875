"""A check on the rig in time: what changed is named, what did not change is left alone."""

import math
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from service.errors import DocumentError
from service.experiment.data import Experiment
from service.health.compare import REPRODUCIBILITY, Baseline, _unexplained, compare, other_speed
from service.health.monitored import Monitored
from service.health.noise import check_weights
from service.health.result import FigureChange
from service.health.sequential import Policy
from service.health.trend import Checked
from service.health.words import drifted_words
from service.health.zones import zone_is_calm
from service.identification.loop.margins import zone_table
from service.identification.measured.noise import ESTIMATED_WEIGHTS
from service.identification.measured.points import plane_points
from service.identification.plane.zoh import discrete_response
from service.identification.result.saved import saved_planes
from service.output import json_text
from service.report.health import health_page
from sim.errors import AmbError
from sim.reference import pid_with_biquad, reference_rig
from sim.twin import with_effects
from tests.support.commissioned import AXES, LAW, SHEET, check, plan, result, with_magnets, with_mode
from tests.support.planes import plane_model_of, synthetic_experiment, synthetic_sweep


@pytest.fixture(scope="module")
def unchanged() -> Experiment:
    return check(reference_rig())


@cache
def changed() -> Experiment:
    return check(with_magnets(ki=0.95))


def checked(experiment: Experiment, **options):
    return compare(Baseline(result()), experiment, SHEET, **options)


def test_a_rig_that_did_not_change_raises_no_alarm(unchanged):
    found = checked(unchanged)
    assert not found.alarm
    assert found.drifted == ()
    significance = np.array([c.significance for c in found.changes])
    # calibrated: as large as standard normal numbers are, neither all small nor any huge
    assert 0.4 < np.sqrt(np.mean(significance**2)) < 1.6
    assert np.abs(significance).max() < 4.0
    assert all(0.7 < p.rms_over_sigma < 1.3 for p in found.planes)


def test_a_check_takes_a_tenth_of_a_commissioning(unchanged):
    assert float(unchanged.attributes["rig_seconds"]) < 100.0


@pytest.mark.parametrize("told", ["80 s", "nan", "inf"])
def test_a_time_on_the_rig_that_is_no_number_is_not_known(unchanged, told):
    found = checked(replace(unchanged, attributes={"rig_seconds": told})).document()
    assert found["rig_seconds"] is None
    json_text(found)


def test_five_percent_less_ki_are_an_alarm_that_names_ki():
    found = checked(changed())
    assert found.alarm
    assert set(found.drifted) == {"x.kiA", "x.kiB", "y.kiA", "y.kiB"}
    for c in found.changes:
        if c.monitored.name.startswith("ki"):
            assert c.change_percent == pytest.approx(-5.0, abs=4 * c.std_percent)
    assert "force-current factor" in found.sentence()


def test_one_magnet_of_one_bearing_is_told_from_the_others():
    found = checked(check(with_magnets(ks=1.03, axes=[3])))
    assert found.drifted == ("y.ksB",)


def test_damping_that_doubles_is_named():
    found = checked(check(with_mode(0, damping=2.0)))
    assert set(found.drifted) == {"x.zeta1", "y.zeta1"}
    by_id = {c.monitored.id: c for c in found.changes}
    assert by_id["x.zeta1"].change_percent == pytest.approx(100.0, abs=3.0)


def test_a_mode_that_moved_by_many_of_its_widths_is_found():
    found = checked(check(with_mode(1, frequency=1.01)))
    assert set(found.drifted) == {"x.wn2", "y.wn2"}
    by_id = {c.monitored.id: c for c in found.changes}
    assert by_id["y.wn2"].change_percent == pytest.approx(1.0, abs=0.01)


def test_a_change_is_no_surer_than_two_campaigns_on_one_rig_agree(unchanged):
    """However little noise there is: what was let pass of transients is in each."""
    for c in checked(unchanged).changes:
        noise = math.hypot(c.std_was, c.std_now)
        assert c.std_change == pytest.approx(math.hypot(noise, REPRODUCIBILITY[c.monitored.kind] * abs(c.was)))
        assert c.reproducibility > 0


def test_a_baseline_of_few_data_asks_for_larger_changes(unchanged):
    """Its deviations are less sure, so the tails of what chance makes of them are longer."""
    few = [{"chosen": True, "data": 80, "parameters": 45}]
    planes = result()["planes"]
    document = {**result(), "planes": {**planes, "x": {**planes["x"], "mode_evidence": few}}}
    found = compare(Baseline(document), unchanged, SHEET)
    x, y = (next(c for c in found.changes if c.monitored.plane == p) for p in "xy")
    assert x.threshold > 1.1 * y.threshold


@pytest.mark.parametrize(("beyond", "unexplained"), [(0.97, False), (1.03, True)])
def test_residuals_are_unexplained_as_soon_as_chance_hardly_makes_them(beyond, unexplained):
    level, freedom = 1e-4, 100
    rms = math.sqrt(ESTIMATED_WEIGHTS * chi2.isf(level, freedom) / freedom)
    saved, now = SimpleNamespace(rms_over_sigma=0.9), SimpleNamespace(rms=beyond * rms, freedom=freedom)
    assert _unexplained(saved, now, level) is unexplained


def test_what_leaks_at_the_borders_of_blocks_costs_a_point_little_of_its_weight(unchanged):
    """It cancels in the mean of the blocks, but for the first and the last: of six blocks a sixth of it counts."""
    saved = saved_planes(result(), SHEET)["x"]
    points = plane_points(unchanged.main, tuple(unchanged.axes), "x")
    tone = np.isclose(points.omega, np.unique(points.omega)[5])
    signs = np.array([1, -1] * (points.n_blocks // 2))
    scatter = np.var(points.Y, axis=1, ddof=1).mean(axis=1)
    louder = points.Y.copy()
    louder[tone] += signs[:, None] * np.sqrt(100 * scatter[tone])[:, None, None]
    assert not points.suspect[tone].any()
    before, after = (
        {(k, j): w for k, j, w in check_weights(saved.model, p, unchanged).plant.entries}
        for p in (points, replace(points, Y=louder))
    )
    for channel in (2, 3):
        falls = np.abs(before[channel, channel][tone] / after[channel, channel][tone]) ** 2
        assert np.all(falls > 5)
        assert np.all(falls < 35)


def with_law(**settings: float) -> Experiment:
    """A check's tones on the rig as it was commissioned, but for settings of its controller."""
    models = {p: plane_model_of(reference_rig(), p) for p in "xy"}
    tones = np.array(plan().profile.frequencies_hz)
    noise = {"current_noise_a": 1e-6, "displacement_noise_m": 1e-12, "relative_noise": 1e-4}
    sweep = synthetic_sweep(models, AXES, pid_with_biquad(**settings), tones, 0.05, seed=3, **noise)
    return synthetic_experiment(sweep, axes=AXES, rig="reference")


EVERY_LAW = {f"{p}.controller_{axis}" for p in "xy" for axis in "AB"}


@pytest.mark.parametrize(
    "settings", [{"proportional_a_per_m": 26e3}, {"derivative_as_per_m": 40.0}, {"notch_hz": 850.0}], ids=str
)
def test_a_controller_that_was_changed_is_an_alarm_and_its_margins_are_not_the_old_ones(settings):
    """Rotor, magnets and amplifiers are as they were, so no figure of theirs shows it; the loop is another one."""
    found = checked(with_law(**settings))
    assert found.alarm
    assert set(found.drifted) == EVERY_LAW
    assert found.zone == "not known" or found.zone == "D"
    assert "the controller of xA, xB, yA, yB is not the one of the commissioning" in found.sentence()
    assert "sensitivity peak not known" in found.sentence()
    document = found.document()
    assert not zone_is_calm(document)
    assert not any("sensitivity_peak" in name for name in document["parameters"])
    for peak in document["sensitivity_peak"].values():
        assert (peak["value"], peak["zone"]) == (None, "not known")
        assert peak["measured"] > 1.0
    assert drifted_words(document)[0] == "the controller of xA is not the one of the commissioning"
    page = health_page(document, [Checked(datetime(2026, 1, 1, tzinfo=UTC), document)])
    assert "tells nothing where another one ran" in page


def test_a_controller_that_was_left_alone_is_no_alarm(unchanged):
    """Nor is what the starts of tones leave in u - r + C y."""
    for experiment in (unchanged, with_law()):
        found = checked(experiment)
        assert not found.alarm
        for law in found.document()["controller"].values():
            assert not law["differs"]
            assert law["difference_percent"] < 0.1


def test_the_controller_of_one_axis_leaves_no_margin_of_its_plane():
    """The other axis' loop is closed by it."""
    measured = with_law()
    main = measured.main
    u = main.U.copy()
    u[main.axis == 1, :, :, 1] *= 1.02
    found = checked(replace(measured, sweeps=(replace(main, U=u),)))
    assert "x.controller_B" in found.drifted
    assert not EVERY_LAW & set(found.drifted) - {"x.controller_B"}
    assert [bool(p.sensitivity_peaks) for p in found.planes] == [False, True]
    assert found.zone == "not known" or found.zone == "D"


def with_one_loud_point(measured: Experiment, flag: str) -> Experiment:
    """A tone at which u is seven times what it was, and y what the controller makes that of, with its flag."""
    main = measured.main
    (at,) = np.flatnonzero((main.axis == 0) & (main.frequency_hz == np.unique(main.frequency_hz)[4]))
    u, y = main.U.copy(), main.Y.copy()
    c = discrete_response(*LAW, 2 * np.pi * main.frequency_hz[[at]], SHEET.sample_time_s)[0]
    u[at] *= 7
    y[at] = (main.R[at] - u[at]) / c
    flags = ["" for _ in main.frequency_hz]
    flags[at] = flag
    return replace(measured, sweeps=(replace(main, U=u, Y=y, flags=tuple(flags)), *measured.sweeps[1:]))


def test_a_point_that_had_not_settled_moves_no_zone():
    calm, loud = with_law(), with_one_loud_point(with_law(), "not settled")
    assert checked(loud).zone == checked(calm).zone
    assert checked(loud).planes[0].measured_peak == pytest.approx(checked(calm).planes[0].measured_peak, rel=0.05)


def test_a_measured_peak_counts_where_it_is_above_the_models_beyond_its_noise():
    """What the largest of some lines has of noise is no peak of the loop; what no model has, is."""
    found = checked(with_law())
    peak = max(c.now for p in found.planes for c in p.sensitivity_peaks.values())
    assert found.peak == peak
    x, y = found.planes
    assert replace(found, planes=(replace(x, measured_peak=(99.0, 99.0)), y)).peak == peak
    above = replace(found, planes=(replace(x, measured_above=(99.0,)), y))
    assert (above.peak, above.zone) == (99.0, "D")


def test_axes_that_were_not_commissioned_are_told(unchanged):
    """Nothing of them is known, so that nothing drifted is no word on the rig."""
    only = {**result(), "planes": {"x": result()["planes"]["x"]}}
    found = compare(Baseline(only), unchanged, SHEET)
    assert "nothing drifted; yA, yB not checked, as no model has them" in found.sentence()
    assert "no model of yA, yB" in found.notes[0]
    assert found.document()["axes_without_model"] == ["yA", "yB"]
    assert checked(unchanged).document()["axes_without_model"] == []


def test_what_no_parameter_explains_is_said(unchanged):
    main = unchanged.main
    # one channel of one axis answers 3 % less at every other frequency, as no magnet, mode or amplifier does
    odd = np.searchsorted(np.unique(main.frequency_hz), main.frequency_hz) % 2 == 1
    y = main.Y.copy()
    y[odd, :, :, 0] *= 0.97
    broken = replace(unchanged, sweeps=(replace(main, Y=y), *unchanged.sweeps[1:]))
    found = checked(broken)
    assert "x.unexplained" in found.drifted
    assert "y.unexplained" not in found.drifted


def test_the_document_has_what_the_service_shows(unchanged):
    document = checked(unchanged, tests_made=7).document()
    assert (document["format"], document["version"], document["rig"]) == ("amb-health-check", 1, SHEET.name)
    assert document["alarm"] is False
    assert document["drifted"] == []
    ki = document["parameters"]["x.kiA"]
    assert ki["now"]["value"] == pytest.approx(181.0, rel=0.01)
    assert ki["baseline"]["std"] < ki["now"]["std"]
    assert {"change_percent", "significance", "p_value", "threshold"} <= ki.keys()
    assert document["tests_made"] == 7
    assert document["zone"] in "ABCD"
    assert set(document["sensitivity_peak"]) == set(SHEET.axes)
    low, high = document["sensitivity_peak"]["xA"]["interval_95"]
    assert low < 4.2308 < high  # the true peak of the sampled loop, sim.twin


def test_the_table_of_zones_is_the_users(unchanged):
    found = checked(unchanged)
    assert found.zone == "D"
    assert "zone D of ISO 14839-3" in found.sentence()
    own = compare(Baseline(result()), unchanged, replace(SHEET, sensitivity_zones_db=zone_table("fine=20,bad")))
    assert own.zone == "fine"
    assert "zone fine of the rig's own table" in own.sentence()
    assert own.document()["zone_limits_db"] == {"fine": 20.0}


def test_fewer_false_alarms_ask_for_larger_changes(unchanged):
    strict, loose = (checked(unchanged, policy=Policy(p)).changes[0].threshold for p in (0.001, 1.0))
    assert strict > loose > 3.5


def test_what_cannot_be_compared_is_refused_in_one_line(unchanged):
    with pytest.raises(DocumentError, match=r"result\.json"):
        Baseline({"format": "amb-gap-report", "version": 1})
    with pytest.raises(AmbError, match="axes"):
        checked(replace(unchanged, axes=("xA", "xB")))
    old = {**result(), "planes": {p: {**d, "parameters": None} for p, d in result()["planes"].items()}}
    with pytest.raises(AmbError, match="identify"):
        compare(Baseline(old), unchanged, SHEET)
    with pytest.raises(AmbError, match="incomplete"):
        compare(Baseline({**result(), "planes": {"x": {"parameters": {}}}}), unchanged, SHEET)
    few = unchanged.main.select(unchanged.main.frequency_hz > 900)
    with pytest.raises(AmbError, match="at least"):
        checked(replace(unchanged, sweeps=(few,)))
    deaf = replace(unchanged.main, Y=unchanged.main.Y * np.array([1, 0, 1, 1]))
    with pytest.raises(AmbError, match="y of xB reads 0 m"):
        checked(replace(unchanged, sweeps=(deaf,)))
    with pytest.raises(AmbError, match="no excited tone"):
        checked(replace(unchanged, sweeps=tuple(s for s in unchanged.sweeps if s.kind == "noise")))


def test_a_loop_that_nearly_touches_minus_one_is_an_alarm_however_uncertain_its_peak() -> None:
    """A peak of 128 that may as well be 60 or without end is none of 5."""
    peak = Monitored("x", "sensitivity_peak_A", "1", "margin", "sensitivity peak of xA")
    change = FigureChange(peak, was=5.1, std_was=0.05, now=128.0, std_now=336.0, p_value=0.0, threshold=4.5)
    assert change.drifted
    small = FigureChange(peak, was=5.1, std_was=0.05, now=5.3, std_now=0.05, p_value=0.0, threshold=4.5)
    assert not small.drifted
    assert small.significance == pytest.approx((5.3 - 5.1) / math.hypot(0.05, 0.05), rel=0.05)


def test_a_log_that_is_a_sample_early_is_put_in_step_as_that_of_the_commissioning_is() -> None:
    found = checked(check(with_effects(reference_rig(), {"logging_offset": {"samples": 1.0}})))
    assert not found.alarm
    assert any("sample" in note for note in found.notes)


def at_speed(experiment: Experiment, speed_rad_s: float) -> Experiment:
    return replace(experiment, sweeps=tuple(replace(s, speed_rad_s=speed_rad_s) for s in experiment.sweeps))


def test_a_check_at_another_speed_than_the_commissionings_says_so():
    assert result()["speed_rad_s"] == 0.0
    found = compare(Baseline(result()), at_speed(changed(), 300.0), SHEET)
    assert found.alarm
    document = found.document()
    assert (document["speed_rad_s"], document["baseline_speed_rad_s"]) == (300.0, 0.0)
    for text in (document["notes"][0], document["sentence"]):
        assert "checked at 300 rad/s and commissioned at 0 rad/s" in text
    alike = compare(Baseline(result()), changed(), SHEET)
    assert alike.notes == ()
    assert "rad/s" not in alike.sentence()


@pytest.mark.parametrize(
    ("was_at", "is_at", "told"),
    [
        (300.0, 0.0, "checked at 0 rad/s and commissioned at 300 rad/s"),
        (None, 300.0, "checked at 300 rad/s and commissioned at a speed that its result does not tell"),
        (None, 0.0, ""),
        (-300.0, 301.0, ""),
    ],
)
def test_results_that_tell_no_speed_and_speeds_that_are_nearly_one(was_at, is_at, told):
    document = {**result(), "speed_rad_s": was_at}
    if was_at is None:  # an older version's
        del document["speed_rad_s"]
    said = other_speed(Baseline(document).speed_rad_s, is_at)
    assert bool(said) == bool(told)
    assert told in said


def test_without_currents_a_change_of_ki_is_seen_with_the_amplifiers_as_they_were() -> None:
    measured = changed()
    blind = replace(measured, sweeps=tuple(replace(s, I=None) for s in measured.sweeps))
    found = checked(blind)
    assert set(found.drifted) >= {"x.kiA", "x.kiB", "y.kiA", "y.kiB"}
    assert any("currents are not logged" in note for note in found.notes)
