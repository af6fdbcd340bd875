"""What would do the same as an effect and is none: a label, a sign, a scale, one bad point."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from service.experiment.data import Experiment
from service.gap.apply import applied
from service.gap.diagnose import diagnose
from service.gap.diagnosis import Diagnosis
from service.gap.document import gap_document, sentence
from service.gap.fitting.candidates import Candidate
from service.gap.fitting.fitted import Fit
from service.gap.fitting.part import Ground
from service.gap.hints import hints, unseen_modes, unsettled_lines
from service.gap.measured.observation import GapError, observe
from service.gap.which.explained import Explained
from sim.datasheet import Datasheet
from sim.effects import CATALOGUE
from sim.twin import rig_from_datasheet, with_effects
from tests.support.synthetic import HARMONICS, experiment, known_datasheet, true_rig
from tests.support.two_axes import one_plane

pytestmark = pytest.mark.slow

SHEET, TRUTH = known_datasheet(seed=61)
MEASURED = experiment(true_rig(TRUTH))


def with_point(measured: Experiment, sweep: int, factor: float) -> tuple[Experiment, float]:
    """One displacement of a sweep measured wrongly, and its frequency, Hz."""
    sweeps = list(measured.sweeps)
    s, k = sweeps[sweep], len(sweeps[sweep].axis) // 3
    Y = s.Y.copy()
    Y[k] *= factor
    sweeps[sweep] = replace(s, Y=Y)
    return replace(measured, sweeps=tuple(sweeps)), float(s.frequency_hz[k])


@pytest.mark.parametrize("sweep", [0, 1])
def test_one_bad_point_is_named(sweep: int) -> None:
    bad, sheet = one_plane(MEASURED, SHEET)
    bad, hz = with_point(bad, sweep, 1.5)
    d = diagnose(bad, sheet)
    told = [note for note in d.notes if "measure it again" in note]
    assert len(told) == 1
    assert f"of sweeps/{sweep} lies in one point, {hz:.4g} Hz" in told[0]
    assert not d.verdict.effects
    if d.verdict.kind == "no_gap":
        assert "but for a few points" in sentence(d)


def test_one_bad_point_is_named_beside_an_effect_too() -> None:
    late = experiment(with_effects(true_rig(TRUTH), {"loop_delay": {"delay_s": 3e-5}}))
    bad, sheet = one_plane(late, SHEET)
    bad, hz = with_point(bad, 1, 1.1)
    d = diagnose(bad, sheet)
    assert d.verdict.effects == ("loop_delay",)
    told = [note for note in d.notes if "measure it again" in note]
    assert len(told) == 1
    assert f"of sweeps/1 lies in one point, {hz:.4g} Hz" in told[0]


@pytest.mark.parametrize(("drift", "elsewhere", "told"), [(0.05, 1.0, True), (0.002, 1.0, False), (0.05, 9.0, False)])
def test_lines_at_which_the_rig_still_rang_are_named_where_most_is_left_there(
    drift: float, elsewhere: float, told: bool
) -> None:
    """Its blocks change little, and its response may be off by a third: the ringing of a narrow resonance is long."""
    o = observe(MEASURED.main, rig_from_datasheet(SHEET))
    hz = float(o.frequency_hz[9])
    rang = o.points_hz == hz
    z = elsewhere * np.ones(o.Y.shape, dtype=complex)
    z[rang] *= 40.0 / elsewhere
    ringing = replace(o, drifting=rang & (o.axis == 0), drift=np.where(rang, drift, 0.0))
    ground = SimpleNamespace(observations=(ringing,))
    found = unsettled_lines([Explained(cast(Ground, ground), (), (), (z,))])
    assert [f"at {hz:.4g} Hz" in words for words in found] == [True] * told


def test_a_clean_rig_has_no_bad_point() -> None:
    d = diagnose(*one_plane(MEASURED, SHEET))
    assert not any("measure it again" in note for note in d.notes)


@pytest.mark.parametrize(("highest_hz", "unseen"), [(100.0, 2), (600.0, 1), (1000.0, 0)])
def test_a_mode_that_no_line_comes_near_is_told_where_there_is_no_gap(highest_hz: float, unseen: int) -> None:
    rig = rig_from_datasheet(SHEET)
    o = replace(observe(MEASURED.main, rig), frequency_hz=np.geomspace(10.0, highest_hz, 120))
    notes = unseen_modes(rig, (o,))
    modes_hz = {m.natural_frequency_rad_s / (2 * np.pi) for plane in rig.rotor.modes for m in plane}
    assert len(notes) == min(unseen, 1)
    assert [f"{hz:.4g}" in "".join(notes) for hz in sorted(modes_hz)] == [hz > highest_hz for hz in sorted(modes_hz)]


def measured_turning(sheet: Datasheet, at_rad_s: float, stated_rad_s: float) -> Experiment:
    measured = experiment(replace(rig_from_datasheet(sheet), speed_rad_s=at_rad_s))
    return replace(measured, sweeps=tuple(replace(s, speed_rad_s=stated_rad_s) for s in measured.sweeps))


def turning(sheet: Datasheet, at_rad_s: float, stated_rad_s: float) -> Diagnosis:
    return diagnose(measured_turning(sheet, at_rad_s, stated_rad_s), sheet)


@pytest.mark.parametrize(
    ("stated_rad_s", "said"),
    [
        (100.0, ("shows 1 times", "a twin turns once it names gyroscopic coupling")),
        (100.0 * 30 / np.pi, ("shows 0.1 times", "100 rad/s")),
        (100.0 / (2 * np.pi), ("shows 6.3 times", "100 rad/s")),
        (-100.0, ("shows -1 times", "positive from x to y")),
    ],
)
def test_a_rotor_that_turns_has_the_moment_that_its_twin_lacks_and_a_wrong_speed_is_asked_about(
    stated_rad_s: float, said: tuple[str, ...]
) -> None:
    d = turning(replace(TRUTH, polar_inertia_kgm2=1.9), 100.0, stated_rad_s)
    assert d.verdict.effects == ("gyroscopic_coupling",)
    assert d.chosen.fit.values[0]["polar_inertia_kgm2"] == pytest.approx(1.9 * 100.0 / stated_rad_s, rel=0.03)
    (note,) = (note for note in d.notes if "gyroscopic moment" in note)
    assert all(words in note for words in said), note


def test_a_rotor_that_stands_has_no_effect_and_is_asked_whether_it_turns() -> None:
    standing = turning(replace(TRUTH, polar_inertia_kgm2=1.9), 0.0, 300.0)
    assert standing.verdict.kind == "no_gap"
    assert any("does it turn" in note for note in standing.notes)


def test_a_twin_that_turns_has_no_gap() -> None:
    """Of a twin with gyroscopic coupling the polar inertia that it states counts."""
    sheet = replace(TRUTH, polar_inertia_kgm2=1.9)
    turns = replace(sheet, effects=(("gyroscopic_coupling", (("polar_inertia_kgm2", 0.0), ("mode_coupling", 0.0))),))
    assert turning(turns, 100.0, 100.0).verdict.kind == "no_gap"
    twin = applied(sheet, gap_document(turning(sheet, 100.0, 100.0)))
    assert twin.polar_inertia_kgm2 is None
    again = diagnose(measured_turning(sheet, 100.0, 100.0), twin)
    assert again.verdict.kind == "no_gap"


def test_a_log_that_is_scaled_is_asked_about_where_a_controller_s_gain_is_blamed() -> None:
    measured, sheet = one_plane(MEASURED, SHEET)
    d = diagnose(replace(measured, sweeps=tuple(replace(s, Y=1.05 * s.Y) for s in measured.sweeps)), sheet)
    assert d.verdict.effects == ("controller_mismatch",)
    assert any("logged 1.05 times as large" in note for note in d.notes)


@pytest.mark.parametrize(("off", "asked"), [(0.001, True), (0.1, False)])
def test_a_resonance_where_the_datasheet_has_a_mode_has_that_mode_asked_about(off: float, asked: bool) -> None:
    """A shape whose values at A and B have two conventions of sign leaves that mode, and what cancels it."""
    rig, effect = rig_from_datasheet(SHEET), CATALOGUE["extra_flexible_mode"]
    values = {p.name: p.typical for p in effect.parameters} | {"frequency_hz": (1 + off) * SHEET.modes[0].frequency_hz}
    fit = Fit((effect.id,), np.zeros(1), (values,), effect.on(rig, **values), (), 0.0, np.arange(1), np.eye(1), "")
    o = observe(MEASURED.sweeps[0], rig)
    told = hints(Candidate(fit.effects, fit, 0.0, ({},)), rig, (o,))
    assert len(told) == asked
    assert all(f"({SHEET.modes[0].frequency_hz:.4g} Hz): check that mode's frequency" in text for text in told)


def test_of_sensor_gains_the_ratios_are_told() -> None:
    """The gain of both sensors of a plane trades against ki: 7 % of one came out as 21 and 13 % of both."""
    rig, effect = rig_from_datasheet(SHEET), CATALOGUE["sensor_gain"]
    values = {
        "gain_change_xA": 0.13,
        "gain_change_xB": 0.13 + 1.13 * 0.07,
        "gain_change_yA": 0.0,
        "gain_change_yB": 0.0,
    }
    found = effect.on(rig, **values)
    fit = Fit((effect.id,), np.zeros(1), (values,), found, (), 0.0, np.arange(1), np.eye(1), "")
    (told,) = hints(Candidate(fit.effects, fit, 0.0, ({},)), rig, (observe(MEASURED.sweeps[0], rig),))
    assert "xB reads 1.07 times what xA does and yB reads 1 times what yA does" in told


@pytest.mark.parametrize(("lag_s", "told"), [(1e-5, True), (1.5e-6, False)])
def test_what_amplifiers_lag_by_beside_their_bandwidth_may_be_a_delay(lag_s: float, told: bool) -> None:
    rig, effect = rig_from_datasheet(SHEET), CATALOGUE["amplifier_bandwidth"]
    values = {**effect.null(), "frequency_change": 0.2, "lag_s": lag_s}
    fit = Fit((effect.id,), np.zeros(1), (values,), effect.on(rig, **values), (), 0.0, np.arange(1), np.eye(1), "")
    notes = hints(Candidate(fit.effects, fit, 0.0, ({},)), rig, (observe(MEASURED.sweeps[0], rig),))
    assert any("lag by 10 us: a loop delay of as much" in note for note in notes) == told
    assert told or not notes


def test_a_current_that_one_sweep_lacks_is_used_in_neither() -> None:
    measured, sheet = one_plane(MEASURED, SHEET)
    main, other = measured.sweeps
    d = diagnose(replace(measured, sweeps=(main, replace(other, I=None))), sheet)
    assert d.verdict.kind == "no_gap"
    assert any("sweeps/1 has no coil current" in note for note in d.notes)


def test_lines_at_one_place_of_the_frequency_response_are_no_diagnosis() -> None:
    measured, sheet = one_plane(MEASURED, SHEET)
    main, other = measured.sweeps
    lines, of_line = np.unique(main.frequency_hz, return_inverse=True)
    beside = replace(main, frequency_hz=100 * (1 + 1e-6 * np.arange(len(lines)))[of_line])
    with pytest.raises(GapError, match=r"all its usable lines between 100 and 100\.0\d* Hz, which is one place"):
        diagnose(replace(measured, sweeps=(beside, other)), sheet)


def test_a_sweep_of_three_lines_is_no_diagnosis() -> None:
    measured, sheet = one_plane(MEASURED, SHEET)
    main, other = measured.sweeps
    few = main.select(np.isin(main.frequency_hz, np.unique(main.frequency_hz)[:4]))
    assert few.harmonics == HARMONICS
    with pytest.raises(GapError, match=r"sweeps/0 has 4 usable lines; a diagnosis needs at least 5"):
        diagnose(replace(measured, sweeps=(few, other)), sheet)
