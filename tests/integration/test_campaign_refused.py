"""What a campaign refuses before anything moves, and what it does with files that lie in its folder."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from drivers.controller import Capabilities, State, Status
from drivers.errors import BusError, CancelledError, LeaseError
from drivers.simulated.driver import SimulatedController
from service.bootstrap import measure, write_datasheet
from service.campaign.journal import entries, line
from service.campaign.run import LOCK, recover, recover_into_file, run_campaign
from service.cli import run
from service.errors import ConflictError, OutputError
from service.experiment.errors import CampaignError, JournalError
from service.experiment.file import read
from service.experiment.speeds import changed_speed
from sim.reference import reference_rig
from tests.support.campaigns import SHEET, SMALL, Faulty, assert_same, campaign, interrupted_at


def assert_refused(error, match, controller, folder, sheet=SHEET, **options):
    with pytest.raises(error, match=match) as caught:
        run_campaign(controller, sheet, folder, profile=SMALL, **options)
    assert "\n" not in str(caught.value)
    assert controller.n == 0


def test_a_folder_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    assert_refused(OutputError, "nothing was started", Faulty(None), tmp_path / "file" / "out")


def test_a_datasheet_of_another_rig(tmp_path):
    other = replace(SHEET, axes=("xA", "xB"))
    assert_refused(CampaignError, "give the datasheet of this rig", Faulty(None), tmp_path, other)
    assert_refused(CampaignError, "sample_time_s", Faulty(None), tmp_path, replace(SHEET, sample_time_s=5e-5))


@pytest.mark.parametrize("told", [math.nan, math.inf, 0.0])
@pytest.mark.parametrize("name", ["sample_rate_hz", "max_amplitude_a", "displacement_limit_m", "current_limit_a"])
def test_a_controller_whose_figures_are_none_that_a_plan_can_go_by(tmp_path, name, told):
    class Odd(Faulty):
        def capabilities(self) -> Capabilities:
            return replace(self.inner.capabilities(), **{name: told})

    assert_refused(CampaignError, rf"tells identity\.{name} as {told:g}, .*correct it", Odd(None), tmp_path)


def test_a_rig_that_another_host_holds(tmp_path):
    rig = Faulty(None)
    other = SimulatedController(rig.inner._device)
    with other.lease("another host"):
        assert_refused(LeaseError, "another host", rig, tmp_path)


@pytest.mark.parametrize(("state", "said"), [(State.TRIPPED, "acknowledge it first"), (State.OFF, "switch it on")])
def test_a_rig_that_is_tripped_or_off(tmp_path, state, said):
    class Down(Faulty):
        def status(self) -> Status:
            return replace(self.inner.status(), state=state, trip_message="displacement of axis xA")

    assert_refused(CampaignError, said, Down(None), tmp_path)


def test_a_journal_of_another_rig_or_profile(tmp_path):
    with pytest.raises(CancelledError):
        campaign(Faulty(interrupted_at(20, KeyboardInterrupt())), tmp_path)
    before = (tmp_path / "experiment.journal").read_bytes()
    assert_refused(
        JournalError,
        r"rotor\.mass_kg .* now it is 281\.0; .*--no-resume",
        Faulty(None),
        tmp_path,
        replace(SHEET, mass_kg=281.0),
    )
    assert (tmp_path / "experiment.journal").read_bytes() == before
    smaller = replace(SHEET, displacement_limit_m=5e-5, linear_range_m=1e-4)
    told = r"bearings\.linear_range_m .*; limits\.displacement_m of the datasheet was .*, now it is 5e-05; "
    assert_refused(JournalError, told, Faulty(None), tmp_path, smaller)
    with pytest.raises(JournalError, match=r"profile\.points was 24, now it is 25"):
        campaign(Faulty(None), tmp_path, replace(SMALL, points=25))


class Turning(Faulty):
    """A rig whose rotor turns, as its status says."""

    speed_rad_s = 314.0

    def status(self) -> Status:
        return replace(self.inner.status(), speed_rad_s=self.speed_rad_s)


def test_a_speed_at_which_no_rotor_turns(tmp_path):
    """The file of the whole campaign would be refused for it; told by a glitch on the way, it is that point's alone."""
    rig = Turning(None)
    rig.speed_rad_s = 3e5
    assert_refused(CampaignError, r"the controller tells is 3e\+05 rad/s, .* check it and its unit", rig, tmp_path)
    glitch = Turning(lambda k: setattr(glitch, "speed_rad_s", -1e9 if k == 40 else 314.0))
    campaign(glitch, tmp_path, TINY)
    assert {s.speed_rad_s for s in read(tmp_path / "experiment.h5").sweeps} == {314.0}


