"""A campaign goes on where another machine began it, whose processor has other last digits."""

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from drivers.errors import CancelledError
from service import checkup
from service.campaign import frequencies
from service.campaign.journal import entries, line
from service.campaign.knowledge import Knowledge
from service.campaign.run import recover, run_campaign
from service.cli import run
from service.experiment.errors import JournalError
from service.experiment.file import read
from tests.support.campaigns import SHEET, SMALL, Faulty, campaign, interrupted_at

TINY = replace(SMALL, points=16, validation_points=2, amplifier_points=2)
CHECK = replace(
    SMALL,
    points=9,
    validation_points=0,
    amplifier_points=0,
    frequencies_hz=tuple(np.geomspace(20.0, 700.0, 9).tolist()),
    settle_s=tuple(np.linspace(0.03, 0.031, 9).tolist()),
)
"""As a health check's: calculated, not written by anyone."""


@pytest.fixture
def another_processor(monkeypatch):
    """From now on every response and every grid comes out a few last digits larger."""
    response, grid = Knowledge.response, frequencies.np.geomspace

    def larger(self, axis, frequency_hz):
        found = response(self, axis, frequency_hz)
        return replace(found, **{name: getattr(found, name) * (1 + 3e-15) for name in ("u", "i", "y", "i_excited")})

    def begin():
        monkeypatch.setattr(Knowledge, "response", larger)
        monkeypatch.setattr(frequencies.np, "geomspace", lambda *words: grid(*words) * (1 + 1e-15))

    return begin


def interrupted(folder, n, profile=TINY):
    with pytest.raises(CancelledError):
        campaign(Faulty(interrupted_at(n, KeyboardInterrupt())), folder, profile)
    return folder / "experiment.journal"


def rewritten(path, change):
    """Entries of a journal once each of them, told the one after it, was changed."""
    header, *found = entries(path.read_bytes())[0]
    for entry, after in pairwise(found):
        change(entry, after)
    path.write_bytes(b"".join(line(e) for e in (header, *found)))
    return found


def assert_holds(experiment, before):
    """Every point that was measured before is in the experiment, as it was."""
    for old in before.sweeps:
        new = experiment.named(old.comment)
        for k in range(old.n_points):
            same = (new.frequency_hz == old.frequency_hz[k]) & (new.axis == old.axis[k])
            np.testing.assert_array_equal(new.Y[same][0], old.Y[k])


def test_a_campaign_goes_on_where_another_processor_began_it(tmp_path, another_processor):
    path = interrupted(tmp_path, 60)
    before = recover(tmp_path)
    begun = path.read_bytes()
    another_processor()
    again = Faulty(lambda k: None)
    experiment = campaign(again, tmp_path, TINY)
    assert_holds(experiment, before)
    assert 0 < again.n < len(entries(begun)[0]) + 80  # what was measured is not measured again


def test_what_was_measured_is_recovered_on_another_processor(tmp_path, another_processor, capsys):
    interrupted(tmp_path, 60)
    whole = {s.comment: s.n_points for s in recover(tmp_path).sweeps}
    (tmp_path / "experiment.h5").unlink()
    another_processor()
    assert run(["recover", str(tmp_path)]) == 0
    assert f"{whole['main'] + whole['preliminary']} points" in capsys.readouterr().out
    assert {s.comment: s.n_points for s in read(tmp_path / "experiment.h5").sweeps} == whole


def test_a_digit_that_was_rounded_the_other_way_changes_no_question(tmp_path):
    """An amplitude is one step of the controller larger and a wait one sample longer: they are what was measured."""
    path = interrupted(tmp_path, 60)

    def step(entry, after):
        if entry["phase"] in ("preliminary", "main") and entry["request"]["axis"] != after["request"]["axis"]:
            entry["request"]["amplitude_a"] += 1e-6
            entry["request"]["settle_samples"] += 1

    played = {e["request"]["amplitude_a"] for e in rewritten(path, step)}
    kept = recover(tmp_path)
    assert set(kept.named("preliminary").amplitude_a) <= played
    assert set(kept.main.amplitude_a) <= played
    experiment = campaign(Faulty(lambda k: None), tmp_path, TINY)
    assert set(kept.main.amplitude_a) <= set(experiment.main.amplitude_a)


def test_another_question_is_still_another_plan(tmp_path):
    path = interrupted(tmp_path, 60)

    def larger(entry, _):
        if entry["phase"] == "main":
            entry["request"]["amplitude_a"] *= 1.01

    rewritten(path, larger)
    with pytest.raises(JournalError, match=r"another plan.*--no-resume"):
        campaign(Faulty(lambda k: None), tmp_path, TINY)
    with pytest.raises(JournalError, match=r"another plan.*with the version that wrote it"):
        recover(tmp_path)


def test_what_a_controller_is_asked_to_play_it_can_set(tmp_path):
    """Whole microamperes: so the file has the amplitude that was played, on every machine the same."""
    experiment = campaign(Faulty(lambda k: None), tmp_path, TINY)
    for sweep in experiment.sweeps:
        steps = sweep.amplitude_a * 1e6
        np.testing.assert_allclose(steps, np.round(steps), rtol=0, atol=1e-6)
        assert np.all(steps[sweep.amplitude_a > 0] >= 1)


def check(folder, profile, fault):
    return checkup.measure_check(Faulty(fault), SHEET, SimpleNamespace(profile=profile), folder)


def test_a_check_that_another_processor_planned_goes_on_with_that_plan(tmp_path):
    with pytest.raises(CancelledError):
        check(tmp_path, CHECK, interrupted_at(60, KeyboardInterrupt()))
    measured = recover(tmp_path)
    assert "main" in [s.comment for s in measured.sweeps]
    planned = replace(
        CHECK,
        frequencies_hz=tuple(f * (1 + 1e-12) for f in CHECK.frequencies_hz),
        settle_s=tuple(s * (1 + 1e-9) for s in CHECK.settle_s),
    )
    experiment = check(tmp_path, planned, lambda k: None)
    assert_holds(experiment, measured)
    assert len(set(experiment.main.frequency_hz)) == len(CHECK.frequencies_hz)


def test_what_to_do_about_another_journal_fits_whoever_asks(tmp_path):
    with pytest.raises(CancelledError):
        check(tmp_path, CHECK, interrupted_at(60, KeyboardInterrupt()))
    other = replace(CHECK, settle_s=tuple(2 * s for s in CHECK.settle_s))
    with pytest.raises(JournalError, match=r"settle_s\.0 was .*; otherwise choose another folder$"):
        check(tmp_path, other, lambda k: None)
    with pytest.raises(JournalError, match=r"otherwise submit a new job$"):
        run_campaign(Faulty(None), SHEET, tmp_path, profile=other, anew="submit a new job")
