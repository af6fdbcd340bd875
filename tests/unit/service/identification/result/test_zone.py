"""The zone of a commissioning is that of the loop, not of a point that had not settled or of noise."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from service.cli import summary
from service.experiment.data import Sweep
from service.health.compare import Baseline, compare
from service.health.zones import zone_is_calm
from service.identification.controller.check import check_controller
from service.identification.fit import identify
from service.identification.loop.margins import SURE, above, zone_table
from service.identification.measured.etfe import FrequencyResponse
from service.identification.result.commissioning import CommissioningResult, PlaneResult
from service.identification.result.saved import saved_planes
from service.report.commissioning import verdict
from sim.reference import reference_rig
from tests.support.commissioned import LAW, SHEET
from tests.support.planes import plane_model_of, synthetic_experiment, synthetic_sweep
from tests.support.two_axes import sheet_of_one_plane

ONE = sheet_of_one_plane(SHEET)
MODEL = plane_model_of(reference_rig(), "x")


@cache
def sweep(to_hz: float = 1000.0, comment: str = "main") -> Sweep:
    """One plane of the reference rig from 10 Hz on, with lines about its modes."""
    lines = 60 if comment == "main" else 20
    near = [m[0] / (2 * np.pi) + np.linspace(-3, 3, 7) for m in MODEL.modes if comment == "main"]
    hz = np.unique(np.concatenate([np.geomspace(10 if near else 11, to_hz, lines), *near]))
    noise = {"relative_noise": 1e-3, "current_noise_a": 1e-6, "displacement_noise_m": 1e-12}
    return synthetic_sweep({"x": MODEL}, ONE.axes, LAW, hz[hz <= to_hz], 0.05, seed=lines, comment=comment, **noise)


@cache
def cut_off(to_hz: float) -> PlaneResult:
    return identified(sweep(to_hz), to_hz)


def identified(main: Sweep, to_hz: float = 1000.0) -> PlaneResult:
    sweeps = main, sweep(0.97 * to_hz, "validation")
    return identify(synthetic_experiment(*sweeps, axes=ONE.axes, rig="reference"), ONE).planes["x"]


def whole(plane: PlaneResult) -> dict:
    """A result.json of it alone."""
    return CommissioningResult("reference", ONE.axes, {"x": plane}, "main", "validation").document()


@cache
def usual() -> PlaneResult:
    return identified(sweep())


def test_a_point_that_had_not_settled_moves_no_zone():
    """Its flag says that its mean is off by more than its noise: seven times, as of a tone that still rang."""
    main = sweep()
    at = int(np.flatnonzero((main.axis == 0) & (main.frequency_hz > 45))[0])
    loud = {name: getattr(main, name).copy() for name in "UIY"}
    for signal in loud.values():
        signal[at] *= 7
    flags = ["not settled" if k == at else "" for k in range(main.n_points)]
    found = identified(replace(main, flags=tuple(flags), **loud))
    assert found.document()["margins"]["iso_14839_3_zone"] == usual().document()["margins"]["iso_14839_3_zone"] == "C"
    assert found.margins["A"].measured_peak == pytest.approx(usual().margins["A"].measured_peak, rel=0.01)


@pytest.mark.parametrize(("deviations", "counts"), [(SURE - 1, False), (SURE + 1, True)])
def test_a_measured_peak_counts_once_noise_does_not_explain_that_it_is_above_the_models(deviations, counts):
    std = 0.1
    peak = 4.0 + deviations * std
    value = np.array([1.0, peak, 2.0])[:, None, None] * np.eye(2)
    measured = FrequencyResponse(np.arange(1.0, 4.0), value + 0j, np.full((3, 2, 2), std * np.sqrt(2)))
    assert above(measured, 0, 4.0) == (pytest.approx(peak) if counts else None)


def test_a_band_that_ends_below_the_highest_peak_tells_no_zone():
    """Of the modes there is only what they leave below: the true zone is C."""
    to_hz = 200.0
    found = cut_off(to_hz)
    document = found.document()
    highest = document["measured_hz"][1]
    assert highest == pytest.approx(to_hz, rel=0.02)
    assert document["margins"]["iso_14839_3_zone"] == "not known"
    (told,) = [w for w in found.warnings if "margins and zone of the loop are not known" in w]
    assert f"above the highest measured line ({highest:.4g} Hz)" in told
    assert summary.margins({"planes": {"x": document}})[0].endswith("zone not known")
    result = CommissioningResult("r", ONE.axes, {"x": found}, "main", None)
    tone, sentence = verdict(result)
    assert tone != "good"
    assert "its zone not known: in the x-plane" in sentence


def test_a_controller_is_not_safe_for_a_band_that_ends_below_a_mode():
    """However good the zone that is accepted: what the loop does at the mode is a guess."""
    document = {**whole(cut_off(600.0)), "rig": "r"}
    generous = {"zones": zone_table("ok=40,bad"), "accepted_zone": "ok"}
    found = check_controller("r", saved_planes(document, ONE), LAW, **generous)
    assert not found.safe
    assert any("above the highest measured line" in why for why in found.not_known)
    assert {a.zone for a in found.axes} == {"not known"}
    assert found.document()["axes"]["xA"]["iso_14839_3_zone"] == "not known"


def test_a_band_that_has_the_modes_tells_the_zone_and_says_where_it_ends():
    assert usual().beyond_measured == ""
    document = whole(usual())
    found = check_controller("r", saved_planes(document, ONE), LAW)
    assert {a.zone for a in found.axes} <= set("ABCD")
    assert found.not_known == ()
    assert [w for w in found.warnings if "nothing was measured above 1000 Hz" in w]


def test_a_result_that_does_not_tell_its_band_is_not_judged():
    document = whole(usual())
    del document["planes"]["x"]["measured_hz"]
    found = check_controller("r", saved_planes(document, ONE), LAW, draws=5)
    assert any("does not tell up to which frequency" in why for why in found.not_known)


def test_a_band_that_ends_above_the_highest_peak_tells_its_zone_and_what_it_lacks():
    """The peaks are below the first mode, at 493 Hz; the loop's gain at the second one was not measured."""
    found = cut_off(600.0)
    assert found.document()["margins"]["iso_14839_3_zone"] == "C"
    (told,) = [w for w in found.warnings if "margins are those of the measured band" in w]
    assert "the loop's gain is" in told


def test_a_health_check_after_such_a_commissioning_knows_no_zone_either():
    document = whole(cut_off(200.0))
    found = compare(Baseline(document), synthetic_experiment(sweep(200.0), axes=ONE.axes, rig="r"), ONE)
    assert found.zone == "not known"
    assert "margins and zone not known" in found.sentence()
    assert not zone_is_calm(found.document())


def test_a_loud_and_uncertain_line_does_not_count_before_a_sure_one():
    value = np.array([9.0, 5.0])[:, None, None] * np.eye(2) + 0j
    std = np.array([3.0, 0.01])[:, None, None] * np.ones((2, 2))
    assert above(FrequencyResponse(np.array([1.0, 2.0]), value, std), 1, 4.0) == 5.0
