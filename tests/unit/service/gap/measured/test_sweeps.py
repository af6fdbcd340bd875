"""Which sweeps of an experiment a diagnosis uses."""

from dataclasses import replace

import numpy as np
import pytest

from service.campaign.points import SWEEPS
from service.gap.measured.observation import GapError, observe
from service.gap.measured.sweeps import (
    best_check,
    halves,
    notes_on,
    other_rate,
    silent_axes,
    sweeps_for,
    without_copied_blocks,
    without_copies,
)
from service.gap.observed import observed
from sim.errors import AmbError
from tests.support.synthetic import experiment, known_datasheet, true_rig
from tests.support.two_axes import one_plane

RIG = true_rig(known_datasheet()[1])
MEASURED = experiment(RIG)
MAIN, LOUDER = MEASURED.sweeps


def test_sweeps_that_are_not_of_the_plant_or_not_exact_enough_are_left_out() -> None:
    """All that a campaign writes: what is left are the sweep to fit and the one to check on."""
    of_campaign = [
        replace(MAIN, comment=comment, kind="noise" if comment == "noise" else MAIN.kind) for comment in SWEEPS
    ]
    named = sweeps_for(replace(MEASURED, sweeps=tuple(of_campaign)))
    assert [sweep.comment for _, sweep in named] == ["main", "validation"]
    assert [name for name, _ in named] == [f"sweeps/{SWEEPS.index(c)}" for c in ("main", "validation")]


@pytest.mark.parametrize(("told_rad_s", "speed_rad_s"), [(0.02, 0.0), (-0.3, 0.0), (300.0, 300.0)])
def test_a_rotor_that_rests_has_no_speed_though_its_controller_tells_a_little(told_rad_s, speed_rad_s) -> None:
    """Else effects of a turning rotor would be weighed, and runout looked for at a turn in five minutes."""
    named = sweeps_for(replace(MEASURED, sweeps=tuple(replace(s, speed_rad_s=told_rad_s) for s in MEASURED.sweeps)))
    assert [sweep.speed_rad_s for _, sweep in named] == [speed_rad_s] * 2


def test_of_several_sweeps_the_first_at_another_condition_is_the_one_to_check_on() -> None:
    others = [("sweeps/1", MAIN), ("sweeps/2", LOUDER), ("sweeps/3", LOUDER)]
    (name, _), unused = best_check(MAIN, others, RIG)
    assert name == "sweeps/2"
    assert unused == ["sweeps/1", "sweeps/3"]
    assert best_check(MAIN, others[:1], RIG) == (others[0], [])


def test_no_line_of_the_half_that_no_fit_sees_is_fitted_however_few_there_are() -> None:
    few = observe(LOUDER.select(np.isin(LOUDER.frequency_hz, np.unique(LOUDER.frequency_hz)[:3])), RIG)
    both = halves(few, "sweeps/1")
    assert both is not None
    seen, unseen, name = both
    assert not set(seen.frequency_hz) & set(unseen.frequency_hz)
    assert len(seen.frequency_hz) + len(unseen.frequency_hz) == 3
    assert name == "sweeps/1, every other line"
    assert halves(few.select(np.array([True, False, False])), "sweeps/1") is None


def test_a_log_at_another_rate_than_the_datasheets_controller_is_told() -> None:
    datasheet = known_datasheet()[0]
    assert other_rate(MAIN, datasheet) is None
    told = other_rate(replace(MAIN, sample_rate_hz=20e3), datasheet)
    assert told is not None
    assert "20000 samples a second" in told
    assert "sample_time_s" in told


def test_blocks_that_are_copies_of_one_another_are_left_out() -> None:
    twice = MAIN.with_blocks([0, 0, 1, 1, 2, 2])
    ((_, left), _), (told,) = without_copied_blocks([("sweeps/0", twice), ("sweeps/1", LOUDER)])
    np.testing.assert_array_equal(left.Y, MAIN.Y[:, :3])
    np.testing.assert_array_equal(left.U, MAIN.U[:, :3])
    assert "sweeps/0: of 6 blocks of a point 3 were measured" in told
    lost = twice.Y.copy()
    lost[3] = np.nan  # a point that was not measured says nothing for the others
    assert len(without_copied_blocks([("sweeps/0", replace(twice, Y=lost))])[1]) == 1
    assert without_copied_blocks([("sweeps/0", MAIN), ("sweeps/1", LOUDER)])[1] == []


def test_a_sweep_of_means_is_no_check_and_an_experiment_of_means_no_ground_for_any_verdict() -> None:
    """What is left of a gap may be noise that all copies of a mean share."""
    main, louder = (
        replace(s, **{name: np.repeat(getattr(s, name).mean(axis=1, keepdims=True), 6, axis=1) for name in "RUIY"})
        for s in (MAIN, LOUDER)
    )
    data = observed(replace(MEASURED, sweeps=(MAIN, louder)), known_datasheet()[0])
    assert data.lines_only
    assert any("sweeps/1: the blocks of a point are copies" in note for note in data.notes)
    with pytest.raises(GapError, match="copies of one another: how much of the data is noise is not known"):
        observed(replace(MEASURED, sweeps=(main, louder)), known_datasheet()[0])