def test_a_journal_of_another_speed(tmp_path):
    """One sweep has one speed: what was measured at standstill is no part of a sweep at speed."""
    with pytest.raises(CancelledError):
        campaign(Faulty(interrupted_at(20, KeyboardInterrupt())), tmp_path)
    before = (tmp_path / "experiment.journal").read_bytes()
    told = "turned at 0 rad/s when this campaign began, and turns at 314 rad/s now.*--no-resume"
    assert_refused(JournalError, told, Turning(None), tmp_path)
    assert (tmp_path / "experiment.journal").read_bytes() == before


def test_a_speed_that_differs_by_little_is_the_one_at_which_the_campaign_began(tmp_path):
    first = Turning(interrupted_at(20, KeyboardInterrupt()))
    with pytest.raises(CancelledError):
        campaign(first, tmp_path, TINY)
    second = Turning(lambda k: None)
    second.speed_rad_s = 315.5
    assert {s.speed_rad_s for s in campaign(second, tmp_path, TINY).sweeps} == {314.0}


def test_a_rotor_that_changes_speed_under_way_is_told_with_its_lines(tmp_path):
    """As one that runs down: every point has the speed at which it was measured."""
    rig = Turning(lambda k: setattr(rig, "speed_rad_s", 314.0 - k))
    experiment = campaign(rig, tmp_path, TINY)
    left = 314.0 - rig.n
    assert experiment.attributes["speed_changed"] == f"from 314 to {left:.4g} rad/s"
    (told,) = changed_speed(experiment)
    main = experiment.main
    speeds = main.point_speed_rad_s
    assert len(np.unique(speeds)) > 8
    assert speeds.min() < 314.0 - main.n_points < speeds.max()
    away = np.abs(speeds - 314.0) > 1.0 + 3.14
    assert f"at {away.sum()} of {main.n_points} points of main (" in told
    assert f"{speeds[away].min():.4g} to {speeds[away].max():.4g} rad/s in place of 314" in told
    assert {s.speed_rad_s for s in experiment.sweeps} == {314.0}
    assert [told] == changed_speed(read(tmp_path / "experiment.h5"))


def test_a_speed_that_came_back_before_the_end_is_told(tmp_path):
    """Read as a campaign begins and ends alone it would not be seen."""
    rig = Turning(lambda k: setattr(rig, "speed_rad_s", 100.0 if k in (40, 41) else 314.0))
    experiment = campaign(rig, tmp_path, TINY)
    assert "speed_changed" not in experiment.attributes
    (told,) = changed_speed(experiment)
    (sweep,) = [s for s in experiment.sweeps if (s.point_speed_rad_s == 100.0).any()]
    (line,) = np.unique(sweep.frequency_hz[sweep.point_speed_rad_s == 100.0])[:1]
    assert f"{line:.4g}" in told
    assert "100 rad/s in place of 314" in told


