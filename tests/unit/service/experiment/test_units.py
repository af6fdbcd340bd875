"""A value in another unit is told: its data would fit, and be those of another rig."""

from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Experiment
from service.experiment.errors import ExperimentFileError
from service.experiment.units import must_be_in_si, odd_air_gap, odd_modes, odd_rotor, odd_stiffness, odd_tolerances
from sim.datasheet import Tolerance
from sim.reference import reference_datasheet, reference_rig
from tests.support.planes import plane_model_of, synthetic_experiment, synthetic_sweep
from tests.support.synthetic import known_datasheet

SHEET = reference_datasheet()


@pytest.fixture(scope="module")
def measured() -> Experiment:
    models = {plane: plane_model_of(reference_rig(), plane) for plane in "xy"}
    law = (np.array(SHEET.numerator), np.array(SHEET.denominator))
    return synthetic_experiment(
        synthetic_sweep(models, SHEET.axes, law, np.geomspace(10, 900, 10), 0.1, seed=1), axes=SHEET.axes
    )


@pytest.mark.parametrize(
    ("name", "factor", "unit"), [("Y", 1e6, "µm"), ("Y", 1e3, "mm"), ("I", 1e3, "mA"), ("R", 1e300, "mA")]
)
def test_amplitudes_that_no_rig_has_are_refused_with_the_unit_that_they_may_be_in(measured, name, factor, unit):
    must_be_in_si(measured, SHEET)
    (sweep,) = measured.sweeps
    wrong = replace(measured, sweeps=(replace(sweep, **{name: factor * getattr(sweep, name)}),))
    with pytest.raises(ExperimentFileError, match=rf"sweeps/0: {name} reaches .* is it in {unit}\?"):
        must_be_in_si(wrong, SHEET)


def test_frequencies_in_kilohertz_are_told(measured):
    (sweep,) = measured.sweeps
    slow = replace(measured, sweeps=(replace(sweep, frequency_hz=1e-3 * sweep.frequency_hz),))
    with pytest.raises(ExperimentFileError, match=r"the tones end at 0\.9 Hz, .* is frequency_hz in kHz\?"):
        must_be_in_si(slow, SHEET)


def test_a_sample_time_in_milliseconds_is_told(measured):
    with pytest.raises(ExperimentFileError, match=r"sample_time_s of 0\.1 s cannot play: is that in ms"):
        must_be_in_si(measured, replace(SHEET, sample_time_s=0.1))


@pytest.mark.parametrize("factor", [1e-3, 1e3])
@pytest.mark.parametrize("field", ["mass_kg", "transverse_inertia_kgm2"])
def test_a_mass_in_grams_or_tonnes_is_no_rotor(field, factor):
    assert odd_rotor(SHEET) == []
    (told,) = odd_rotor(replace(SHEET, **{field: factor * getattr(SHEET, field)}))
    assert "mass_kg" in told
    assert "radius of gyration" in told


@pytest.mark.parametrize("factor", [0.1, 10.0])
@pytest.mark.parametrize("field", ["bearing_from_cog_m", "sensor_from_cog_m"])
def test_distances_that_are_not_beside_each_other_name_the_one_that_is_off(field, factor):
    a, b = getattr(SHEET, field)
    (told,) = odd_rotor(replace(SHEET, **{field: (factor * a, factor * b)}))
    assert f"is {field} in another unit than m" in told
    near_the_centre = replace(SHEET, bearing_from_cog_m=(0.05, 0.77), sensor_from_cog_m=(0.005, 0.83))
    assert odd_rotor(near_the_centre) == []


def test_all_distances_in_another_unit_are_asked_about_with_mass_and_inertia():
    far = {k: tuple(0.01 * d for d in getattr(SHEET, k)) for k in ("bearing_from_cog_m", "sensor_from_cog_m")}
    (told,) = odd_rotor(replace(SHEET, **far))
    for name in ("mass_kg", "transverse_inertia_kgm2", "bearing_from_cog_m", "sensor_from_cog_m"):
        assert name in told


def test_stiffness_off_by_a_thousand_is_a_unit_and_twice_is_none():
    usual = np.array([0.5, 0.6, 0.55, 0.5])
    assert odd_stiffness({"ki": usual, "ks": usual}) == []
    (ks,) = odd_stiffness({"ki": usual, "ks": 1e6 * usual})
    assert "position_stiffness_n_per_m (N/mm, N/µm)" in ks
    (ki,) = odd_stiffness({"ki": 1e-3 * usual, "ks": usual})
    assert "current_stiffness_n_per_a" in ki
    (both,) = odd_stiffness({"ki": 1e3 * usual, "ks": 1e3 * usual})
    assert "mass_kg" in both
    assert all("bearing_from_cog_m" in told for told in (ks, both))


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("current_stiffness", 20.0, "current_stiffness lets values be anything"),  # per cent
        ("sensor_position_m", 1.0, "sensor_position_m in m"),  # mm
        ("mass", 1e-9, "mass takes values for certain"),
    ],
)
def test_a_tolerance_that_says_all_or_nothing_is_told(field, value, said):
    stated = replace(SHEET, tolerance_stated=True, tolerance=Tolerance())
    assert odd_tolerances(stated) == []
    off = replace(stated, tolerance=replace(Tolerance(), **{field: value}))
    (told,) = odd_tolerances(off)
    assert said in told
    assert odd_tolerances(replace(off, tolerance_stated=False)) == []


@pytest.mark.parametrize(
    ("field", "factor"),
    [("position_stiffness_n_per_m", 1e-3), ("current_stiffness_n_per_a", 1e-3), ("bias_current_a", 1e3)],
)
def test_magnets_whose_factors_no_air_gap_makes_are_told(field, factor):
    assert odd_air_gap(SHEET) == []
    twice = replace(SHEET, current_stiffness_n_per_a=tuple(2 * k for k in SHEET.current_stiffness_n_per_a))
    assert odd_air_gap(twice) == []
    (told,) = odd_air_gap(replace(SHEET, **{field: tuple(factor * v for v in getattr(SHEET, field))}))
    assert field in told


def test_a_damping_that_no_shaft_has_is_told_with_its_mode() -> None:
    sheet = known_datasheet()[0]
    assert sheet.modes
    assert odd_modes(sheet) == []
    per_cent = replace(sheet, modes=tuple(replace(m, damping_ratio=100 * m.damping_ratio) for m in sheet.modes))
    (told,) = odd_modes(per_cent)
    for m in per_cent.modes:
        assert f"{m.damping_ratio:.3g} at {m.frequency_hz:.4g} Hz" in told
    assert "per cent" in told