def test_a_copy_of_a_sweep_is_no_data_that_no_fit_has_seen() -> None:
    copied = replace(MEASURED, sweeps=(MAIN, replace(MAIN, comment="validation")))
    data = observed(copied, known_datasheet()[0])
    assert data.lines_only
    assert any("all points of sweeps/1 are copies" in note for note in data.notes)
    assert any("one sweep only" in note for note in data.notes)


def test_points_that_are_copies_are_left_out_and_those_that_were_measured_again_are_not() -> None:
    twice = MAIN.select(np.concatenate([np.arange(MAIN.n_points), np.arange(6)]))
    again = replace(MAIN, Y=MAIN.Y * (1 + 1e-5))
    ((name, one), (_, other)), (told,) = without_copies([("sweeps/0", twice), ("sweeps/1", again)])
    assert (name, one.n_points, other.n_points) == ("sweeps/0", MAIN.n_points, MAIN.n_points)
    assert told.startswith(f"6 of {twice.n_points} points of sweeps/0 are copies")
    assert without_copies([("sweeps/0", MAIN), ("sweeps/1", LOUDER)])[1] == []


def test_a_copy_in_single_precision_is_one() -> None:
    single = replace(MAIN, U=MAIN.U.astype(np.complex64).astype(complex), Y=MAIN.Y.astype(np.complex64).astype(complex))
    left, (told,) = without_copies([("sweeps/0", MAIN), ("sweeps/1", single)])
    assert [name for name, _ in left] == ["sweeps/0"]
    assert told.startswith("all points of sweeps/1 are copies")


def test_without_harmonics_it_is_told_what_cannot_be_seen() -> None:
    one = replace(MAIN, harmonics=(0, 1), **{name: getattr(MAIN, name)[:, :, :2] for name in ("R", "U", "I", "Y")})
    (told,) = set(notes_on(one, True, known_datasheet()[0])) - set(notes_on(MAIN, True, known_datasheet()[0]))
    assert "holds no harmonics" in told


def test_axes_that_are_never_excited_are_told() -> None:
    axes = MEASURED.axes
    assert silent_axes([("sweeps/0", MAIN), ("sweeps/1", LOUDER)], axes) == []
    (told,) = silent_axes([("sweeps/0", MAIN), ("sweeps/1", LOUDER.select(LOUDER.axis < 2))], axes)
    assert told.startswith("sweeps/1 does not excite yA, yB")
    first = replace(MEASURED, sweeps=tuple(s.select(s.axis == 0) for s in MEASURED.sweeps))
    notes = observed(first, known_datasheet()[0]).notes
    assert sum("does not excite xB, yA, yB" in note for note in notes) == 2


def test_a_dead_log_is_told_as_dead_though_its_blocks_are_alike() -> None:
    dead = tuple(replace(s, Y=np.zeros_like(s.Y)) for s in MEASURED.sweeps)
    with pytest.raises(AmbError, match="channel of the log is dead"):
        observed(replace(MEASURED, sweeps=dead), known_datasheet()[0])


def test_a_datasheet_with_dampings_in_per_cent_is_told_beside_the_verdict() -> None:
    sheet = known_datasheet()[0]
    per_cent = replace(sheet, modes=tuple(replace(m, damping_ratio=100 * m.damping_ratio) for m in sheet.modes))
    assert any("is it in per cent?" in note for note in observed(MEASURED, per_cent).notes)


def test_a_sweep_too_short_to_check_on_is_left_out_with_its_reason() -> None:
    short = replace(LOUDER.select(np.arange(LOUDER.n_points) < 6), comment="low lines")
    data = observed(replace(MEASURED, sweeps=(MAIN, short, LOUDER)), known_datasheet()[0])
    assert (data.name, data.lines_only) == ("sweeps/2", False)
    (told,) = [note for note in data.notes if note.startswith("sweeps/1 is not used")]
    assert "6 usable points" in told
    alone = observed(replace(MEASURED, sweeps=(MAIN, short)), known_datasheet()[0])
    assert alone.lines_only


def test_a_sweep_that_is_too_short_for_halves_is_told_as_that() -> None:
    measured, sheet = one_plane(MEASURED, known_datasheet()[0])
    (main, _) = measured.sweeps
    few = main.select(np.isin(main.frequency_hz, np.unique(main.frequency_hz)[::8][:7]))
    with pytest.raises(GapError, match="the only sweep, so that half of its lines is fitted"):
        observed(replace(measured, sweeps=(few,)), sheet)
