"""Rigs whose mass, geometry and sensor gains are not the datasheet's, but within its tolerances of them."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from service.experiment.data import Experiment
from service.identification.controller.check import check_controller
from service.identification.fit import identify
from service.identification.plane.layout import GIVEN, SHIFTS
from service.identification.plane.model import PlaneModel
from service.identification.plane_fit import FittedPlane, fit_plane, settled_alike
from service.identification.priors.given import Given
from service.identification.priors.tolerances import Tolerances
from service.identification.result.commissioning import CommissioningResult
from service.identification.result.saved import saved_planes
from service.identification.within_tolerances import within_tolerances
from service.report.commissioning import commissioning_page
from sim.datasheet import ASSUMED, Datasheet
from tests.support.planes import synthetic_experiment, synthetic_sweep
from tests.support.two_axes import sheet_of_one_plane

OFF = {
    "mass_kg": 0.004,
    "transverse_inertia_kgm2": -0.008,
    "sensor_gain_A": {"x": 0.006, "y": -0.009},
    "sensor_gain_B": {"x": -0.004, "y": 0.011},
    "sensor_shift_A_m": 0.7e-3,
    "sensor_shift_B_m": -1.1e-3,
}
"""Of a rig: relative, or in m; each within some tolerance of what the reference rig's datasheet says."""
HZ = np.unique(np.concatenate([np.geomspace(10, 1000, 60), 493 + np.linspace(-6, 6, 7), 907.5 + np.linspace(-9, 9, 7)]))


def other(truth: dict[str, PlaneModel], off: dict, scale: float = 1.0) -> dict[str, PlaneModel]:
    """The planes with these values; modes as they are."""
    found = {}
    for plane, model in truth.items():
        theta = model.theta.copy()
        for name, by in off.items():
            value = scale * (by[plane] if isinstance(by, dict) else by)
            place = model.layout.index(name)
            theta[place] = value if name in SHIFTS else theta[place] * (1 + value)
        found[plane] = model.at(theta)
    return found


def measured(models: dict[str, PlaneModel], datasheet: Datasheet, controller) -> Experiment:
    size = np.where(HZ < 100, 0.12, 0.2)
    main = synthetic_sweep(models, datasheet.axes, controller, HZ, size, seed=1)
    unseen = synthetic_sweep(models, datasheet.axes, controller, np.geomspace(12, 950, 20), 0.15, seed=2)
    return synthetic_experiment(main, replace(unseen, comment="validation"), axes=datasheet.axes)


@pytest.fixture(scope="module")
def rig(truth: dict[str, PlaneModel]) -> dict[str, PlaneModel]:
    return other(truth, OFF)


@pytest.fixture(scope="module")
def asked() -> list[bool]:
    """Whether planes that are looked at for what one of them tells of all are those with other values, each time."""
    return []


@pytest.fixture(scope="module")
def off_result(rig: dict[str, PlaneModel], datasheet: Datasheet, controller, asked: list[bool]) -> CommissioningResult:
    def recorded(planes: dict[str, FittedPlane], *rest: Any) -> dict[str, FittedPlane]:
        asked.append(all(f.given is not None for f in planes.values()))
        return settled_alike(planes, *rest)

    with pytest.MonkeyPatch.context() as m:
        m.setattr("service.identification.fit.settled_alike", recorded)
        return identify(measured(rig, datasheet, controller), datasheet)


def test_such_a_rig_behaves_as_its_model(off_result: CommissioningResult) -> None:
    for plane in off_result.planes.values():
        assert plane.adequate
        assert 0.8 < plane.residual_rms_total < 1.2
        assert plane.cross_validation_fit_percent is not None
        assert plane.cross_validation_fit_percent.min() > 99.5
    assert any("the planes are identified with these" in w for w in off_result.warnings)


def test_tolerances_that_nobody_stated_are_told_as_assumed(
    off_result: CommissioningResult, result: CommissioningResult
) -> None:
    """What is known of ki then hangs on them; where the datasheet's values explain the data nothing does."""
    assert ASSUMED in off_result.warnings
    assert ASSUMED not in result.warnings


def test_what_rang_in_one_plane_is_looked_for_in_all_with_other_values_too(
    off_result: CommissioningResult, asked: list[bool]
) -> None:
    assert off_result.adjusted
    assert asked == [False, True]