def test_speeds_are_kept_over_an_interruption(tmp_path):
    """Those of the points that the first run measured, too, and by ambit recover."""
    first = Turning(interrupted_at(30, KeyboardInterrupt()))
    with pytest.raises(CancelledError):
        campaign(first, tmp_path, TINY)
    kept = [s.point_speed_rad_s for s in recover(tmp_path).sweeps]
    assert kept
    assert all((speeds == 314.0).all() for speeds in kept)
    second = Turning(lambda k: None)
    second.speed_rad_s = 315.5
    speeds = np.concatenate([s.point_speed_rad_s for s in campaign(second, tmp_path, TINY).sweeps])
    assert set(speeds.tolist()) == {314.0, 315.5}


class Mute(Turning):
    """A controller whose status cannot be read while it is measured."""

    def status(self) -> Status:
        if self.n:
            raise BusError("no answer")
        return super().status()


def test_a_status_that_cannot_be_read_spoils_no_measurement(tmp_path):
    experiment = campaign(Mute(lambda k: None), tmp_path, TINY)
    assert experiment.main.n_points
    assert changed_speed(experiment) == []


def test_a_campaign_that_is_refused_leaves_the_datasheet_of_the_other_one(tmp_path):
    with pytest.raises(CancelledError):
        campaign(Faulty(interrupted_at(5, KeyboardInterrupt())), tmp_path)
    path = write_datasheet(tmp_path, SHEET)
    before = path.read_text()
    with pytest.raises(JournalError, match=r"rotor\.mass_kg of the datasheet"):
        measure(Faulty(None), replace(SHEET, mass_kg=281.0), tmp_path, profile=SMALL)
    assert path.read_text() == before


TINY = replace(SMALL, points=16, validation_points=2, amplifier_points=2)


def names(folder):
    return {p.name for p in folder.iterdir()}


def test_starting_anew_puts_the_old_journal_and_experiment_aside(tmp_path):
    with pytest.raises(CancelledError):
        campaign(Faulty(interrupted_at(60, KeyboardInterrupt())), tmp_path, TINY)
    before = read(tmp_path / "experiment.h5")
    campaign(SimulatedController(reference_rig(), seed=2), tmp_path, TINY, resume=False)
    assert names(tmp_path) == {"experiment.h5", "experiment.previous-1.h5", "experiment.previous-1.journal"}
    assert_same(read(tmp_path / "experiment.previous-1.h5"), before)


def test_the_journal_of_a_campaign_that_runs_stays_its_own(tmp_path):
    """Another host that would start anew in its folder does not have the rig, and moves no file."""
    during = []

    def meanwhile(k):
        if k == 40:
            other = SimulatedController(rig.inner._device)
            with pytest.raises(LeaseError):
                campaign(other, tmp_path, TINY, resume=False)
            during.extend(names(tmp_path))

    rig = Faulty(meanwhile)
    campaign(rig, tmp_path, TINY)
    assert set(during) == {"experiment.journal", LOCK}
    assert names(tmp_path) == {"experiment.h5"}


@pytest.mark.parametrize("resume", [True, False])
def test_campaigns_of_two_rigs_do_not_write_into_one_folder(tmp_path, resume):
    kept, refused = [], []

    def meanwhile(k):
        if k == 40:
            kept.append((tmp_path / "experiment.journal").read_bytes())
            other = Faulty(lambda n: None)  # a rig of its own, whose lease keeps nobody out
            with pytest.raises(ConflictError) as error:
                campaign(other, tmp_path, TINY, resume=resume)
            refused.append(str(error.value))
            assert (other.n, other.status().lease_holder) == (0, "")
            assert (tmp_path / "experiment.journal").read_bytes() == kept[0]
            recover_into_file(tmp_path)  # to look at what there is disturbs nobody

    campaign(Faulty(meanwhile), tmp_path, TINY)
    assert refused == [f"another campaign is at work in {tmp_path}; wait for its end, or choose another folder"]
    assert names(tmp_path) == {"experiment.h5"}


