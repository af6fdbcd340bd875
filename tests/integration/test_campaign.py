"""A campaign on the simulated rig: what it measures, what it survives, what it refuses."""

import json
import threading
from dataclasses import replace

import numpy as np
import pytest

from drivers.controller import State, Status
from drivers.errors import BusError, CancelledError, LeaseError
from drivers.simulated.driver import SimulatedController
from service.experiment.campaign import recover, run_campaign
from service.experiment.data import Experiment
from service.experiment.errors import CampaignError, ExperimentFileError, JournalError
from service.experiment.file import read
from service.experiment.plan import Profile
from sim.reference import reference_datasheet, reference_rig
from sim.twin import linear_model

SMALL = Profile(
    accuracy=0.005, points=24, validation_points=5, amplifier_points=5, coarse_points=8, rig_seconds=100.0
)  # fmt: skip
PEAKS = Profile(
    accuracy=0.005,
    from_hz=380.0,
    points=45,
    validation_points=4,
    amplifier_points=2,
    coarse_points=6,
    rig_seconds=120.0,
)
SHEET = reference_datasheet()


def campaign(rig, folder, profile=SMALL, sheet=SHEET, **options) -> Experiment:
    controller = rig if not hasattr(rig, "rotor") else SimulatedController(rig, seed=1)
    return run_campaign(controller, sheet, folder, profile=profile, **options)


def same(one: Experiment, other: Experiment) -> None:
    assert [s.comment for s in one.sweeps] == [s.comment for s in other.sweeps]
    for a, b in zip(one.sweeps, other.sweeps, strict=True):
        assert a.flags == b.flags
        for name in ("frequency_hz", "axis", "amplitude_a", "U", "I", "Y"):
            np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-12, atol=0, err_msg=name)


def plant(sweep, n=4):
    """Frequencies and G = Y U^-1, (F, n, n)."""
    f = np.unique(sweep.frequency_hz)
    assert sweep.n_points == n * len(f)
    assert np.array_equal(sweep.axis, np.tile(np.arange(n), len(f)))
    U, Y = (x[:, :, 1].mean(axis=1).reshape(len(f), n, n).swapaxes(1, 2) for x in (sweep.U, sweep.Y))
    return f, Y @ np.linalg.inv(U)


