"""The report of a diagnosis says where, which, how far and how sure, whatever the verdict is."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from service.gap.diagnosis import Diagnosis, closures_of
from service.gap.document import gap_document
from service.gap.fitting.candidates import Candidate
from service.gap.fitting.fitted import Fit
from service.gap.loop import loop_figures
from service.gap.measured.observation import observe
from service.gap.weighing.ranking import Ranked
from service.gap.weighing.shrinkage import relative_gap, relative_noise, shrinkage
from service.gap.weighing.verdict import Verdict
from service.gap.where.dependence import Dependence
from service.gap.where.where import PathGap, Where
from service.report.gap import gap_page
from service.report.gap_figures import candidate_figure
from sim.effects import CATALOGUE, effect
from sim.reference import reference_rig
from tests.support.browser import BROWSER
from tests.support.planes import plane_model_of, synthetic_sweep
from tests.support.tab import tab

needs_browser = pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")

DELAY_S = 40e-6


def candidate(rig, *effects, values=(), ends=None) -> Candidate:
    fit = Fit(effects, np.zeros(1), tuple(values), rig, ((1.0, 10),), 0.0, np.arange(1), np.eye(1), "converged")
    fit = replace(fit, ends=ends or {})
    return Candidate(effects, fit, 0.0, tuple({k: 0.01 * v for k, v in value.items()} for value in values))


@pytest.fixture(scope="module")
def diagnosis() -> Diagnosis:
    """A rig with a delay that its twin lacks, and a diagnosis that says so."""
    twin = reference_rig()
    rig = effect("loop_delay").on(twin, delay_s=DELAY_S)
    models = {plane: plane_model_of(rig, plane) for plane in "xy"}
    controller = (rig.controller.numerator, rig.controller.denominator)
    hz = np.geomspace(10, 950, 24)
    main, other = (
        observe(synthetic_sweep(models, rig.axes, controller, f, a, seed=3), twin)
        for f, a in ((hz, 0.1), (hz * 1.02, 0.2))
    )
    found = {"delay_s": DELAY_S}
    order = (
        Ranked(candidate(rig, "loop_delay", values=(found,)), -10.0, 0.9, 0.0),
        Ranked(candidate(rig, "sensor_lag", values=({"time_constant_s": 3e-5, "delay_s": 1e-7},)), -13.0, 0.1, 0.01),
        Ranked(candidate(twin), -900.0, 0.0, 1.0),
    )
    where = Where(
        (PathGap("controller", 0.0, 0.3), PathGap("amplifier", 0.04, 22.0), PathGap("plant", 0.001, 0.5)),
        ((10.0, 100.0, 0.01, 6.0), (100.0, 950.0, 0.1, 20.0)),
        (("xA", "xA", 0.04, 22.0),),
        (("i", 2, 0.4), ("y", 3, 7.5)),
        Dependence(amplitude=False, speed=None),
        "amplifier",
        "amplifier",
    )
    return Diagnosis(
        rig="reference",
        where=where,
        order=order,
        verdict=Verdict("effect", ("loop_delay",), (("loop_delay", "sensor_lag"),), 0.9, ()),
        shrinkage=shrinkage(twin, rig, other, "sweeps/1"),
        closures={("loop_delay",): 0.999, ("sensor_lag",): 0.93, (): 0.0},
        gap_before=relative_gap(twin, other),
        noise_floor=relative_noise(other, 4),
        gaps_after={("loop_delay",): relative_gap(rig, other)},
        observation=main,
        held_out=other,
        loop=loop_figures(twin, rig, other),
        next_experiment={
            "separates": ["loop_delay", "sensor_lag"],
            "experiment": "wide_band",
            "description": "each axis from 1 kHz up to 3 kHz",
            "distance_sd": 14.2,
            "odds_of_telling_apart": 0.99,
            "tones": [{"axis": "xA", "frequency_hz": 1500.0, "amplitude_a": 0.25}],
            "by_hand": ["bring the rotor to 30 rev/s and hold it"],
            "command": "ambit submit experiment --rig reference",
            "job": {"kind": "experiment"},
            "alternatives": [{"experiment": "larger_amplitude", "distance_sd": 1.5}],
        },
        notes=("two sweeps only",),
    )


def lead(page: str) -> str:
    found = re.search(r'<p class="lead [a-z]+">(.*?)</p>', page)
    assert found is not None
    return found[1]


def figure(page: str, name: str) -> dict:
    data = re.search(rf'id="{name}-data">(.*?)</script>', page, flags=re.S)
    assert data is not None, name
    return json.loads(data[1])


def test_where_which_how_far_and_how_sure_come_first(diagnosis):
    first = lead(gap_page(diagnosis))
    for word in ("amplifier", "loop delay", "90 %", "closes"):
        assert word in first


def test_a_gap_that_the_unseen_sweep_does_not_show_is_not_said_to_close_by_nothing(diagnosis):
    unseen = replace(diagnosis.shrinkage, before=0.9, closure=None, closure_95=(None, None))
    page = gap_page(replace(diagnosis, shrinkage=unseen))
    assert "the unseen sweep does not show this gap" in lead(page)
    assert "closes" not in lead(page).replace("how much of it closes", "")


def test_a_gap_that_a_few_lines_alone_show_on_unseen_data_is_not_said_to_be_hidden(diagnosis):
    unseen = replace(diagnosis.shrinkage, before=1020.0, after=127.0, closure=None, closure_95=(None, None))
    first = lead(gap_page(replace(diagnosis, shrinkage=unseen)))
    assert "a few lines alone show this gap on unseen data" in first
    assert "does not show" not in first


def test_an_effect_that_makes_unseen_data_worse_is_not_said_to_close_a_negative_share(diagnosis):
    worse = replace(diagnosis.shrinkage, before=36.9, after=40.8, closure=-0.11, closure_95=(-0.2, 0.0))
    first = lead(gap_page(replace(diagnosis, shrinkage=worse)))
    assert "which closes nothing of the gap on unseen data: it is 11 % larger there" in first
    assert "-11" not in first


def test_a_gap_below_the_noise_has_a_reason_beside_it(diagnosis):
    """The floor holds an error that any twin is allowed, so one that is right may come nearer."""
    page = gap_page(replace(diagnosis, gap_before=5.7e-4, noise_floor=1.33e-3))
    figures = page.index("0.057 %"), page.index("0.133 %")
    reason = page.index("with 0.03 % of each value for what no twin gets right")
    assert max(figures) < reason < page.index('<h2 id="where">')


@pytest.mark.parametrize("kind", ["no_gap", "none_of_these"])
def test_how_sure_is_told_whatever_the_verdict(diagnosis, kind):
    assert "probability 87 %" in lead(gap_page(replace(diagnosis, verdict=Verdict(kind, (), (), 0.87, ("why",)))))


def test_closure_is_told_by_path_and_channel(diagnosis):
    s = gap_document(diagnosis)["shrinkage"]
    by_path = {p["path"]: p for p in s["paths"]}
    assert set(by_path) == {"controller", "amplifier", "plant"}
    assert by_path["amplifier"]["before"] > 2 > by_path["amplifier"]["after"]
    low, high = by_path["amplifier"]["closure_95"]
    assert low <= by_path["amplifier"]["closure"] <= high
    assert by_path["controller"]["closure"] is None, "a delay behind the log of u leaves the controller as it is"
    own = {c["output"] for c in s["channels"] if c["signal"] == "i" and c["output"] == c["input"] and c["closure"]}
    assert own == set(diagnosis.null.fit.rig.axes)
    assert "i xA from xA" in gap_page(diagnosis)


def test_the_runner_up_is_kept_whatever_adds_to_the_chosen_one(diagnosis):
    """A second effect beside the right one always fits a little better: ten such are no rivals."""
    chosen, rival, plain = diagnosis.order
    names = [e for e in CATALOGUE if e not in ("loop_delay", "sensor_lag")][:12]
    found = {"delay_s": DELAY_S}
    rig = chosen.candidate.fit.rig
    more = [replace(chosen, candidate=candidate(rig, "loop_delay", e, values=(found, {}))) for e in names]
    crowded = replace(diagnosis, order=(chosen, *more, rival, plain))
    document = gap_document(crowded)
    assert document["shrinkage"]["runner_up"]["effects"] == ["sensor_lag"]
    shown = [c["effects"] for c in document["candidates"]]
    assert shown[:2] == [["loop_delay"], ["sensor_lag"]]
    assert len(shown) == 10
    assert "runner-up, sensor lag" in gap_page(crowded)


def test_no_closure_is_told_of_what_the_fitted_data_do_not_show(diagnosis):
    chosen, lag, plain = diagnosis.order
    left_open = replace(diagnosis, order=(chosen, replace(lag, open_strength=("sensor_lag",)), plain))
    shrunk = {r.candidate.effects: replace(diagnosis.shrinkage, closure=-34.0) for r in left_open.order}
    closures = closures_of(left_open.order, shrunk, ("loop_delay",))
    assert closures == {("loop_delay",): -34.0, ("sensor_lag",): None, (): -34.0}
    gaps_after = {("loop_delay",): 0.001, ("sensor_lag",): 7.77}
    told = replace(left_open, closures=closures, gaps_after=gaps_after)
    assert [c["open_strength"] for c in gap_document(told)["candidates"]] == [[], ["sensor_lag"]]
    page = gap_page(told)
    _, closure = figure(page, "candidates")["data"]
    assert closure["text"][1] == "not shown by the fitted data"
    assert "777 %" not in page


def test_what_closes_nothing_closes_no_less_than_nothing(diagnosis):
    page = gap_page(replace(diagnosis, closures={("loop_delay",): 0.999, ("sensor_lag",): -0.0004}))
    _, closure = figure(page, "candidates")["data"]
    assert closure["text"] == ["100 %", "0 %"]
    unclosed = replace(diagnosis.shrinkage, closure=-1e-9, closure_95=(-0.0, 0.1))
    page = gap_page(replace(diagnosis, shrinkage=unclosed))
    assert "closes 0 %" in lead(page)
    assert "(95 %: 0 % to 10 %)" in page


def test_an_effect_that_a_wrong_datasheet_would_explain_is_told_as_that(diagnosis):
    verdict = replace(diagnosis.verdict, effects=("sensor_gain",), indistinguishable=())
    told = lead(gap_page(replace(diagnosis, verdict=verdict, gap_before=1e-4, noise_floor=3e-4)))
    assert "explains the rig to 0.01 %, which is noise, but only with its datasheet off" in told
    assert "sensor gain" in told
    assert "only with its datasheet off" not in lead(gap_page(replace(diagnosis, gap_before=1e-4, noise_floor=3e-4)))


def test_every_figure_is_there(diagnosis):
    page = gap_page(diagnosis)
    names = set(re.findall(r'<div class="plot" id="([^"]+)"', page))
    assert names == {
        "gap", "quotient", "residuals", "channels", "candidates", "amplitude", "harmonics", "nu-gap",
    }  # fmt: skip


def test_a_value_that_no_fit_found_has_no_deviation_but_is_told_as_given(diagnosis):
    chosen, *others = diagnosis.order
    given = replace(chosen.candidate, given=frozenset({("loop_delay", "delay_s")}))
    page = gap_page(replace(diagnosis, order=(replace(chosen, candidate=given), *others)))
    assert page.count('<td class="n">given</td>') == 1
    assert '<td class="n">given</td>' not in gap_page(diagnosis)


def test_a_value_at_the_end_of_its_range_is_told_as_that_and_no_other(diagnosis):
    assert "end of range" not in gap_page(diagnosis)
    chosen, rival, plain = diagnosis.order
    longest = next(p.high for p in CATALOGUE["loop_delay"].parameters if p.name == "delay_s")
    ends = {("loop_delay", "delay_s"): "high"}
    stopped = candidate(chosen.candidate.fit.rig, "loop_delay", values=({"delay_s": longest},), ends=ends)
    at_end = replace(diagnosis, order=(replace(chosen, candidate=stopped), rival, plain))
    document = gap_document(at_end)
    assert [c["parameters"]["delay_s"]["at_bound"] for c in document["candidates"]] == ["high", None]
    note = "delay of loop delay is at the high end of its range, where the fit had to stop: not measured"
    assert document["notes"] == ["two sweeps only", note]
    page = gap_page(at_end)
    assert note in page
    assert '<td class="n">high end of range</td>' in page


def test_the_line_across_the_harmonics_says_what_it_is(diagnosis):
    page = gap_page(diagnosis)
    layout = figure(page, "harmonics")["layout"]
    assert [s["y0"] for s in layout["shapes"]] == [5.0]
    assert [a["text"] for a in layout["annotations"]] == ["significant above 5"]
    assert "the threshold of 5 standard deviations" in page


def test_parameters_carry_unit_and_uncertainty(diagnosis):
    page = gap_page(diagnosis)
    assert ">40.00 µs<" in page
    assert ">0.40<" in page


def loop_section(page: str) -> str:
    return page.partition("What it means for the loop</h2>")[2].partition("<h2")[0]


def test_at_the_table_of_the_loop_stands_which_lines_had_not_settled(diagnosis):
    whole = loop_section(gap_page(diagnosis))
    assert whole.index("<table") < whole.index(">xA<")
    assert "settled" not in whole
    o = diagnosis.held_out
    peak = diagnosis.loop["extremes"]["sensitivity"]["xA"]["measured"]["frequency_hz"]
    worst = o.points_hz == peak
    restless = replace(o, drifting=worst, drift=np.where(worst, 1.124, 0.0))
    loop = loop_figures(diagnosis.null.fit.rig, diagnosis.chosen.fit.rig, restless)
    told = loop_section(gap_page(replace(diagnosis, loop=loop)))
    before_table = told[: told.index("<table")]
    assert f"1 line had not settled and was left out of what is measured here: at {peak:.4g} Hz" in before_table
    assert "still changed by up to 112 %" in before_table
    assert "|S| is largest there: with it its measured peak is up to" in before_table
    seen = 20 * np.log10(
        [diagnosis.loop["sensitivity_peak"]["measured"]["xA"], loop["sensitivity_peak"]["measured"]["xA"]]
    )
    assert f'<td>xA, with those that had not</td><td class="n">{seen[0]:.2f}</td>' in told
    assert f'<td>xA, lines that had settled</td><td class="n">{seen[1]:.2f}</td>' in told
    assert "1 line left out, as above" in told


def test_the_alias_class_says_what_separates_it(diagnosis):
    page = gap_page(diagnosis)
    assert "cannot tell apart: loop delay, sensor lag" in page


def test_what_fits_as_well_but_is_far_less_likely_is_not_told_as_open(diagnosis):
    chosen, lag = diagnosis.order[0], next(r for r in diagnosis.order if r.candidate.effects == ("sensor_lag",))
    behind = replace(lag, log_evidence=chosen.log_evidence - 50)
    page = gap_page(replace(diagnosis, order=(chosen, behind, diagnosis.order[-1])))
    assert "cannot tell apart" not in page
    assert "sensor lag fits about as well as loop delay but is far less likely" in page


def test_the_next_experiment_is_ready_to_submit(diagnosis):
    page = gap_page(diagnosis)
    assert "from 1 kHz up to 3 kHz" in page
    assert ">1500<" in page
    assert 0 < page.find("by hand: bring the rotor to 30 rev/s") < page.find("ambit submit experiment --rig reference")


def test_the_gap_closes_down_to_the_noise(diagnosis):
    """What the heat map shows: large in i before, noise after."""
    page = gap_page(diagnosis)
    before, after = (np.array(t["z"]) for t in figure(page, "residuals")["data"])
    assert before[4:8].max() > 1  # i, ten times the noise
    assert after[4:8].max() < 0.5


def test_nothing_to_add_shows_one_twin(diagnosis):
    twin = replace(diagnosis, verdict=Verdict("none_of_these", (), (), 0.9, ("nothing fits",)), next_experiment=None)
    page = gap_page(twin)
    assert "no known effect explains" in lead(page)
    assert {t["name"] for t in figure(page, "gap")["data"]} == {"noise floor", "twin"}
    assert len(figure(page, "residuals")["data"]) == 1
    assert "nothing fits" in page
    assert "Put right what the first sentence names" in page
    assert "Nothing is left that an experiment" not in page


@pytest.mark.parametrize(("change", "told"), [(0.4, True), (9.0, False)])
def test_what_tells_a_dependence_on_the_amplitude_is_said(diagnosis, change, told):
    """Harmonics at one amplitude do where the two sweeps do not differ."""
    where = replace(diagnosis.where, depends=Dependence(amplitude=True, speed=None, significance=change))
    page = gap_page(replace(diagnosis, where=where))
    assert f"changes by {change} standard deviations" in page
    assert ("is told by harmonics" in page) is told


def test_interference_acts_in_the_signals(diagnosis):
    named = replace(diagnosis.order[0], candidate=candidate(reference_rig(), "runout", values=({"amplitude_m": 1e-7},)))
    page = gap_page(
        replace(
            diagnosis,
            verdict=replace(diagnosis.verdict, effects=("runout",), indistinguishable=()),
            order=(named, *diagnosis.order[1:]),
        )
    )
    assert "runout acts in the signals" in page
    assert "in the additive" not in page


def test_labels_of_three_effects_have_room(diagnosis):
    rig, found = diagnosis.order[0].candidate.fit.rig, {"delay_s": DELAY_S}
    names = ("loop_delay", "magnetic_cross_coupling", "amplifier_voltage_limit")
    three = replace(diagnosis.order[0], candidate=candidate(rig, *names, values=(found, {}, {})))
    heights = [
        candidate_figure(d, gap_document(d)).layout["height"]
        for d in (diagnosis, replace(diagnosis, order=(three, *diagnosis.order[1:])))
    ]
    assert heights[1] > heights[0]


def test_without_currents_the_amplifier_has_no_panel(diagnosis):
    blind = [replace(o, I=None, sd_i=np.full_like(o.sd_y, np.inf)) for o in (diagnosis.observation, diagnosis.held_out)]
    page = gap_page(replace(diagnosis, observation=blind[0], held_out=blind[1]))
    shown = figure(page, "gap")["layout"]["annotations"]
    assert [a["text"] for a in shown] == ["<b>controller: u</b>", "<b>plant: y</b>"]


def test_an_axis_that_was_not_excited_has_no_column(diagnosis):
    def of_one_axis(o):
        kept = o.axis == 0
        arrays = {k: v[kept] for k, v in vars(o).items() if isinstance(v, np.ndarray) and len(v) == len(kept)}
        return replace(o, **arrays)

    one = replace(diagnosis, observation=of_one_axis(diagnosis.observation), held_out=of_one_axis(diagnosis.held_out))
    shown = figure(gap_page(one), "quotient")
    assert [a["text"] for a in shown["layout"]["annotations"]] == ["<b>i<sub>xA</sub></b>"]
    assert sum(t["name"] == "measured over twin before" for t in shown["data"]) == 2  # magnitude and phase


@needs_browser
def test_the_whole_page_is_as_wide_as_a_phone(diagnosis, tmp_path):
    file = tmp_path / "page.html"
    file.write_text(gap_page(diagnosis))
    with tab() as phone:
        phone.narrow(390)
        phone.open(file.as_uri())
        phone.until("document.documentElement.dataset.drawn")
        assert phone.wide() == 390
