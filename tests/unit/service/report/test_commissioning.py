"""The report of a commissioning says what was found, whatever the experiment lacked."""

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest

from service.identification.fit import identify
from service.identification.priors.given import Adjusted
from service.report.commissioning import commissioning_page, verdict
from service.report.format import figures
from tests.support.browser import BROWSER
from tests.support.tab import tab

needs_browser = pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")

LARGEST_BYTES = 6_000_000


def names(page: str) -> set[str]:
    return set(re.findall(r'<div class="plot" id="([^"]+)"', page))


def figure(page: str, name: str) -> dict:
    data = re.search(rf'id="{name}-data">(.*?)</script>', page, flags=re.S)
    assert data is not None, name
    return json.loads(data[1])


@pytest.fixture(scope="module")
def page(result, measured):
    return commissioning_page(result, *measured)


def test_the_first_sentence_says_the_result(page, result):
    lead = re.search(r'<p class="lead [a-z]+">(.*?)</p>', page)
    assert lead is not None
    assert "identified" in lead[1]
    assert "NRMSE" in lead[1]
    assert "ISO 14839-3" in lead[1]


def test_every_figure_of_merit_is_in_the_tables(page, result):
    for plane in result.planes.values():
        for estimate in plane.stiffness.values():
            value, std = figures(estimate.value, estimate.std)
            assert f">{value}<" in page
            assert f">{std}<" in page
        for mode in plane.modes:
            assert f">{figures(mode.natural_frequency_rad_s.value, mode.natural_frequency_rad_s.std)[0]}<" in page


def test_a_sweep_is_named_as_on_the_terminal(page):
    assert ">main sweep<" in page
    assert ">unseen sweep<" in page


def test_every_figure_is_there(page):
    expected = {"amplitudes"}
    for plane in "xy":
        expected |= {f"plant-{plane}A", f"plant-{plane}B"}
        expected |= {
            f"{kind}-{plane}" for kind in ("amplifier", "staged", "sensitivity", "poles", "residuals", "correlations")
        }
    assert names(page) == expected


def test_it_can_be_mailed(page):
    assert len(page.encode()) < LARGEST_BYTES


def test_the_plant_shows_measured_points_model_region_and_unseen_sweep(page):
    shown = {t["name"] for t in figure(page, "plant-xA")["data"]}
    assert shown == {"measured", "model", "99 % region", "unseen sweep", "99 % of the noise"}


def test_both_orders_of_the_amplifier_are_shown(page):
    shown = {t["name"] for t in figure(page, "amplifier-x")["data"]}
    assert {"first order", "second order, chosen"} <= shown


def test_a_wrong_model_is_not_called_identified(result):
    planes = {k: replace(p, adequate=False, residual_rms_total=12.3) for k, p in result.planes.items()}
    tone, text = verdict(replace(result, planes=planes))
    assert tone != "good"
    assert "identified" not in text
    assert "12 times the noise" in text


def test_a_model_that_does_not_hold_on_the_unseen_sweep_is_no_good_news(result):
    """However well it describes what it was fitted to, and however small the share of the signal that is wrong."""
    own = (("fine", 40.0), ("bad", math.inf))
    planes = {k: replace(p, zones_db=own, tests_passed=True) for k, p in result.planes.items()}
    assert verdict(replace(result, planes=planes))[0] == "good"
    tone, text = verdict(replace(result, planes=planes | {"x": replace(planes["x"], off_unseen=28.7)}))
    assert tone == "warn"
    assert "On the unseen sweep the residuals are up to 29 times the noise" in text


@pytest.mark.parametrize(("off", "tone"), [(1.2, "good"), (-4.1, "warn")])
def test_a_value_beyond_its_tolerance_is_no_good_news(result, off, tone):
    """Then nobody knows which of them is wrong: of the mass, ki and ks in proportion with it."""
    own = (("fine", 40.0), ("bad", math.inf))
    planes = {k: replace(p, zones_db=own, tests_passed=True) for k, p in result.planes.items()}
    held = (Adjusted("transverse_inertia_kgm2", 10.87 * (1 + 0.01 * off), 0.01, 10.87, 0.1087),)
    found, text = verdict(replace(result, planes=planes, adjusted=held))
    assert found == tone
    assert ("The transverse inertia is 4.1 tolerances from the datasheet's value" in text) == (tone == "warn")


def test_margins_of_a_controller_that_did_not_run_are_no_good_news(result):
    own = (("fine", 40.0), ("bad", math.inf))
    planes = {k: replace(p, zones_db=own, tests_passed=True) for k, p in result.planes.items()}
    told = replace(result, planes=planes)
    assert verdict(told)[0] == "good"
    tone, text = verdict(replace(told, controller_differs=True))
    assert tone == "warn"
    assert "does not hold the control law of the datasheet" in text
    assert told.document()["controller_as_stated"]
    assert not replace(told, controller_differs=True).document()["controller_as_stated"]


