"""A campaign that is interrupted, cancelled or cut off from its rig: the rig is quiet, the points are kept."""

import threading
from dataclasses import replace

import numpy as np
import pytest

from drivers.errors import BusError, CancelledError, StoppedElsewhereError
from service.campaign.journal import read as entries_of
from service.campaign.multisine.plan import MultisineProfile
from service.campaign.run import recover
from service.experiment.errors import ExperimentFileError
from service.experiment.file import read
from service.experiment.incomplete import incomplete
from sim.reference import reference_rig
from tests.support.campaigns import SMALL, Faulty, assert_same, campaign, interrupted_at, plant


@pytest.mark.parametrize("n", [1, 3, 40, 120])
def test_a_keyboard_interrupt_stops_the_rig_keeps_the_points_and_can_be_resumed(tmp_path, whole, n):
    rig = Faulty(interrupted_at(n, KeyboardInterrupt()))
    with pytest.raises(CancelledError, match="run it again"):
        campaign(rig, tmp_path)
    assert rig.stops
    assert rig.status().excitation_a == 0
    assert rig.status().lease_holder == ""
    kept = recover(tmp_path)
    if n >= 40:
        assert_same(read(tmp_path / "experiment.h5"), kept)
        assert kept.named("preliminary").n_points > 0
        assert "stopped" in incomplete(read(tmp_path / "experiment.h5"))[0]
    resumed = Faulty(lambda k: None)
    # the same noise as in the uninterrupted run: play to the device what was already measured
    experiment = campaign(resumed, tmp_path)
    assert [s.comment for s in experiment.sweeps] == [s.comment for s in whole[1].sweeps]
    for old, new in zip(kept.sweeps, (experiment.named(s.comment) for s in kept.sweeps), strict=True):
        for f, axis, y in zip(old.frequency_hz, old.axis, old.Y, strict=True):
            match = (new.frequency_hz == f) & (new.axis == axis)
            assert match.sum() == 1
            np.testing.assert_array_equal(new.Y[match][0], y)
    assert not (tmp_path / "experiment.journal").exists()
    assert not incomplete(read(tmp_path / "experiment.h5"))
    plant(experiment.main)


class WithoutPeaks(Faulty):
    """A controller that tells no peaks, as a vendor's may."""

    def measure(self, tone):
        return replace(super().measure(tone), peak_displacement_m=np.nan, peak_current_a=np.inf)

    def measure_periodic(self, waveform):
        self.n += 1
        self.fault(self.n)
        result = self.inner.measure_periodic(waveform)
        return replace(result, peak_displacement_m=np.nan, peak_current_a=np.nan)


@pytest.mark.parametrize("profile", [SMALL, MultisineProfile(lines=20, periods=2, realisations=2)])
def test_a_controller_that_tells_no_peaks_loses_no_point(tmp_path, profile):
    """Also of those that an earlier run measured."""
    with pytest.raises(CancelledError, match="run it again"):
        campaign(WithoutPeaks(interrupted_at(12, KeyboardInterrupt())), tmp_path, profile)
    _, found = entries_of(tmp_path / "experiment.journal")
    assert len(found) == 11
    second = WithoutPeaks(interrupted_at(8, KeyboardInterrupt()))
    with pytest.raises(CancelledError, match="run it again"):
        campaign(second, tmp_path, profile)
    _, more = entries_of(tmp_path / "experiment.journal")
    assert len(more) == 18
    assert more[3]["peak_displacement_m"] is None
    recover(tmp_path)


def test_a_stop_from_elsewhere_is_told_as_one_with_what_is_kept(tmp_path):
    with pytest.raises(StoppedElsewhereError, match="points are kept in"):
        campaign(Faulty(interrupted_at(40, StoppedElsewhereError("stopped from elsewhere"))), tmp_path)


def test_a_resumed_campaign_measures_only_what_is_missing(tmp_path):
    first = Faulty(interrupted_at(100, KeyboardInterrupt()))
    with pytest.raises(CancelledError):
        campaign(first, tmp_path)
    second = Faulty(lambda k: None)
    reports = []
    campaign(second, tmp_path, progress=reports.append)
    third = Faulty(lambda k: None)
    campaign(third, tmp_path / "anew")
    assert abs(second.n + 99 - third.n) < 25  # other noise, other repetitions
    rates = [r.points_per_s for r in reports]
    assert rates[0] == 0  # what an earlier run measured says nothing of the rate


