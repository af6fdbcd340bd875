"""The whole identification on data whose truth is known: what a user relies on."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Experiment, Sweep
from service.identification.fit import identify
from service.identification.options import Options
from service.identification.plane.model import PlaneModel
from service.identification.result.commissioning import CommissioningResult
from sim.datasheet import Datasheet, Mode, Tolerance
from sim.errors import AmbError
from tests.support.planes import synthetic_experiment, synthetic_sweep
from tests.support.two_axes import one_plane, sheet_of_one_plane


def test_stiffness_is_found_from_a_datasheet_that_is_far_off(
    result: CommissioningResult, truth: dict[str, PlaneModel]
) -> None:
    for plane, model in truth.items():
        found = result.planes[plane].stiffness
        for name, value in zip(("ksA", "ksB", "kiA", "kiB"), [*model.ks, *model.ki], strict=True):
            assert found[name].value == pytest.approx(value, rel=5e-4)
            assert abs(found[name].value - value) < 4 * found[name].std
    assert result.planes["x"].stiffness["kiA"].error_percent == pytest.approx(100 * (340 - 181) / 181, rel=1e-2)


def test_modes_are_found_without_knowing_any(result: CommissioningResult, truth: dict[str, PlaneModel]) -> None:
    for plane, model in truth.items():
        modes = result.planes[plane].modes
        assert [m.kind for m in modes] == ["rotor", "rotor"]
        for mode, w, zeta in zip(modes, model.natural_frequencies, model.damping_ratios, strict=True):
            assert mode.natural_frequency_rad_s.value == pytest.approx(w, rel=2e-4)
            assert abs(mode.natural_frequency_rad_s.value - w) < 3 * mode.natural_frequency_rad_s.std
            assert mode.damping_ratio.value == pytest.approx(zeta, rel=0.03)
        # the plant's pole lies below the free rotor's frequency, by the position stiffness
        assert modes[0].levitated_frequency_rad_s.value < modes[0].natural_frequency_rad_s.value - 1


def test_evidence_shows_the_alternatives(result: CommissioningResult) -> None:
    plane = result.planes["x"]
    chosen = [e.name for e in plane.mode_evidence if e.chosen]
    assert chosen == ["2 modes"]
    assert {e.name for e in plane.mode_evidence} >= {"1 mode", "2 modes", "3 modes"}
    assert [e.name for e in plane.amplifiers["A"].evidence if e.chosen] == ["order 2"]
    splits = plane.staged.split_evidence
    assert len(splits) > 3
    (chosen_split,) = [e for e in splits if e.chosen]
    assert chosen_split.mdl == min(e.mdl for e in splits)
    assert all(e.unseen_rms is not None for e in splits)
    # what describes the fitted sweep best does so for the unseen one, or nearly
    assert chosen_split.unseen_rms < 1.5 * min(e.unseen_rms for e in splits)
    # between the rigid rotor's poles (18 and 37 Hz) and the first mode: a low split keeps the mode's foot out of ki, ks
    assert 50 < plane.staged.split_hz < 450


def test_fit_on_the_unseen_sweep_and_residuals_of_noise_size(result: CommissioningResult) -> None:
    for plane in result.planes.values():
        assert plane.fit_percent.min() > 99
        assert plane.cross_validation_fit_percent is not None
        assert plane.cross_validation_fit_percent.min() > 99
        assert 0.8 < plane.residual_rms_total < 1.2
        assert plane.adequate
        assert plane.tests_passed
        assert plane.staged.complete_fit_percent.min() < plane.fit_percent.min()


def test_a_rig_that_was_another_one_on_the_unseen_sweep_is_told(
    experiment: Experiment, datasheet: Datasheet, truth: dict[str, PlaneModel], controller
) -> None:
    """By residuals that its deviations do not allow for: a per cent of a gain changes no NRMSE that anyone looks at."""
    one, model = sheet_of_one_plane(datasheet), truth["x"]
    f = experiment.main.frequency_hz[experiment.main.axis == 0]
    sweep = synthetic_sweep({"x": model}, one.axes, controller, f, 0.12, seed=4)
    crept = model.theta.copy()
    crept[model.layout.index("sensor_gain_A")] *= 1.01
    told = []
    for unseen in (model, model.at(crept)):
        later = synthetic_sweep({"x": unseen}, one.axes, controller, np.geomspace(12, 950, 20), 0.15, seed=5)
        found = identify(synthetic_experiment(sweep, replace(later, comment="validation"), axes=one.axes), one)
        (plane,) = found.planes.values()
        assert plane.adequate
        assert plane.cross_validation_fit_percent is not None
        assert plane.cross_validation_fit_percent.min() > 98
        warned = any("sweep that no fit has seen" in w for w in plane.warnings)
        assert warned == (plane.off_unseen > 0) == (not plane.document()["cross_validation_passed"])
        told.append(warned)
    assert told == [False, True]


def test_the_document_is_strict_json_with_the_contracts_keys(result: CommissioningResult) -> None:
    document = json.loads(json.dumps(result.document(), allow_nan=False))
    assert document["format"] == "amb-commissioning-result"
    assert document["version"] == 1
    x = document["planes"]["x"]
    assert set(x["stiffness"]) == {"ksA", "ksB", "kiA", "kiB"}
    assert set(x["stiffness"]["ksA"]) >= {"value", "std", "unit", "nominal", "error_percent"}
    assert set(x["amplifiers"]["A"]) >= {"order", "poles_rad_s", "dc_gain", "fit_percent"}
    assert set(x["rotor_modes"][0]) >= {"natural_frequency_rad_s", "damping_ratio"}
    assert set(x["extended"]) >= {"transverse_inertia_kgm2", "centre_of_gravity_m", "identifiable"}
    assert np.array(x["fit_percent"]).shape == np.array(x["cross_validation_fit_percent"]).shape == (2, 2)
    assert set(x["staged"]) >= {"rigid_fit_percent", "flexible_fit_percent", "complete_fit_percent"}
    assert set(x["residuals"]) >= {"whiteness", "independence", "level", "passed"}
    assert np.array(x["state_space"]["A"]).shape == (8, 8)
    assert x["margins"]["iso_14839_3_zone"] in "ABCD"
    assert set(x["margins"]["sensitivity_peak"]) == {"A", "B"}


def test_inertia_and_centre_of_gravity_are_told_and_the_exact_aliases_named(
    result: CommissioningResult, datasheet: Datasheet
) -> None:
    extended = result.planes["x"].extended
    inertia, cog = extended["transverse_inertia_kgm2"], extended["centre_of_gravity_m"]
    assert abs(inertia["value"] - datasheet.transverse_inertia_kgm2) < 4 * inertia["std"] < 0.05
    assert abs(cog["value"]) < 4 * cog["std"] < 2e-4
    assert extended["identifiable"] is True
    # force against mass cannot be seen, whatever the data
    blind = extended["blind_directions"]
    assert extended["rank"] < extended["parameters"]
    assert any({"mass_kg", "ki_A", "ks_A"} <= set(b["combination"]) for b in blind)


def test_a_rig_with_one_plane(
    experiment: Experiment, datasheet: Datasheet, truth: dict[str, PlaneModel], controller
) -> None:
    one = sheet_of_one_plane(datasheet)
    f = experiment.main.frequency_hz[experiment.main.axis == 0]
    sweep = synthetic_sweep({"x": truth["x"]}, one.axes, controller, f, 0.12, seed=4)
    result = identify(synthetic_experiment(sweep, axes=one.axes), one)
    assert not result.controller_differs
    assert list(result.planes) == ["x"]
    assert result.planes["x"].stiffness["kiA"].value == pytest.approx(181, rel=5e-4)
    assert result.planes["x"].cross_validation_fit_percent is None
    assert any("cross-validation" in w for w in result.warnings)


def test_a_controller_that_is_not_the_datasheets_is_told(
    experiment: Experiment, datasheet: Datasheet, truth: dict[str, PlaneModel], controller
) -> None:
    one = sheet_of_one_plane(replace(datasheet, numerator=tuple(1.05 * x for x in datasheet.numerator)))
    f = experiment.main.frequency_hz[experiment.main.axis == 0]
    sweep = synthetic_sweep({"x": truth["x"]}, one.axes, controller, f, 0.12, seed=4)
    assert identify(synthetic_experiment(sweep, axes=one.axes), one).controller_differs


def test_without_currents_the_amplifiers_are_taken_from_the_datasheet(
    experiment: Experiment, datasheet: Datasheet, truth: dict[str, PlaneModel]
) -> None:
    amplifiers = truth["x"].amplifiers
    known = replace(
        datasheet,
        amplifier_natural_frequency_hz=tuple(a.parameters[1] / 2 / np.pi for a in amplifiers) * 2,
        amplifier_damping_ratio=tuple(a.parameters[2] for a in amplifiers) * 2,
    )
    blind = replace(experiment, sweeps=tuple(replace(s, I=None) for s in experiment.sweeps))
    plane = identify(blind, known).planes["x"]
    ki = plane.stiffness["kiA"]
    assert abs(ki.value - 181) < 2 * ki.std
    assert plane.curves.amplifier is None
    # little but the force law's amplitude tells a magnet's gain from its amplifier's: ki is known about as well as that
    gain, told = plane.amplifiers["A"].parameters["gain"], known.tolerance.amplifier_gain
    assert 0.3 * told < gain.std < 1.05 * told
    assert ki.std / 181 == pytest.approx(gain.std, rel=0.2)
    assert np.isnan(plane.delay_s.std)
    assert any("currents are not logged" in w for w in plane.warnings)


def test_without_currents_amplifiers_within_their_tolerances_are_no_error_of_the_model_and_no_mode(
    experiment: Experiment, datasheet: Datasheet, truth: dict[str, PlaneModel]
) -> None:
    """Modes are counted with amplifiers that may be off as the datasheet says, or another mode explains them."""
    own = truth["x"].amplifiers
    off = replace(
        datasheet,
        amplifier_natural_frequency_hz=tuple(1.02 * a.parameters[1] / 2 / np.pi for a in own) * 2,
        amplifier_damping_ratio=tuple(0.95 * a.parameters[2] for a in own) * 2,
    )
    blind = replace(experiment, sweeps=tuple(replace(s, I=None) for s in experiment.sweeps))
    for name, plane in identify(blind, off).planes.items():
        assert plane.adequate
        assert len(plane.modes) == 2
        for key, value in zip(("ksA", "ksB"), truth[name].ks, strict=True):
            assert abs(plane.stiffness[key].value - value) < 4 * plane.stiffness[key].std < 1e-2 * value


def test_points_that_cannot_be_used_are_left_out_and_listed(experiment: Experiment, datasheet: Datasheet) -> None:
    main = experiment.main
    y, size = main.Y.copy(), main.amplitude_a.copy()
    y[3, 2, 0, 0] = np.nan
    size[5] = 0.0
    flags = [""] * main.n_points
    flags[7], flags[9] = "tripped: displacement", "repeated at lower amplitude after a displacement trip"
    flags[11] = "not settled"
    spoiled = replace(main, Y=y, amplitude_a=size, flags=tuple(flags))
    result = identify(replace(experiment, sweeps=(spoiled, *experiment.sweeps[1:])), datasheet)
    notes = " ".join(result.planes["x"].warnings)
    assert "not finite" in notes
    assert "amplitude 0" in notes
    assert "tripped" in notes
    assert "lower amplitude" not in notes
    assert "1 point had not settled" in notes
    assert result.planes["x"].stiffness["kiA"].value == pytest.approx(181, rel=5e-4)


@pytest.mark.slow
@pytest.mark.parametrize("step_m", [1e-7, 1e-5])
def test_a_log_of_coarse_steps_costs_the_points_that_read_nothing_and_is_said_not_to_fit(
    experiment: Experiment, datasheet: Datasheet, step_m: float
) -> None:
    """Lines are 18 um at most and 0.8 um in the median: high ones round to 0 in every block."""

    def logged(sweep: Sweep) -> Sweep:
        return replace(sweep, Y=step_m * (np.round(sweep.Y.real / step_m) + 1j * np.round(sweep.Y.imag / step_m)))

    measured, datasheet = one_plane(experiment, datasheet)
    plane = identify(replace(measured, sweeps=tuple(map(logged, measured.sweeps))), datasheet).planes["x"]
    assert not plane.adequate
    assert any("y reads 0 in every block" in warning for warning in plane.warnings)
    assert all(np.isfinite([e.value for e in plane.stiffness.values()]))


def test_a_plane_without_any_displacement_is_refused_in_one_line(experiment: Experiment, datasheet: Datasheet) -> None:
    dead = tuple(replace(sweep, Y=np.zeros_like(sweep.Y)) for sweep in experiment.sweeps)
    with pytest.raises(AmbError, match="y of xA reads 0 m in every block") as caught:
        identify(replace(experiment, sweeps=dead), datasheet)
    assert "\n" not in str(caught.value)


def test_one_excited_input_is_refused_in_one_line(experiment: Experiment, datasheet: Datasheet) -> None:
    main = experiment.main
    half = main.select(main.axis != 1)
    with pytest.raises(AmbError, match=r"plane x: only xA is excited.*excite xB") as caught:
        identify(replace(experiment, sweeps=(half,)), datasheet)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("count", [2, 4])
def test_points_at_a_few_frequencies_are_refused_however_many_they_are(
    experiment: Experiment, datasheet: Datasheet, count: int
) -> None:
    main = experiment.main
    few = np.flatnonzero(np.isin(main.frequency_hz, np.unique(main.frequency_hz)[4 : 4 + count]))
    with pytest.raises(AmbError, match=f"plane x: xA and xB are excited at {count} and {count} different frequencies"):
        identify(replace(experiment, sweeps=(main.select(np.tile(few, 8)),)), datasheet)


def test_points_at_one_place_of_the_frequency_response_are_refused(
    experiment: Experiment, datasheet: Datasheet
) -> None:
    main = experiment.main
    lines, of_line = np.unique(main.frequency_hz, return_inverse=True)
    beside = replace(main, frequency_hz=100 * (1 + 2e-6 * np.arange(len(lines)))[of_line])
    with pytest.raises(AmbError, match=r"all points lie between 100 and 100\.0\d* Hz, which is one place"):
        identify(replace(experiment, sweeps=(beside,)), datasheet)


def test_one_block_is_refused(experiment: Experiment, datasheet: Datasheet) -> None:
    main = experiment.main
    single = replace(main, R=main.R[:, :1], U=main.U[:, :1], I=main.I[:, :1], Y=main.Y[:, :1])
    with pytest.raises(AmbError, match="at least 2 blocks"):
        identify(replace(experiment, sweeps=(single,)), datasheet)


def test_singular_excitation_is_refused_with_its_frequency(experiment: Experiment, datasheet: Datasheet) -> None:
    main = experiment.main
    f = main.frequency_hz[4]
    same = np.flatnonzero((main.frequency_hz == f) & (main.axis < 2))
    u, i, y = main.U.copy(), main.I.copy(), main.Y.copy()
    for signal in (u, i, y):
        signal[same[1]] = signal[same[0]]
    with pytest.raises(AmbError, match=f"{f:.4g} Hz is singular"):
        identify(replace(experiment, sweeps=(replace(main, U=u, I=i, Y=y),)), datasheet)


def test_another_rigs_datasheet_is_refused(experiment: Experiment, datasheet: Datasheet) -> None:
    with pytest.raises(AmbError, match="axes"):
        identify(replace(experiment, axes=("xA", "xB")), datasheet)


def test_no_excited_sweep_is_refused(experiment: Experiment, datasheet: Datasheet) -> None:
    noise = replace(experiment.main, kind="noise")
    with pytest.raises(AmbError, match="nothing to identify"):
        identify(replace(experiment, sweeps=(noise,)), datasheet)


def test_a_plane_that_was_not_excited_is_skipped_with_a_word(experiment: Experiment, datasheet: Datasheet) -> None:
    main = experiment.main
    result = identify(replace(experiment, sweeps=(main.select(main.axis < 2),)), datasheet)
    assert list(result.planes) == ["x"]
    assert any("plane y is not excited" in w for w in result.warnings)


@pytest.mark.slow
def test_a_wrong_model_is_flagged_and_its_intervals_widened(
    experiment: Experiment, datasheet: Datasheet, result: CommissioningResult
) -> None:
    # sensors 12 mm off: no stiffness explains that
    wrong = replace(datasheet, sensor_from_cog_m=(0.472, 0.458))
    plane = identify(*one_plane(experiment, wrong)).planes["x"]
    good = result.planes["x"]
    assert not plane.adequate
    assert not plane.tests_passed
    assert "residuals are" in plane.warnings[0]
    assert plane.stiffness["kiA"].std > 10 * good.stiffness["kiA"].std_from_data
    assert plane.widening > 3


def test_ignoring_the_force_law_would_bias_the_stiffness(
    datasheet: Datasheet, truth: dict[str, PlaneModel], controller
) -> None:
    from service.identification.joint.refine import refine
    from service.identification.measured.data import Data
    from service.identification.measured.points import plane_points

    f = np.unique(np.concatenate([np.geomspace(10, 1000, 40), 493 + np.linspace(-6, 6, 5)]))
    sweep = synthetic_sweep(truth, datasheet.axes, controller, f, np.where(f < 60, 0.2, 0.4), seed=5)
    data = Data(plane_points(sweep, datasheet.axes, "x"))
    assert 10e-6 < np.abs(data.plant.y).max() < 80e-6
    start = truth["x"]
    linear = refine(start, data, start.layout.free(), nonlinear=False).model
    full = refine(start, data, start.layout.free(), nonlinear=True).model
    # the ratio does not hang on how the shapes split
    truth_ratio = start.ks / start.ki
    assert np.all(np.abs(full.ks / full.ki / truth_ratio - 1) < 2e-4)
    assert np.max(np.abs(linear.ks / linear.ki / truth_ratio - 1)) > 1e-3


def test_without_knowledge_of_the_splits_one_combination_is_blind_and_says_so(
    experiment: Experiment, datasheet: Datasheet, result: CommissioningResult
) -> None:
    free = identify(experiment, datasheet, Options(closeness=False)).planes["x"].modes[0].natural_frequency_rad_s
    with_closeness = result.planes["x"].modes[0].natural_frequency_rad_s
    # this rotor's shape triples from bearing B to its sensor: that they are close tells little, and misleads neither
    for told in (free, with_closeness):
        assert abs(told.value - 3097.0) < 2 * told.std
        assert told.std > 50 * told.std_from_data
    # the plant's own pole does not hang on it
    assert result.planes["x"].modes[0].levitated_frequency_rad_s.std < 0.1 * with_closeness.std


def test_a_rotor_model_in_the_datasheet_tells_how_shapes_split(
    experiment: Experiment, datasheet: Datasheet, truth: dict[str, PlaneModel], result: CommissioningResult
) -> None:
    model = truth["x"]
    modes = tuple(
        Mode(w / (2 * np.pi) * 1.01, 0.002, tuple(m[2:4] * 1.3), tuple(m[4:6] * 1.3))
        for m, w in zip(model.modes, model.natural_frequencies, strict=True)
    )
    plane = identify(experiment, replace(datasheet, modes=modes, tolerance=Tolerance(mode_shape=0.02))).planes["x"]
    for mode, before, w in zip(plane.modes, result.planes["x"].modes, model.natural_frequencies, strict=True):
        found = mode.natural_frequency_rad_s
        assert found.std < before.natural_frequency_rad_s.std
        assert abs(found.value - w) < 3 * found.std < 2e-4 * w