def test_deviations_are_told_as_what_they_are(page, result, measured):
    """A few parts in a million of ki, where a sensor's gain is known to a per cent."""
    with_these = "(one sigma) with the datasheet's mass, geometry and sensor gains"
    assert with_these in verdict(result)[1]
    assert "standard deviations are those with these given" in page
    held = replace(result, adjusted=(Adjusted("mass_kg", 280.7, 0.6, 280.0, 1.4),))
    assert with_these not in verdict(held)[1]
    assert "standard deviations are those with these given" not in commissioning_page(held, *measured)


def test_large_residuals_are_told_without_an_exponent(result):
    planes = {k: replace(p, adequate=False, residual_rms_total=313.2) for k, p in result.planes.items()}
    assert "the residuals are 313 times the noise" in verdict(replace(result, planes=planes))[1]


def test_a_model_with_an_error_that_had_to_be_allowed_for_is_not_told_by_residuals_below_the_noise(result):
    """Its residuals are in units of noise and that error together."""
    planes = {k: replace(p, adequate=False, residual_rms_total=0.93) for k, p in result.planes.items()}
    text = verdict(replace(result, planes=planes))[1]
    assert "does not behave as its model" in text
    assert "times the noise" not in text
    assert "error of the model that had to be allowed for" in text


@pytest.mark.slow
def test_a_rotor_of_other_distances_is_told_before_what_follows_from_it(measured):
    experiment, datasheet = measured
    a, b = datasheet.bearing_from_cog_m
    first, *others = identify(experiment, replace(datasheet, bearing_from_cog_m=(10 * a, 10 * b))).warnings
    assert "is bearing_from_cog_m in another unit" in first
    assert not any("not beside each other" in other for other in others)


@pytest.mark.slow
def test_a_wrong_model_is_not_said_to_have_converged(measured):
    """In result.json: the search converges on a wrong model, too."""
    experiment, datasheet = measured
    wrong = replace(datasheet, transverse_inertia_kgm2=2 * datasheet.transverse_inertia_kgm2)
    for plane in identify(experiment, wrong).document()["planes"].values():
        assert plane["residuals"]["model_adequate"] is False
        assert plane["status"].startswith("model not adequate: ")


def test_a_model_that_does_not_agree_with_the_data_is_not_said_to_be_identified(result):
    """However well its residuals pass: near instability noise is larger than what is measured."""
    poor = {name: replace(p, cross_validation_fit_percent=np.full((2, 2), -36.1)) for name, p in result.planes.items()}
    tone, text = verdict(replace(result, planes=poor))
    assert tone == "bad"
    assert "not identified well enough" in text
    assert "-36.10 % NRMSE only" in text


@pytest.mark.parametrize(("limit_db", "tone"), [(30.0, "good"), (3.0, "warn")])
def test_the_last_of_two_zones_of_its_own_is_no_good_news(result, limit_db, tone):
    own = (("fine", limit_db), ("bad", math.inf))
    planes = {k: replace(p, zones_db=own, tests_passed=True, adequate=True) for k, p in result.planes.items()}
    assert verdict(replace(result, planes=planes))[0] == tone


@pytest.mark.parametrize(("fit_percent", "std"), [(-1296.0, 0.01), (99.0, 3.0)])
def test_of_a_model_that_says_nothing_no_figure_is_told_in_the_sentence(result, fit_percent, std):
    """As of a displacement with the wrong sign."""
    nothing = {}
    for name, p in result.planes.items():
        unseen = np.full_like(p.cross_validation_fit_percent, fit_percent)
        stiffness = {k: replace(e, std=std * abs(e.value)) for k, e in p.stiffness.items()}
        nothing[name] = replace(p, cross_validation_fit_percent=unseen, stiffness=stiffness)
    tone, text = verdict(replace(result, planes=nothing))
    assert tone == "bad"
    assert "is not identified" in text
    assert "N/A" not in text
    assert "signs and units of the logged signals" in text
    told = replace(result, planes=nothing).document()
    assert (result.document()["identified"], told["identified"]) == (True, False)


def test_a_datasheet_is_off_by_no_share_of_what_may_be_zero(measured, result):
    """A stiffness at the end of its range: percent of nothing have fifteen digits."""
    planes = {}
    for name, p in result.planes.items():
        tiny = replace(p.stiffness["ksB"], value=4e-7, std=19000.0)
        planes[name] = replace(p, stiffness=p.stiffness | {"ksB": tiny})
    nothing = replace(result, planes=planes)
    of_ks = nothing.document()["planes"]["x"]["stiffness"]
    assert (of_ks["ksA"]["error_percent"] > 30, of_ks["ksB"]["error_percent"]) == (True, None)
    row = re.search(r"ks xB, N/m.*?</tr>", commissioning_page(nothing, *measured), flags=re.S)
    assert row is not None
    assert row[0].endswith(">–</td></tr>")