def relative_error(sweep, rig):
    f, G = plant(sweep)
    truth = linear_model(rig, f).y_per_u
    plane = np.kron(np.eye(2), np.ones((2, 2)))
    return f, np.linalg.norm((G - truth) * plane, axis=(1, 2)) / np.linalg.norm(truth * plane, axis=(1, 2))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A finished campaign on the reference rig, and its progress reports."""
    folder = tmp_path_factory.mktemp("campaign")
    reports = []
    return folder, campaign(reference_rig(), folder, progress=reports.append), reports


def test_all_sweeps_are_there_and_the_file_has_them(whole):
    folder, experiment, _ = whole
    assert [s.comment for s in experiment.sweeps] == ["main", "validation", "amplifier", "noise", "preliminary"]
    assert [s.kind for s in experiment.sweeps].count("noise") == 1
    assert {p.name for p in folder.iterdir()} == {"experiment.h5"}
    same(read(folder / "experiment.h5"), experiment)


def test_the_plant_is_measured_as_accurately_as_asked(whole):
    _, experiment, _ = whole
    for name in ("main", "validation"):
        _, error = relative_error(experiment.named(name), reference_rig())
        assert np.median(error) < SMALL.accuracy
        assert np.max(error) < 8 * SMALL.accuracy


def test_validation_is_on_other_frequencies_at_another_amplitude(whole):
    _, experiment, _ = whole
    main, other = experiment.named("main"), experiment.named("validation")
    assert not set(main.frequency_hz) & set(other.frequency_hz)
    ratio = []
    for f, axis, a in zip(other.frequency_hz, other.axis, other.amplitude_a, strict=True):
        near = np.argmin(np.abs(main.frequency_hz[main.axis == axis] - f))
        ratio.append(a / main.amplitude_a[main.axis == axis][near])
    assert np.mean(np.abs(np.log(ratio)) > np.log(1.3)) > 0.7  # a neighbour is not quite the same frequency


def test_amplifiers_are_measured_to_three_kilohertz(whole):
    _, experiment, _ = whole
    sweep = experiment.named("amplifier")
    assert sweep.frequency_hz.max() == pytest.approx(3000, rel=0.02)
    k = np.arange(sweep.n_points)
    measured = sweep.I[k, :, 1, sweep.axis].mean(axis=1) / sweep.U[k, :, 1, sweep.axis].mean(axis=1)
    truth = linear_model(reference_rig(), sweep.frequency_hz).i_per_u[k, sweep.axis, sweep.axis]
    assert np.median(np.abs(measured / truth - 1)) < 2 * SMALL.accuracy


def test_displacement_stays_within_its_share_of_the_linear_range(whole):
    _, experiment, _ = whole
    main = experiment.named("main")
    assert np.max(np.abs(main.Y[:, :, 1])) < 1.6 * SMALL.displacement_share * SHEET.linear_range_m


def test_progress_counts_up_to_its_total(whole):
    _, experiment, reports = whole
    assert [r.done for r in reports] == list(range(1, len(reports) + 1))
    assert reports[-1].done == reports[-1].total
    assert all(r.total >= r.done and r.seconds_left >= 0 for r in reports)
    assert reports[-1].rig_seconds == pytest.approx(float(experiment.attributes["rig_seconds"]), abs=1e-3)
    assert {"noise", "preliminary", "main", "validation", "amplifier"} <= {r.phase for r in reports}
    assert "Hz axis" in reports[-1].last
    assert sum(r.seconds_left > 0 for r in reports) > len(reports) / 2


def test_the_same_seed_gives_the_same_experiment(whole, tmp_path):
    same(campaign(reference_rig(), tmp_path), whole[1])


@pytest.mark.parametrize("frequencies_hz", [None, (430.0, 850.0)])
def test_peaks_are_found_and_resolved_wherever_the_rig_has_them(tmp_path, frequencies_hz):
    rig = reference_rig()
    if frequencies_hz:
        modes = tuple(
            tuple(replace(m, natural_frequency_rad_s=2 * np.pi * f) for m, f in zip(plane, frequencies_hz, strict=True))
            for plane in rig.rotor.modes
        )
        rig = replace(rig, rotor=replace(rig.rotor, modes=modes))
    reports = []
    experiment = campaign(rig, tmp_path, PEAKS, progress=reports.append)
    assert "peaks" in {r.phase for r in reports}
    f = np.unique(experiment.main.frequency_hz)
    dense = np.linspace(390, 990, 60_001)
    G = linear_model(rig, dense).y_per_u
    for plane in (slice(0, 2), slice(2, 4)):
        size = np.linalg.norm(G[:, plane, plane], axis=(1, 2))
        tops = [k for k in range(1, len(size) - 1) if size[k - 1] < size[k] > size[k + 1] and size[k] > 1e-6]
        assert len(tops) == 2
        for top in tops:
            wide = np.abs(dense - dense[top]) < 5
            wide &= size > size[top] / np.sqrt(2)
            low, high = dense[wide][0], dense[wide][-1]
            slack = 0.1 * (high - low)
            assert np.sum((f >= low - slack) & (f <= high + slack)) >= PEAKS.peak_points, dense[top]


# ---- interruptions


class Faulty:
    """A simulated rig with something wrong on the way: ``fault(n)`` may raise before the n-th measurement."""

    def __init__(self, fault, rig=None):
        self.inner = SimulatedController(rig or reference_rig(), seed=1)
        self.fault, self.n, self.stops = fault, 0, 0

    def __getattr__(self, name):
        return getattr(self.inner, name)

    def measure(self, tone):
        self.n += 1
        self.fault(self.n)
        return self.inner.measure(tone)

    def stop(self):
        self.stops += 1
        self.inner.stop()


def interrupted_at(n, error):
    def fault(k):
        if k == n:
            raise error

    return fault


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
        same(read(tmp_path / "experiment.h5"), kept)
        assert kept.named("preliminary").n_points > 0
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
    plant(experiment.main)


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


def test_a_bus_that_fails_now_and_then_costs_nothing(tmp_path, whole):
    def fault(k):
        if k % 40 == 7:
            raise BusError("no answer within 0.3 s")

    same(campaign(Faulty(fault), tmp_path), whole[1])


def test_a_bus_that_fails_for_good_ends_the_campaign_and_keeps_the_points(tmp_path, monkeypatch):
    monkeypatch.setattr("service.experiment.campaign.FIRST_PAUSE_S", 0.001)

    def fault(k):
        if k >= 60:
            raise BusError("no answer within 0.3 s")

    rig = Faulty(fault)
    with pytest.raises(BusError, match="no answer"):
        campaign(rig, tmp_path)
    assert rig.n == 65
    assert rig.stops
    assert read(tmp_path / "experiment.h5").main.n_points > 4


# ---- trips and poor points


def test_a_rig_that_trips_easily_is_measured_at_lower_amplitude_and_marked(tmp_path):
    class Fragile(Faulty):
        """Says that it allows 80 um, and trips at one."""

        def capabilities(self):
            return replace(self.inner.capabilities(), displacement_limit_m=80e-6)

    rig = Fragile(lambda k: None, replace(reference_rig(), displacement_limit_m=1.0e-6))
    experiment = campaign(rig, tmp_path, replace(SMALL, points=16, validation_points=2, amplifier_points=2))
    main = experiment.main
    tripped = np.array(["after a displacement trip" in f for f in main.flags])
    assert tripped.any()
    f, _ = plant(main)
    assert len(f) >= 16
    assert np.all(main.amplitude_a > 0)
    assert np.max(np.abs(main.Y[:, :, 1])) < 1.0e-6
    assert rig.status().trip == 0


def test_a_point_that_trips_at_every_amplitude_stays_in_the_sweep(tmp_path):
    class Allergic(Faulty):
        """Trips on every tone of axis 1 between 90 and 130 Hz, as a rig with a loose part might."""

        tripped = False

        def measure(self, tone):
            from drivers.errors import TripError

            if tone.axis == 1 and tone.amplitude_a > 0 and 90 < tone.frequency_hz(10_000) < 130:
                raise TripError("displacement", "displacement of axis xB reached 81 um, over the limit of 80 um")
            return self.inner.measure(tone)

    experiment = campaign(Allergic(None), tmp_path, replace(SMALL, validation_points=2, amplifier_points=2))
    main = experiment.main
    lost = (main.axis == 1) & (main.frequency_hz > 90) & (main.frequency_hz < 130)
    assert lost.any()
    assert np.all(main.amplitude_a[lost] == 0)
    assert all("not measured: displacement trip" in main.flags[k] for k in np.flatnonzero(lost))
    assert np.all(main.amplitude_a[~lost] > 0)
    assert read(tmp_path / "experiment.h5").main.flags == main.flags


def test_a_rig_that_does_not_come_to_rest_is_left_alone(tmp_path):
    from drivers.errors import TripError

    def fault(k):
        if k > 60:
            raise TripError("displacement", "displacement of axis xB reached 300 um, over the limit of 80 um")

    rig = Faulty(fault)
    with pytest.raises(CampaignError, match="did not come to rest"):
        campaign(rig, tmp_path)
    assert rig.n < 70
    assert recover(tmp_path).main.n_points > 4
    # someone has seen to the rig: the campaign goes on, and the point that tripped stays marked
    experiment = campaign(Faulty(lambda k: None), tmp_path)
    assert sum("not measured" in f for s in experiment.sweeps for f in s.flags) == 1


def test_an_amplifier_at_its_voltage_limit_is_repeated_lower_and_marked(tmp_path):
    rig = reference_rig()
    limited = replace(rig, amplifiers=replace(rig.amplifiers, slew_limit_a_per_s=np.full(4, 500.0)))
    profile = replace(SMALL, accuracy=0.002, points=16, validation_points=2, amplifier_points=8)
    experiment = campaign(limited, tmp_path, profile)
    flags = [f for s in experiment.sweeps for f in s.flags]
    assert any("current was distorted" in f for f in flags)
    assert not any("trip" in f for f in flags)
    # what the first distorted point showed holds for all that follow
    assert sum("distorted" in f for f in flags) < 8
    for sweep in (experiment.named("main"), experiment.named("amplifier")):
        k = np.arange(sweep.n_points)
        slew = 2 * np.pi * sweep.frequency_hz * np.abs(sweep.I[k, :, 1, sweep.axis]).mean(axis=1)
        assert np.all(slew < 500)


def test_a_noisy_rig_is_excited_harder_and_for_longer(whole, tmp_path):
    from sim.rig import Noise

    loud = reference_rig(noise=Noise(displacement_m=200e-9, current_a=20e-3))
    profile = replace(SMALL, validation_points=2, amplifier_points=2)
    experiment = campaign(loud, tmp_path, profile)
    quiet = whole[1].main
    assert np.median(experiment.main.amplitude_a) > 2 * np.median(quiet.amplitude_a)
    assert np.median(experiment.main.block_samples) > 1.3 * np.median(quiet.block_samples)


def test_a_controller_without_records_gives_the_same_sweeps(tmp_path):
    class NoRecords(Faulty):
        def capabilities(self):
            return replace(self.inner.capabilities(), raw_records=False)

        def measure(self, tone):
            assert not tone.raw
            return super().measure(tone)

    experiment = campaign(NoRecords(lambda k: None), tmp_path, replace(SMALL, points=16))
    assert [s.comment for s in experiment.sweeps] == ["main", "validation", "amplifier", "noise", "preliminary"]
    _, error = relative_error(experiment.main, reference_rig())
    assert np.median(error) < SMALL.accuracy


# ---- what is refused before anything moves


def refused(error, match, controller, folder, sheet=SHEET, **options):
    with pytest.raises(error, match=match) as caught:
        run_campaign(controller, sheet, folder, profile=SMALL, **options)
    assert "\n" not in str(caught.value)
    assert controller.n == 0


def test_a_folder_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    refused(ExperimentFileError, "nothing has moved", Faulty(None), tmp_path / "file" / "out")


def test_a_datasheet_of_another_rig(tmp_path):
    other = replace(SHEET, axes=("xA", "xB"))
    refused(CampaignError, "give the datasheet of this rig", Faulty(None), tmp_path, other)
    refused(CampaignError, "sample_time_s", Faulty(None), tmp_path, replace(SHEET, sample_time_s=5e-5))


def test_a_rig_that_another_host_holds(tmp_path):
    rig = Faulty(None)
    other = SimulatedController(rig.inner._device)
    with other.lease("another host"):
        refused(LeaseError, "another host", rig, tmp_path)


@pytest.mark.parametrize(("state", "said"), [(State.TRIPPED, "acknowledge it first"), (State.OFF, "switch it on")])
def test_a_rig_that_is_tripped_or_off(tmp_path, state, said):
    class Down(Faulty):
        def status(self) -> Status:
            return replace(self.inner.status(), state=state, trip_message="displacement of axis xA")

    refused(CampaignError, said, Down(None), tmp_path)


def test_a_journal_of_another_rig_or_profile(tmp_path):
    with pytest.raises(CancelledError):
        campaign(Faulty(interrupted_at(20, KeyboardInterrupt())), tmp_path)
    before = (tmp_path / "experiment.journal").read_bytes()
    refused(JournalError, "datasheet_sha256", Faulty(None), tmp_path, replace(SHEET, mass_kg=281.0))
    assert (tmp_path / "experiment.journal").read_bytes() == before
    with pytest.raises(JournalError, match="its profile is"):
        campaign(Faulty(None), tmp_path, replace(SMALL, points=25))


def test_starting_anew_puts_the_old_journal_and_experiment_aside(tmp_path):
    tiny = replace(SMALL, points=16, validation_points=2, amplifier_points=2)
    with pytest.raises(CancelledError):
        campaign(Faulty(interrupted_at(60, KeyboardInterrupt())), tmp_path, tiny)
    campaign(Faulty(lambda k: None), tmp_path, tiny, resume=False)
    assert {p.name for p in tmp_path.iterdir()} == {
        "experiment.h5",
        "experiment.previous-1.h5",
        "experiment.previous-1.journal",
    }


def test_a_journal_whose_next_point_is_another_one(tmp_path):
    from service.experiment.journal import entries, line

    with pytest.raises(CancelledError):
        campaign(Faulty(interrupted_at(20, KeyboardInterrupt())), tmp_path)
    path = tmp_path / "experiment.journal"
    found, _ = entries(path.read_bytes())
    found[10]["request"]["samples"] += 1
    path.write_bytes(b"".join(line(e) for e in found))
    with pytest.raises(JournalError, match="another plan"):
        campaign(Faulty(lambda k: None), tmp_path)


def test_recovering_without_a_journal(tmp_path):
    with pytest.raises(JournalError, match="cannot read"):
        recover(tmp_path)


def test_progress_is_plain_data(whole):
    from dataclasses import asdict

    assert json.loads(json.dumps(asdict(whole[2][-1])))["phase"] == "amplifier"