def test_cancelling_from_elsewhere_ends_within_a_tone(tmp_path):
    flag = threading.Event()
    reports = []

    def progress(report):
        reports.append(report)
        if report.done == 30:
            flag.set()

    with pytest.raises(CancelledError, match="points are kept"):
        campaign(reference_rig(), tmp_path, progress=progress, cancelled=flag.is_set)
    assert len(reports) <= 31
    assert sum(s.n_points for s in recover(tmp_path).sweeps if s.kind != "noise") >= 20


def test_cancelling_stops_a_tone_that_is_being_played(tmp_path):
    class Slow(Faulty):
        """Measurements that would take for ever, but for a stop."""

        stopped = threading.Event()

        def measure(self, tone):
            self.n += 1
            if self.n < 5:
                return self.inner.measure(tone)
            assert self.stopped.wait(30)
            raise CancelledError("stopped; the excitation is off")

        def stop(self):
            super().stop()
            self.stopped.set()

    rig = Slow(None)
    with pytest.raises(CancelledError):
        campaign(rig, tmp_path, cancelled=lambda: rig.n >= 5)
    assert rig.stops >= 1


def test_cancelling_is_said_until_it_is_heard(tmp_path):
    class Deaf(Faulty):
        """A stop that comes just before the next tone begins is none of that tone."""

        stopped = threading.Event()

        def measure(self, tone):
            self.n += 1
            if self.n < 5:
                return self.inner.measure(tone)
            assert self.stopped.wait(30)
            self.stopped.clear()
            assert self.stopped.wait(30), "said once, it was never heard"
            raise CancelledError("stopped; the excitation is off")

        def stop(self):
            super().stop()
            self.stopped.set()

    rig = Deaf(None)
    with pytest.raises(CancelledError):
        campaign(rig, tmp_path, cancelled=lambda: rig.n >= 5)


def test_a_bus_that_fails_now_and_then_costs_nothing(tmp_path, whole):
    def fault(k):
        if k % 40 == 7:
            raise BusError("no answer within 0.3 s")

    assert_same(campaign(Faulty(fault), tmp_path), whole[1])


def test_a_bus_that_fails_for_good_ends_the_campaign_and_keeps_the_points(tmp_path, monkeypatch):
    monkeypatch.setattr("service.campaign.leased.FIRST_PAUSE_S", 0.001)

    def fault(k):
        if k >= 60:
            raise BusError("no answer within 0.3 s")

    rig = Faulty(fault)
    with pytest.raises(BusError, match="no answer"):
        campaign(rig, tmp_path)
    assert rig.n == 65
    assert rig.stops
    assert read(tmp_path / "experiment.h5").main.n_points > 4


def test_a_bus_that_fails_slowly_is_given_up_after_a_minute_and_not_after_many(tmp_path, monkeypatch):
    clock = [0.0]
    monkeypatch.setattr("service.campaign.leased.time.monotonic", lambda: clock[0])
    monkeypatch.setattr("service.campaign.leased.time.sleep", lambda seconds: None)

    def fault(k):
        if k >= 10:
            clock[0] += 40.0  # as long as a driver tries to fetch a long record over a bus that loses frames
            raise BusError("frames are lost")

    rig = Faulty(fault)
    with pytest.raises(BusError, match="frames are lost"):
        campaign(rig, tmp_path)
    assert rig.n == 12


def test_a_file_that_cannot_be_written_stops_nobody_who_has_leased_the_rig_since(tmp_path, monkeypatch):
    def full(path, experiment):
        raise ExperimentFileError("the disk is full")

    monkeypatch.setattr("service.experiment.file.write", full)
    rig = Faulty(lambda k: None)
    with pytest.raises(ExperimentFileError, match="the disk is full"):
        campaign(rig, tmp_path)
    assert rig.n
    assert rig.stops == 0
    assert recover(tmp_path).main.n_points > 4


def test_points_that_cannot_be_put_together_do_not_hide_what_ended_the_campaign(tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr("service.campaign.run.experiment", lambda *_: 1 // 0)
        with pytest.raises(CancelledError, match="run it again") as told:
            campaign(Faulty(interrupted_at(40, KeyboardInterrupt())), tmp_path)
    assert recover(tmp_path).named("preliminary").n_points > 0
    assert "39 measurements are kept in the journal" in str(told.value), "none of them is lost"
    assert "no experiment.h5 could be made of them" in str(told.value)


def test_an_experiment_that_cannot_be_written_is_not_told_as_kept(tmp_path, monkeypatch):
    def full(path, experiment):
        raise ExperimentFileError("the disk is full")

    monkeypatch.setattr("service.experiment.file.write", full)
    with pytest.raises(CancelledError, match=r"39 measurements are kept in the journal.*the disk is full"):
        campaign(Faulty(interrupted_at(40, KeyboardInterrupt())), tmp_path)
