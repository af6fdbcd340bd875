"""A diagnosis names what is there, says nothing where nothing is, and refuses what it cannot do."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from service.experiment.data import Experiment
from service.gap.apply import applied
from service.gap.diagnose import FARTHEST, diagnose, leaves_some, values_off
from service.gap.document import gap_document
from service.gap.fitting import candidates
from service.gap.fitting.candidates import Candidate, Task, fit_task
from service.gap.measured.observation import GapError
from service.gap.origin import origin
from service.gap.weighing.verdict import Verdict
from sim.errors import EffectError
from sim.twin import with_effects
from tests.support.synthetic import experiment, known_datasheet, sweep, true_rig
from tests.support.two_axes import one_plane


def test_a_clean_rig_has_no_gap_and_the_way_there_is_told() -> None:
    datasheet, truth = known_datasheet(seed=1)
    heard: list[tuple[float, str]] = []
    measured = experiment(true_rig(truth))
    d = diagnose(measured, datasheet, progress=lambda percent, words: heard.append((percent, words)))
    assert d.verdict.kind == "no_gap"
    assert gap_document(d)["verdict"]["effects"] == []
    assert gap_document(d)["of"] == origin(measured, datasheet)
    percents = [percent for percent, _ in heard]
    assert percents == sorted(percents)
    assert 0 <= percents[0] < 5
    assert 95 < percents[-1] <= 100
    assert max(np.diff(percents)) < 25  # the largest is the one over a second pass that was not needed
    for path in ("controller", "amplifier", "plant"):
        assert any(words.startswith(f"explaining the {path}") for _, words in heard)


@pytest.mark.parametrize(
    ("effect", "values", "path", "within"),
    [
        pytest.param("loop_delay", {"delay_s": 2e-5}, "amplifier", 0.05, marks=pytest.mark.slow),
        # the datasheet's own tolerances, 1 % of the frequency and 2 % of the damping, are in these changes, and in
        # their deviations that one amplifier may have changed more than the other
        pytest.param(
            "amplifier_bandwidth",
            {"frequency_change": 0.06, "damping_change": -0.05, "lag_s": 1.5e-6},
            "amplifier",
            0.3,
            marks=pytest.mark.slow,
        ),
        pytest.param("magnetic_saturation", {"saturation_inverse_per_a": 0.6}, "plant", 0.05, marks=pytest.mark.slow),
    ],
)
def test_a_withheld_effect_is_named_measured_and_closed(
    effect: str, values: dict[str, float], path: str, within: float
) -> None:
    datasheet, truth = known_datasheet(seed=2)
    d = diagnose(*one_plane(experiment(with_effects(true_rig(truth), {effect: values})), datasheet))
    report = gap_document(d)
    assert report["verdict"]["effects"] == [effect]
    assert report["where"]["path"] == path
    assert report["shrinkage"]["closure"] > 0.95
    found = report["candidates"][0]["parameters"]
    for name, value in values.items():
        assert found[name]["value"] == pytest.approx(value, rel=within)
        assert abs(found[name]["value"] - value) < 4 * found[name]["std"]
        assert found[name]["std"] < within * abs(value)
    left_open = [c["closure"] for c in report["candidates"] if c["open_strength"]]
    assert left_open == [None] * len(left_open) != []


@pytest.mark.slow
@pytest.mark.parametrize("inverse_per_a", [0.15, 0.3, 0.4])
def test_a_saturation_fainter_than_the_floor_of_rough_stages_is_found_by_its_law(inverse_per_a: float) -> None:
    datasheet, truth = known_datasheet(seed=2)
    rig = with_effects(true_rig(truth), {"magnetic_saturation": {"saturation_inverse_per_a": inverse_per_a}})
    d = diagnose(*one_plane(experiment(rig), datasheet))
    assert d.verdict.effects == ("magnetic_saturation",)
    assert d.gap_before < 0.004
    found, std = (one[0]["saturation_inverse_per_a"] for one in (d.chosen.fit.values, d.chosen.standard_deviations))
    assert abs(found - inverse_per_a) < 3 * std < 0.3 * inverse_per_a


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.0, 1.0])
def test_how_long_faint_eddy_currents_lag_is_told_for_the_force_and_for_the_current(share: float) -> None:
    datasheet, truth = known_datasheet(seed=2)
    eddy = {"eddy_currents": {"time_constant_s": 1e-7, "displacement_share": share}}
    d = diagnose(*one_plane(experiment(with_effects(true_rig(truth), eddy)), datasheet))
    assert d.verdict.effects == ("eddy_currents",)
    (found,), (std,) = d.chosen.fit.values, d.chosen.standard_deviations
    assert found["time_constant_s"] == pytest.approx(1e-7, rel=0.05)
    assert abs(found["time_constant_s"] - 1e-7) < 2 * std["time_constant_s"]
    assert found["displacement_share"] == pytest.approx(share, abs=0.05)


@pytest.mark.slow
def test_a_line_near_a_mode_that_few_lines_tell_of_does_not_speak_against_an_effect() -> None:
    """One sweep of 18 lines, nine to fit: of the shape at the mode only an unseen line tells."""
    datasheet, truth = known_datasheet(seed=5)
    rng = np.random.default_rng(5)
    off = [
        replace(m, shape_at_bearings=tuple(shapes[0]), shape_at_sensors=tuple(shapes[1]))
        for m in datasheet.modes
        for shapes in [np.array([m.shape_at_bearings, m.shape_at_sensors]) * (1 + 0.07 * rng.standard_normal((2, 2)))]
    ]
    datasheet = replace(datasheet, modes=tuple(off), tolerance=replace(datasheet.tolerance, mode_shape=0.1))
    rig = with_effects(true_rig(truth), {"sensor_position": {"shift_A_m": 0.012, "shift_B_m": 0.012}})
    frequency = np.r_[np.geomspace(15.0, 420.0, 17), 494.0]
    one = Experiment("reference", datasheet.axes, (sweep(rig, frequency, 0.3, seed=5),))
    d = diagnose(*one_plane(one, datasheet))
    assert d.verdict.effects == ("sensor_position",)
    assert d.shrinkage.closure is not None
    assert d.shrinkage.closure < 0.7  # else the line asks nothing


@pytest.mark.slow
def test_an_effect_that_could_not_be_fitted_is_said_not_to_have_been_weighed(monkeypatch: pytest.MonkeyPatch) -> None:
    def without(task: Task) -> Candidate:
        if "off_centre_rotor" in task.effects:
            raise EffectError("off_centre_rotor leads to no rig")
        return fit_task(task)

    monkeypatch.setattr(candidates, "fit_task", without)
    datasheet, truth = known_datasheet(seed=1)
    measured, datasheet = one_plane(experiment(true_rig(truth)), datasheet)
    report = gap_document(diagnose(measured, datasheet))
    assert report["verdict"]["kind"] == "no_gap"
    assert "off centre rotor was not weighed: no twin with it could be fitted" in report["notes"]
    assert sum("not weighed" in note for note in report["notes"]) == 1


@pytest.mark.slow
def test_the_twin_with_its_effect_applied_has_no_gap_left() -> None:
    datasheet, truth = known_datasheet(seed=4)
    rig = with_effects(true_rig(truth), {"sensor_lag": {"time_constant_s": 2e-5}})
    measured, datasheet = one_plane(experiment(rig), datasheet)
    report = gap_document(diagnose(measured, datasheet))
    twin = applied(datasheet, report)
    assert [name for name, _ in twin.effects] == report["verdict"]["effects"]
    assert diagnose(measured, twin).verdict.kind == "no_gap"


@pytest.mark.slow
def test_an_unknown_law_is_not_explained_away() -> None:
    """The logged displacement of one axis saturates softly: in the log only, so no part of the rig does it."""
    datasheet, truth = known_datasheet(seed=5)
    measured, datasheet = one_plane(experiment(true_rig(truth)), datasheet)

    def bent(sweep):
        Y, f = sweep.Y.copy(), sweep.harmonics.index(1)
        size = np.abs(Y[:, :, f, 0])
        Y[:, :, f, 0] *= 1 / (1 + (size / 8e-6) ** 2)
        return replace(sweep, Y=Y)

    d = diagnose(Experiment(measured.rig, measured.axes, tuple(bent(s) for s in measured.sweeps)), datasheet)
    assert d.verdict.kind == "none_of_these"
    assert gap_document(d)["where"]["path"] in ("controller", "plant")


@pytest.mark.slow
def test_one_sweep_is_cross_validated_and_says_so() -> None:
    datasheet, truth = known_datasheet(seed=6)
    rig = with_effects(true_rig(truth), {"loop_delay": {"delay_s": 3e-5}})
    one = replace(experiment(rig), sweeps=experiment(rig).sweeps[:1])
    d = diagnose(*one_plane(one, datasheet))
    assert d.verdict.effects == ("loop_delay",)
    assert any("weaker" in note for note in d.notes)


@pytest.mark.slow
def test_without_the_current_it_says_what_is_lost() -> None:
    datasheet, truth = known_datasheet(seed=7)
    full = experiment(with_effects(true_rig(truth), {"support_resonance": {"frequency_hz": 300.0}}))
    d = diagnose(*one_plane(replace(full, sweeps=tuple(replace(s, I=None) for s in full.sweeps)), datasheet))
    assert d.verdict.effects == ("support_resonance",)
    assert any("current was not logged" in note for note in d.notes)


def test_axes_that_do_not_match_are_refused() -> None:
    datasheet, truth = known_datasheet()
    measured = replace(experiment(true_rig(truth)), axes=("xA", "xB"))
    with pytest.raises(GapError, match="give the datasheet of the rig"):
        diagnose(measured, datasheet)
    with pytest.raises(GapError, match="in the datasheet's order"):
        diagnose(replace(measured, axes=("xA", "yA", "xB", "yB")), datasheet)


@pytest.mark.slow
def test_a_datasheet_without_modes_gets_them_from_the_experiment() -> None:
    datasheet, truth = known_datasheet(seed=8)
    rig = true_rig(truth)
    measured, unknown = one_plane(experiment(rig), replace(datasheet, modes=()))
    clean = diagnose(measured, unknown)
    assert clean.verdict.kind == "no_gap"
    (told,) = [note for note in clean.notes if "identified from this experiment" in note]
    first, second = (float(f) for f in re.findall(r"([\d.]+) Hz", told))
    assert (first, second) == pytest.approx([m.frequency_hz for m in truth.modes], rel=1e-3)
    housing = {"inverse_mass_per_kg": 1 / 900, "frequency_hz": 430.0}
    two = experiment(with_effects(rig, {"loop_delay": {"delay_s": 3e-5}, "support_resonance": housing}))
    found = diagnose(*one_plane(two, replace(datasheet, modes=()))).verdict
    assert found.effects == ("loop_delay", "support_resonance")


@pytest.mark.parametrize("n_modes", [0, 1])
def test_a_rotor_with_fewer_modes_than_two_is_diagnosed(n_modes: int) -> None:
    datasheet, truth = (replace(sheet, modes=sheet.modes[:n_modes]) for sheet in known_datasheet(seed=6))
    d = diagnose(*one_plane(experiment(true_rig(truth)), datasheet))
    assert d.verdict.kind == "no_gap"
    withheld = with_effects(true_rig(truth), {"eddy_currents": {"time_constant_s": 2e-6}})
    d = diagnose(*one_plane(experiment(withheld), datasheet))
    assert d.verdict.effects == ("eddy_currents",)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [2.0, 2.6])
def test_what_a_datasheet_without_tolerances_says_is_no_proof_of_an_effect_where_it_is_far_off(factor: float) -> None:
    """Magnets of a design sheet, much stronger than they are: all of them, and that is told."""
    datasheet, truth = known_datasheet(seed=8)
    ki = tuple(factor * ki for ki in truth.current_stiffness_n_per_a)
    ks = tuple((1 + 0.45 * (factor - 1)) * ks for ks in truth.position_stiffness_n_per_m)
    nominal = replace(
        datasheet, current_stiffness_n_per_a=ki, position_stiffness_n_per_m=ks, tolerance_stated=False, modes=()
    )
    d = diagnose(*one_plane(experiment(true_rig(truth)), nominal))
    assert d.verdict.kind == "no_gap"
    (told,) = [note for note in d.notes if "off beyond its tolerances" in note]
    percents = [float(x) for x in re.findall(r"current stiffness \w+ ([-+\d]+) %", told)]
    assert [100 / (1 + p / 100) for p in percents] == pytest.approx([100 / factor] * 2, abs=4)
    document = gap_document(d)
    assert document["verdict"]["sentence"].startswith("No effect is missing (probability ")
    assert "the datasheet is off beyond its tolerances (current stiffness " in document["verdict"]["sentence"]
    assert len(document["datasheet_off"]) >= 2


@pytest.mark.slow
@pytest.mark.parametrize("gain", [1.0, 2.0], ids=["the same controller", "another controller, too"])
def test_the_datasheet_of_another_rig_is_said_to_be_one(gain: float) -> None:
    datasheet, truth = known_datasheet(seed=9)
    other = replace(
        datasheet,
        numerator=tuple(gain * b for b in datasheet.numerator),
        mass_kg=0.3 * datasheet.mass_kg,
        modes=tuple(replace(m, frequency_hz=0.7 * m.frequency_hz) for m in datasheet.modes),
    )
    measured = experiment(true_rig(truth))
    d = diagnose(*one_plane(replace(measured, sweeps=measured.sweeps[:1]), other))
    assert d.verdict.kind == "none_of_these"
    said = gap_document(d)["verdict"]
    assert "of another rig" in " ".join(said["reasons"])
    assert said["sentence"].startswith("Nothing can be said of effects")
    assert "check it" in said["sentence"]


def test_of_many_values_that_what_nothing_explains_draws_away_a_few_are_named() -> None:
    far = [f"mode{k} damping x -90 %" for k in range(30)]
    told = values_off(far, unexplained=True)
    assert told.count("damping") == FARTHEST
    assert f"and {30 - FARTHEST} more (what nothing explains may have drawn them there)" in told
    assert values_off(far, unexplained=False).count("damping") == 30


@pytest.mark.parametrize(
    ("kind", "effects", "left", "significance", "drawn"),
    [
        ("effect", ("magnetic_hysteresis",), 0.16, 25.0, True),
        ("effect", ("magnetic_hysteresis",), 0.16, 2.0, False),
        ("effect", ("magnetic_hysteresis",), 0.001, 25.0, False),
        ("no_gap", (), 1.0, 0.0, False),
        ("none_of_these", (), 1.0, 25.0, True),
    ],
)
def test_what_an_effect_leaves_may_have_drawn_the_datasheet_s_values(
    kind: str, effects: tuple[str, ...], left: float, significance: float, drawn: bool
) -> None:
    """Plays for Bouc-Wen hysteresis: sensors seemed to be elsewhere by as much as a fit allows."""
    best = SimpleNamespace(unexplained=left)
    part = SimpleNamespace(chosen=SimpleNamespace(effects=effects), order=[best], remaining=significance)
    assert leaves_some(Verdict(kind, effects, (), 0.9, ()), [part]) is drawn