def test_a_resumed_campaign_leaves_nothing_of_the_interruption(tmp_path):
    for n in (60, 20):
        with pytest.raises(CancelledError):
            campaign(Faulty(interrupted_at(n, KeyboardInterrupt())), tmp_path, TINY)
        assert names(tmp_path) == {"experiment.h5", "experiment.journal"}
    campaign(Faulty(lambda k: None), tmp_path, TINY)
    assert names(tmp_path) == {"experiment.h5"}


def test_an_interrupted_campaign_does_not_cost_the_one_before(tmp_path):
    whole = campaign(Faulty(lambda k: None), tmp_path, TINY)
    with pytest.raises(CancelledError):
        campaign(SimulatedWithInterrupt(), tmp_path, TINY)
    assert names(tmp_path) == {"experiment.h5", "experiment.previous-1.h5", "experiment.journal"}
    assert_same(read(tmp_path / "experiment.previous-1.h5"), whole)


class SimulatedWithInterrupt(Faulty):
    """Another noise, and Ctrl-C on the way."""

    def __init__(self):
        super().__init__(interrupted_at(60, KeyboardInterrupt()))
        self.inner = SimulatedController(reference_rig(), seed=2)


def test_a_journal_whose_next_point_is_another_one(tmp_path):
    with pytest.raises(CancelledError):
        campaign(Faulty(interrupted_at(20, KeyboardInterrupt())), tmp_path)
    path = tmp_path / "experiment.journal"
    found, _ = entries(path.read_bytes())
    found[10]["request"]["samples"] += 1
    path.write_bytes(b"".join(line(e) for e in found))
    with pytest.raises(JournalError, match="another plan"):
        campaign(Faulty(lambda k: None), tmp_path)


def test_recovering_without_a_journal(tmp_path, capsys):
    with pytest.raises(JournalError, match="cannot read"):
        recover(tmp_path)
    assert run(["recover", str(tmp_path)]) == 1
    assert "cannot read the journal" in capsys.readouterr().err


def test_recovering_what_is_complete(tmp_path, capsys):
    campaign(Faulty(lambda k: None), tmp_path, TINY)
    path = tmp_path / "experiment.h5"
    before = path.read_bytes()
    assert run(["recover", str(tmp_path)]) == 0
    assert f"the campaign is complete, nothing is left to recover: {path}" in " ".join(capsys.readouterr().out.split())
    assert run(["recover", str(tmp_path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["complete"] is True
    assert path.read_bytes() == before


@pytest.mark.parametrize("n", [1, 12, 60])
def test_what_was_measured_is_recovered_and_a_file_that_has_more_stays(tmp_path, capsys, n):
    with pytest.raises(CancelledError):
        campaign(Faulty(interrupted_at(n, KeyboardInterrupt())), tmp_path)
    path, content = tmp_path / "experiment.h5", (tmp_path / "experiment.journal").read_bytes()
    excited = sum(s.n_points for s in recover(tmp_path).sweeps if s.kind != "noise")
    path.unlink(missing_ok=True)
    assert run(["recover", str(tmp_path)]) == (0 if excited else 1)
    told = capsys.readouterr()
    assert ("holds no excited point yet" in told.err) is (excited == 0)
    if excited:
        assert f"{excited} points" in told.out
        found = path.read_bytes()
        first, _ = entries(content)
        (tmp_path / "experiment.journal").write_bytes(b"".join(line(e) for e in first[:-4]))
        assert run(["recover", str(tmp_path)]) in (0, 1)
        assert path.read_bytes() == found


@pytest.mark.parametrize("profile", [SMALL, replace(SMALL, from_hz=1.0, frequencies_hz=(9.5, 20.0))])
def test_a_controller_that_plays_none_of_the_frequencies_is_told_before_anything_moves(tmp_path, profile):
    class Low(Faulty):
        def capabilities(self):
            return replace(self.inner.capabilities(), max_frequency_hz=9.0)

    rig = Low(lambda k: None)
    with pytest.raises(CampaignError, match="plays tones below 9 Hz, and the lowest that is asked for is"):
        campaign(rig, tmp_path, profile)
    assert rig.n == 0