def test_zones_of_the_datasheet_are_those_of_the_verdict_and_the_plots(measured, result):
    experiment, datasheet = measured
    own = (("fine", 40.0), ("bad", math.inf))
    planes = {k: replace(p, zones_db=own) for k, p in result.planes.items()}
    page = commissioning_page(replace(result, planes=planes), experiment, datasheet)
    assert "zone fine of the rig" in page
    assert all(p.document()["margins"]["iso_14839_3_zone"] == "fine" for p in planes.values())
    assert all(p.document()["margins"]["zone_limits_db"] == {"fine": 40.0} for p in planes.values())


def test_without_an_unseen_sweep_the_sentence_says_so(result):
    planes = {k: replace(p, cross_validation_fit_percent=None) for k, p in result.planes.items()}
    assert "fitted to" in verdict(replace(result, planes=planes))[1]


def test_one_sweep_without_currents_in_two_axes(measured):
    experiment, datasheet = measured
    keep = experiment.sweeps[0].axis < 2
    main = experiment.sweeps[0].select(keep)
    two = replace(main, I=None, R=main.R[..., :2], U=main.U[..., :2], Y=main.Y[..., :2])
    small = replace(experiment, axes=("xA", "xB"), sweeps=(two,))
    per_axis = {
        k: v[:2]
        for k, v in vars(datasheet).items()
        if isinstance(v, tuple) and len(v) == 4 and k not in ("numerator", "denominator", "sensitivity_zones_db")
    }
    sheet = replace(datasheet, **per_axis)
    page = commissioning_page(identify(small, sheet), small, sheet)
    assert names(page) == {
        "plant-xA", "plant-xB", "staged-x", "sensitivity-x", "poles-x", "residuals-x", "correlations-x", "amplitudes",
    }  # fmt: skip
    assert "fitted to" in page


@pytest.mark.parametrize(
    ("computing_s", "beside"),
    [(0.0, "the hold"), (60e-6, "the hold and the 60 µs of computing that the datasheet states")],
)
def test_a_delay_is_told_with_what_it_comes_on_top_of(result, measured, computing_s, beside):
    """The identified delay is what the datasheet's computing delay leaves."""
    experiment, datasheet = measured
    planes = {
        name: replace(
            p,
            model=replace(p.model, known=replace(p.model.known, computing_delay_s=computing_s)),
            delay_s=replace(p.delay_s, value=12.34e-6, std=0.56e-6),
        )
        for name, p in result.planes.items()
    }
    page = commissioning_page(
        replace(result, planes=planes), experiment, replace(datasheet, computing_delay_s=computing_s)
    )
    assert page.count(f"between control signal and coil beside {beside}: 12.34 ± 0.56 µs.") == len(planes)


def test_marked_points_are_listed(result, measured):
    experiment, datasheet = measured
    main = experiment.sweeps[0]
    flags = ["" for _ in range(main.n_points)]
    flags[5] = "not settled; repeated at lower amplitude"
    marked = replace(experiment, sweeps=(replace(main, flags=tuple(flags)), *experiment.sweeps[1:]))
    page = commissioning_page(result, marked, datasheet)
    assert "<td>not settled</td>" in page
    assert "<td>repeated at lower amplitude</td>" in page


@pytest.mark.parametrize("told", ["1503.2 s", "nan", "inf", ""])
def test_a_time_on_the_rig_that_is_no_number_is_not_told(result, measured, told):
    experiment, datasheet = measured
    assert " in 25 min on the rig" in commissioning_page(
        result, replace(experiment, attributes={"rig_seconds": "1503.2"}), datasheet
    )
    page = commissioning_page(result, replace(experiment, attributes={"rig_seconds": told}), datasheet)
    assert "min on the rig" not in page


def test_the_time_on_the_rig_goes_to_its_sweep(result, measured):
    experiment, datasheet = measured
    ends, sweeps = 0.0, []
    for s in experiment.sweeps:
        sweeps.append(replace(s, time_s=ends + np.arange(1, s.n_points + 1) * 0.5))
        ends = float(sweeps[-1].time_s[-1])
    page = commissioning_page(result, replace(experiment, sweeps=tuple(sweeps)), datasheet)
    n = experiment.sweeps[0].n_points
    assert f">{round(n * 0.5) // 60} min {round(n * 0.5) % 60:02d} s<" in page


@needs_browser
def test_the_whole_page_is_as_wide_as_a_phone(page, tmp_path):
    file = tmp_path / "page.html"
    file.write_text(page)
    with tab() as phone:
        phone.narrow(390)
        phone.open(file.as_uri())
        phone.until("document.documentElement.dataset.drawn")
        assert phone.wide() == 390