def test_its_stiffness_is_right_within_its_deviation_which_allows_for_what_no_data_tell(
    off_result: CommissioningResult, rig: dict[str, PlaneModel], datasheet: Datasheet
) -> None:
    t = datasheet.tolerance
    # mass and the gain of all sensors are known by their tolerances alone
    least = {"ki": np.hypot(t.mass, t.sensor_gain / np.sqrt(2)), "ks": t.mass}
    for plane, model in rig.items():
        found = off_result.planes[plane].stiffness
        for name, value in zip(("kiA", "kiB", "ksA", "ksB"), [*model.ki, *model.ks], strict=True):
            one = found[name]
            assert abs(one.value - value) < 3 * one.std
            assert 0.9 * least[name[:2]] < one.std / one.value < 2 * least[name[:2]]


def test_what_the_data_tell_of_geometry_and_sensors_is_told(
    off_result: CommissioningResult, rig: dict[str, PlaneModel]
) -> None:
    held = {a.name: a for a in off_result.adjusted}
    true = {name: rig["x"].theta[rig["x"].layout.index(name)] for name in ("transverse_inertia_kgm2", *SHIFTS)}
    for name, value in true.items():
        assert held[name].std < 0.7 * held[name].tolerance
        assert abs(held[name].value - value) < 3.5 * held[name].std
    for plane, model in rig.items():
        b, a = (held[f"sensor_gain_{plane}{end}"].value for end in "BA")
        assert b / a == pytest.approx(model.sensor_gain[1] / model.sensor_gain[0], abs=3e-3)
        assert off_result.planes[plane].model.theta[model.layout.given] == pytest.approx(
            [held[n if "gain" not in n else f"sensor_gain_{plane}{n[-1]}"].value for n in GIVEN]
        )


def test_they_are_asked_for_where_a_mode_that_no_rotor_has_explains_the_data_too(
    rig: dict[str, PlaneModel], datasheet: Datasheet, controller, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Noise this loud hides what such values do, but for what a further mode takes up, and ki with it."""
    one, axes = sheet_of_one_plane(datasheet), ("xA", "xB")
    sweep = synthetic_sweep({"x": rig["x"]}, axes, controller, HZ, 0.2, seed=1, displacement_noise_m=1e-7)
    told = {"x": Tolerances.of_given(one, axes)}

    def fit(plane: str, released: Tolerances | None, given: Given | None) -> FittedPlane:
        return fit_plane(sweep, None, None, axes, plane, one, released=released, given=given)

    found = {"x": fit("x", None, None)}
    assert found["x"].adequate
    patches = {False: ("patch",), True: ("rotor",)}
    explained = found["x"].selected.refined.model
    monkeypatch.setattr("service.identification.plane_fit.kinds", lambda model, *_: patches[model is not explained])
    within = within_tolerances(found, told, fit)
    assert within.adjusted
    assert within.doubts[0].startswith("no mode that no rotor has is needed to explain the data with other values")
    monkeypatch.setattr("service.identification.plane_fit.kinds", lambda *_: ("rotor", "patch"))
    assert not within_tolerances(found, told, fit).adjusted


def test_what_is_known_of_shapes_is_no_more_than_with_these_values_free(
    rig: dict[str, PlaneModel], datasheet: Datasheet, controller
) -> None:
    """The work of the position stiffness, which tells of a shape's split, is also that of a mass that is off."""
    one, model = sheet_of_one_plane(datasheet), rig["x"]
    sweep = measured({"x": model}, one, controller).main
    told = Tolerances.of_given(one, ("xA", "xB"))
    given = Given(model.theta[model.layout.given], np.diag((told.stds / 10) ** 2))
    spread = []
    for held in (None, given):
        found = fit_plane(sweep, None, None, one.axes, "x", one, released=told, given=held)
        splits = found.selected.splits
        assert splits is not None
        spread.append(np.sqrt(np.diag(splits.covariance)))
    assert np.all(spread[1] > 0.8 * spread[0])


def test_responses_and_margins_are_known_as_well_as_they_are_measured(
    off_result: CommissioningResult, result: CommissioningResult
) -> None:
    """What neither mass nor gains change is not blurred by what is not known of them."""
    for name, plane in off_result.planes.items():
        size = np.linalg.norm(plane.curves.model, axis=(1, 2))
        assert np.median(np.linalg.norm(plane.curves.model_std, axis=(1, 2)) / size) < 1e-3
        for end in "AB":
            assert plane.margins[end].peak_std < 1.5 * result.planes[name].margins[end].peak_std


def test_inertia_and_centre_of_gravity_are_told_as_they_are_known_where_mass_and_sensors_are_not(
    off_result: CommissioningResult, rig: dict[str, PlaneModel]
) -> None:
    held = {a.name: a for a in off_result.adjusted}
    for plane, model in rig.items():
        extended = off_result.planes[plane].extended
        for name in ("transverse_inertia_kgm2", "centre_of_gravity_m"):
            told = extended[name]
            assert abs(told["value"] - model.theta[model.layout.index(name)]) < 3 * told["std"]
            assert told["std"] == pytest.approx(held[name].std)
        # the data halve what is not known of the inertia; of the centre of gravity they tell next to nothing
        assert extended["transverse_inertia_kgm2"]["identifiable"]
        assert not extended["centre_of_gravity_m"]["identifiable"]
        # mass and inertia in one proportion: only the force per mass is seen
        names, matrix = extended["correlations"]["names"], np.array(extended["correlations"]["matrix"])
        assert matrix[names.index("transverse inertia"), names.index("ksA")] > 0.5


def test_a_rig_that_is_as_its_datasheet_says_is_held_there(result: CommissioningResult) -> None:
    assert result.adjusted == ()
    assert "adjusted" not in result.document()
    for plane in result.planes.values():
        assert not set(GIVEN) & set(plane.parameter_names)


def test_what_no_geometry_explains_leaves_the_datasheets(
    truth: dict[str, PlaneModel], datasheet: Datasheet, controller
) -> None:
    """Currents that saturate: the magnets push less where they are driven hard, and no sensor's place does that."""
    whole = measured(truth, datasheet, controller)
    main = whole.sweeps[0]
    distorted = replace(main, Y=main.Y * (1 - 0.05 * (np.abs(main.I) / np.abs(main.I).max()) ** 2))
    found = identify(replace(whole, sweeps=(distorted, *whole.sweeps[1:])), datasheet)
    assert not all(p.adequate for p in found.planes.values())
    assert found.adjusted == ()
    for plane in found.planes.values():
        assert plane.model.theta[plane.model.layout.given] == pytest.approx(
            truth[plane.plane].theta[truth[plane.plane].layout.given]
        )


def test_a_value_far_off_is_told(truth: dict[str, PlaneModel], datasheet: Datasheet, controller) -> None:
    """A sensor that sits 6 mm from where the drawing has it."""
    stated = replace(datasheet, tolerance_stated=True)
    found = identify(measured(other(truth, {"sensor_shift_A_m": 6e-3}), datasheet, controller), stated)
    assert ASSUMED not in found.warnings
    (told,) = [w for w in found.warnings if "rather wrong than loose" in w]
    assert told.startswith("sensor position A by +")
    (held,) = [a for a in found.adjusted if a.name == "sensor_shift_A_m"]
    assert held.value == pytest.approx(6e-3, rel=0.1)


def test_later_work_starts_from_the_values_that_were_held(
    off_result: CommissioningResult, datasheet: Datasheet
) -> None:
    document = json.loads(json.dumps(off_result.document()))
    assert [a["name"] for a in document["adjusted"]] == [a.name for a in off_result.adjusted]
    for name, saved in saved_planes(document, datasheet).items():
        plane = off_result.planes[name]
        assert saved.model.theta == pytest.approx(plane.model.theta)
        names = np.array(saved.model.layout.names)
        assert set(names[saved.uncertain & ~saved.free]) == set(GIVEN)
        # a health check compares what it fits, and what is not known of the rest is common to both
        assert saved.covariance_from_data.shape == (saved.free.sum(),) * 2
        assert saved.covariance.shape == (saved.uncertain.sum(),) * 2
        assert np.all(np.diag(saved.covariance_from_data) > 0)
    checked = check_controller(
        off_result.rig,
        saved_planes(document, datasheet),
        (datasheet.numerator, datasheet.denominator),
        datasheet.sample_time_s,
    )
    assert checked.stable


def test_a_result_of_before_sensors_could_be_elsewhere_is_read(
    result: CommissioningResult, datasheet: Datasheet
) -> None:
    document = json.loads(json.dumps(result.document()))
    for plane in document["planes"].values():
        for name in SHIFTS:
            del plane["parameters"]["values"][name]
    for name, saved in saved_planes(document, datasheet).items():
        assert saved.model.theta == pytest.approx(result.planes[name].model.theta)


def test_the_report_shows_what_is_held(
    off_result: CommissioningResult, rig: dict[str, PlaneModel], datasheet: Datasheet, controller
) -> None:
    page = commissioning_page(off_result, measured(rig, datasheet, controller), datasheet)
    assert "held within the datasheet" in page
    assert "sensor position B, m" in page
    assert "transverse inertia, kg m²" in page
